"""What a publication says, number by number, and what this stack gives for each.

A number is labelled by what came of it:

    reproduced    the stack's number lies within the tolerance of what is printed
    differs       it does not; the remark says why
    published     it was not run again here; the remark says what is lacking

The tolerance of a printed number is half of its last digit, unless the finding names another one and says why.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

REPRODUCED, DIFFERS, PUBLISHED = "reproduced", "differs", "published"
ROUNDING = 1e-9  # of the tolerance: 0.5 of the last digit is within half of it


class Finding(NamedTuple):
    """One number or statement of a publication, and what came of it here."""

    what: str
    printed: str  # as it is printed, or as the printed formula gives it: "33.53", or a statement such as "stable"
    found: float | str | None  # here; None: not run again
    unit: str = ""
    tolerance: float | None = None  # in the unit; None: half of the last printed digit, and no tolerance of a statement
    remark: str = ""  # why it differs or was not run, or what had to be assumed

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
        return None if self.value is None else last_digit(self.printed) if self.tolerance is None else self.tolerance

    @property
    def label(self) -> str:
        """`reproduced`, `differs` or `published`."""
        if self.found is None:
            return PUBLISHED
        value, within = self.value, self.within
        if value is None or within is None:
            return REPRODUCED if self.found == self.printed else DIFFERS
        near = not isinstance(self.found, str) and abs(self.found - value) <= within * (1.0 + ROUNDING)
        return REPRODUCED if near else DIFFERS


@dataclass(frozen=True, kw_only=True)
class Publication:
    """A publication and the rerun of its numbers."""

    name: str
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
