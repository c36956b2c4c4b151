"""What a live run makes of numbers as large as there are, and of ticks that are left out."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import Any

import pytest

from channel import LeftOut
from teleop import load_result, load_scene, run
from teleop.live.records.merge import merge
from teleop.scene.loading import live_knobs
from teleop.scene.scene import Scene, both_ends
from teleop.simulation.metrics import worked_out

pytestmark = pytest.mark.live


def hostile(shell: Any, size: float) -> None:
    """From tick 100 on, have this end send `size` in every number of its messages, and as the energy that it put in."""
    end = shell.endpoint
    honest = end._datagram

    def datagram(k: int, now: int, tx: tuple[Any, ...], sent: tuple[Any, ...] | None, row: Any) -> bytes | None:
        if k > 100:
            value = size if k // 20 % 2 else -size
            tx = tuple(type(message)(*[value] * len(message)) for message in tx)
            if sent is not None:  # what its waves have come to
                sent = tuple(type(one)(one.T, value, size) for one in sent)
            row = tuple(size if i == end.places.E_in else number for i, number in enumerate(row))
        data: bytes | None = honest(k, now, tx, sent, row)
        return data

    end._datagram = datagram


def strict(folder: Path) -> dict[str, Any]:
    """Its summary, no number in which is anything that JSON does not know."""
    def unknown(word: str) -> None:
        raise AssertionError(f"{word} is no JSON")

    told: dict[str, Any] = json.loads((folder / "summary.json").read_text(), parse_constant=unknown)
    return told


@pytest.mark.parametrize(("name", "e", "size"), [
    ("hard_wall", "m", 1e308), ("rubber", "s", 1e160), *[pytest.param(*each, marks=pytest.mark.full) for each in (
        ("hard_wall", "s", 1e308), ("rubber", "m", 1e308), ("hard_wall", "m", 1e160))]])
def test_a_peer_that_sends_waves_of_1e308_leaves_a_summary_and_no_traceback(
    name: str, e: str, size: float, pair: Callable[..., Any], tmp_path: Path
) -> None:
    scene: Scene = replace(load_scene(name, duration=0.3, law="wave"), link=None)
    both = pair(scene)
    hostile(both.shells[e], size)
    both.run()
    assert both.errors == {"m": None, "s": None}
    folders = both.write()
    merged = merge(scene, *folders)
    merged.save(tmp_path / "merged")
    for folder in (*folders, tmp_path / "merged"):
        told = strict(folder)
        assert told["status"] in ("ok", "stopped", "diverged")
        assert load_result(folder).sentence == told["sentence"]
    victim = strict(both.out / ("slave" if e == "m" else "master"))
    assert victim["slave" if e == "m" else "master"]["stamp_margin"] == "-inf" or size < 1e200
    # Where a tick was left out at the last moment, both may end before anything has overflowed.
    lost = sorted(name for name, value in worked_out(scene, merged.trace).items() if not isfinite(value))
    notes = [note for note in merged.notes if note.startswith("not finite, and so left out of the metrics")]
    assert notes == [f"not finite, and so left out of the metrics: {', '.join(lost)}"] * bool(lost)


def test_what_a_killed_end_left_of_such_a_run_is_made_whole(pair: Callable[..., Any]) -> None:
    scene: Scene = replace(load_scene("hard_wall", duration=0.3), link=None)
    both = pair(scene)
    hostile(both.shells["m"], 1e308)
    master, slave = both.run().write()
    for folder in (master, slave):
        header, _, rows = (folder / "record.bin").read_bytes().partition(b"\n")
        about = {**json.loads(header), "scene": "hard_wall", "knobs": {"duration": "0.3", "link": "none"}}
        (folder / "record.bin").write_bytes(json.dumps(about).encode() + b"\n" + rows)
        (folder / "summary.json").unlink()
        (folder / "trace.npz").unlink()
        assert "without a word" in load_result(folder).sentence
        strict(folder)


def test_a_pressed_wall_keeps_its_force_with_half_of_the_ticks_left_out() -> None:
    """With zeros in the gaps the force was 0.0 N at 44 % of ticks left out."""
    scene = both_ends(load_scene("hard_wall", **live_knobs("hard_wall", {"duration": "4"})))
    pressed = run(load_scene("hard_wall", duration=4.0)).metrics["f_m_end"]
    assert pressed > 2.0
    for share in (0.1, 0.44):
        trace = run(replace(scene, left_out_m=LeftOut(share), left_out_s=LeftOut(share))).trace
        for name in ("f_m", "f_s"):
            assert trace[name][-100:].mean() > 0.8 * pressed, (share, name)
