"""Law, link and wall turned on the page, and what the page says of it."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.browser import Page
from tests.live.page.browser.mock import LAWS, Mock
from tests.waiting import until

pytestmark = pytest.mark.live


def labels(page: Page) -> list[str]:
    got: list[str] = page.evaluate("[...document.querySelectorAll('#sliders label')].map(one => one.innerText)")
    return [" ".join(one.split()) for one in got]


def test_a_slider_asks_for_one_turn_when_it_rests_by_keyboard_and_by_mouse_on_a_logarithmic_scale(
    mock: Mock, page: Page, tab: Callable[..., Page]
) -> None:
    """And a turn on one page shows on the other."""
    assert labels(page) == ["Delay, each way 50 ms", "Jitter 0 ms", "Loss 0 %", "Wall stiffness 20 kN/m",
                            "Scale of the slave\u2019s motion 1 times the hand\u2019s"]
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


def test_the_scale_follows_its_slider_without_a_turn(mock: Mock, page: Page) -> None:
    page.evaluate("""const slider = document.getElementById('k_scale');
        slider.value = 1000;
        for (const name of ['input', 'change']) slider.dispatchEvent(new Event(name));""")
    until(lambda: mock.of("scale") and mock.of("scale")[-1] == {"type": "scale", "to": 4.0})
    assert mock.of("turn") == []
    assert labels(page)[-1].endswith("4 times the hand\u2019s")
    mock.status = {**mock.status, "scale": 0.5}  # which another page has set
    page.until("document.getElementById('k_scale').getAttribute('aria-valuetext').startsWith('0.5')")


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
