"""How the page looks: at every width, light and dark, to a keyboard and a screen reader; and its strips."""

from __future__ import annotations

import re
from collections.abc import Callable

import pytest

from teleop.live.page.command import page_bytes
from tests.browser import Page
from tests.live.page.browser.mock import WALL, Mock

pytestmark = pytest.mark.live

DARK = {"prefers_color_scheme": "dark"}
LIGHT = {"prefers_color_scheme": "light"}
PAINTED = """(name => {
  const [r, g_, b] = [1, 3, 5].map(i => parseInt(C[name].slice(i, i + 2), 16));
  const data = stage.getContext('2d').getImageData(0, 0, stage.width, stage.height).data;
  let n = 0;
  for (let i = 0; i < data.length; i += 4)
    if (data[i] === r && data[i + 1] === g_ && data[i + 2] === b && data[i + 3] === 255) n++;
  return n;
})"""
BEYOND = """[...document.querySelectorAll('body *')].filter(one => {
  const b = one.getBoundingClientRect();
  return !one.closest('noscript, script, option') && b.width && (b.right > innerWidth + .5 || b.left < -.5);
}).map(one => one.outerHTML.slice(0, 80)).join()"""
CONTRAST = """(() => {
  const light = c => { const [r, g, b] = [1, 3, 5].map(i => parseInt(c.slice(i, i + 2), 16) / 255)
    .map(v => v <= .04045 ? v / 12.92 : ((v + .055) / 1.055) ** 2.4); return .2126 * r + .7152 * g + .0722 * b; };
  const css = getComputedStyle(document.documentElement);
  const of = name => { const c = css.getPropertyValue('--' + name).trim();
    return light(c.length === 4 ? '#' + [...c.slice(1)].map(d => d + d).join('') : c); };
  const found = {};
  for (const [ink, paper] of [['ink', 'card'], ['soft', 'card'], ['soft', 'paper'], ['master', 'card'],
      ['slave', 'card'], ['wall', 'card'], ['bad', 'card'], ['bad', 'paper'], ['warn', 'warnbg'], ['bad', 'badbg']]) {
    const [a, b] = [of(ink), of(paper)].sort((x, y) => y - x);
    found[ink + ' on ' + paper] = (a + .05) / (b + .05);
  }
  return found;
})()"""


def test_the_page_is_one_small_file_that_names_no_other() -> None:
    text = page_bytes().decode()
    assert len(text.encode()) < 60_000
    assert text.count("<script>") == text.count("<style>") == 1
    for other in ("src=", "@import", "url(", "http://", "https://", " style=", "eval(", "innerHTML"):
        assert other not in text, other


@pytest.mark.parametrize("axes", [1, 3])
def test_nothing_goes_beyond_the_width_light_and_dark(
    server: Callable[..., Mock], tab: Callable[..., Page], axes: int
) -> None:
    mock = server(axes=axes)
    page = tab(mock.url)
    mock.status = {"lost": "the channel", "m": {"gain": 0.0, "cause": "silence: no fresh packet came for 0.2 s"},
                   "s": {"gain": 0.0, "cause": "no answer: the other end has heard nothing of this one"}}
    mock.say("warn", "The swing grows " * 12)
    page.until("lost !== null && document.getElementById('said').className === 'warn'")
    for width in (360, 768, 1280):
        page.size(width, 900, mobile=width < 500)
        page.until(f"innerWidth === {width}")
        for media in (LIGHT, DARK):
            page.media(**media)
            page.until(f"matchMedia('(prefers-color-scheme: {media['prefers_color_scheme']})').matches")
            page.until("stage.clientWidth <= innerWidth && C.master === "
                       "getComputedStyle(document.documentElement).getPropertyValue('--master').trim()")
            page.until(f"{BEYOND} === ''")  # once it is laid out anew
            assert page.evaluate("document.documentElement.scrollWidth") <= width
            page.until(f"{PAINTED}('master') > 100 && {PAINTED}('slave') > 100 && {PAINTED}('wall') > 100")
    assert [one for one in page.console if "willReadFrequently" not in one] == [], "but for what this test reads itself"


def test_every_text_has_the_contrast_of_aa_and_light_and_dark_change_while_the_page_is_open(
    mock: Mock, tab: Callable[..., Page]
) -> None:
    page = tab(mock.url, media=LIGHT)
    light = page.evaluate("[C.master, getComputedStyle(document.body).backgroundColor]")
    for media in (LIGHT, DARK):
        page.media(**media)
        page.until(f"(C.master === {light[0]!r}) === {str(media is LIGHT).lower()}")
        assert (page.evaluate("getComputedStyle(document.body).backgroundColor") == light[1]) == (media is LIGHT)
        assert {name: ratio for name, ratio in page.evaluate(CONTRAST).items() if ratio < 4.5} == {}, media
        page.until(f"{PAINTED}('master') > 100")


