"""Records: the objects that the tick is written over, whose fields the loop of one structure holds in variables."""

from __future__ import annotations

from typing import ClassVar


class Record:
    """A run, an end, an axis, a stage. What it is made with is known beforehand; the rest its class declares.

    `suffix` tells its variables from those of others: the field x of a record with the suffix m0 is x_m0.
    """

    suffix: str
    passing: ClassVar[tuple[str, ...]] = ()  # fields that each tick sets before it reads them

    def __init__(self, suffix: str = "") -> None:
        self.suffix = suffix

    def word(self, field: str) -> str:
        """The name of a field's variable."""
        return f"{field}_{self.suffix}" if self.suffix else field


_DECLARED: dict[type[Record], dict[str, str]] = {}


def declared(kind: type[Record]) -> dict[str, str]:
    """The fields that a class of records declares and has no value for, with their types as they are written."""
    if kind not in _DECLARED:
        written = [vars(each).get("__annotations__", {}) for each in kind.__mro__]
        _DECLARED[kind] = {name: type_ for own in written for name, type_ in own.items() if not hasattr(kind, name)}
    return _DECLARED[kind]


def called(kind: type[Record]) -> tuple[str, ...]:
    """Those of its fields that are functions; a record is made with them."""
    return tuple([name for name, written in declared(kind).items() if written.startswith("Callable")])
