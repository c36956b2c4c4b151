"""The hand: its grip, the references it follows, and recorded motions."""

import json
import math
import os
from array import array
from collections.abc import Callable, Sequence
from math import nan, pi, sin
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

import scenarios
from master import HandRecording, SteeredMaster
from master.hand import Grip, Reach, Rest, Sine
from master.recording import Recording
from teleop import load_scene, run
from teleop.errors import Refused
from teleop.live.records.reader import TruncatedRecord
from teleop.scene.loading import stored_scene

MS = 1_000_000


def test_sine_is_sampled_at_the_ticks_however_late() -> None:
    (x,) = Sine(amplitude=0.05, frequency=1.0).samples(1, 10_001, MS)
    assert len(x) == 10_001
    for k in (0, 250, 7919, 10_000):
        assert x[k] == 0.05 * math.sin(2.0 * math.pi * (k * MS / 1e9))
    assert x[9_250] == pytest.approx(0.05, rel=1e-12)  # t is not accumulated: no drift after 9 s


def test_reach_is_the_minimum_jerk_polynomial() -> None:
    # Flash and Hogan 1985: rest at both ends, half way at half time, peak speed 15/8 of the mean.
    (x,) = Reach(to=0.3, start=0.5, duration=0.8, origin=0.1).samples(1, 2001, MS)
    path = (np.array(x) - 0.1) / 0.2
    s = (np.arange(2001) / 1000.0 - 0.5) / 0.8
    inside = (s >= 0) & (s <= 1)
    np.testing.assert_allclose(path[inside], np.polyval([6, -15, 10, 0, 0, 0], s[inside]), atol=1e-14)
    assert set(path[s < 0]) == {0.0}
    assert set(np.array(x)[s >= 1]) == {0.3}
    assert path[900] == pytest.approx(0.5, abs=1e-14)
    speed = np.diff(path) * 1000.0 * 0.8
    assert speed.max() == pytest.approx(15 / 8, rel=1e-5)
    assert speed.min() >= 0.0
    assert abs(np.diff(speed)[[500, 1299]]).max() < 1e-4  # no step in acceleration at the ends
    np.testing.assert_allclose(path[500:1301] + path[500:1301][::-1], 1.0, atol=1e-14)


def test_a_number_lies_along_the_first_axis_and_a_tuple_has_an_entry_for_each_and_grips_compare_by_value() -> None:
    assert [*Rest(at=0.02).samples(1, 3, MS)[0]] == [0.02, 0.02, 0.02]
    assert [*Rest().samples(1, 2, MS)[0]] == [0.0, 0.0]
    for one in (Sine(amplitude=0.2, frequency=250.0), Reach(to=0.2, duration=1e-3), Rest(at=0.2)):
        x, y, z = one.samples(3, 2, MS)
        assert x[1] == 0.2, one
        assert [*y] == [*z] == [0.0, 0.0], one
    for each in (Sine(amplitude=(0.1, 0.2, -0.3), frequency=250.0), Rest(at=(0.1, 0.2, -0.3)),
                 Reach(to=(0.1, 0.2, -0.3), duration=1e-3, origin=(1.0, 2.0, 3.0))):
        assert [axis[1] for axis in each.samples(3, 2, MS)] == [0.1, 0.2, -0.3], each
    whole, real = (Grip(mass=m, k=200, d=5, reference=Sine(amplitude=0.05, frequency=1.0)) for m in (0, 0.0))
    assert whole == real
    assert hash(whole) == hash(real)


# Recordings: what is replayed, and what is refused with path and line


Write = Callable[[str], str]
SHIPPED = str(Path(scenarios.__file__).with_name("reach.csv"))


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def at(text: str) -> str:
        path = tmp_path / "motion.csv"
        path.write_bytes(text.encode(errors="surrogateescape"))
        return str(path)

    return at


