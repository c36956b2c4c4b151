"""The page as its own server serves it; what is lost is said, and that it came back; what a reload shows."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from teleop.live.page.command import page_bytes
from tests.browser import Browser, Page
from tests.live.page.browser.mock import Mock
from tests.live.page.conftest import TOKEN, Served
from tests.waiting import until

pytestmark = pytest.mark.live


def test_a_server_that_is_gone_is_said_and_so_is_its_return_and_who_listens_there_meanwhile_is_not_sent_the_token(
    server: Callable[..., Mock], tab: Callable[..., Page]
) -> None:
    """A page that came back sent it every four seconds to whoever listened there."""
    asked: list[str] = []

    class Stranger(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            asked.append(f"{self.path} {self.headers}")
            self.send_response(200)
            self.end_headers()
            self.wfile.write(b"0" * 64)

        def log_message(self, *_words: object) -> None:
            pass

    mock = server()
    page = tab(mock.url)
    token = mock.url.partition("token=")[2]
    assert token
    page.drag(page.place("#stage"), (40.0, 0.0))
    mock.stop()
    page.until("document.getElementById('said').className === 'error'")
    assert "The server does not answer" in page.text("#said")
    assert page.text("#conn").startswith("not connected")
    t = page.evaluate("row.t")
    with ThreadingHTTPServer(("127.0.0.1", mock.port), Stranger) as stranger:
        threading.Thread(target=stranger.serve_forever, daemon=True).start()
        until(lambda: len(asked) > 1)
        stranger.shutdown()
    assert all(each.startswith("/proof?nonce=") for each in asked)
    assert token not in "".join(asked)
    assert len({each.split()[0] for each in asked}) == len(asked), "a proof cannot be used twice"
    server(port=mock.port)
    page.until("document.getElementById('conn').textContent === 'connected'")
    assert page.text("#said") == "The demo runs again, and this page shows it."
    page.until(f"row.t !== {t} && rows.length > 10")
    assert page.evaluate("target") is None  # it does not take the hand of a run that it did not drag


def test_a_server_that_stands_still_is_not_called_connected(mock: Mock, page: Page) -> None:
    page.until("rows.length > 10")
    mock.silent = True
    page.until("document.getElementById('conn').textContent === 'no answer'")
    assert page.evaluate("document.getElementById('conn').className") == "lost"
    assert "the connection is cut" in page.text("#said")
    mock.silent = False
    page.until("document.getElementById('conn').textContent === 'connected'")
    assert page.text("#said") == "The server answers again."


def test_a_part_that_is_lost_is_said_where_one_looks_and_sentences_of_the_server_are_shown_as_text(
    mock: Mock, page: Page
) -> None:
    who = "the master"
    assert page.text("#conn") == "connected"
    safe = {"gain": 0.0, "cause": "silence: nothing heard for 0.2 s"}
    mock.status = {"lost": who, "m": safe, "s": {"gain": 1.0, "cause": None}}
    page.until(f"document.getElementById('conn').textContent === '{who} is lost'")
    assert page.evaluate("document.getElementById('conn').className") == "lost"
    assert page.text("#gm") == "Master’s force 0 %: silence: nothing heard for 0.2 s"
    mock.status = {"lost": None, "m": {"gain": 1.0, "cause": None}, "s": {"gain": 1.0, "cause": None}}
    page.until("document.getElementById('conn').textContent === 'connected'")
    page.until("document.getElementById('gm').className === ''")
    mock.say("error", "<b>the slave</b> is gone")
    page.until("document.getElementById('said').textContent.includes('<b>the slave</b> is gone')")


def test_a_reload_and_a_second_tab_show_the_last_ten_seconds_and_what_begins_anew_empties_the_strips(
    mock: Mock, page: Page, tab: Callable[..., Page]
) -> None:
    page.until("rows.length > 90")
    page.evaluate("window.old = true")
    page.call("Page.reload")
    page.until("!window.old && document.readyState === 'complete' && row !== null")
    other = tab(mock.url)
    for one in (page, other):
        assert one.evaluate("rows[0].t") < 0.1
        assert one.evaluate("rows.length") > 90
        assert one.console == []
    # A part of the run that begins anew in time empties the strips.
    mock.world.t = 0.0
    page.until("rows[0].t < .1 && row.t < 5")
    page.until("rows.length > 5")


def test_a_browser_without_websockets_is_told_so(mock: Mock, browser: Browser) -> None:
    page = browser.page(width=800, height=600)
    page.call("Page.addScriptToEvaluateOnNewDocument", source="delete window.WebSocket")
    page.go(mock.url)
    page.until("document.getElementById('said').className === 'error'")
    assert "This browser has no WebSocket" in page.text("#said")
    assert page.console == []
    page.close()


def test_a_browser_without_javascript_is_told_so(mock: Mock, browser: Browser) -> None:
    page = browser.page(width=800, height=600)
    page.call("Emulation.setScriptExecutionDisabled", value=True)
    page.call("Page.navigate", url=mock.url)
    until(lambda: "'noscript'" in str(page.call("DOM.getDocument", depth=-1)), "the page did not come")
    document = page.call("DOM.getDocument")
    at = page.call("DOM.querySelector", nodeId=document["root"]["nodeId"], selector="noscript p")["nodeId"]
    assert page.call("DOM.getBoxModel", nodeId=at)["model"]["height"] > 20
    assert "needs JavaScript" in page.call("DOM.getOuterHTML", nodeId=at)["outerHTML"]
    for box in page.call("DOM.querySelectorAll", nodeId=document["root"]["nodeId"],
                         selector=".card, button, canvas, footer")["nodeIds"]:
        html = page.call("DOM.getOuterHTML", nodeId=box)["outerHTML"]
        if "needs JavaScript" not in html:
            with pytest.raises(AssertionError):  # it has no box
                page.call("DOM.getBoxModel", nodeId=box)
    page.close()


def test_a_drag_reaches_the_master_and_a_law_is_switched_while_it_is_held(
    served: Callable[..., Served], tab: Callable[..., Page]
) -> None:
    def look(served: Served) -> None:
        page = tab(f"http://{served.host}/?token={TOKEN}")
        page.drag(page.place("#stage"), (page.evaluate("(.058 - base()[0]) * place().scale"), 0.0))
        page.until("Math.abs(row.xm[0] - .058) < 1e-3 && row.fm[0] > 1 && row.fe[0] > .3")
        page.evaluate("document.getElementById('law').focus()")
        page.key("ArrowDown")  # the one below wave
        page.until("hello.law === 'wave_filter' && document.getElementById('law').value === 'wave_filter'")
        page.until("status.parts === 2")
        page.until("row.gain[0] === 1 && row.gain[1] === 1 && Math.abs(row.xm[0] - .058) < 1e-3")
        page.key("Escape")
        page.until("target === null")
        assert page.console == []

    async def scenario(page: Served) -> None:
        await asyncio.to_thread(look, page)
        await page.until(lambda: page.orders("master")[-1] == {"order": "hand", "to": None})

    index = served(scenario, html=page_bytes()).index()
    assert [part["knobs"].get("law", "wave") for part in index["parts"]] == ["wave", "wave_filter"]