def test_with_reduced_motion_no_packet_moves_and_the_strips_go_in_steps(mock: Mock, tab: Callable[..., Page]) -> None:
    page = tab(mock.url, media={"prefers_reduced_motion": "reduce"})
    page.evaluate("window.steps = []; setInterval(() => { if (steps.at(-1) !== stripped) steps.push(stripped); }, 1)")
    page.until("steps.length > 5")
    gaps = page.evaluate("steps.slice(2).map((t, i) => t - steps[i + 1])")
    assert min(gaps) >= 249.0  # ms
    assert page.evaluate("dots.length") == 0
    page.until(f"{PAINTED}('master') > 100")


def test_every_control_is_reached_by_tab_with_a_visible_focus_and_has_a_name_and_sliders_a_number_with_its_unit(
    page: Page
) -> None:
    order = []
    for _ in range(10):
        page.key("Tab")
        order.append(page.evaluate("document.activeElement.id"))
        assert page.evaluate("parseFloat(getComputedStyle(document.activeElement).outlineWidth)") >= 2.0
    assert order == ["stage", "clutch", "again", "go", "law", "k_delay", "k_jitter", "k_loss", "k_k_e", "k_scale"]
    tree = page.call("Accessibility.getFullAXTree")["nodes"]
    named = {node["role"]["value"]: node["name"]["value"] for node in tree if "name" in node and "role" in node}
    assert {"application", "button", "combobox", "slider"} <= set(named)
    roles = ("application", "button", "combobox", "slider")
    assert [node for node in tree if node.get("role", {}).get("value") in roles and not node["name"]["value"]] == []
    names = [node["name"]["value"] for node in tree if node.get("role", {}).get("value") == "button"]
    assert names == ["Clutch (hold)", "Start again", "Let go", "Pause"], "without their keys"
    shortcuts = "[...document.querySelectorAll('button')].map(one => one.getAttribute('aria-keyshortcuts'))"
    assert page.evaluate(shortcuts) == ["C", "T", "R", "Escape", "P"]
    page.evaluate("$('k_delay').show(.15), $('k_k_e').show(5e3)")
    assert page.evaluate("['k_delay', 'k_k_e'].map(id => $(id).getAttribute('aria-valuetext'))") == ["150 ms", "5 kN/m"]


def test_a_quiet_visit_leaves_no_console_message_and_strips_draw_the_same_as_they_scroll_and_at_once(
    page: Page
) -> None:
    page.drag(page.place("#stage"), (60.0, 0.0))
    page.key("c")
    page.key("r")
    page.until("row.t > 4")
    assert page.console == []
    # The newest rows were drawn as they came; drawn once more as a whole the picture is the same, but for rounding.
    differ = page.evaluate("""(() => strips.map(one => {
      const {canvas, c} = one, read = () => c.getImageData(0, 0, canvas.width, canvas.height).data;
      const edge = one.edge, scrolled = read(), keep = rows;
      rows = rows.filter(r => r.t <= edge);
      const last = rows[rows.length - 1].t;
      rows[rows.length - 1] = {...rows[rows.length - 1], t: edge};
      one.whole = true;
      paused = edge;
      drawStrip(one);
      paused = null;
      rows = keep;
      const whole = read();
      one.whole = true;
      let n = 0;
      for (let i = 3; i < whole.length; i += 4) if (Math.abs(whole[i] - scrolled[i]) > 64) n++;
      return n / (whole.length / 4);
    }))()""")
    assert max(differ) < 0.02


def test_the_view_is_as_wide_as_before_once_what_flew_away_is_back(
    server: Callable[..., Mock], tab: Callable[..., Page]
) -> None:
    """A law that shook threw the slave a metre away; the handle is not to be drawn ten times smaller ever after."""
    mock = server(ran=0.0)
    mock.world.steered = True  # it stays where it is, however late this looks
    page = tab(mock.url)
    page.evaluate("take({...row, t: row.t + 1e-6, xs: [-1]})")
    assert page.evaluate("view.span") > 1.0
    page.evaluate("rows.splice(0, rows.length - 1), rows[0].t -= 30, 0")
    page.until("view.span === hello.span")


SIZES = {"wide": {"width": 1280, "height": 1000}, "phone": {"width": 390, "height": 844, "scale": 2.0, "mobile": True},
         "200 %": {"width": 640, "height": 500, "scale": 2.0}}
