"""The record of a steered hand, run again under any law."""

from __future__ import annotations

import json
import os
from array import array
from collections.abc import Sequence
from math import nan
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from master.hand_record import HandRecording
from master.steered import SteeredMaster
from teleop import load_scene, run
from teleop.errors import Refused
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


def test_a_part_that_ended_before_its_first_tick_is_left_out_of_a_page(tmp_path: Path) -> None:
    """Ctrl-C just after a turn left such a part, and the whole drag was refused."""
    folder = page(tmp_path / "p", ("start", [(0, 0.1), (1, 0.2), (2, 0.3)]), ("turn", []))
    written(folder / "02" / "master", [])
    assert places(folder) == [0.1, 0.2, 0.3]


def dragged(folder: Path, scene: str = "hard_wall", **knobs: object) -> tuple[list[float], Any]:
    """Drag the hand of a scene to and fro over 1.5 s, recorded in `folder`: its reference, tick by tick; the scene."""
    made = load_scene(scene, **knobs)
    device = SteeredMaster(made)
    device.record(folder)
    path = [device._r[0]]
    for k in range(1, 1501):
        if k % 16 == 0:
            device.steer([0.06 * float(np.sin(0.004 * k))] + [0.0] * (made.axes - 1) if k < 1200 else None)
        device.read(k)
        device.hold((2.0,) * made.axes)
        path.append(device._r[0])
    device.record(None)
    return path, made


def test_the_reference_of_a_drag_is_run_again_to_the_bit(tmp_path: Path) -> None:
    path, _ = dragged(tmp_path)
    scene = load_scene("hard_wall", hand=str(tmp_path))
    assert scene.hand is not None
    assert [list(axis) for axis in scene.hand.reference.samples(1, scene.ticks + 1, scene.dt_ns)] == [path]
    assert scene.duration == 1.5
    assert scene.ticks == 1500


def test_a_hand_that_is_driven_by_its_own_record_moves_the_master_as_it_did(tmp_path: Path) -> None:
    """Under the forces of the drag: the same samples between the same ticks are the same motion, to the bit."""
    _, made = dragged(tmp_path)
    from master.device import SimulatedMaster

    steered, again = SteeredMaster(made), SimulatedMaster(load_scene("hard_wall", hand=str(tmp_path)), senses=True)
    for k in range(1, 1501):
        if k % 16 == 0:
            steered.steer([0.06 * float(np.sin(0.004 * k))] if k < 1200 else None)
        assert again.read(k) == steered.read(k)
        for device in (again, steered):
            device.hold((2.0,))


def test_one_drag_is_felt_under_six_laws(tmp_path: Path) -> None:
    path, _ = dragged(tmp_path)
    felt = {}
    for law in LAWS:
        result = run(load_scene("hard_wall", hand=str(tmp_path), law=law, delay=0.05))
        assert result.status == "ok", law
        assert result.ticks == 1500
        assert result.parameters["hand"] == str(tmp_path)
        felt[law] = result.trace["f_m"]
        assert np.abs(result.trace["x_m"] - np.array(path[:1500])).max() < 0.1, "the hand leads, by its spring"
    assert len({force.tobytes() for force in felt.values()}) == len(LAWS), "each law answers in its own way"


def test_the_hand_keeps_its_mass_spring_and_damper_and_its_duration_may_be_another(tmp_path: Path) -> None:
    dragged(tmp_path)
    own, scene = load_scene("hard_wall"), load_scene("hard_wall", hand=tmp_path, duration="3")
    assert own.hand is not None
    assert scene.hand is not None
    assert (scene.hand.mass, scene.hand.k, scene.hand.d) == (own.hand.mass, own.hand.k, own.hand.d)
    assert scene.ticks == 3000
    moved = scene.hand.reference.samples(1, 3001, 1_000_000)[0]
    assert set(moved[1500:]) == {moved[1500]}, "after its last tick it stays"


def test_a_part_of_it_is_that_part_of_the_whole(tmp_path: Path) -> None:
    dragged(tmp_path)
    found = HandRecording(str(tmp_path))
    whole = found.samples(1, 2000, 1_000_000)[0]
    for first, count in ((0, 256), (700, 13), (1490, 100), (1900, 50)):
        assert found.samples(1, count, 1_000_000, first=first)[0] == whole[first:first + count]


# -- folders -----------------------------------------------------------------------------------------------------------