def test_motion_is_what_numpy_interpolates_and_rows_at_ticks_are_replayed_to_the_last_bit(write: Write) -> None:
    dice = np.random.default_rng(5)
    t = np.cumsum(dice.uniform(1e-4, 5e-3, 200)) - 0.05
    motion = dice.normal(size=(200, 3))
    path = write("".join(f"{float(a)!r},{b[0]!r},{b[1]!r},{b[2]!r}\n" for a, b in zip(t, motion.tolist(), strict=True)))
    got = Recording(path=path, scale=-2.0).samples(3, 700, MS)
    for axis in range(3):
        np.testing.assert_allclose(got[axis], -2.0 * np.interp(np.arange(700) / 1e3, t, motion[:, axis]), atol=1e-12)
    x = motion[:, 0].tolist()
    path = write("".join(f"{k * MS / 1e9!r}, {each!r}\n" for k, each in enumerate(x)))
    assert [*Recording(path=path).samples(1, 202, MS)[0]] == [*x, x[-1], x[-1]]


def test_ways_to_write_the_same_motion_of_which_one_column_moves_the_first_axis_and_three_need_three(
    write: Write
) -> None:
    for text in ("t,x\n0,0.5\n1,1.5\n", "0,0.5\n1,1.5\n", "\ufefft,x\r\n0,0.5\r\n1,1.5\r\n",
                 "# made by hand\n\n  T , X\n# more\n0 , 5e-1  # here\n\n1,+1.5"):
        (x,) = Recording(path=write(text)).samples(1, 3, 500 * MS)
        assert [*x] == [0.5, 1.0, 1.5], text
    (x,) = Recording(path=write("0.002, 0.5\n0.004, 1.5")).samples(1, 6, MS)
    assert [*x] == [0.5, 0.5, 0.5, 1.0, 1.5, 1.5], "held before the first row too"
    stays = Recording(path=write("0, 0.5")).samples(3, 2, MS)
    assert [[*axis] for axis in stays] == [[0.5, 0.5], [0.0, 0.0], [0.0, 0.0]]
    with pytest.raises(Refused, match="along 3 axes, the scene has axes=1; set axes=3"):
        Recording(path=write("0, 0.5, 0, 0")).samples(1, 1, MS)


def test_the_file_is_read_once_and_only_named_in_the_text(write: Write) -> None:
    path = write("0, 0.5")
    recording = Recording(path=path, scale=2.0)
    write("0, 0.7")
    assert [*recording.samples(1, 1, MS)[0]] == [1.0]
    assert repr(recording) == f"Recording(path={path!r}, scale=2.0)"
    assert recording != Recording(path=path, scale=2.0)  # other contents: another motion
    assert recording != Recording(path=path)


BROKEN_FILES = [
    ("", "holds no motion"),
    ("t, x\n# nothing came\n", "holds no motion"),
    ("t, x\n0, 1\n0.1\n", "line 3: 1 column in place of 2"),
    ("t, x, y, z\n0, 1, 2\n", "line 2: 3 columns in place of 4"),
    ("t, x\n0, 1, 2, 3\n", "line 2: 4 columns in place of 2"),
    ("0, 1, 2\n", "line 1: 3 columns in place of 2 or 4"),
    ("0, 1, 2, 3\n0.1, 1, 2, \n", "line 2: '' is not a number"),
    ("t, x\n0, 1\n0.1, one\n", "line 3: 'one' is not a number"),
    ("time, x\n0, 1\n", "line 1: 'time' is not a number"),
    ("t, x\n0, 1\nt, x\n", "line 3: 't' is not a number"),
    ("0; 1\n", "line 1: '0; 1' is not a number"),
    ("0, 1_0\n", "line 1: '1_0' is not a number"),
    ("0, nan\n", "line 1: 'nan' is not finite"),
    ("0, 1e999\n", "line 1: '1e999' is not finite"),
    ("0, 1\n0.2, 1\n0.1, 1\n", r"line 3: t = 0\.1 s does not come after 0\.2 s"),
    ("0, 1\n0, 2\n", "line 2: t = 0 s does not come after 0 s"), ("\x89PNG\udcff\udcfe", "is not text"),
]


def test_broken_recordings_are_refused_with_path_and_line(write: Write) -> None:
    for text, says in BROKEN_FILES:
        with pytest.raises(Refused, match=says) as refused:
            Recording(path=write(text))
        assert "motion.csv" in str(refused.value)


