"""A device that fails: it never gets a force that is not to be held, and the law never sees what it read wrong."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from math import inf, nan
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from master.device import SimulatedMaster
from slave.robot import SimulatedSlave
from teleop.errors import DeviceError, Refused
from teleop.live.devices.guarded_device import DEAD_NS, GuardedDevice, deadline_of
from teleop.live.records.merge import merge
from teleop.live.summary import UNWATCHED
from teleop.protocol.endpoint import Endpoint, Reading, Stepped
from teleop.protocol.session import Session
from teleop.scene.loading import load_scene
from tests.live.conftest import Command

MS = 1_000_000
WELL = Reading((0.1,), (0.2,), (0.3,))


class Device:
    """Reads and holds what the test says."""

    def __init__(self) -> None:
        self.reads: Any = WELL
        self.holds: Exception | None = None
        self.held: list[tuple[float, ...]] = []

    def read(self, k: int) -> Reading:
        if isinstance(self.reads, Exception):
            raise self.reads
        reading: Reading = self.reads
        return reading

    def hold(self, force: tuple[float, ...]) -> None:
        if self.holds is not None:
            raise self.holds
        self.held.append(force)


@pytest.mark.parametrize("wrong", [
    Reading((0.0,), (nan,), None), Reading((0.0,), (inf,), None), Reading((nan,), (0.0,), None),
    Reading((0.0,), (0.0,), (nan,)), Reading((0.0,), (0.0,), (-inf,)), Reading((0.0, nan), (0.0, 0.0), None),
    DeviceError("the encoder is gone"), OSError(5, "Input/output error"),
], ids=repr)
def test_what_cannot_be_read_or_is_not_finite_is_no_reading(wrong: Any) -> None:
    device = Device()
    guarded = GuardedDevice(device, 1)
    assert guarded.read(0, 0) == WELL
    device.reads = wrong
    assert guarded.read(1, MS) is None
    assert guarded.trouble is not None
    device.reads = WELL
    assert guarded.read(2, 2 * MS) == WELL
    assert guarded.trouble is None


def test_finite_numbers_without_a_finite_sum_are_a_reading() -> None:
    huge = Reading((1.7e308,), (1.7e308,), (1.7e308,))
    device = Device()
    device.reads = huge
    guarded = GuardedDevice(device, 1)
    assert guarded.read(0, 0) == guarded.read(1, MS) == huge
    assert guarded.trouble is None


def test_a_body_that_has_left_is_not_a_device_that_fails() -> None:
    device = Device()
    device.reads = Reading((inf,), (0.0,), None)
    assert GuardedDevice(device, 1).read(0, 0) == device.reads


def test_a_trusted_device_is_taken_at_its_word() -> None:
    device = Device()
    device.reads = Reading((nan,), (nan,), None)
    assert GuardedDevice(device, 1, trusted=True).read(0, 0) is device.reads


def test_a_device_that_cannot_hold_is_in_trouble_until_it_can() -> None:
    device = Device()
    device.holds = DeviceError("the amplifier is off")
    guarded = GuardedDevice(device, 1)
    guarded.hold((1.0, 2.0))
    assert guarded.read(1, MS) == WELL, "it can still be read"
    assert guarded.trouble == "the amplifier is off"
    device.holds = None
    guarded.let_go()
    assert device.held == [(0.0,)]
    assert guarded.read(2, 2 * MS) == WELL
    assert guarded.trouble is None


def test_a_device_that_fails_for_long_is_given_up_and_one_that_comes_back_is_not() -> None:
    device = Device()
    guarded = GuardedDevice(device, 1)
    guarded.read(0, 0)
    device.reads = OSError("gone")
    first = 10 * DEAD_NS  # however long nobody asked it: before the first exchange an end may wait for hours
    guarded.read(1, first)
    assert not guarded.dead(first + DEAD_NS)
    guarded.read(2, first + DEAD_NS + 1)
    assert guarded.dead(first + DEAD_NS + 1)
    device.reads = WELL
    guarded.read(3, first + DEAD_NS + 2)
    assert not guarded.dead(first + DEAD_NS + 2)


@pytest.mark.parametrize("senses", [True, False])
def test_a_device_whose_sensor_comes_or_goes_is_in_trouble_and_not_a_type_error(senses: bool) -> None:
    device = Device()
    with_force, without = WELL, WELL._replace(f=None)
    device.reads = with_force if senses else without
    guarded = GuardedDevice(device, 1)
    assert guarded.read(0, 0) == device.reads
    device.reads = without if senses else with_force
    assert guarded.read(1, MS) is None
    assert "a device has a force sensor or none" in str(guarded.trouble)


def test_anything_else_that_it_raises_is_a_bug_and_not_swallowed() -> None:
    device = Device()
    device.reads = ZeroDivisionError()
    with pytest.raises(ZeroDivisionError):
        GuardedDevice(device, 1).read(0, 0)


@pytest.mark.parametrize("number", [int, np.float32, np.float16, np.int16, np.float64, Fraction], ids=repr)
@pytest.mark.parametrize("trusted", [False, True])
def test_numbers_of_any_real_type_are_read_as_floats(number: Any, trusted: bool) -> None:
    device = Device()
    device.reads = Reading((number(1),), (number(-2),), (number(3),))
    reading = GuardedDevice(device, 1, trusted=trusted).read(0, 0)
    assert reading == Reading((1.0,), (-2.0,), (3.0,))
    assert {type(part[0]) for part in reading if part is not None} == {float}
    device.reads = Reading((10**400,), (0,), None)
    assert GuardedDevice(device, 1).read(0, 0) == Reading((inf,), (0.0,), None), "a body that has left"


def test_a_reading_of_floats_is_taken_as_it_is_and_costs_no_copy() -> None:
    assert GuardedDevice(Device(), 1).read(0, 0) is WELL


@pytest.mark.parametrize("wrong", [True, np.bool_(True), "1.0", None, 1j, (1.0,), np.array([1.0]), b"1"], ids=repr)
def test_what_is_no_number_is_refused_at_first_and_no_reading_later(wrong: Any) -> None:
    well = (0.0,)
    for reading in (Reading((wrong,), well, None), Reading(well, (wrong,), None), Reading(well, well, (wrong,))):
        device = Device()
        device.reads = reading
        with pytest.raises(Refused, match=r"each a tuple with a number for each axis.*write for example"):
            GuardedDevice(device, 1).read(0, 0)
        device.reads = WELL
        guarded = GuardedDevice(device, 1)
        assert guarded.read(0, 0) == WELL
        device.reads = reading
        assert guarded.read(1, MS) is None
        assert "a number for each axis" in str(guarded.trouble)


@pytest.mark.parametrize(("dt", "every", "stepped", "refused"), [
    (1e-3, 1, False, False), (1e-3, 75, False, False), (1e-3, 80, False, True), (0.1, 1, False, True),
    (0.1, 1, True, False),
])
def test_an_end_that_would_renew_the_force_too_seldom_for_its_device_is_refused(
    dt: float, every: int, stepped: bool, refused: bool
) -> None:
    scene = load_scene("free_motion", dt=dt)
    device = SimulatedMaster(scene)
    session = Session(master=True, manifest={}, number=1, every=every)
    end = Endpoint(scene, "m", session, Stepped(None) if stepped else None)
    if refused:
        with pytest.raises(Refused, match=r"lapses after 0.15 s.*every 0.(08|1) s; tick at least every 0.075 s"):
            deadline_of(device, end)
    else:
        assert deadline_of(device, end) == (None if stepped else device.deadline)


def test_a_device_without_a_deadline_is_taken_and_one_whose_deadline_is_no_time_is_not() -> None:
    end = Endpoint(load_scene("free_motion"), "m", Session(master=True, manifest={}, number=1))
    device: Any = Device()
    assert deadline_of(device, end) is None
    device.deadline = 0.0
    with pytest.raises(Refused, match="deadline must be above 0"):
        deadline_of(device, end)


# In a live run

SCENE = load_scene("hard_wall", duration=1.2, link="delay(0.002)")


class Sick(SimulatedMaster):
    """Cannot be read from tick 300 to 320, and reads NaN from 700 to 720."""

    def __init__(self, scene: Any) -> None:
        super().__init__(scene)
        self.held: list[tuple[int, tuple[float, ...]]] = []
        self.k = 0

    def read(self, k: int) -> Reading:
        self.k = k
        reading = super().read(k)
        if 300 <= k < 320:
            raise DeviceError("the encoder is gone")
        return reading._replace(v=(nan,)) if 700 <= k < 720 else reading

    def hold(self, force: tuple[float, ...]) -> None:
        self.held.append((self.k, force))
        super().hold(force)


@pytest.mark.live
def test_an_end_whose_device_fails_is_safe_and_comes_back_by_itself(pair: Callable[..., Any]) -> None:
    scene = replace(SCENE, link=None)
    device = Sick(scene)
    both = pair(scene, parts={"m": {"device": device}, "s": {}}).run()
    assert both.status() == {"m": "ok", "s": "ok"}
    guard = both.shells["m"].endpoint.guard
    entries = [event for event in guard.events if event.what == "safe"]
    causes = [event.why for event in entries]
    assert any("the encoder is gone" in why for why in causes)
    assert any("not finite" in why for why in causes)
    assert len([event for event in guard.events if event.what == "released"]) >= 2
    for first in (300, 700):
        blind = [force for k, (force,) in device.held if first - 1 <= k < first + 20]
        assert all(abs(b) < abs(a) or b == 0.0 for a, b in pairwise(blind)), "on its way to zero"
    trace = merge(scene, *both.write()).trace
    ticks = np.round(trace["t"] * 1e3).astype(int)
    assert not ((ticks >= 300) & (ticks < 320)).any(), "a tick without a reading is left out whole"
    assert np.isfinite(trace["v_m"]).all()
    assert trace["g_m"][-1] == 1.0


class Dead:
    """Is gone from tick 100 on."""

    def __init__(self, inner: Any) -> None:
        self.inner = inner
        self.hold = inner.hold

    def read(self, k: int) -> Reading:
        if k >= 100:
            raise OSError("the bus is gone")
        reading: Reading = self.inner.read(k)
        return reading


@pytest.mark.live
@pytest.mark.parametrize("e", ["m", "s"])
def test_a_device_that_never_comes_back_ends_the_run_with_a_sentence_at_both_ends(
    e: str, pair: Callable[..., Any]
) -> None:
    scene = replace(SCENE, link=None, duration=5.0)
    device = Dead((SimulatedMaster if e == "m" else SimulatedSlave)(scene))
    parts: dict[str, Any] = {"m": {}, "s": {}}
    parts[e]["device"] = device
    both = pair(scene, parts=parts).run()
    assert both.errors == {"m": None, "s": None}
    assert both.status() == {"m": "stopped", "s": "stopped"}
    for shell in both.shells.values():
        assert "the device fails: the bus is gone" in shell.outcome.sentence


@pytest.mark.parametrize(("axes", "wrong", "words"), [
    (1, Reading(0.0, 0.0, None), r"Reading\(\(x,\), \(v,\), None\)"),  # type: ignore[arg-type]
    (1, ((0.0,), (0.0,), None), "tuple"), (1, None, "gave None"), (1, Reading((0.0,), (0.0, 0.0), None), "here 1"),
    (3, Reading((0.0,) * 3, (0.0,) * 3, (0.0,)), r"Reading\(\(x, x2, x3\), \(v, v2, v3\), "),
])
def test_a_device_that_reads_something_else_is_told_so_at_once_and_how_to_write_it(
    axes: int, wrong: Any, words: str
) -> None:
    device = Device()
    device.reads = wrong
    with pytest.raises(Refused, match=words):
        GuardedDevice(device, axes).read(0, 0)


class Coarse(SimulatedMaster):
    """Reads what its driver unpacks: single precision, and an int where nothing moves."""

    def read(self, k: int) -> Reading:
        x, v, f, *_ = super().read(k)
        return Reading(tuple(map(np.float32, x)), tuple(np.float32(n) if n else 0 for n in v), f)  # type: ignore[misc]


@pytest.mark.live
def test_a_device_that_reads_ints_and_float32_is_heard_by_the_other_end(pair: Callable[..., Any]) -> None:
    """The other end took its messages for malformed, dropped them all, and told of silence."""
    scene = replace(SCENE, link=None)
    both = pair(scene, parts={"m": {"device": Coarse(scene)}, "s": {}}).run()
    assert both.errors == {"m": None, "s": None}
    assert both.status() == {"m": "ok", "s": "ok"}
    slave = both.shells["s"].endpoint
    assert "malformed" not in slave.rejected
    assert slave.inbox.played > 100
    both.write()


class Bare:
    """A device without a deadline."""

    def __init__(self, scene: Any) -> None:
        inner = SimulatedMaster(scene)
        self.read, self.hold = inner.read, inner.hold


@pytest.mark.live
def test_that_nothing_lets_go_of_a_device_but_its_end_was_told_only_after_the_run(
    command: Callable[..., Command], tmp_path: Path
) -> None:
    program = """
from slave.robot import SimulatedSlave
from teleop.live.end import end_main


class Bare:
    def __init__(self, scene):
        inner = SimulatedSlave(scene)
        self.read, self.hold = inner.read, inner.hold


raise SystemExit(end_main("s", Bare))
"""
    (tmp_path / "bare.py").write_text(program)
    end = command("bare", "hard_wall", "--listen", "127.0.0.1:0", "--json", "--wait", "60")
    end.event("listening")
    assert end.process.stderr is not None
    assert end.process.stderr.readline() == f"teleop: {UNWATCHED}\n"


@pytest.mark.live
def test_a_device_whose_force_nothing_would_let_go_of_is_told_of_in_the_summary(pair: Callable[..., Any]) -> None:
    scene = replace(SCENE, link=None, duration=0.2)
    both = pair(scene, parts={"m": {"device": Bare(scene)}, "s": {}}).run()
    told = [json.loads((folder / "summary.json").read_text())["notes"] for folder in both.write()]
    assert [UNWATCHED in notes for notes in told] == [True, False]