def test_the_ticks_of_a_page_go_on_over_its_parts_and_one_without_a_row_repeats_the_one_before(tmp_path: Path) -> None:
    folder = page(tmp_path / "p", ("start", [(0, 0.1), (1, 0.2), (2, 0.3)]), ("turn", [(2, 0.35), (5, 0.4), (6, 0.5)]))
    assert places(folder) == [0.1, 0.2, 0.35, 0.35, 0.35, 0.4, 0.5]
    assert places(folder / "01") == places(folder / "01" / "master") == [0.1, 0.2, 0.3]
    assert places(folder / "02") == [0.35, 0.35, 0.35, 0.4, 0.5], "its first tick is tick 0"


@pytest.mark.parametrize("why", ["again", "lost"])
def test_of_a_page_that_was_started_again_there_is_what_came_since(tmp_path: Path, why: str) -> None:
    folder = page(tmp_path / "p", ("start", [(0, 0.1), (9, 0.2)]), (why, [(9, 0.0), (10, 0.3)]),
                  ("turn", [(10, 0.3), (12, 0.4)]))
    assert places(folder) == [0.0, 0.3, 0.3, 0.4]


def test_a_part_that_never_began_its_record_is_left_out(tmp_path: Path) -> None:
    folder = page(tmp_path / "p", ("start", [(0, 0.1), (1, 0.2)]), ("turn", []), ("turn", [(3, 0.4)]))
    assert places(folder) == [0.1, 0.2, 0.2, 0.4]


def test_what_a_killed_process_leaves_is_taken_up_to_the_row_that_is_cut_off(tmp_path: Path) -> None:
    written(tmp_path, [(0, 0.1), (1, 0.2)], tail=b"\0" * 9)
    with pytest.warns(TruncatedRecord, match="cut off in the middle of a row.*after row 2 is lost"):
        assert places(tmp_path) == [0.1, 0.2]


ROWS = [(0.0, 0.1), (1.0, 0.2)]


@pytest.mark.parametrize(("make", "said"), [
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
])
def test_a_folder_that_holds_no_drag_is_refused_in_a_sentence(tmp_path: Path, make: Any, said: str) -> None:
    make(at := tmp_path / "p")
    with pytest.raises(Refused, match=said) as refused:
        HandRecording(str(at))
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("path", ["", 3, None, {}])
def test_what_names_no_folder_is_refused(path: Any) -> None:
    with pytest.raises(Refused, match="named by the folder of a live page"):
        load_scene("hard_wall", hand=path)


@pytest.mark.parametrize(("scene", "knobs", "said"), [
    ("hard_wall", {"dt": 2e-3}, r"1 axis with dt=0.001 s, and the scene has 1 axis and dt=0.002 s.*--set dt=0.001"),
    ("recorded_reach", {}, "the scene has 3 axes"),
])
def test_a_scene_with_other_ticks_or_axes_is_refused(
        tmp_path: Path, scene: str, knobs: dict[str, Any], said: str) -> None:
    written(tmp_path, [(0, 0.1), (2000, 0.2)])
    with pytest.raises(Refused, match=said):
        load_scene(scene, hand=str(tmp_path), **knobs)


def test_a_stored_run_that_names_a_recorded_hand_reads_it_for_those_alone_who_trust_it(tmp_path: Path) -> None:
    written(tmp_path, ROWS)
    knobs = {"hand": str(tmp_path)}
    with pytest.raises(Refused, match="which names a file of this machine"):
        stored_scene("hard_wall", knobs, trust=False)
    assert stored_scene("hard_wall", knobs, trust=True).ticks == 1


def test_another_motion_under_the_same_path_is_another_reference(tmp_path: Path) -> None:
    one, same = (HandRecording(str(written(tmp_path, ROWS))) for _ in "ab")
    other = HandRecording(str(written(tmp_path, [(0, 0.1), (1, 0.3)])))
    assert one == same != other
    assert hash(one) == hash(same)


@pytest.mark.parametrize(("axes", "dt_ns", "cure"), [(3, 1_000_000, "in$"), (1, 2_000_000, "in, or --set dt=0.001$")])
def test_a_scene_with_other_axes_was_told_to_set_the_tick_that_it_had(
    tmp_path: Path, axes: int, dt_ns: int, cure: str
) -> None:
    hand = HandRecording(str(written(tmp_path, [(0.0, 0.0), (1.0, 0.0)])))
    with pytest.raises(Refused, match=f"take the scene that it was recorded {cure}"):
        hand.check(axes, dt_ns)