def test_shipped_reach_is_what_its_head_says() -> None:
    def m(t: float, a: float, b: float) -> float:
        s = min(max((t - a) / (b - a), 0.0), 1.0)
        return s**3 * (10 - 15 * s + 6 * s * s)

    def h(t: float, a: float, b: float) -> float:
        return 4 * m(t, a, b) * (1 - m(t, a, b))

    def tremor(t: float, i: int) -> float:
        fast = 0.20 * sin(2 * pi * 8.7 * t + 2.1 * i) + 0.12 * sin(2 * pi * 10.9 * t + 4.3 * i)
        return m(t, 0, 0.5) * (fast + 0.5 * sin(2 * pi * 0.37 * t + 1.3 * i))

    x, y, z = Recording(path=SHIPPED).samples(3, 601, 10 * MS)
    for k in range(601):
        t = k / 100
        presses = 8 * m(t, 1.9, 2.3) - 9 * m(t, 2.4, 2.8) + 12 * m(t, 2.9, 3.3) - 10 * m(t, 3.4, 3.8)
        want_x = 40 * m(t, 0.5, 1.4) + presses + 6 * m(t, 3.9, 4.2) - 43 * m(t, 4.6, 5.5) + tremor(t, 0)
        want_y = 6 * h(t, 0.5, 1.4) + 10 * m(t, 1.8, 4.4) - 8 * m(t, 4.6, 5.6) + tremor(t, 1)
        want_z = 9 * h(t, 0.5, 1.4) + 5 * h(t, 4.6, 5.5) - 2 * m(t, 1.4, 1.9) + tremor(t, 2)
        assert (1e3 * x[k], 1e3 * y[k], 1e3 * z[k]) == pytest.approx((want_x, want_y, want_z), abs=6e-4)
    assert x[0] == y[0] == z[0] == 0.0  # it begins where a master at rest stands
    assert 0.045 < max(x) < 0.055  # and goes deeper than the canonical wall, at 0.03 m


# The record of a steered hand, run again under any law


LAWS = ("wave", "pfra", "tdpa", "two_layer", "pd_d", "direct")


def written(folder: Path, rows: Sequence[Sequence[float]], *, tail: bytes = b"", **header: Any) -> Path:
    """A hand.bin with these rows of tick and place."""
    folder.mkdir(parents=True, exist_ok=True)
    axes = len(rows[0]) - 1 if rows else 1
    line = json.dumps({"version": 1, "dt_ns": 1_000_000, "axes": axes, **header}).encode() + b"\n"
    (folder / "hand.bin").write_bytes(line + b"".join(array("d", row).tobytes() for row in rows) + tail)
    return folder


def page(folder: Path, *parts: tuple[str, list[tuple[float, float]]]) -> Path:
    """A page's folder: of each part why it began, and its rows; a part without rows has no record."""
    folder.mkdir(parents=True)
    entries = []
    for i, (why, rows) in enumerate(parts, start=1):
        entries.append({"folder": f"{i:02d}", "knobs": {}, "k": int(rows[0][0]) if rows else 0, "why": why})
        if rows:
            written(folder / f"{i:02d}" / "master", rows)
    (folder / "page.json").write_text(json.dumps({"version": 1, "scene": "hard_wall", "parts": entries}))
    return folder


def places(folder: Path) -> list[float]:
    found = HandRecording(str(folder))
    return found.samples(1, found.ticks + 1, found.dt_ns)[0].tolist()


class Drag(NamedTuple):
    folder: Path
    path: list[float]  # its reference, tick by tick


@pytest.fixture(scope="module")
def drag(tmp_path_factory: pytest.TempPathFactory) -> Drag:
    """The hand of hard_wall, dragged to and fro over 1.5 s and recorded."""
    folder, device = tmp_path_factory.mktemp("drag"), SteeredMaster(load_scene("hard_wall"))
    device.record(folder)
    path = [device._r[0]]
    for k in range(1, 1501):
        if k % 16 == 0:
            device.steer([0.06 * float(np.sin(0.004 * k))] if k < 1200 else None)
        device.read(k)
        device.hold((2.0,))
        path.append(device._r[0])
    device.record(None)
    return Drag(folder, path)


