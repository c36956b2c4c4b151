"""Every way out of a run, live: the force goes to zero within the slew limit, and along the ramp without one."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from math import inf, nan
from threading import Thread
from typing import Any

import numpy as np
import pytest

from master.device import SimulatedMaster
from slave.robot import SimulatedSlave
from teleop import Cap, DeviceError, MassDamper, Reading, Watchdog, load_scene, run
from teleop.live.process.interrupt import Interrupt
from teleop.live.records.record import read_events
from tests.fakes import Body

pytestmark = pytest.mark.live
FULL = pytest.mark.full
Make = Callable[..., Any]
DEVICES: dict[str, Any] = {"m": SimulatedMaster, "s": SimulatedSlave}
SLEW = 1000.0  # N/s: 1 N a tick
BASE = replace(load_scene("canonical", duration=0.6), link=None, slave=MassDamper(mass=0.5, damping=30.0))
SLEWED = replace(BASE, cap=Cap(f_max=20.0, slew=SLEW), watchdog=Watchdog(timeout=0.1, ramp=0.0))
RAMPED = replace(BASE, watchdog=Watchdog(timeout=0.1, ramp=0.05))
AT = 540  # the tick of what happens


class Felt(Body):
    """A device that acts at a tick with over 2 N on it, and keeps when it was given each force; from zero on."""

    def __init__(self, scene: Any, e: str, act: Callable[[Reading], Reading] = lambda reading: reading) -> None:
        super().__init__(inner=DEVICES[e](scene), reads=self.acts)
        self.act, self.over = act, 0
        self.others: list[Felt] = []  # that have to have force on them, too, for it to act
        self.held, self.ticks, self.when = [(0.0,)], [-1], [0]  # when: ns
        self.acted: int | None = None

    def acts(self, k: int, reading: Reading) -> Reading:
        loaded = min(abs(device.held[-1][0]) for device in (self, *self.others)) > 2.0
        if k < AT or self.acted is not None or not loaded:  # a busy machine's silence lets go of it, too
            return reading
        self.acted = k  # a tick may be missed
        return self.act(reading)

    def hold(self, force: tuple[float, ...]) -> None:
        super().hold(force)
        self.when.append(time.monotonic_ns())

    @property
    def forces(self) -> tuple[Any, Any]:
        """Each force, and at which tick."""
        return np.array(self.held)[:, 0], np.array(self.ticks)


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
    force, when = device.forces[0][device.over - 1 :], np.array(device.when[device.over - 2 :])
    least = 0.0 if scene.cap is None else SLEW * 1e-3  # without a slew limit a wave that is missing takes more
    assert abs(force[0]) > least, "in one step it would be more than is allowed"
    assert force[-1] == 0.0
    steps = np.abs(np.diff(force))
    if scene.cap is not None:
        assert steps.max() <= SLEW * 1e-3 + 1e-9
    else:  # of the ramp's 50 ms, with a tick to spare: that a force was held late does not make the next one later
        late = np.diff(when) / 1e6
        assert (steps <= abs(force[0]) / 50.0 * (2.0 + late[1:] + late[:-1])).all()


@pytest.mark.parametrize(("scene", "seed"), [
    pytest.param(SLEWED, None, id="slewed"), pytest.param(RAMPED, None, id="ramped"),
    pytest.param(replace(SLEWED, units=("rad",)), 1, id="slewed, stepped, of a joint"),
    pytest.param(RAMPED, 1, id="ramped, stepped", marks=FULL),
])
def test_at_the_end_of_a_run_the_force_does_not_jump(scene: Any, seed: int | None, pair: Make) -> None:
    """It was at zero in one tick, 20 N of it; a torque of six joints was told as "1.61 N taken to zero"."""
    for _ in range(20):  # a machine that is too busy has let go before
        devices = {e: Felt(scene, e) for e in "ms"}
        parts = {e: {"device": device} for e, device in devices.items()}
        both = marked(pair(scene, seed=seed, parts=parts), devices).run()
        assert both.status() == {"m": "ok", "s": "ok"}
        if min(abs(device.held[device.over - 1][0]) for device in devices.values()) > 1.0:
            break
    for device in devices.values():
        gently(scene, device)
    for folder in both.write():
        told = read_events(folder)[-1]
        assert told["what"] == "zero"
        assert f" {'N m' if scene.units else 'N'} taken to zero in 0." in told["why"]
        assert "at once" not in told["why"]
    if seed is not None:
        virtual = run(scene, seed=seed)
        for e, shell in both.shells.items():
            assert (shell.counts.ticks, shell.outcome.sentence) == (virtual.ticks, virtual.sentence), e


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
        endpoint._law._started = Law(endpoint._law._started)
        return reading

    return act


def leaves(_both: list[Any], _e: str) -> Callable[[Reading], Reading]:
    return lambda reading: reading._replace(x=(inf,))


@pytest.mark.parametrize(("how", "status", "e", "scene"), [
    pytest.param(how, "stopped" if how is stop else "diverged", e, scene, id=f"{how.__name__} {e} {name}",
                 marks=[] if (how, e, name) in ((stop, "m", "slewed"), (law_is_nan, "s", "ramped"),
                                                (leaves, "m", "ramped")) else FULL)
    for how in (stop, law_is_nan, leaves) for e in "ms" for name, scene in (("slewed", SLEWED), ("ramped", RAMPED))
])
def test_a_run_that_is_stopped_or_diverges_ends_without_a_jump_at_either_end(
    how: Any, status: str, e: str, scene: Any, pair: Make
) -> None:
    """It was 12 N in one tick at a divergence, and as much at the end that heard the other's farewell."""
    scene = replace(scene, duration=60.0)  # it ends as soon as there is force at both
    both: list[Any] = []
    other = "sm"["ms".index(e)]
    devices = {e: Felt(scene, e, how(both, e)), other: Felt(scene, other)}
    devices[e].others.append(devices[other])
    both.append(pair(scene, parts={end: {"device": device} for end, device in devices.items()}))
    marked(both[0], devices).run()
    assert both[0].errors == {"m": None, "s": None}
    assert both[0].shells[e].outcome.status == status
    for device in devices.values():
        gently(scene, device)


