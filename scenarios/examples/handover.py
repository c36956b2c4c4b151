"""Figures of a handover between operator and policy, law by law: the handle's jumps, and the time to take over.

    python scenarios/examples/handover.py [LAW ...]

A jump is the most change of the handle's force within a tick of 1 ms, as the policy takes over in mid-motion and gives
back at a spring, the worst of links of 20, 50 and 100 ms; "at once": of a policy that pulls without any of it.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from math import nan

import numpy as np

from teleop import Scene, load_scene, run

PULLS = 2.0  # s, at which the hand pulls back
GRIPPED = 2.0  # of the column policy_m: the operator took over by force


def jump(of: Scene, since: float, until: float) -> float:
    """The most change of the handle's force within a tick, N m, between two times."""
    trace = run(of).trace
    change, t = np.abs(np.diff(trace["f_m"])), trace["t"][1:]
    return float(change[(t >= since) & (t < until)].max())


def at_once(of: Scene) -> Scene:
    """The scene with a policy that has all authority within a tick, and none of what smooths its force."""
    assert of.handover is not None
    hard = replace(of.handover, ramp=1e-3, yields=1e-3, slew=1e9, bandwidth=999.0, most_speed=1e6)
    return replace(of, handover=hard)


def figures(law: str, delay: float) -> tuple[float, ...]:
    """Jumps (N m) on taking, on giving back, at once and with a small tank; time (s) until a pull has taken over."""
    scene = load_scene("handover", law=law, delay=delay)
    small = load_scene("handover", law=law, delay=delay, tank=0.05, tank_power=0.05)
    free = load_scene("handover", law=law, delay=delay, slew=None)
    pulled = run(load_scene("handover", law=law, delay=delay, grip=PULLS)).trace
    at = np.flatnonzero(pulled["policy_m"] == GRIPPED)
    by_force = float(pulled["t"][at[0]]) - PULLS if len(at) else nan
    return jump(scene, 1.0, 1.5), jump(scene, 2.9, 3.4), jump(at_once(free), 1.0, 1.5), jump(small, 1.0, 3.4), by_force


if __name__ == "__main__":
    print("law            taking  giving back  at once  small tank (N m a tick)  by force (s)")
    for name in sys.argv[1:] or ["pp", "wave"]:
        worst = np.max([figures(name, delay) for delay in (0.02, 0.05, 0.1)], axis=0)
        print(f"{name:14} {worst[0]:6.4f}  {worst[1]:11.4f}  {worst[2]:7.2f}  {worst[3]:23.4f}  {worst[4]:12.3f}")
