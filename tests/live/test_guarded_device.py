"""A device that fails: it never gets a force that is not to be held, and the law never sees what it read wrong."""

from __future__ import annotations

from fractions import Fraction
from math import inf, nan
from typing import Any

import numpy as np
import pytest

from master.device import SimulatedMaster
from teleop import DeviceError, Reading, Refused, load_scene
from teleop.live.devices.guarded_device import DEAD_NS, GuardedDevice, deadline_of
from teleop.protocol.endpoint import Endpoint, Stepped
from teleop.protocol.session import Session
from tests.fakes import WELL, always, raising, reading

MS = 1_000_000
X = ((0.0,), (0.0,))
SWITCHED = Reading(*X, clutch=True)


@pytest.mark.parametrize("first", [WELL, WELL._replace(f=None), SWITCHED, Reading(*X)], ids=["f", "no f", "clutch", ""])
def test_what_cannot_be_read_or_is_not_finite_is_no_reading(first: Reading) -> None:
    """And neither is a reading in which a sensor or a switch comes or goes: it was a TypeError."""
    wrong: dict[Any, str] = {
        Reading((0.0,), (nan,), None): "", Reading((0.0,), (inf,), None): "", Reading((nan,), (0.0,), None): "",
        Reading((0.0,), (0.0,), (nan,)): "", Reading((0.0,), (0.0,), (-inf,)): "",
        Reading((0.0, nan), (0.0, 0.0), None): "", DeviceError("the encoder is gone"): "the encoder is gone",
        OSError(5, "Input/output error"): "Input/output error",
        first._replace(f=None if first.f else (0.3,)): "a device has a force sensor or none",
        first._replace(clutch=1): "clutch", first._replace(clutch=None if first.clutch else False): "clutch",
        first._replace(present=False): "present",
    }
    for bad, words in wrong.items():
        device = reading(first)
        guarded = GuardedDevice(device, 1)
        assert guarded.read(0, 0) == first
        device.reads = always(bad)
        assert guarded.read(1, MS) is None, bad
        assert words in str(guarded.trouble), bad
        device.reads = always(first)
        assert guarded.read(2, 2 * MS) == first, bad
        assert guarded.trouble is None


def test_huge_numbers_a_body_that_has_left_and_a_trusted_device_are_taken_as_they_are() -> None:
    """Finite numbers may have no finite sum; where a body is at infinity is for the run to judge."""
    huge, left = Reading((1.7e308,), (1.7e308,), (1.7e308,)), Reading((inf,), (0.0,), None)
    for far in (huge, left, WELL):
        guarded = GuardedDevice(reading(far), 1)
        assert guarded.read(0, 0) is far, "and costs no copy"
        assert guarded.read(1, MS) is far
        assert guarded.trouble is None
    blind = Reading((nan,), (nan,), None)
    assert GuardedDevice(reading(blind), 1, trusted=True).read(0, 0) is blind


def test_a_device_that_cannot_hold_is_in_trouble_until_it_can_and_one_that_never_had_a_force_is_asked_once() -> None:
    device = reading(holds=raising(DeviceError("the amplifier is off")))
    guarded = GuardedDevice(device, 1)
    guarded.hold((1.0, 2.0))
    assert guarded.read(1, MS) == WELL, "it can still be read"
    assert guarded.trouble == "the amplifier is off"
    device.holds = None
    guarded.let_go()
    assert device.held == [(0.0,)]
    assert guarded.read(2, 2 * MS) == WELL
    assert guarded.trouble is None
    guarded = GuardedDevice(reading(holds=raising(OSError("no such device"))), 1)
    assert not guarded.let_go()
    assert not guarded.forced


def test_a_device_that_fails_for_long_is_given_up_one_that_comes_back_is_not_and_a_bug_is_not_swallowed() -> None:
    device = reading()
    guarded = GuardedDevice(device, 1)
    guarded.read(0, 0)
    device.reads = always(OSError("gone"))
    first = 10 * DEAD_NS  # however long nobody asked it: before the first exchange an end may wait for hours
    guarded.read(1, first)
    assert not guarded.dead(first + DEAD_NS)
    guarded.read(2, first + DEAD_NS + 1)
    assert guarded.dead(first + DEAD_NS + 1)
    device.reads = always(WELL)
    guarded.read(3, first + DEAD_NS + 2)
    assert not guarded.dead(first + DEAD_NS + 2)
    with pytest.raises(ZeroDivisionError):
        GuardedDevice(reading(ZeroDivisionError()), 1).read(0, 0)