def test_the_reference_of_a_drag_is_run_again_to_the_bit_and_so_is_any_part_of_it(drag: Drag) -> None:
    own, scene = load_scene("hard_wall"), load_scene("hard_wall", hand=str(drag.folder))
    assert own.hand is not None
    assert scene.hand is not None
    assert [list(axis) for axis in scene.hand.reference.samples(1, scene.ticks + 1, scene.dt_ns)] == [drag.path]
    assert (scene.duration, scene.ticks) == (1.5, 1500)
    assert (scene.hand.mass, scene.hand.k, scene.hand.d) == (own.hand.mass, own.hand.k, own.hand.d)
    longer = load_scene("hard_wall", hand=drag.folder, duration="3")
    assert longer.hand is not None
    assert longer.ticks == 3000
    whole = longer.hand.reference.samples(1, 3001, 1_000_000)[0]
    assert set(whole[1500:]) == {whole[1500]}, "after its last tick it stays"
    found = HandRecording(str(drag.folder))
    for first, count in ((0, 256), (700, 13), (1490, 100), (1900, 50)):
        assert found.samples(1, count, 1_000_000, first=first)[0] == whole[first:first + count]


@pytest.mark.parametrize("laws", [("wave", "direct"), pytest.param(LAWS, marks=pytest.mark.full)])
def test_one_drag_is_felt_under_every_law(drag: Drag, laws: tuple[str, ...]) -> None:
    felt = {}
    for law in laws:
        result = run(load_scene("hard_wall", hand=str(drag.folder), law=law, delay=0.05))
        assert (result.status, result.ticks) == ("ok", 1500), law
        assert result.parameters["hand"] == str(drag.folder)
        felt[law] = result.trace["f_m"]
        assert np.abs(result.trace["x_m"] - np.array(drag.path[:1500])).max() < 0.1, "the hand leads, by its spring"
    assert len({force.tobytes() for force in felt.values()}) == len(laws), "each law answers in its own way"


# Folders


def test_the_ticks_of_a_page_go_on_over_its_parts_and_of_one_started_again_there_is_what_came_since(
    tmp_path: Path
) -> None:
    """A tick without a row repeats the one before.

    Ctrl-C just after a turn left a part that ended before its first tick, and the whole drag was refused.
    """
    start = ("start", [(0, 0.1), (1, 0.2), (2, 0.3)])
    folder = page(tmp_path / "p", start, ("turn", [(2, 0.35), (5, 0.4), (6, 0.5)]))
    assert places(folder) == [0.1, 0.2, 0.35, 0.35, 0.35, 0.4, 0.5]
    assert places(folder / "01") == places(folder / "01" / "master") == [0.1, 0.2, 0.3]
    assert places(folder / "02") == [0.35, 0.35, 0.35, 0.4, 0.5], "its first tick is tick 0"
    for why in ("again", "lost"):
        folder = page(tmp_path / why, ("start", [(0, 0.1), (9, 0.2)]), (why, [(9, 0.0), (10, 0.3)]),
                      ("turn", [(10, 0.3), (12, 0.4)]))
        assert places(folder) == [0.0, 0.3, 0.3, 0.4], why
    folder = page(tmp_path / "ended", start, ("turn", []))
    written(folder / "02" / "master", [])
    assert places(folder) == [0.1, 0.2, 0.3]
    never = page(tmp_path / "never", start, ("turn", []), ("turn", [(4, 0.4)]))
    assert places(never) == [0.1, 0.2, 0.3, 0.3, 0.4], "nor one that never began its record"


def test_what_a_killed_process_leaves_is_taken_up_to_the_row_that_is_cut_off(tmp_path: Path) -> None:
    """Another motion under the same path is another reference."""
    written(tmp_path, [(0, 0.1), (1, 0.2)], tail=b"\0" * 9)
    with pytest.warns(TruncatedRecord, match="cut off in the middle of a row.*after row 2 is lost"):
        assert places(tmp_path) == [0.1, 0.2]
    one, same = (HandRecording(str(written(tmp_path, ROWS))) for _ in "ab")
    other = HandRecording(str(written(tmp_path, [(0, 0.1), (1, 0.3)])))
    assert one == same != other
    assert hash(one) == hash(same)


ROWS = [(0.0, 0.1), (1.0, 0.2)]