@pytest.mark.parametrize(("e", "scene"), [
    pytest.param("m", SLEWED, id="m slewed"), pytest.param("s", RAMPED, id="s ramped"),
    pytest.param("s", SLEWED, id="s slewed", marks=FULL), pytest.param("m", RAMPED, id="m ramped", marks=FULL),
])
def test_one_reading_that_fails_does_not_make_the_force_jump(e: str, scene: Any, pair: Make) -> None:
    """It was at zero in one tick, 4 N of it."""
    class Once(Felt):
        def acts(self, k: int, reading: Reading) -> Reading:
            if self.acted is not None and k > self.acted + 100:
                interrupt.name = "SIGTERM"
            return super().acts(k, reading)

    def act(_reading: Reading) -> Reading:
        raise DeviceError("a frame was lost")

    interrupt, scene = Interrupt(), replace(scene, duration=60.0)
    device = Once(scene, e, act)
    both = pair(scene, parts={**{"m": {}, "s": {}}, e: {"device": device, "interrupt": interrupt}}).run()
    assert both.status() == {"m": "stopped", "s": "stopped"}
    assert any("a frame was lost" in event.why for event in both.shells[e].endpoint.guard.events)
    force, at = device.forces
    assert device.acted is not None
    then = int(np.flatnonzero(at == device.acted)[0])
    assert abs(force[then - 1]) > 1.0
    ramp = 1.0 - 0.02 * (at[then] - at[then - 1] + 1)  # ticks may be missed
    assert ramp < force[then] / force[then - 1] < 1.0 or scene.cap is not None, "on its way down"
    if scene.cap is not None:  # without one the law may jump by itself, where a wave is missing
        steps = np.abs(np.diff(force))
        assert (steps <= SLEW * 1e-3 * np.maximum(1, np.diff(at)) + 1e-9).all()
    assert not force[(at > device.acted + 60) & (at < device.acted + 90)].any(), "until packets settle"


@pytest.mark.parametrize("reads", [True, False])
def test_a_device_that_did_not_take_a_force_begins_again_at_zero(reads: bool, pair: Make) -> None:
    """Its amplifier was off, or its watchdog has taken over: what was held before must not come back at once."""
    class Off(Felt):
        risen = 0

        def hold(self, force: tuple[float, ...]) -> None:
            if self.acted is not None and self.at <= self.acted + 1 and any(force):
                raise DeviceError("the amplifier is off")
            super().hold(force)
            self.risen += self.acted is not None and any(force)
            if self.risen == 3:
                interrupt.name = "SIGTERM"

    def act(reading: Reading) -> Reading:
        if not reads:
            raise DeviceError("a frame was lost")
        return reading

    interrupt, scene = Interrupt(), replace(RAMPED, duration=60.0)
    device = Off(scene, "s", act)
    both = pair(scene, parts={"m": {}, "s": {"device": device, "interrupt": interrupt}}).run()
    assert both.status() == {"m": "stopped", "s": "stopped"}
    force, at = device.forces
    assert device.acted is not None
    assert abs(force[at < device.acted][-1]) > 1.0
    assert not force[(at >= device.acted) & (at < device.acted + 90)].any()
    rises = int(np.flatnonzero((at > device.acted) & (force != 0.0))[0])
    steps = np.abs(np.diff(force[rises - 1 : rises + 3]))
    assert (steps < np.diff(at[rises - 1 : rises + 3])).all(), "from zero on, a fiftieth of the force a tick"


def test_a_second_signal_ends_the_force_at_once(pair: Make) -> None:
    scene = replace(BASE, watchdog=Watchdog(timeout=0.1, ramp=1.5), duration=60.0)
    interrupt = Interrupt()
    device = Felt(scene, "s")

    def press() -> None:
        interrupt.name, interrupt.count = "SIGINT", interrupt.count + 1

    between: list[float] = []

    def twice() -> None:
        while device.at < AT or abs(device.held[-1][0]) < 2.0:
            time.sleep(0.001)
        press()
        time.sleep(0.1)
        between.append(abs(device.held[-1][0]))
        press()

    both = pair(scene, parts={"m": {}, "s": {"device": device, "interrupt": interrupt}})
    Thread(target=twice, daemon=True).start()
    both.run()
    assert both.errors == {"m": None, "s": None}
    assert between[0] > 1.0, "on its way"
    force = device.forces[0]
    assert (force[-1], np.abs(force[-3:-1]).max() > 1.0) == (0.0, True)
    assert "at once" in both.shells["s"].endpoint.guard.events[-1].why