def test_numbers_of_any_real_type_are_read_as_floats_and_truths_of_numpys_as_truths() -> None:
    for number in (int, np.float32, np.float16, np.int16, np.float64, Fraction):
        for trusted in (False, True):
            device = reading(Reading((number(1),), (number(-2),), (number(3),)))
            found = GuardedDevice(device, 1, trusted=trusted).read(0, 0)
            assert found == Reading((1.0,), (-2.0,), (3.0,)), number
            assert {type(part[0]) for part in found if isinstance(part, tuple)} == {float}, number
    far = reading(Reading((10**400,), (0,), None))
    assert GuardedDevice(far, 1).read(0, 0) == Reading((inf,), (0.0,), None), "a body that has left"
    switched: Any = Reading(*X, clutch=np.bool_(True), present=np.bool_(False))
    found = GuardedDevice(reading(switched), 1).read(0, 0)
    assert found is not None
    assert (found.clutch, found.present, type(found.present)) == (True, False, bool)


@pytest.mark.parametrize("wrong", [True, np.bool_(True), "1.0", None, 1j, (1.0,), np.array([1.0]), b"1"], ids=repr)
def test_what_is_no_number_is_refused_at_first_and_no_reading_later(wrong: Any) -> None:
    well = (0.0,)
    for bad in (Reading((wrong,), well, None), Reading(well, (wrong,), None), Reading(well, well, (wrong,))):
        with pytest.raises(Refused, match=r"each a tuple with a number for each axis.*write for example"):
            GuardedDevice(reading(bad), 1).read(0, 0)
        device = reading()
        guarded = GuardedDevice(device, 1)
        assert guarded.read(0, 0) == WELL
        device.reads = always(bad)
        assert guarded.read(1, MS) is None
        assert "a number for each axis" in str(guarded.trouble)


def test_a_device_that_reads_something_else_is_told_so_at_once_and_how_to_write_it() -> None:
    cases: list[tuple[int, Any, str]] = [
        (1, Reading(0.0, 0.0, None), r"Reading\(\(x,\), \(v,\), None\)"),  # type: ignore[arg-type]
        (1, ((0.0,), (0.0,), None), "tuple"), (1, None, "gave None"), (1, Reading((0.0,), (0.0, 0.0), None), "here 1"),
        (3, Reading((0.0,) * 3, (0.0,) * 3, (0.0,)), r"Reading\(\(x, x2, x3\), \(v, v2, v3\), "),
        (1, Reading(*X, clutch="open"), "clutch=True"),  # type: ignore[arg-type]
    ]
    for axes, wrong, words in cases:
        with pytest.raises(Refused, match=words):
            GuardedDevice(reading(wrong), axes).read(0, 0)


def test_an_end_that_would_renew_the_force_too_seldom_for_its_device_is_refused_and_a_deadline_of_no_time() -> None:
    for dt, every, stepped, refused in ((1e-3, 1, False, False), (1e-3, 75, False, False), (1e-3, 80, False, True),
                                        (0.1, 1, False, True), (0.1, 1, True, False)):
        scene = load_scene("free_motion", dt=dt)
        simulated = SimulatedMaster(scene)
        session = Session(master=True, manifest={}, number=1, every=every)
        end = Endpoint(scene, "m", session, Stepped(None) if stepped else None)
        if refused:
            with pytest.raises(Refused, match=r"lapses after 0.15 s.*every 0.(08|1) s; tick at least every 0.075 s"):
                deadline_of(simulated, end)
        else:
            assert deadline_of(simulated, end) == (None if stepped else simulated.deadline)
    end = Endpoint(load_scene("free_motion"), "m", Session(master=True, manifest={}, number=1))
    device = reading()
    device.deadline = None
    assert deadline_of(device, end) is None
    device.deadline = 0.0
    with pytest.raises(Refused, match="deadline must be above 0"):
        deadline_of(device, end)
