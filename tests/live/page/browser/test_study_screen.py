"""The screen of a participant in a real browser: a session as a person would go through it, cut once and resumed."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest

from teleop.people.journal import read_journal
from teleop.people.trials.command import DOCUMENT
from tests.browser import Browser, Page
from tests.fakes import usually
from tests.live.page.browser.mock import Mock
from tests.live.page.test_real import NAMES, PLAN, StudySession
from tests.waiting import PATIENCE, until

pytestmark = pytest.mark.live

COMPARE = 'kind = "compare"\nstandard = 400.0\nlevels = [{levels}]\nseconds = 0.8\nrepeats = {repeats}'
QUESTIONS = '''
[[question]]
kind = "tlx"
[[question]]
kind = "text"
after = "session"
items = ["Anything to add?"]
'''


def answer_questions(page: Page) -> None:
    """Answer a questionnaire by mouse, which nothing is chosen in before, and wait for what comes after it."""
    page.evaluate("window.answered_screen = screen, 0")
    if page.evaluate("screen.kind") == "text":
        page.evaluate("document.querySelector('#form textarea').focus()")
        page.call("Input.insertText", text="No, thank you.")
    else:
        assert page.evaluate("[...document.querySelectorAll('#form input')].every(one => one.className === 'unset')")
        assert page.evaluate("document.querySelector('#form input').getAttribute('aria-valuetext')") == "not answered"
        for i in range(1, 7):
            assert page.evaluate("document.getElementById('next').disabled")
            page.click(f"#form fieldset:nth-of-type({i}) input")
    page.click("#next")
    page.until("screen !== answered_screen")


def press(page: Page) -> None:
    """Drag the handle until the page shows it a centimetre beyond the wall's surface, or the trial is over."""
    (x, y), by = page.place("#stage"), 380.0
    page.drag((x, y), (by, 0.0), steps=4, release=False)
    page.until("screen.screen !== 'trial' || row && row.xm[0] > hello.wall + .01")
    page.mouse("mouseReleased", x + by, y)


def sit(page: Page, trials: int) -> None:
    """Go through the session to its end, or until so many trials are done, with the mouse and the keys."""
    end = time.monotonic() + PATIENCE + 10.0 * trials
    while time.monotonic() < end:
        screen, done = page.evaluate("[screen.screen, screen.done]")
        if screen == "end" or (screen == "trial" and done >= trials):
            return
        if screen == "consent":
            page.evaluate("document.getElementById('code').focus()")
            page.call("Input.insertText", text="P1")
            page.click("#next")
        elif screen in ("instructions", "stopped"):
            page.click("#next")
        elif screen == "trial":
            press(page)
        elif screen == "answer" and done % 2:
            page.key("2")
        elif screen == "answer":
            page.click("#first")
        elif screen == "question":
            answer_questions(page)
        time.sleep(0.05)
    raise AssertionError(f"the session stands at {page.evaluate('screen')}")


@usually("trials", [4, 40], 4)
def test_a_person_goes_through_a_session_that_is_cut_once_and_is_sent_no_name_of_a_law(
    browser: Browser, tmp_path: Path, trials: int
) -> None:
    levels, repeats = ("200.0", 2) if trials == 4 else ("200.0, 900.0", 10)
    (tmp_path / "plan.toml").write_text(PLAN.format(task=COMPARE.format(levels=levels, repeats=repeats),
                                                    primary="time") + QUESTIONS)
    page = browser.page(width=900, height=800)
    page.call("Network.enable")
    try:
        with StudySession(tmp_path) as session:
            page.go(session.url)
            document = page.evaluate("document.documentElement.outerHTML")
            sit(page, trials // 2)
            session.interrupt()
        with StudySession(tmp_path, "--resume") as again:
            page.go(again.url)
            sit(page, trials + 1)
            page.until("document.getElementById('words').textContent.includes('Thank you')")
            again.wait()
        page.until("getComputedStyle(document.querySelector('footer')).visibility === 'hidden'")
        assert page.text("#said") == "", "the end of the server is no error"
    finally:
        page.close()
    rows = read_journal(tmp_path / "study" / "sub-01" / "journal.jsonl")
    done = [row for row in rows if row["kind"] == "trial"]
    assert [row["number"] for row in done] == [*range(1, trials + 1)]
    assert [row["again"] for row in done] == [int(i == trials // 2) for i in range(trials)]
    assert {row["answer"] for row in done} == {1, 2}
    assert sum(row["peak_force"] > 1.0 for row in done) > trials / 2, "the wall was pressed"
    assert all(row["refresh"] for row in done[1:])
    assert [row["texts"] for row in rows if "texts" in row] == [["No, thank you."]]
    assert len(page.frames) > 10 * trials
    for sent in (document, *page.frames):
        found = NAMES.search(sent)
        assert found is None, sent[max(0, found.start() - 80):found.end() + 80]


def test_answers_go_by_buttons_that_a_finger_hits_or_by_a_key_and_stop_by_a_key_at_any_time(
    browser: Browser, server: Callable[..., Mock]
) -> None:
    mock = server(document=DOCUMENT)
    mock.silent = True  # its rows are the page's
    page = browser.page(mock.url, width=900, height=800)

    def show(screen: str) -> None:
        mock.send({"type": "screen", "screen": screen, "done": 1, "trials": 4, "noun": "wall", "text": "Which?",
                   "seconds": 9.0, "interval": 1, "intervals": 2})
        page.until(f"screen.screen === '{screen}'")

    try:
        until(lambda: mock.clients)
        show("answer")
        sizes = page.evaluate("[...document.querySelectorAll('button')].filter(one => one.offsetParent).map("
                              "one => [one.id, Math.min(one.offsetWidth, one.offsetHeight)])")
        assert {name for name, _ in sizes} == {"first", "second", "stop", "leave"}
        assert min(size for _, size in sizes) >= 44
        page.key("2")
        page.click("#first")
        until(lambda: len(mock.of("answer")) == 2)
        assert [each["interval"] for each in mock.of("answer")] == [2, 1]
        for screen in ("turn", "trial", "break", "answer"):
            show(screen)
            page.key("Escape")
        until(lambda: len(mock.of("stop")) == 4)
    finally:
        page.close()
