"""What a publication says, number by number, and what this stack gives for each.

A number is labelled by what came of it:

    reproduced    the stack's number lies within the tolerance of what is printed
    differs       it does not; the remark says why
    fitted        something that the publication leaves open was chosen here by this very number
    published     it was not run again here; the remark says what is lacking

The tolerance of a printed number is half of its last digit, unless the finding names one that was chosen here.

Publications are counted apart by the source of their numbers (`NumberSource`): only a number that a paper prints is a
measurement or a result of others; a formula at numbers of our own says that its derivation holds here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

REPRODUCED, DIFFERS, FITTED, PUBLISHED = "reproduced", "differs", "fitted", "published"
ROUNDING = 1e-9  # of the tolerance: 0.5 of the last digit is within half of it


class NumberSource(Enum):
    """Source of the numbers of a publication."""

    PRINTED = "printed in a paper"
    FORMULA = "of a paper's formula at numbers chosen here"
    TEXTBOOK = "of teaching material"


class Finding(NamedTuple):
    """One number or statement of a publication, and what came of it here."""

    what: str
    printed: str  # as it is printed, or as the printed formula gives it: "33.53", or a statement such as "stable"
    found: float | str | None  # here; None: not run again
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
        if self.found is None:
            return PUBLISHED
        if self.is_fitted:
            return FITTED
        value, within = self.value, self.within
        if value is None or within is None:
            return REPRODUCED if self.found == self.printed else DIFFERS
        near = not isinstance(self.found, str) and abs(self.found - value) <= within * (1.0 + ROUNDING)
        return REPRODUCED if near else DIFFERS


@dataclass(frozen=True, kw_only=True)
class Publication:
    """A publication and the rerun of its numbers."""

    name: str
    kind: NumberSource
    source: str  # authors, title, where and when
    about: str  # what is compared, in a sentence
    setting: str  # the scene that is run here, and what of it is printed and what assumed
    rerun: Callable[[], Sequence[Finding]]


def last_digit(printed: str) -> float:
    """Half of the last digit of a printed number.

    >>> last_digit("33.53"), last_digit("1600"), last_digit("-17.6")
    (0.005, 0.5, 0.05)
    """
    digits = len(printed.partition(".")[2])
    return float(f"5e-{digits + 1}")
