"""A live run as a link: its scene over it gives the live run's forces, with the ticks that its ends left out."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from channel.recorded import Recorded
from teleop import Fixed, Integral, Playout, Result, Scene, Zero, load_scene, run
from teleop.live.records.inputs import INPUTS
from teleop.live.records.reader import read_record
from teleop.live.records.record import read_events
from teleop.scene.playout import as_typed
from tests.live.recording import Recording
from tests.teleop.protocol.virtual_clock import MS, healing

NOISE = 1e-9  # N


def apart(folder: Path, e: str, result: Result, until: int | None = None) -> tuple[float, int]:
    """The greatest difference of an end's force (N) at the ticks that it ran, and how many these were."""
    header, record, _ = read_record(folder)
    rows: Any = record.rows
    ticks = np.asarray(record.ticks)
    ticks = ticks[: len(ticks) if until is None else int(np.searchsorted(ticks, until))]
    live = rows.table(0, len(ticks))[:, header["columns"][3:].index(f"f_{e}")]
    assert np.array_equal(np.asarray(record.played)[: len(ticks)], result.trace[f"seq_{e}"][ticks])
    return float(np.abs(live - result.trace[f"f_{e}"][ticks]).max()), len(ticks)


@pytest.mark.live
def test_a_lossy_live_run_over_its_own_link_in_virtual_time_gives_its_forces(lossy: Path) -> None:
    """Up to where an end let go, if the machine stalled it for so long: what a guard does then is not of the link."""
    knobs = json.loads((lossy / "master" / INPUTS).read_bytes().split(b"\n")[0])["knobs"]
    result = run(load_scene("hard_wall", **{**knobs, "link": f"recorded({str(lossy)!r})"}))
    events = [event for name in ("master", "slave") for event in read_events(lossy / name)]
    until = min((event["k"] for event in events if event["what"] in ("safe", "session")), default=2000)
    for e, name in (("m", "master"), ("s", "slave")):
        most, ticks = apart(lossy / name, e, result, until)
        assert most <= NOISE
        counts = json.loads((lossy / name / "summary.json").read_text())
        assert until < 2000 or ticks == counts["ticks"]
    if until == 2000:
        assert np.abs(result.trace["f_m"]).max() > 0.1


def world(folder: Path, playout: Playout) -> tuple[Recording, Scene]:
    """Two seconds over loss, copies and jitter, both ends asleep for a while, with clocks that differ."""
    scene = healing(energy=True, duration=2.0, dt=0.001, playout=playout)
    found = Recording(scene, out=folder, loss=0.1, jitter=9 * MS, copies=0.1, noise=MS // 2)
    found.until_both_play(1.0)
    for e in "msms":
        found.run(0.3)
        found.pause(e, asleep=True)
        found.run(0.03)
        found.pause(e, asleep=False)
    found.run(2.0)
    return found, scene


@pytest.mark.parametrize("playout", [
    pytest.param(Integral(), marks=pytest.mark.full), Zero(), pytest.param(Fixed(0.04), marks=pytest.mark.full),
], ids=as_typed)
def test_left_out_ticks_and_arrivals_of_a_run_make_the_same_run_in_virtual_time(
    playout: Playout, tmp_path: Path
) -> None:
    found, scene = world(tmp_path, playout)
    folders = {e: folder for folder, e in found.folders()}
    link = Recorded(str(folders["m"]), str(folders["s"]))
    result = run(replace(scene, link=link))
    assert result.status == "ok"
    for e, folder in folders.items():
        most, ticks = apart(folder, e, result, scene.ticks)
        assert most <= NOISE
        assert scene.ticks - 80 < ticks < scene.ticks - 40
    without = run(replace(scene, link=Recorded(str(folders["m"]), str(folders["s"]), left_out=False)))
    assert np.abs(without.trace["f_m"] - result.trace["f_m"]).max() > 1e-3


def test_the_left_out_ticks_come_by_time_whatever_the_tick(tmp_path: Path) -> None:
    found, scene = world(tmp_path, Zero())
    folders = {e: folder for folder, e in found.folders()}
    link = Recorded(str(folders["m"]), str(folders["s"]))
    own, half = (link.leaves_out(0, dt_ns) for dt_ns in (MS, MS // 2))
    assert own is not None
    assert half is not None
    out = own.left_out(0, 2 * scene.ticks, 0)
    assert np.array_equal(half.left_out(0, 2 * scene.ticks, 5), np.repeat(out[: scene.ticks], 2))
    ran = np.asarray(read_record(folders["m"])[1].ticks)
    assert np.array_equal(np.flatnonzero(~out[: ran[-1] + 1]), ran)
    assert np.array_equal(out[ran[-1] + 1 :], out[: len(out) - ran[-1] - 1])  # and from the beginning again
