"""Every way out of a run, live: the force goes to zero within the slew limit, and along the ramp without one."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from dataclasses import replace
from math import inf, nan
from typing import Any

import numpy as np
import pytest

from master.device import SimulatedMaster
from slave.robot import SimulatedSlave
from teleop.errors import DeviceError
from teleop.live.driving import run as drive
from teleop.live.process.interrupt import Interrupt
from teleop.live.records.record import read_events
from teleop.live.shell import Shell
from teleop.physics.plant import MassDamper
from teleop.protocol.endpoint import Reading
from teleop.scene.loading import load_scene
from teleop.simulation.virtual import run
from teleop.stages.force_cap import Cap
from teleop.stages.watchdog import Watchdog

pytestmark = pytest.mark.live
Make = Callable[..., Any]
DEVICES: dict[str, Any] = {"m": SimulatedMaster, "s": SimulatedSlave}
SLEW = 1000.0  # N/s: 1 N a tick
BASE = replace(load_scene("canonical", duration=0.6), link=None, slave=MassDamper(mass=0.5, damping=30.0))
SLEWED = replace(BASE, cap=Cap(f_max=20.0, slew=SLEW), watchdog=Watchdog(timeout=0.1, ramp=0.0))
RAMPED = replace(BASE, watchdog=Watchdog(timeout=0.1, ramp=0.05))
AT = 540  # the tick of what happens


class Felt:
    """A device that acts at a tick with over 2 N on it, and keeps every force that it was given."""

    def __init__(self, scene: Any, e: str, act: Callable[[Reading], Reading] = lambda reading: reading) -> None:
        self.inner, self.act, self.k, self.held, self.at = DEVICES[e](scene), act, -1, [0.0], [-1]
        self.when = [0]  # ns, of each force
        self.over = 0
        self.acted: int | None = None

    def read(self, k: int) -> Reading:
        self.k = k
        reading: Reading = self.inner.read(k)
        if k < AT or self.acted is not None or abs(self.held[-1]) <= 2.0:  # a busy machine's silence lets go of it too
            return reading
        self.acted = k  # a tick may be missed
        return self.act(reading)

    def hold(self, force: tuple[float, ...]) -> None:
        self.held.append(force[0])
        self.at.append(self.k)
        self.when.append(time.monotonic_ns())
        self.inner.hold(force)


def marked(both: Any, devices: dict[str, Felt]) -> Any:
    """Two ends whose devices keep how many forces they had been given when the run was over."""
    for e, device in devices.items():
        held = both.shells[e].endpoint.held

        def over(*told: Any, device: Felt = device, way: Any = held.over) -> Any:
            device.over = device.over or len(device.held)
            return way(*told)

        held.over = over
    return both


def gently(scene: Any, device: Felt) -> None:
    """From a force that was there when the run was over down to zero, in steps that are allowed."""
    force, when = np.array(device.held[device.over - 1 :]), np.array(device.when[device.over - 1 :])
    least = 0.0 if scene.cap is None else SLEW * 1e-3  # without a slew limit a wave that is missing takes more
    assert abs(force[0]) > least, "in one step it would be more than is allowed"
    assert force[-1] == 0.0
    steps = np.abs(np.diff(force))
    if scene.cap is not None:
        assert steps.max() <= SLEW * 1e-3 + 1e-9
    else:  # of the ramp's 50 ms, with a tick to spare: that a force was held late does not make the next one later
        late = np.diff(when, prepend=when[0]) / 1e6
        assert (steps <= abs(force[0]) / 50.0 * (2.0 + late[1:] + late[:-1])).all()


@pytest.mark.parametrize("seed", [None, 1], ids=["by the clock", "stepped"])
@pytest.mark.parametrize("scene", [SLEWED, RAMPED], ids=["slewed", "ramped"])
def test_at_the_end_of_a_run_the_force_does_not_jump(scene: Any, seed: int | None, pair: Make) -> None:
    """It was at zero in one tick, 20 N of it."""
    devices = {e: Felt(scene, e) for e in "ms"}
    both = marked(pair(scene, seed=seed, parts={e: {"device": device} for e, device in devices.items()}), devices).run()
    assert both.status() == {"m": "ok", "s": "ok"}
    for device in devices.values():
        gently(scene, device)
    for folder in both.write():
        told = read_events(folder)[-1]
        assert told["what"] == "zero"
        assert " N taken to zero in 0." in told["why"]
        assert "at once" not in told["why"]
    if seed is not None:
        virtual = run(scene, seed=seed)
        for e, shell in both.shells.items():
            assert (shell.counts.ticks, shell.outcome.sentence) == (virtual.ticks, virtual.sentence), e


def test_the_force_that_was_taken_to_zero_is_told_in_the_unit_of_its_axis(pair: Make) -> None:
    """A torque of six joints was told as "1.61 N taken to zero"."""
    both = pair(replace(SLEWED, units=("rad",), duration=0.54), seed=1).run()
    assert all(" N m taken to zero in 0." in read_events(folder)[-1]["why"] for folder in both.write())


def stop(both: list[Any], e: str) -> Callable[[Reading], Reading]:
    def act(reading: Reading) -> Reading:
        both[0].shells[e].interrupt.name = "SIGTERM"
        return reading

    return act


def law_is_nan(both: list[Any], e: str) -> Callable[[Reading], Reading]:
    class Law:
        def __init__(self, started: Any) -> None:
            self.started = started

        def send(self, told: Any) -> Any:
            _, *rest = self.started.send(told)
            return (nan,), *rest

    def act(reading: Reading) -> Reading:
        endpoint = both[0].shells[e].endpoint
        endpoint._started = Law(endpoint._started)
        return reading

    return act


def leaves(_both: list[Any], _e: str) -> Callable[[Reading], Reading]:
    return lambda reading: reading._replace(x=(inf,))


@pytest.mark.parametrize("scene", [SLEWED, RAMPED], ids=["slewed", "ramped"])
@pytest.mark.parametrize("e", ["m", "s"])
@pytest.mark.parametrize(("how", "status"), [(stop, "stopped"), (law_is_nan, "diverged"), (leaves, "diverged")])
def test_a_run_that_is_stopped_or_diverges_ends_without_a_jump_at_either_end(
    how: Any, status: str, e: str, scene: Any, pair: Make
) -> None:
    """It was 12 N in one tick at a divergence, and as much at the end that heard the other's farewell."""
    both: list[Any] = []
    other = "sm"["ms".index(e)]
    devices = {e: Felt(scene, e, how(both, e)), other: Felt(scene, other)}
    both.append(pair(scene, parts={end: {"device": device} for end, device in devices.items()}))
    marked(both[0], devices).run()
    assert both[0].errors == {"m": None, "s": None}
    assert both[0].shells[e].outcome.status == status
    for device in devices.values():
        gently(scene, device)


