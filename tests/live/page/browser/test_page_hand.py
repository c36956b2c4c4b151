"""A person's actions on the page, served by a mock or as it is served; what is lost is said, and that it came back."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from teleop.live.page.command import page_bytes
from tests.browser import Browser, Page
from tests.live.page.browser.mock import LAWS, WALL, Mock
from tests.live.page.conftest import TOKEN, Served
from tests.waiting import until

pytestmark = pytest.mark.live


def asked(mock: Mock) -> list[float | None]:
    """The places on the first axis that the hand was sent to, None: it let go."""
    return [None if message["to"] is None else message["to"][0] for message in mock.of("hand")]


def scale(page: Page) -> float:
    """How many px a metre of the scene has."""
    return float(page.evaluate("place().scale"))


def test_a_drag_moves_the_hand_by_as_much_as_the_pointer_moves_and_a_press_without_a_motion_does_not(
    mock: Mock, page: Page
) -> None:
    """The invitation goes at the first drag; what is pressed stays pressed when the pointer goes up."""
    page.click("#stage")
    page.until("drag === null")
    assert page.text("#invite") == "Drag the handle into the wall"
    assert page.evaluate("document.getElementById('invite').getBoundingClientRect().height") > 0
    assert [to for to in asked(mock) if to is not None] == []
    start = page.evaluate("row.hand[0]")
    page.drag(page.place("#stage"), (-(start + 0.02) * scale(page), 20.0))
    until(lambda: asked(mock) and asked(mock)[-1] == pytest.approx(-0.02, abs=2e-4))
    assert page.evaluate("document.getElementById('invite').getBoundingClientRect().height") == 0
    page.until("row.xs[0] < 0")
    page.drag(page.place("#stage"), (0.07 * scale(page), 0.0))
    page.until(f"row.xs[0] > {WALL} && row.fm[0] > 1")
    heard, t = len(asked(mock)), page.evaluate("row.t")
    page.until(f"row.t > {t} + 1 && row.fm[0] > 1")
    assert len(asked(mock)) > heard  # it says so again, so that a page that is gone is missed
    assert set(asked(mock)[heard:]) == {asked(mock)[-1]}


def test_of_six_joints_the_one_that_is_chosen_is_shown_and_dragged_and_the_others_stay(
    server: Callable[..., Mock], tab: Callable[..., Page]
) -> None:
    mock = server(axes=6)
    page = tab(mock.url)
    assert page.evaluate("[...$('axes').children].map(one => one.firstChild.textContent).join()") == (
        "joint1,joint2,joint3,joint4,joint5,joint6")
    page.click("#axes button:nth-child(5)")
    assert page.evaluate("[...$('axes').children].map(one => one.ariaPressed).join()") == (
        "false,false,false,false,true,false")
    assert page.evaluate("view.span") == 0.4, "its own"
    before = page.evaluate("row.all.hand")
    page.drag(page.place("#stage"), (100.0, 0.0))
    until(lambda: mock.of("hand") and mock.of("hand")[-1]["to"] is not None
          and mock.of("hand")[-1]["to"][4] == pytest.approx(before[4] + 100.0 / scale(page), abs=2e-4))
    *others, _, last = mock.of("hand")[-1]["to"]
    assert [*others, last] == pytest.approx([*before[:4], before[5]], abs=1e-3)
    page.until("row.xs[0] === row.all.xs[4] && row.xs[0] > .01")
    page.until("document.querySelector('figure span').textContent.endsWith('mrad')")
    assert page.console == []


def test_the_hand_lets_go_by_key_by_button_by_a_double_click_and_as_the_scene_is_started_again(
    mock: Mock, page: Page
) -> None:
    for how in ("Escape", "button", "double click", "again"):
        page.drag(page.place("#stage"), (40.0, 0.0))
        until(lambda: asked(mock) and asked(mock)[-1] is not None)
        if how == "Escape":
            page.key("Escape")
        elif how == "button":
            page.click("#go")
        elif how == "again":
            page.key("r")
        else:
            x, y = page.place("#stage")
            for count in (1, 2):
                page.mouse("mousePressed", x, y, clickCount=count)
                page.mouse("mouseReleased", x, y, clickCount=count)
        until(lambda: asked(mock)[-1] is None, how)
        t = page.evaluate("row.t")
        page.until(f"row.t > {t} + .4")
        assert asked(mock)[-1] is None, f"{how}: nothing holds it any more"
    assert mock.of("again")
    page.until("row.hand[0] > .05")  # the scene's own motion
    assert asked(mock)[-1] is None


def test_a_flood_of_pointer_events_becomes_at_most_sixty_messages_a_second(page: Page) -> None:
    page.evaluate("""(() => {
      window.requestAnimationFrame = often;
      window.times = [];
      const send = socket.send.bind(socket);
      socket.send = text => { if (text.includes('"hand"')) times.push(performance.now()); send(text); };
      window.flood = setInterval(() => { for (let i = 0; i < 20; i++) steer([.02 + .0001 * Math.random()]); }, 1);
    })()""")
    page.until("times.length > 120")
    span = page.evaluate("clearInterval(flood), (times[120] - times[0]) / 1e3")
    assert 120 / span <= 61.0  # a second; the stamps are taken within the frame, a little after it is decided


def test_a_finger_drags(mock: Mock, tab: Callable[..., Page]) -> None:
    page = tab(mock.url, width=360, height=800, mobile=True)
    page.call("Emulation.setTouchEmulationEnabled", enabled=True)
    x, y = page.place("#stage")
    page.touch("touchStart", (x, y))
    for i in range(1, 9):
        page.touch("touchMove", (x - 8 * i, y + 10 * i))  # downwards too: the page must not scroll instead
    page.touch("touchEnd")
    until(lambda: asked(mock) and asked(mock)[-1] == pytest.approx(0.06 - 64 / scale(page), abs=1e-3))


def test_arrow_keys_move_the_hand_and_shift_moves_it_finely_and_a_gamepad_is_a_hand_and_a_clutch(
    mock: Mock, page: Page
) -> None:
    page.key("Tab")
    assert page.evaluate("document.activeElement.id + document.activeElement.matches(':focus-visible')") == "stagetrue"
    for _ in range(3):
        page.key("ArrowLeft")
    until(lambda: asked(mock) and asked(mock)[-1] == pytest.approx(0.06 - 3 * 0.12 / 60, abs=2e-4))
    before = asked(mock)[-1]
    page.key("ArrowRight", shift=True)
    until(lambda: asked(mock)[-1] != before)
    assert asked(mock)[-1] == pytest.approx(before + 0.12 / 600, abs=1e-6)
    heard = len(asked(mock))
    page.evaluate("""(() => {
      window.fake = {axes: [-1, 0, 0, 0], buttons: [{pressed: true}]};
      navigator.getGamepads = () => [null, fake];
      window.dispatchEvent(new Event('gamepadconnected'));
    })()""")
    until(lambda: len(asked(mock)) > heard + 8)
    assert asked(mock)[-1] < asked(mock)[heard + 2] < 0.06
    until(lambda: mock.of("clutch") == [{"type": "clutch", "open": True}])
    page.evaluate("fake.buttons[0].pressed = false")
    until(lambda: mock.of("clutch")[1:] == [{"type": "clutch", "open": False}])


def test_three_axes_are_a_plane_and_a_wheel(server: Callable[..., Mock], tab: Callable[..., Page]) -> None:
    mock = server(axes=3)
    page = tab(mock.url)
    page.drag(page.place("#stage"), (-30.0, -40.0))
    until(lambda: mock.of("hand"))
    x, y = page.place("#stage")
    page.mouse("mouseWheel", x, y, deltaX=0, deltaY=-120)
    page.key("PageUp")
    want = [0.06 - 30 / scale(page), 40 / scale(page), 120 * 0.12 / 3e3 + 0.12 / 60]
    until(lambda: mock.of("hand")[-1]["to"] == pytest.approx(want, abs=5e-4), f"{want}")
    assert page.evaluate("scrollY") == 0


def test_the_clutch_is_open_while_it_is_held_by_mouse_or_key_and_the_window_has_the_keyboard(
    mock: Mock, page: Page
) -> None:
    pressed = "document.getElementById('clutch').getAttribute('aria-pressed') === "
    for how in ("mouse", "c", " ", "blur"):
        mock.heard.clear()
        x, y = page.place("#clutch")
        if how == "mouse":
            page.mouse("mousePressed", x, y)
        else:
            page.evaluate(f"document.{'getElementById(`clutch`).focus' if how == ' ' else 'activeElement.blur'}()")
            key = "c" if how == "blur" else how
            page.key(key, "down")
            page.key(key, "down", repeat=True)
        until(lambda: mock.of("clutch") == [{"type": "clutch", "open": True}], how)
        page.until(pressed + "'true'")
        if how == "mouse":
            page.mouse("mouseReleased", x, y)
        elif how == "blur":
            page.evaluate("window.dispatchEvent(new Event('blur'))")
        else:
            page.key(how, "up")
        until(lambda: mock.of("clutch")[1:] == [{"type": "clutch", "open": False}], how)
        page.until(pressed + "'false'")


def labels(page: Page) -> list[str]:
    got: list[str] = page.evaluate("[...document.querySelectorAll('#sliders label')].map(one => one.innerText)")
    return [" ".join(one.split()) for one in got]


def test_a_slider_asks_for_one_turn_when_it_rests_by_keyboard_and_by_mouse_on_a_logarithmic_scale(
    mock: Mock, page: Page, tab: Callable[..., Page]
) -> None:
    """And a turn on one page shows on the other."""
    assert labels(page) == ["Delay, each way 50 ms", "Jitter 0 ms", "Loss 0 %", "Wall stiffness 20 kN/m",
                            "Scale of the slave\u2019s motion 1 times the hand\u2019s"]
    page.evaluate("""const slider = document.getElementById('k_scale');
        slider.value = 1000;
        for (const name of ['input', 'change']) slider.dispatchEvent(new Event(name));""")
    until(lambda: mock.of("scale") and mock.of("scale")[-1] == {"type": "scale", "to": 4.0})
    assert mock.of("turn") == [], "the scale follows its slider without a turn"
    assert labels(page)[-1].endswith("4 times the hand\u2019s")
    mock.status = {**mock.status, "scale": 0.5}  # which another page has set
    page.until("document.getElementById('k_scale').getAttribute('aria-valuetext').startsWith('0.5')")
    # Ten steps in one go, for on a busy machine a slider rests between two keys.
    page.evaluate("""for (let i = 0; i < 9; i++) {
        const delay = document.getElementById('k_delay');
        delay.focus();
        delay.stepUp();
        for (const name of ['input', 'change']) delay.dispatchEvent(new Event(name));
    }""")
    until(lambda: mock.of("turn"))
    assert mock.of("turn") == [{"type": "turn", "delay": 0.063}]
    page.key("ArrowRight")
    page.until("hello.link === 'delay(0.065)'")
    assert mock.of("turn")[1:] == [{"type": "turn", "delay": 0.065}]
    assert labels(page)[0] == "Delay, each way 65 ms"
    assert page.evaluate("document.getElementById('k_delay').getAttribute('aria-valuetext')") == "65 ms"
    x, y = page.place("#k_k_e")
    page.mouse("mousePressed", x, y)
    page.mouse("mouseReleased", x, y)
    until(lambda: len(mock.of("turn")) == 3)
    assert mock.of("turn")[2]["k_e"] == pytest.approx((50 * 1e5) ** 0.5, rel=0.05)  # the middle of 50 and 1e5
    other = tab(mock.url)
    other.evaluate("document.getElementById('k_loss').focus()")
    other.key("ArrowRight")
    page.until("document.getElementById('k_loss').getAttribute('aria-valuetext') !== '0 %'")
    assert labels(page) == labels(other)


def test_a_law_is_switched_on_the_running_system_and_what_shakes_is_called_so(mock: Mock, page: Page) -> None:
    assert page.text("#says") == LAWS["wave"]
    page.evaluate("document.getElementById('law').focus()")
    page.key("ArrowDown")
    until(lambda: mock.of("turn") == [{"type": "turn", "law": "direct"}])
    page.until("hello.law === 'direct'")
    assert page.text("#says") == LAWS["direct"]
    page.until("document.getElementById('said').textContent.includes('a new session')")
    assert page.evaluate("document.getElementById('said').getAttribute('aria-live')") == "polite"
    page.until("rows.some(one => one.mark)")  # a line in the strips
    page.evaluate("socket.send(JSON.stringify({type: 'turn', law: 'direct', delay: .2}))")
    page.until("document.getElementById('said').className === 'warn'")
    assert "The swing grows" in page.text("#said")
    assert page.evaluate("getComputedStyle(document.getElementById('said')).fontWeight") == "600"
    mock.send({**mock.hello(), "law": "deadband(0.1) | wave"})  # one that is not in the list
    page.until("document.getElementById('law').value === 'deadband(0.1) | wave'")
    assert page.evaluate("document.getElementById('law').options.length") == 3


def test_an_open_clutch_was_said_to_be_a_scene_that_keeps_no_energy(mock: Mock, page: Page) -> None:
    of_none = "(row.E = null, rescale(), document.querySelectorAll('figure')[2].querySelector('span').textContent)"
    page.until("document.querySelector('#energy + span').textContent.endsWith('J')")
    page.evaluate("socket.send(JSON.stringify({type: 'clutch', open: true}))")
    page.until("rows.at(-1).E === null")
    page.until("document.querySelector('#energy + span').textContent === '\u2013'")
    assert page.evaluate(of_none) == "\u2013"
    mock.energy = None
    mock.send(mock.hello())
    page.until("hello.energy === null")
    assert page.evaluate(of_none) == "not kept in this scene"


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
