"""What a law is told of the time since its last tick, and of the watchdog's gain at that tick."""

# ruff: noqa: ARG005 - an end takes what it is given, used or not

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import pytest

from teleop import At, Scene, Watchdog, load_scene, run
from teleop.analysis.models.linear import linear_scene
from teleop.simulation.source import rendered
from tests.fakes import law_of


class Place(NamedTuple):
    x: float  # m


class Meter(NamedTuple):
    x: float  # m
    time: float  # s of the run, as the spans add up
    gains: float  # sum of the gains


def told(self: Any, s: Meter, at: At, rx: Place, sign: float) -> tuple[float, Place, Meter]:
    now = Meter(at.x, s.time + at.span, s.gains + at.gain)
    f = sign * self.K * (at.x - rx.x) + (sign - 1.0) * 2.0 * at.v + now.time + sign * 0.01 * now.gains
    return f, Place(at.x), now


Timed = law_of(  # position coupling that shows in its forces what it is told of time and gain
    name="Timed", master_start=lambda self, at: (Meter(at.x, 0.0, 0.0), Place(at.x)),
    slave_start=lambda self, at: (Meter(at.x, 0.0, 0.0), Place(at.x)),
    master=lambda self, s, at, rx: told(self, s, at, rx, 1.0),
    slave=lambda self, s, at, rx: told(self, s, at, rx, -1.0))


def timed(**other: Any) -> Scene:
    """A scene whose watchdog lets go and takes hold again."""
    scene = load_scene("canonical", law=Timed(K=200.0), link="delay(0.01) | blackout(0.1, 0.1)")
    return replace(scene, duration=0.4, watchdog=Watchdog(timeout=0.02, ramp=0.01, settle=0.02), **other)


def probe(at: str, end: str, value: Any) -> Any:
    """`Timed` that writes down what a field of `At` was at each tick of an end."""
    seen: list[float] = value
    own = getattr(Timed, end)

    def asked(self: Any, s: Meter, here: At, rx: Place) -> Any:
        seen.append(getattr(here, at))
        return here.span * here.gain * 0.0 + own(self, s, here, rx)[0], *own(self, s, here, rx)[1:]

    parts: dict[str, Any] = {end: asked}
    return law_of(Timed, **parts)(K=200.0)


@pytest.mark.parametrize("end", ["master", "slave"])
def test_in_virtual_time_span_is_the_tick_and_gain_is_that_of_the_tick_before(end: str) -> None:
    spans: list[float] = []
    gains: list[float] = []
    scene = timed()
    # The contract asks the law for a few ticks before the run does.
    trace = run(replace(scene, law=probe("gain", end, gains))).trace
    run(replace(scene, law=probe("span", end, spans)))
    assert set(spans[-scene.ticks:]) == {scene.dt}
    recorded = trace[f"g_{end[0]}"]
    assert gains[-scene.ticks:] == [1.0, *recorded[:-1].tolist()]
    assert 0.0 in gains
    assert gains[-1] == 1.0


def test_without_a_watchdog_the_gain_is_one() -> None:
    gains: list[float] = []
    run(replace(timed(), watchdog=None, law=probe("gain", "slave", gains)))
    assert set(gains) == {1.0}


def test_a_law_that_names_neither_has_no_line_for_them() -> None:
    text = rendered(load_scene("canonical", law="direct"))
    assert "dt, nan, nan))" in text
    assert "span" not in text


def test_the_linear_steps_of_stability_have_the_tick_for_span() -> None:
    """Each end adds up its spans: an eigenvalue of one, and a constant force, which drops out."""
    scene = replace(load_scene("soft_tissue", law=Timed(K=200.0)), cap=None, watchdog=None)
    steps = linear_scene(scene)
    assert steps.slave.A.shape[0] > 3
