"""The record of a steered hand, run again under any law."""

from __future__ import annotations

import json
import os
from array import array
from collections.abc import Sequence
from math import nan
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from master import HandRecording, SteeredMaster
from teleop import Refused, load_scene, run
from teleop.live.records.reader import TruncatedRecord
from teleop.scene.loading import stored_scene

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


BROKEN: list[tuple[Any, str]] = [
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
    for i, (make, said) in enumerate(BROKEN):
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
