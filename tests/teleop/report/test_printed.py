"""A page in a real browser: it prints on two sheets at most, and its browser has nothing to say against it."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

from teleop import Result, load_scene, run
from teleop.report.of_runs import RunView, of_one, of_parts, of_several
from teleop.report.page import page
from tests.browser import Browser
from tests.programs import BROWSERS, program

pytestmark = pytest.mark.live


def printed(html: bytes, at: Path) -> tuple[int, str]:
    """The sheets of a page that is printed, and what the browser's console says."""
    (at / "page.html").write_bytes(html)
    done = subprocess.run(
        [program(*BROWSERS), "--headless=new", "--no-sandbox", "--disable-gpu", f"--user-data-dir={at / 'profile'}",
         "--enable-logging=stderr", "--v=0", "--no-pdf-header-footer", f"--print-to-pdf={at / 'page.pdf'}",
         (at / "page.html").as_uri()], capture_output=True, text=True, check=True, timeout=120)
    console = "\n".join(line for line in done.stderr.splitlines() if "CONSOLE" in line)
    return len(re.findall(rb"/Type\s*/Page\b(?!s)", (at / "page.pdf").read_bytes())), console


def told(result: Result, name: str = "here") -> RunView:
    return RunView(name, result, result.summary(["teleop", "run", result.scene]))


PARTED = """[...document.querySelectorAll('td.k, th[scope=row]:not(.w), span.k')].filter(each => {
  const range = document.createRange();
  range.selectNodeContents(each);
  return new Set([...range.getClientRects()].map(box => Math.round(box.bottom))).size > 1;
}).map(each => each.textContent)"""
OVERLAPPING = """[...document.querySelectorAll('svg')].flatMap(svg => {
  const boxes = [...svg.querySelectorAll('text')].map(each => [each.textContent, each.getBoundingClientRect()]);
  return boxes.flatMap(([a, one], i) => boxes.slice(0, i).filter(([b, other]) =>
    Math.min(one.right, other.right) - Math.max(one.left, other.left) > 1 &&
    Math.min(one.bottom, other.bottom) - Math.max(one.top, other.top) > 3).map(([b, _]) => a + ' over ' + b));
})"""


@pytest.mark.full
def test_a_page_of_parts_parted_numbers_from_their_units_and_was_as_narrow_as_a_column_of_text(tmp_path: Path) -> None:
    results = [run(load_scene("hard_wall", duration=0.8, **knobs)) for knobs in (
        {"law": "wave"}, {"law": "tdpa"}, {"law": "direct", "delay": 0.15}, {"law": "iss", "k_e": 4000.0})]
    parts = of_parts("pg", [told(each, f"{i:02}") for i, each in enumerate(results)], [(0, "switched")] * 4,
                     {"scene": "hard_wall", "command": []})
    (tmp_path / "page.html").write_bytes(page([parts, of_one(told(results[1]))]))
    browser = Browser()
    try:
        for width in (1280, 800):
            tab = browser.page((tmp_path / "page.html").as_uri(), width=width, height=900)
            assert tab.evaluate(PARTED) == []
            assert tab.evaluate(OVERLAPPING) == []
            assert tab.evaluate("document.documentElement.scrollWidth") <= width, "the page itself does not scroll"
            assert tab.evaluate("document.querySelector('svg').getBoundingClientRect().width") > 0.85 * width
    finally:
        browser.close()


@pytest.mark.full
def test_a_run_is_printed_on_two_sheets_at_most_and_six_on_three(tmp_path: Path) -> None:
    sheets, console = printed(page([of_one(told(run(load_scene("jittery_wan", duration=3.0))))]), tmp_path)
    assert 1 <= sheets <= 2
    assert console == ""
    results = [run(load_scene("hard_wall", duration=1.0, law=law)) for law in (
        "wave", "direct", "pp", "p_d", "iss", "tdpa")]
    sheets, console = printed(page([of_several([told(each, f"run-{i}") for i, each in enumerate(results)])]), tmp_path)
    assert 1 <= sheets <= 3
    assert console == ""