@pytest.mark.parametrize("scene", [SLEWED, RAMPED], ids=["slewed", "ramped"])
@pytest.mark.parametrize("e", ["m", "s"])
def test_one_reading_that_fails_does_not_make_the_force_jump(e: str, scene: Any, pair: Make) -> None:
    """It was at zero in one tick, 4 N of it."""
    def act(_reading: Reading) -> Reading:
        raise DeviceError("a frame was lost")

    device = Felt(replace(scene, duration=1.0), e, act)
    both = pair(replace(scene, duration=1.0), parts={**{"m": {}, "s": {}}, e: {"device": device}}).run()
    assert both.status() == {"m": "ok", "s": "ok"}
    assert any("a frame was lost" in event.why for event in both.shells[e].endpoint.guard.events)
    force, at = np.array(device.held), np.array(device.at)
    assert device.acted is not None
    then = int(np.flatnonzero(at == device.acted)[0])
    assert abs(force[then - 1]) > 1.0
    ramp = 1.0 - 0.02 * (at[then] - at[then - 1] + 1)  # ticks may be missed
    assert ramp < force[then] / force[then - 1] < 1.0 or scene.cap is not None, "on its way down"
    if scene.cap is not None:  # without one the law may jump by itself, where a wave is missing
        steps = np.abs(np.diff(force))
        assert (steps <= SLEW * 1e-3 * np.maximum(1, np.diff(at)) + 1e-9).all()
    assert np.abs(force[(at > device.acted + 60) & (at < device.acted + 90)]).max() == 0.0, "until packets settle"


@pytest.mark.parametrize("reads", [True, False])
def test_a_device_that_did_not_take_a_force_begins_again_at_zero(reads: bool, pair: Make) -> None:
    """Its amplifier was off, or its watchdog has taken over: what was held before must not come back at once."""
    class Off(Felt):
        def hold(self, force: tuple[float, ...]) -> None:
            if self.acted is not None and self.k <= self.acted + 1 and any(force):
                raise DeviceError("the amplifier is off")
            super().hold(force)

    def act(reading: Reading) -> Reading:
        if not reads:
            raise DeviceError("a frame was lost")
        return reading

    scene = replace(RAMPED, duration=1.2)
    device = Off(scene, "s", act)
    both = pair(scene, parts={"m": {}, "s": {"device": device}}).run()
    assert both.status() == {"m": "ok", "s": "ok"}
    force, at = np.array(device.held), np.array(device.at)
    assert device.acted is not None
    assert abs(force[at < device.acted][-1]) > 1.0
    assert np.abs(force[(at >= device.acted) & (at < device.acted + 90)]).max() == 0.0
    rises = int(np.flatnonzero((at > device.acted) & (force != 0.0))[0])
    steps = np.abs(np.diff([0.0, *force[rises : rises + 3]]))
    assert steps.max() < 1.0, "from zero on, a fiftieth of the force a tick"


def test_a_second_signal_ends_the_force_at_once(pair: Make) -> None:
    scene = replace(BASE, watchdog=Watchdog(timeout=0.1, ramp=1.5), duration=5.0)
    interrupt = Interrupt()
    device = Felt(scene, "s")

    def press() -> None:
        interrupt.name, interrupt.count = "SIGINT", interrupt.count + 1

    async def twice() -> None:
        while device.k < AT or abs(device.held[-1]) < 2.0:
            await asyncio.sleep(0.001)
        press()
        await asyncio.sleep(0.1)
        assert abs(device.held[-1]) > 1.0, "on its way"
        press()

    both = pair(scene, parts={"m": {}, "s": {"device": device, "interrupt": interrupt}})

    async def with_fingers(shell: Shell) -> None:
        await (asyncio.gather(drive(shell), twice()) if shell.endpoint.e == "s" else drive(shell))

    both.drive = with_fingers
    both.run()
    assert both.errors == {"m": None, "s": None}
    assert (device.held[-1], abs(device.held[-2]) > 1.0 or abs(device.held[-3]) > 1.0) == (0.0, True)
    assert "at once" in both.shells["s"].endpoint.guard.events[-1].why
