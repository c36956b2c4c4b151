"""One thing that the doctor has looked at."""

from __future__ import annotations

from typing import NamedTuple


class Finding(NamedTuple):
    """What was found of one thing. `good`: None where there is nothing to judge."""

    name: str
    good: bool | None
    says: str
    cure: str | None = None  # what to type, where it is not good

    @property
    def rows(self) -> list[tuple[str, str]]:
        """Its rows of a table of facts."""
        judged = "" if self.good is None else "ok: " if self.good else "poor: "
        return [(self.name, judged + self.says), *([] if self.cure is None else [("", self.cure)])]
