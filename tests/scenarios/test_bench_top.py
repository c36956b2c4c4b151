"""Scene `bench_top`: nothing simulated beside the machines, limits from the start, and switches that are heeded."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from master.hand import Grip, Sine
from slave.wall import Wall
from teleop import load_scene, run


def test_there_is_no_simulated_hand_wall_or_link_and_it_lasts_a_day() -> None:
    scene = load_scene("bench_top")
    assert scene.hand is scene.environment is scene.link is None
    assert scene.duration == 86400.0
    assert None not in (scene.cap, scene.watchdog, scene.operator)
    assert (scene.cap.f_max, scene.cap.slew, scene.cap.v_max) == (5.0, 500.0, 0.5)


def test_each_of_sixteen_axes_has_its_unit_mass_limit_and_scale() -> None:
    each = ",".join(str(0.1 * (i + 1)) for i in range(16))
    scene = load_scene("bench_top", axes="16", units=",".join(["m", "rad"] * 8), m_m=each, m_s=each, f_max=each,
                       scale_x=each, closes_within=each, law="pp", delay="0.01")
    assert scene.axis_units == ("m", "rad") * 8
    wanted = pytest.approx([0.1 * (i + 1) for i in range(16)])
    assert [one.mass for one in scene.master] == [one.mass for one in scene.slave] == wanted
    assert [one.f_max for one in scene.cap] == [one.scale_x for one in scene.scaling] == wanted
    assert scene.operator is not None
    assert scene.operator.within(16) == wanted
    assert run(replace(scene, duration=0.02)).status == "ok"


def test_limits_are_on_in_the_hands_of_whoever_drives_it() -> None:
    """A hand that swings it hard, and a hard wall, put in its place."""
    scene = replace(load_scene("bench_top", duration=2.0, clutch=(1.2, 1.5)), environment=Wall(k=2e4, d=10.0, at=0.01),
                    hand=Grip(mass=0.4, k=500.0, d=5.0, reference=Sine(amplitude=0.3, frequency=1.0)))
    trace = run(scene).trace
    assert np.abs(trace["f_m"]).max() == 5.0
    assert np.abs(np.diff(trace["f_m"], prepend=0.0)).max() <= 0.5 + 1e-12
    assert not trace["f_m"][1260:1500].any()
