"""Velocity estimators of a haptic device, one file each: equations, source and error.

Their names are here, for texts such as `--set velocity=low_pass(cutoff=30)`; none is imported with them.
"""

from __future__ import annotations

from teleop.naming import PartKind

ESTIMATORS = PartKind(
    word="velocity estimator",
    group="teleop.estimators",
    places={
        "backward_difference": "teleop.stages.velocity.backward_difference:BackwardDifference",
        "best_fit": "teleop.stages.velocity.adaptive_window:BestFit",
        "end_fit": "teleop.stages.velocity.adaptive_window:EndFit",
        "levant": "teleop.stages.velocity.levant:Levant",
        "low_pass": "teleop.stages.velocity.low_pass:LowPass",
    },
    examples={
        "low_pass": "low_pass(cutoff=30)",
        "backward_difference": "backward_difference()",
        "best_fit": "best_fit(noise=6e-5, most=15)",
        "end_fit": "end_fit(noise=6e-5, most=15)",
        "levant": "levant(L=1)",
    },
)
