"""The switches of a live master's device: heeded by the scene, in its record and events, and replayed to the bit."""

from __future__ import annotations

from collections.abc import Callable
from math import cos, sin
from typing import Any

import numpy as np
import pytest

from scenarios.examples.device import Carriage
from teleop import Reading, Refused, load_scene
from teleop.live.devices.guarded_device import GuardedDevice
from teleop.live.records.reader import OWN
from teleop.live.records.record import read_events
from teleop.live.replay.rerun import difference, read_end


class Handle:
    """A handle that a hand swings, whose thumb holds the clutch open from 0.3 to 0.6 s."""

    deadline = 0.15

    def __init__(self) -> None:
        self.held: list[float] = []

    def read(self, k: int) -> Reading:
        t = 1e-3 * k
        return Reading((0.02 * sin(6.0 * t),), (0.12 * cos(6.0 * t),), clutch=300 <= k < 600, present=True)

    def hold(self, force: tuple[float, ...]) -> None:
        self.held.append(force[0])


@pytest.mark.live
def test_two_machines_of_ones_own_run_live_with_a_clutch_and_again_to_the_bit(pair: Callable[..., Any]) -> None:
    scene = load_scene("bench_top", law="pp", duration=0.9, needs_clutch=True, needs_present=True, closes_within=0.05)
    both = pair(scene, parts={"m": {"device": Handle()}, "s": {"device": Carriage(scene)}}).run()
    assert both.errors == {"m": None, "s": None}
    assert both.status() == {"m": "ok", "s": "ok"}
    folders = both.write()
    ends = [read_end(folder, scene) for folder in folders]
    assert [difference(end, scene) for end in ends] == [None, None]
    ticks, rows = np.asarray(ends[0].record.ticks), ends[0].record.rows
    names, table = ends[0].header["columns"][len(OWN):], rows.table(0, len(ticks))  # type: ignore[union-attr]
    told = [one for one in read_events(folders[0]) if one["what"] == "clutch"]
    f, g, clutch = (table[:, names.index(name)] for name in ("f_m", "g_clutch_m", "clutch_m"))
    inside = (ticks >= 300) & (ticks < 600)
    assert np.array_equal(clutch > 0.0, inside)
    assert not f[inside & (g == 0.0)].any()
    assert f[~inside & (ticks > 400)].any()
    assert [one["k"] >= at for one, at in zip(told, (300, 600), strict=True)] == [True, True]


class Read:
    """A device that reads what it is told to."""

    def __init__(self, *readings: Reading) -> None:
        self.readings = readings

    def read(self, k: int) -> Reading:
        return self.readings[k]

    def hold(self, force: tuple[float, ...]) -> None:
        pass


X = ((0.0,), (0.0,))


@pytest.mark.parametrize(("first", "later"), [
    (Reading(*X, clutch=True), Reading(*X)), (Reading(*X), Reading(*X, present=False)),
    (Reading(*X, clutch=True), Reading(*X, clutch=1)),  # type: ignore[arg-type]
], ids=["it goes", "it comes", "it is no truth"])
def test_a_switch_that_comes_or_goes_is_a_device_that_fails(first: Reading, later: Reading) -> None:
    guarded = GuardedDevice(Read(first, later, first), 1)
    assert guarded.read(0, 0) == first
    assert guarded.read(1, 1) is None
    assert "clutch" in str(guarded.trouble) or "present" in str(guarded.trouble)
    assert guarded.read(2, 2) == first


def test_a_switch_may_be_one_of_numpys_truths() -> None:
    guarded = GuardedDevice(Read(Reading(*X, clutch=np.bool_(True), present=np.bool_(False))), 1)  # type: ignore[arg-type]
    reading = guarded.read(0, 0)
    assert reading is not None
    assert (reading.clutch, reading.present) == (True, False)
    assert type(reading.present) is bool


def test_a_switch_that_is_no_truth_is_refused_at_the_first_reading() -> None:
    with pytest.raises(Refused, match="clutch=True"):
        GuardedDevice(Read(Reading(*X, clutch="open")), 1).read(0, 0)  # type: ignore[arg-type]
