"""Force on what is touched, against that of the rigid rod (`teleop.studies.rod`): did the hand get to the wall at all.

A law may track well because its drag keeps the hand off the wall, and then the wall feels a small part of what it would
feel of the hand through a rod. One that hardly tells the hand of the wall lets it press harder than the rod would.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from teleop.scene.scene import Scene
from teleop.studies.rod import rod_motion

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

LATE = 0.5  # the share of a run, from its end, that counts as late: the hand is in contact then


class Touch(NamedTuple):
    """Force on the environment, N, magnitude over the axes."""

    peak: float
    late: float  # mean over the late part


def touch_of_rod(scene: Scene) -> Touch | None:
    """That of the rigid rod; None where nothing is touched, and where there is no rod."""
    import numpy as np

    motion = rod_motion(scene)
    found = touch_of(np.array([axis.f_env for axis in motion]).T) if motion else None
    return found if found is not None and found.late > 0.0 else None


def touch_of(forces: NDArray[np.float64]) -> Touch:
    """That of the forces (ticks,) or (ticks, axes) of a run, N."""
    import numpy as np

    size = np.abs(forces) if forces.ndim == 1 else np.sqrt((forces * forces).sum(axis=1))
    return Touch(float(size.max()), float(size[-max(1, round(LATE * len(size))):].mean()))
