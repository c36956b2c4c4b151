"""Polushin, Liu and Lung 2007: what projection-based force reflection lets the hand feel."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from teleop.law import At, find_law
from teleop.scene.loading import load_scene
from teleop.simulation.virtual import run
from teleop.studies.reproduce.publication import NumberSource, Publication, Replication

FORCES = ((5.0, 3.0), (1.0, 3.0), (-2.0, 3.0), (-5.0, -3.0))  # N: f_env, f_h
SURFACE = 0.03  # m, of the scene beating_heart in the mean


def reflected_force(f_env: float, f_h: float) -> float:
    """The force (N) that the law reflects with alpha = 0, of one axis."""
    law: Any = find_law("pfra")(alpha=0.0)
    at = At(0.0, 0.0, f_h, 0.0, 0.0, True, 0.0, 1e-3, 1e-3)
    state, rx = law.master_start(at)
    rx = type(rx)(f_env)
    return float(law.master(state, at, rx, law.master_sums(state, at, rx))[0])


def let_go(law: str) -> tuple[float, float]:
    """Motion (m) of a master that nobody holds, and the greatest force (N) on the slave.

    Both ends begin at the mean surface of a beating wall, 30 mm from the origin: it pushes the slave from there.
    """
    scene = load_scene("beating_heart", law=law, observer=None, duration=2.0)
    trace = run(replace(scene, hand=None, start_m=SURFACE, start_s=SURFACE)).trace
    return float(np.ptp(trace["x_m"])), float(np.abs(trace["f_env"]).max())


def rerun() -> list[Replication]:
    """The projection in one axis, and both ends of alpha in whole runs."""
    numbers = [Replication(f"alpha = 0, f_env = {f_env:g} N, f_h = {f_h:g} N: reflected",
                           f"{max(min(f_env, f_h), 0.0) if f_h > 0.0 else min(max(f_env, f_h), 0.0):g}",
                           reflected_force(f_env, f_h), "N", 1e-12)
               for f_env, f_h in FORCES]
    knobs = {"duration": 1.0, "delay": 0.02, "law.kf": 0.5}
    whole, direct = (run(load_scene("soft_tissue", law=law, **knobs, **alpha)).trace
                     for law, alpha in (("pfra", {"law.alpha": 1.0}), ("direct", {})))
    same = all((whole[name] == direct[name]).all() for name in ("x_m", "f_m", "x_s", "f_s"))
    numbers.append(Replication("alpha = 1 is direct force reflection", "the same", "the same" if same else "another",
                               remark="a second of soft_tissue, bit for bit"))
    (moved, touched), (bare, _) = let_go("pfra"), let_go("direct")
    numbers.append(Replication("alpha = 0, nobody holds the master: it moves by", "0", moved, "m", 0.0,
                               f"while the moving wall pushes the slave with up to {touched:.2g} N; under the law "
                               f"direct, which reflects that force as it is, it moves by {1e3 * bare:.0f} mm"))
    return numbers


PUBLICATION = Publication(
    name="polushin",
    kind=NumberSource.FORMULA,
    source="I. G. Polushin, P. X. Liu and C.-H. Lung, A force-reflection algorithm for improved transparency in "
           "bilateral teleoperation with communication delay, IEEE/ASME Trans. Mechatronics 12(3), 2007",
    about="the reflected force is felt as far as the hand resists it, and never moves the master by itself",
    setting="law pfra by itself; the scenes soft_tissue and, with a force sensor and without a hand, beating_heart. "
            "The numbers follow from the printed formula: f_env clipped to lie between 0 and f_h",
    rerun=rerun,
)