UNDER = """((span) => {
  const found = [];
  for (let i = 0; i <= 40; i++) for (const lag of [-.6, -.1, 0, .02, .3, .7]) {
    const at = view.c + (i / 40 - .5) * span, one = n => Array(hello.axes).fill(n);
    row = {...row, hand: one(at), xm: one(at - lag * .03), xs: one(at - lag * .02), fm: one(9 * lag), fe: one(7 * lag)};
    draw(0);
    const box = placed.labels, all = [...placed.bodies, ...box];
    for (const a of box) for (const b of all) if (a !== b && !apart(a, b)) found.push([i, lag, a, b]);
    for (const a of box) if (a[0] < 0 || a[2] > W || a[1] < 0 || a[3] > H) found.push([i, lag, a]);
  }
  return found;
})"""


@pytest.mark.parametrize("axes", [1, 3])
def test_no_label_is_under_a_body_or_another_label_wherever_the_hand_is(
    axes: int, server: Callable[..., Mock], tab: Callable[..., Page]
) -> None:
    """On a phone the wall's name stood under the invitation, and the slave's force under the slave."""
    url = server(axes=axes).url
    for name, size in SIZES.items():
        page = tab(url, **size)
        page.evaluate("socket.onmessage = null")
        assert page.evaluate(f"{UNDER}(.9 * view.span).slice(0, 3)") == [], name
        page.close()


def test_the_invitation_stands_beside_the_wall_in_the_free_space_and_not_on_it(
    mock: Mock, tab: Callable[..., Page]
) -> None:
    for name, size in SIZES.items():
        page = tab(mock.url, **size)
        page.until("$('invite').style.width")
        left, right, bottom = page.evaluate("""((a, b) => [b.left - a.left, b.right - a.left, b.bottom - a.top])(
          stage.getBoundingClientRect(), $('invite').firstChild.getBoundingClientRect())""")
        wall, height = page.evaluate("[place().s.ox + hello.wall * place().scale, H]")
        assert 0 <= left < right <= wall, name
        assert wall - right < 40, f"{name}: beside it"
        assert bottom < height - 24, f"{name}: above the ruler"
        page.close()


def test_laws_skipped_ticks_the_disk_the_clutch_and_a_switch_have_their_words(mock: Mock, page: Page) -> None:
    """Beside a slider at 0 % stood "loss 0.2 to 1.3 %": ticks that an end had skipped."""
    assert page.evaluate("[...$('law').querySelectorAll('optgroup')].map(one => one.label)") == [
        "Passive over any link", "No claim over a delay"]
    assert page.text("#gains") == "wave(b=20)"
    assert page.evaluate("$('gains').getBoundingClientRect().top >= $('law').getBoundingClientRect().bottom")
    gone = {"gain": 0.0, "cause": "the session is over: the clutch is open"}
    mock.status = {"lost": None, "m": gone, "s": gone, "skipped": 0.013, "written": 28.5e6, "free": 77.9e9,
                   "idle": False}
    page.until("$('skipped').textContent === 'ticks skipped by this machine 1.3 %'")
    assert page.text("#loss") == "loss 0 %"
    assert page.text("#disk") == "28.5 MB written, 77.9 GB left on the disk"
    mock.status["idle"] = True
    page.until("$('disk').textContent.startsWith('nothing is being written: nobody steers; ')")
    mock.world.clutch = True
    page.until("$('gm').textContent === 'Clutch open: both forces off' && $('gs').textContent === ''")
    mock.world.clutch = False
    mock.status["switching"] = True
    page.until("$('gm').textContent === 'Switching...'")


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


def test_one_direction_has_one_colour_in_packets_ages_and_queue_and_lost_packets_fall_out(
    mock: Mock, page: Page
) -> None:
    """The queue had them swapped: forward in the slave's colour."""
    mock.knobs["jitter"] = 0.02  # whose queue is twice as long forward as backward
    page.until("row.queue[0] === .02")
    page.until(f"{COLUMN}(3, .99, 'master').length && {COLUMN}(3, .99, 'slave').length")
    forward, backward = page.evaluate(f"['master', 'slave'].map(name => {COLUMN}(3, .99, name)[0])")
    assert forward < backward, "the longer one, forward, in the master's colour is above"
    assert texts(page, "figure:nth-of-type(4) .m") == ["forward 20 ms"]
    assert texts(page, "figure:nth-of-type(4) .s") == ["backward 10 ms"]
    page.until("new Set(dots.map(dot => dot.way)).size === 2")
    mock.knobs["loss"] = 0.5
    page.until("dots.some(dot => dot.fall > 0)")


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
