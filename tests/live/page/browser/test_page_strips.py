"""The strips: axes, units and limits, the readout under the pointer, pause and history, and what each curve is of."""

from __future__ import annotations

import re
from collections.abc import Callable

import pytest

from tests.browser import Page
from tests.live.page.browser.mock import WALL, Mock

pytestmark = pytest.mark.live

COLUMN = """((strip, x, name) => {  // the rows of a column of pixels that have this colour, an edge of a line too
  const {canvas, c} = strips[strip], data = c.getImageData(Math.round(x * canvas.width), 0, 1, canvas.height).data;
  const want = [1, 3, 5].map(i => parseInt(C[name].slice(i, i + 2), 16)), found = [];
  for (let i = 0; i < data.length; i += 4)
    if (want.every((v, j) => Math.abs(data[i + j] - v) < 30) && data[i + 3] > 100) found.push(i / 4);
  return found;
})"""


def texts(page: Page, selector: str) -> list[str]:
    found: list[str] = page.evaluate(f"[...document.querySelectorAll('{selector}')].map(one => one.textContent)")
    return found


def point(page: Page, strip: int, share: float) -> None:
    """Put the pointer to this share of a strip's width."""
    x, y, width = page.evaluate(
        f"(b => [b.x, b.y + b.height / 2, b.width])(strips[{strip}].canvas.getBoundingClientRect())")
    page.mouse("mouseMoved", x + share * width, y)


def test_each_strip_has_its_time_axis_its_unit_round_limits_that_hold_what_it_shows_and_all_that_as_text(
    page: Page
) -> None:
    """An axis went from -63 to 87, and none said what its time was."""
    page.until("$('summary').textContent.includes('Queue')")
    text = page.text("#summary")
    assert text.startswith("Ten seconds up to now. Position, mm: from ")
    assert f"wall {1e3 * WALL:.0f} mm" in text
    assert page.evaluate("$('strips').getAttribute('aria-describedby')") == "summary"
    assert page.evaluate("getComputedStyle($('summary')).position") == "absolute"
    page.until("strips.every(one => one.figure.querySelector('.hi').textContent)")
    assert texts(page, "figure h2") == [
        "Position, mm", "Force, N", "Energy stored in the link, mJ", "Queue of waves, ms"]
    for times in texts(page, "figure p"):
        assert times == "\u221210 s\u22128 s\u22126 s\u22124 s\u22122 snow"
    for span in (0.15, 0.11, 0.033, 7.7):
        page.evaluate(f"hello.span = view.span = {span}, rescale()")
        limits = page.evaluate("strips.map(one => [one.lo * one.k, one.hi * one.k])")
        for low, high in limits:
            for limit in (low, high):
                digits = f"{abs(limit):.3e}".split("e")[0].rstrip("0").rstrip(".")
                assert len(digits.replace(".", "")) <= 2, limit
        assert limits[0][0] / 1e3 <= -span / 2 + 0.08 * 0.12 + 1e-9
        assert limits[0][1] / 1e3 >= span / 2 - 1e-9


def test_the_numbers_are_those_under_the_pointer_on_every_strip_and_the_newest_ones_without_it(
    server: Callable[..., Mock], tab: Callable[..., Page]
) -> None:
    """The mock's hand reaches in its first two seconds, so the rows of then are others than the newest."""
    page = tab(server(ran=4.0).url)
    page.until("row.t > 6")
    page.click("#pause")
    t = page.evaluate("edge()")
    shown = page.evaluate("captions(), strips.map(one => one.spans[0].textContent)")
    for strip in range(4):
        share = 1.0 - (t - 1.2) / 10.0
        point(page, strip, share)
        page.until("!strips[0].cursor.hidden")
        at = page.evaluate("edge() - 10 + pointed")
        assert at == pytest.approx(1.2, abs=0.02)
        want = page.evaluate("(t => rows.findLast(r => r.t <= t).xm[0] * 1e3)(edge() - 10 + pointed + 1e-9)")
        assert f"master {want:.1f} mm" == texts(page, "figure span.m")[0]
        ago = re.search(r", (\S+) s ago$", texts(page, "figure span.w")[0])
        assert ago is not None
        assert float(ago[1]) == pytest.approx(page.evaluate("row.t") - at, abs=1.0)  # the run goes on
        ruler = page.evaluate(f"(a => a.left)(strips[{strip}].cursor.getBoundingClientRect())")
        left, width = page.evaluate(f"(b => [b.left, b.width])(strips[{strip}].canvas.getBoundingClientRect())")
        assert (ruler - left) / width == pytest.approx(share, abs=0.004)
    page.mouse("mouseMoved", 2.0, 2.0)
    page.until("strips[0].cursor.hidden")
    assert page.evaluate("strips.map(one => one.spans[0].textContent)") == shown


