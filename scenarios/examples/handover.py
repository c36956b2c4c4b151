"""Figures of a handover between operator and policy, law by law: the handle's jumps, and the time to take over.

    python scenarios/examples/handover.py [LAW ...]

A jump is the most change of the handle's force within a tick of 1 ms, as the policy takes over in mid-motion and gives
back at a spring, over a link of 20, 50 and 100 ms each way; beside it that of a policy that pulls at once.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from math import nan
from typing import Any

import numpy as np

from teleop import Scene, load_scene, run
from teleop.stages.authority import Standing

LAWS = ("pp", "p_d", "pd_d", "pspm", "two_layer", "wave", "wave_filter", "wave_matched", "wave_position", "wave_scaled")
DELAYS = (0.02, 0.05, 0.1)  # s
PULLS = 2.0  # s, at which the hand pulls back


def jump(of: Scene, since: float, until: float) -> float:
    """The most change of the handle's force within a tick, N m, between two times."""
    trace = run(of).trace
    change, t = np.abs(np.diff(trace["f_m"])), trace["t"][1:]
    return float(change[(t >= since) & (t < until)].max())


def at_once(of: Scene) -> Scene:
    """The scene with a policy that has all authority within a tick, and none of what smooths its force."""
    hard = replace(of.handover, ramp=1e-3, yields=1e-3, slew=1e9, bandwidth=999.0, most_speed=1e6)  # type: ignore[type-var]
    return replace(of, handover=hard)


def by_force(law: str, delay: float) -> float:
    """Time (s) from the hand's first pull until it has taken over; NaN: it has not, or had before."""
    trace = run(load_scene("handover", law=law, delay=delay, grip=PULLS)).trace
    at = np.flatnonzero(trace["policy_m"] == Standing.GRIPPED)
    return float(trace["t"][at[0]]) - PULLS if len(at) and trace["t"][at[0]] > PULLS else nan


def figures(law: str) -> dict[str, float]:
    """The worst of each figure over the three links."""
    worst: dict[str, float] = {}
    for delay in DELAYS:
        scene: Any = load_scene("handover", law=law, delay=delay)
        small = load_scene("handover", law=law, delay=delay, tank=0.05, tank_power=0.05)
        each = {"taking": jump(scene, 1.0, 1.5), "giving back": jump(scene, 2.9, 3.4), "at once": jump(at_once(
            load_scene("handover", law=law, delay=delay, slew=None)), 1.0, 1.5),
            "small tank": jump(small, 1.0, 3.4), "by force": by_force(law, delay)}
        worst = {name: max(value, worst.get(name, 0.0)) for name, value in each.items()}
    return worst


if __name__ == "__main__":
    print("law            taking  giving back  at once  small tank (N m a tick)  by force (s)")
    for name in sys.argv[1:] or LAWS:
        got = figures(name)
        print(f"{name:14} {got['taking']:6.4f}  {got['giving back']:11.4f}  {got['at once']:7.2f}  "
              f"{got['small tank']:10.4f}               {got['by force']:12.3f}")
