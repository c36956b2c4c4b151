"""Publications and their reruns, number by number, with the rendered walls that several of them are about.

A number is labelled by its rerun:

    reproduced    the stack's number lies within the tolerance of the printed one
    differs       it does not; the remark says why
    fitted        something that the publication leaves open was chosen here by this very number
    published     it was not run again here; the remark says what is lacking

The tolerance of a printed number is half of its last digit, unless it has one that was chosen here.

Publications are counted apart by the source of their numbers (`NumberSource`): only a number that a paper prints is a
measurement or a result of others; a formula at numbers of our own says that its derivation holds here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any, NamedTuple

from teleop.scene.loading import load_scene
from teleop.scene.scene import Scene

REPRODUCED, DIFFERS, FITTED, PUBLISHED = "reproduced", "differs", "fitted", "published"
ROUNDING = 1e-9  # of the tolerance: 0.5 of the last digit is within half of it


class NumberSource(Enum):
    """Source of the numbers of a publication."""

    PRINTED = "printed in a paper"
    FORMULA = "of a paper's formula at numbers chosen here"
    TEXTBOOK = "of teaching material"


class Replication(NamedTuple):
    """Number or statement of a publication, with the result of its rerun here."""

    what: str
    printed: str  # as it is printed, or as the printed formula gives it: "33.53", or a statement such as "stable"
    result: float | str | None  # here; None: not run again
    unit: str = ""
    tolerance: float | str | None = None  # chosen here, in the unit; of a statement in words; None: half of the last
    # printed digit, and none of a statement
    remark: str = ""  # why it differs or was not run, or what had to be assumed
    is_fitted: bool = False  # what the publication leaves open was chosen by this number

    @property
    def value(self) -> float | None:
        """The printed number; None for a statement."""
        try:
            return float(self.printed)
        except ValueError:
            return None

    @property
    def within(self) -> float | None:
        """The tolerance (in the unit); None for a statement."""
        if self.value is None or isinstance(self.tolerance, str):
            return None
        return last_digit(self.printed) if self.tolerance is None else self.tolerance

    @property
    def label(self) -> str:
        """`reproduced`, `differs`, `fitted` or `published`."""
        if self.result is None:
            return PUBLISHED
        if self.is_fitted:
            return FITTED
        value, within = self.value, self.within
        if value is None or within is None:
            return REPRODUCED if self.result == self.printed else DIFFERS
        near = not isinstance(self.result, str) and abs(self.result - value) <= within * (1.0 + ROUNDING)
        return REPRODUCED if near else DIFFERS


@dataclass(frozen=True, kw_only=True)
class Publication:
    """A publication and the rerun of its numbers."""

    name: str
    kind: NumberSource
    source: str  # authors, title, where and when
    about: str  # the thing compared, in a sentence
    setting: str  # the scene that is run here, and which of its numbers are printed and which assumed
    rerun: Callable[[], Sequence[Replication]]


def last_digit(printed: str) -> float:
    """Half of the last digit of a printed number.

    >>> last_digit("33.53"), last_digit("1600"), last_digit("-17.6")
    (0.005, 0.5, 0.05)
    """
    digits = len(printed.partition(".")[2])
    return float(f"5e-{digits + 1}")


def wall(K: float, B: float = 0.0, **knobs: object) -> Scene:
    """A handle at a rendered wall of stiffness K (N/m) and damping B (N s/m), sampled at 1 kHz: `virtual_wall`."""
    return load_scene("virtual_wall", **{"law.K": K, "law.B": B, **knobs})


def with_hand(scene: Scene, *, mass: float, k: float, d: float, at: float, start: float) -> Scene:
    """The scene with a hand that stands still at `at` (m) and a handle that starts at `start` (m), at rest."""
    still: Any = load_scene("encoder_wall").hand
    hand = replace(still, mass=mass, k=k, d=d, reference=replace(still.reference, at=at))
    return replace(scene, hand=hand, start_m=start)