BROKEN_FOLDERS: list[tuple[Any, str]] = [
    (lambda at: at.mkdir(), r"holds no record of a steered hand \(hand.bin\)"),
    (lambda _at: None, "holds no record of a steered hand"),
    (page, "holds no record of a steered hand"),
    (lambda at: written(at, []), "has no row yet"),
    (lambda at: written(at, [(3, 0.1)]), "one tick alone"),
    (lambda at: written(at, ROWS, version=2), "header.version must be a whole number of at most 1"),
    (lambda at: written(at, ROWS, dt_ns=0), "dt_ns must be a whole number of at least 1000"),
    (lambda at: written(at, ROWS, axes=17), "axes must be a whole number of at most 16"),
    (lambda at: written(at, [(0, 0.1), (0, 0.2)]), "damaged: its row 1"),
    (lambda at: written(at, [(0, 0.1), (1.5, 0.2)]), "damaged: its row 1"),
    (lambda at: written(at, [(-1, 0.1), (1, 0.2)]), "damaged: its row 0"),
    (lambda at: written(at, [(0, 0.1), (1, nan)]), "damaged: its row 1"),
    (lambda at: written(at, [(nan, 0.1), (1, 0.0)]), "damaged: its row 0"),
    (lambda at: written(at, [(0, 0.1), (1, 1e9)]), "damaged: its row 1"),
    (lambda at: written(at, [(0, 0.1), (1e300, 0.1)]), "damaged: its row 1"),
    (lambda at: written(at, [(0, 0.1), (9e7, 0.1)]), "2 rows for 90000000 ticks"),
    (lambda at: (at.mkdir(), (at / "hand.bin").write_bytes(b"x" * 5000)), "its first line is no header"),
    (lambda at: (at.mkdir(), (at / "hand.bin").write_bytes(b"[]\n")), "header must be an object"),
    (lambda at: (at.mkdir(), (at / "hand.bin").mkdir()), "it is a folder, not a file"),
    (lambda at: (at.mkdir(), os.mkfifo(at / "hand.bin")), "it is a pipe, not a file"),
    (lambda at: (written(at.parent / "q", ROWS), at.mkdir(), (at / "hand.bin").symlink_to(at.parent / "q/hand.bin")),
     "it is a link, not a file"),
    (lambda at: (written(at.parent / "q", ROWS), at.mkdir(), (at / "master").symlink_to(at.parent / "q")),
     "what a folder links to is not opened"),
    (lambda at: (page(at), (at / "page.json").write_text('{"version": 2, "parts": []}')), "does not say which parts"),
    (lambda at: (page(at), (at / "page.json").write_text('{"version": 1, "parts": [')), "does not say which parts"),
    (lambda at: (page(at), (at / "page.json").write_text(
        '{"version": 1, "parts": [{"folder": "../q", "why": "start"}]}')), "which is no folder in it"),
    (lambda at: (page(at), (at / "page.json").write_text(
        '{"version": 1, "parts": [{"folder": "..", "why": "start"}]}')), "which is no folder in it"),
    (lambda at: (page(at, ("start", [(5, 0.1), (6, 0.1)]), ("turn", [(2, 0.1), (9, 0.1)]))), "does not go on where"),
    (lambda at: (page(at, ("start", ROWS), ("turn", ROWS)), written(at / "02/master", [(2, 0.1, 0.2)])),
     "does not go on where"),
]


def test_a_folder_that_holds_no_drag_is_refused_in_a_sentence(tmp_path: Path) -> None:
    for i, (make, said) in enumerate(BROKEN_FOLDERS):
        (tmp_path / str(i)).mkdir()
        make(at := tmp_path / str(i) / "p")
        with pytest.raises(Refused, match=said) as refused:
            HandRecording(str(at))
        assert "\n" not in str(refused.value), i


def test_a_scene_with_other_ticks_or_axes_is_refused_and_a_stored_run_reads_a_hand_for_those_who_trust_it(
    tmp_path: Path
) -> None:
    """One with other axes was told to set the tick that it had."""
    written(tmp_path, [(0, 0.1), (2000, 0.2)])
    with pytest.raises(Refused, match=r"1 axis with dt=0.001 s, and the scene has 1 axis and dt=0.002 s.*--set dt=0.0"):
        load_scene("hard_wall", hand=str(tmp_path), dt=2e-3)
    with pytest.raises(Refused, match=r"the scene has 3 axes .* take the scene that it was recorded in$"):
        load_scene("recorded_reach", hand=str(tmp_path))
    knobs = {"hand": str(tmp_path)}
    with pytest.raises(Refused, match="which names a file of this machine"):
        stored_scene("hard_wall", knobs, trust=False)
    assert stored_scene("hard_wall", knobs, trust=True).ticks == 2000