def test_a_pause_holds_the_strips_while_the_run_goes_on_and_they_scroll_back_to_what_was(
    server: Callable[..., Mock], tab: Callable[..., Page]
) -> None:
    page = tab(server(ran=9.9).url)
    page.until("row.t > 12.5")  # more than the ten seconds that are shown
    page.key("p")
    held = page.evaluate("edge()")
    page.until(f"row.t > {held} + 1")
    assert page.evaluate("edge()") == held
    assert page.evaluate("$('pause').getAttribute('aria-pressed')") == "true"
    page.evaluate("$('back').value = $('back').min, $('back').oninput({target: $('back')})")
    assert page.evaluate("edge() - 10 - rows[0].t") == pytest.approx(0.0, abs=0.11)
    assert page.evaluate("$('back').getAttribute('aria-valuetext')").endswith(" s ago")
    page.until(f"{COLUMN}(0, .02, 'slave').length > 0 && {COLUMN}(0, .6, 'slave').length > 0")
    assert page.evaluate("strips[0].times[5].textContent") != "now"
    back = page.evaluate("edge()")
    x, y = page.place("figure canvas")
    page.drag((x, y), (-200.0, 0.0))
    assert page.evaluate("edge()") > back + 1.0
    page.key("p")
    page.until("paused === null && row.t - strips[0].edge < .2")
    assert page.text("#when") == "live"


def test_five_minutes_can_be_looked_at_again_and_no_more_is_kept(page: Page) -> None:
    count, seconds = page.evaluate("""(() => { for (let i = 0; i < 2 * KEPT; i++) take({...row, t: row.t + 1 / 60});
      return [rows.length, row.t - rows[0].t]; })()""")
    assert 17_400 <= count <= 18_000
    assert seconds > 280


def test_the_energy_of_the_law_before_ends_at_the_switch_and_another_quantity_is_not_drawn_beside_it(
    mock: Mock, page: Page
) -> None:
    """The curve of one law went on into that of the next, though one was stored in the link and the other absorbed."""
    page.until(f"{COLUMN}(2, .9, 'ink').length > 0")
    mock.world.part = "02"
    page.until("rows.some(one => one.mark)")
    page.until("(i => i > 0 && row.t - rows[i].t > 2)(rows.findIndex(one => one.mark))")
    page.evaluate("scaled = 0, strips[2].whole = dirty = true")
    page.until("strips[2].title.textContent.startsWith('Energy stored in the link')")
    mock.world.part, mock.world.kind, mock.energy = "03", "ports", "ports"
    page.until("strips[2].title.textContent === 'Net energy absorbed (negative: generated), mJ'")
    page.until("row.kind === 'ports' && !strips[2].whole")
    assert page.evaluate(f"{COLUMN}(2, .3, 'ink')") == []
    page.until(f"{COLUMN}(2, .99, 'ink').length > 0")


def test_one_direction_has_one_colour_in_packets_ages_and_queue(mock: Mock, page: Page) -> None:
    """The queue had them swapped: forward in the slave's colour."""
    mock.knobs["jitter"] = 0.02  # whose queue is twice as long forward as backward
    page.until("row.queue[0] === .02")
    page.until(f"{COLUMN}(3, .99, 'master').length && {COLUMN}(3, .99, 'slave').length")
    forward, backward = page.evaluate(f"['master', 'slave'].map(name => {COLUMN}(3, .99, name)[0])")
    assert forward < backward, "the longer one, forward, in the master's colour is above"
    assert texts(page, "figure:nth-of-type(4) .m") == ["forward 20 ms"]
    assert texts(page, "figure:nth-of-type(4) .s") == ["backward 10 ms"]
    page.until("new Set(dots.map(dot => dot.way)).size === 2")


def test_all_axes_of_six_are_drawn_as_small_strips_and_the_robot_from_the_side_by_its_outlines(
    server: Callable[..., Mock], tab: Callable[..., Page]
) -> None:
    mock = server(axes=6)
    page = tab(mock.url)
    page.until("""[...document.querySelectorAll('#axes canvas')].filter(one => {
      const data = one.getContext('2d').getImageData(0, 0, one.width, one.height).data;
      return data.some((v, i) => i % 4 === 3 && v > 250);
    }).length === 6""")
    assert page.evaluate("$('arm').hidden")
    box = [[x, 0.0, z] for x in (0.0, 0.2) for z in (-0.02, 0.02)]
    shapes = [{"radius": 0.0, "points": box}, {"radius": 0.03, "points": [[0, 0, 0]]}]
    mock.send({**mock.hello(), "arm": {"shapes": shapes, "world": [], "middle": [0.1, 0.0], "span": 0.5}})
    page.until("hello.arm && !$('arm').hidden && $('arm').width > 200")
    page.evaluate("take({...row, t: row.t + 1e-4, arm: [[[1, 0, 0, 0, 0, 1, 0, 0], [1, 0, 0, 0, 0, 1, .2, .1]]]})")
    seen = """((x, y) => {
      const at = $('arm'), c = at.getContext('2d'), k = Math.min(at.width, at.height - 28 * R) / .5;
      return [...c.getImageData(at.width / 2 + (x - .1) * k, (at.height + 28 * R) / 2 - y * k, 1, 1).data];
    })"""
    page.until(f"{seen}(.1, 0)[3] === 255")
    assert page.evaluate(f"{seen}(.1, 0)") == page.evaluate(f"{seen}(.2, .1)")  # within the box, and the disc
    for x, y in ((0.1, 0.03), (0.25, 0.0), (-0.02, 0.0), (0.2, 0.135)):
        assert page.evaluate(f"{seen}({x}, {y})[3]") == 0, (x, y)
    assert [one for one in page.console if "willReadFrequently" not in one] == [], "but for what this test reads itself"
