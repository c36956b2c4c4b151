"""The types of C that a printed file has, and what stands for a value while a function is printed."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from functools import lru_cache, reduce
from inspect import getsource
from math import isnan
from typing import Any, NamedTuple, get_type_hints

from teleop.errors import Refused
from teleop.simulation.expressions import Known

DOUBLE, INT, BOOL, NOTHING = "double", "int64_t", "bool", "void"
FLOAT = "float"
FLOATS = 2.0**-126, 2.0**128  # the numbers of float that are not subnormal: from, and below
WHOLE, MIXED = "whole", "mixed"  # reals of C: an int of Python, as of `floor`, whose 0 has no sign; an int or a float
REALS = (WHOLE, DOUBLE, MIXED)
LIST = "const double *"  # a list of numbers, by its address
SCALARS = (BOOL, INT, *REALS)  # each holds the values of those before it, but for the zeros


KEYWORDS = frozenset(  # of C and C++
    """auto break case char const continue default do double else enum extern float for goto if inline int long register
    restrict return short signed sizeof static struct switch typedef union unsigned void volatile while bool true false
    catch class delete explicit export friend mutable namespace new operator private protected public template this
    throw try typename using virtual""".split())  # noqa: SIM905 - a list of a word a line would be two pages


class NotPrinted(Refused):
    """Why a function has no lines in C, with its file and line."""


class Struct:
    """A record: a NamedTuple, a tuple of unlike parts, a frozen dataclass. `texts`: the fields that are no numbers."""

    def __init__(self, name: str, members: Mapping[str, Any], of_class: Any, texts: Mapping[str, Any]) -> None:
        self.name, self.members, self.of_class, self.texts = name, members, of_class, texts

    def __repr__(self) -> str:
        return self.name


class Array:
    """A tuple of like parts. `bare`: an array of C by itself, as an argument or within the inputs."""

    def __init__(self, of: Any, count: int, *, bare: bool = False) -> None:
        self.of, self.count, self.bare = of, count, bare
        self.name = f"{of if isinstance(of, str) else of.name}_{count}"

    def __repr__(self) -> str:
        return self.name


Type = Any  # a scalar's name, a `Struct` or an `Array`


class Printed(NamedTuple):
    """An expression of C. `fixed`: a number of the parameters or a literal, which stays the same for a run."""

    type: Type
    text: str
    fixed: bool = False


class TupleParts(NamedTuple):
    """Values side by side, of a NamedTuple's class or of none."""

    values: tuple[Any, ...]
    of_class: Any = None


class MethodOf(NamedTuple):
    """A function and its first argument."""

    function: Any
    first: Any


Value = Any  # Known, Printed, TupleParts or MethodOf


class Types:
    """The types of one file. `real`: double, or float."""

    def __init__(self, prefix: str, real: str = DOUBLE) -> None:
        self.prefix, self.real = prefix, real
        self._made: dict[Any, Any] = {}
        self._names: set[str] = set()

    def c(self, kind: Type) -> str:
        """The name of a type in C."""
        if isinstance(kind, Struct | Array):
            return self.prefix + kind.name
        return self.real if kind in REALS else str(kind)

    def struct(self, name: str, members: Mapping[str, Any], of_class: Any = None,
               texts: Mapping[str, Any] | None = None) -> Struct:
        """The struct of these members; one and the same whenever it is asked for."""
        key = (of_class or name, tuple(members.items()), tuple((texts or {}).items()))
        if key not in self._made:
            self._made[key] = Struct(self._fresh(name), members, of_class, texts or {})
        result: Struct = self._made[key]
        return result

    def array(self, of: Type, count: int) -> Array:
        """The array of `count` of this type, as a struct, which C can assign and return."""
        key = (of, count)
        if key not in self._made:
            self._made[key] = Array(of, count)
        result: Array = self._made[key]
        return result

    def _fresh(self, name: str) -> str:
        n, word = 2, name
        while word in self._names:
            n, word = n + 1, f"{name}_v{n}"  # name_2 is a pair of them
        self._names.add(word)
        return word

    def tuple_of(self, kinds: Iterable[Type], of_class: Any = None) -> Type:
        """The type of a tuple with parts of these types."""
        kinds = list(kinds)
        if of_class is not None:
            return self.struct(of_class.__name__, dict(zip(of_class._fields, kinds, strict=True)), of_class)
        if not kinds:
            return NOTHING
        if all(kind in REALS for kind in kinds):
            kinds = [reduce(self.join, kinds)] * len(kinds)
        if all(kind is kinds[0] or kind == kinds[0] for kind in kinds) and kinds[0] != NOTHING:
            return self.array(kinds[0], len(kinds))
        names = "_".join(kind if isinstance(kind, str) else kind.name for kind in kinds)
        name = "Pair_" + re.sub(r"\W+", "_", names)[:55]
        return self.struct(name, {f"part{i}": kind for i, kind in enumerate(kinds)})

    def of_value(self, value: Any) -> Type:
        """The type of a value that Python has."""
        if isinstance(value, bool):
            return BOOL
        if isinstance(value, int):
            return INT
        if isinstance(value, float):
            return DOUBLE
        if isinstance(value, list):
            return LIST
        if isinstance(value, tuple) and hasattr(value, "_fields"):
            kinds = dict(zip(value._fields, map(self.of_value, value), strict=True))
            texts = {name: getattr(value, name) for name, kind in kinds.items()
                     if kind == NOTHING and getattr(value, name) != ()}
            return NOTHING if set(kinds.values()) == {NOTHING} else self.struct(
                type(value).__name__, kinds, type(value), texts)
        if isinstance(value, tuple):
            return self.tuple_of(map(self.of_value, value))
        if is_dataclass(value):
            return self._of_law(value)
        return NOTHING

    def _of_law(self, law: Any) -> Struct:
        hints = get_type_hints(type(law))
        kinds = {each.name: self.of_value(getattr(law, each.name)) for each in fields(law)}
        kinds = {name: DOUBLE if kind == INT and hints.get(name) is float else kind for name, kind in kinds.items()}
        texts = {name: getattr(law, name) for name, kind in kinds.items() if kind == NOTHING}
        return self.struct(type(law).__name__, kinds, type(law), texts)

    def join(self, a: Type, b: Type) -> Type:
        """The least type that holds the values of both; None where there is none."""
        if a is b or a == b or b is None:
            return a
        if a is None:
            return b
        if a in SCALARS and b in SCALARS:
            return MIXED if DOUBLE in (a, b) else max(a, b, key=SCALARS.index)
        if isinstance(a, Struct | Array) and isinstance(b, Struct | Array):
            of_class = getattr(a, "of_class", None)
            mine, theirs = parts_of(a), parts_of(b)
            if of_class is getattr(b, "of_class", None) and len(mine) == len(theirs) and not getattr(a, "texts", None):
                joined = [self.join(x, y) for x, y in zip(mine, theirs, strict=True)]
                return None if None in joined else self.tuple_of(joined, of_class)
        return None

    def literal(self, value: Any, kind: Type) -> str:
        """A value of Python as C has it in an initialiser."""
        if isinstance(kind, Array):
            inner = ", ".join(self.literal(each, kind.of) for each in value)
            return f"{{{inner}}}" if kind.bare else f"{{{{{inner}}}}}"
        if isinstance(kind, Struct):
            values = value if isinstance(value, tuple) else [getattr(value, name) for name in kind.members]
            parts = [self.literal(each, of) for each, of in zip(values, kind.members.values(), strict=True)
                     if of != NOTHING]
            return f"{{{', '.join(parts) or '0'}}}"
        if kind in REALS:
            return self.real_number(float(value))
        if kind == BOOL:
            return "true" if value else "false"
        return str(int(value))

    def real_number(self, value: float) -> str:
        """A float, with the digits that give the same bits again."""
        if isnan(value):
            return "NAN"
        if value - value != 0.0:
            return "INFINITY" if value > 0.0 else "-INFINITY"
        if self.real == FLOAT and value != 0.0 and not FLOATS[0] <= abs(value) < FLOATS[1]:
            raise NotPrinted(f"{value!r} is beyond the range of float; leave --float out")
        return repr(value) + "f" * (self.real == FLOAT)

    def declarations(self, wanted: Iterable[Type] | None = None, known: str = "") -> str:
        """The types that are `wanted`, or all, each after those that it is made of, but those in the text `known`."""
        text: dict[Any, str] = {}

        def declare(kind: Type) -> None:
            if isinstance(kind, str) or kind in text:
                return
            for each in dict.fromkeys(parts_of(kind)):
                declare(each)
            if getattr(kind, "bare", False) or f" {self.c(kind)};\n" in known:
                return
            lines = [f"    {self.c(of)} {c_field(name)};{comment(units_of(kind.of_class).get(name, ''))}"
                     for name, of in kind.members.items() if of != NOTHING] if isinstance(kind, Struct) else [
                         f"    {self.c(kind.of)} at[{kind.count}];"]
            body = "\n".join(lines or ["    char nothing;"])
            text[kind] = f"typedef struct {{\n{body}\n}} {self.c(kind)};\n"

        for kind in [*self._made.values()] if wanted is None else wanted:
            declare(kind)
        return "\n".join(text.values())


def c_field(name: str) -> str:
    """The name of a field in C and C++."""
    return f"{name}_" if name in KEYWORDS else name


def parts_of(kind: Any) -> list[Type]:
    """The types of the parts of a struct or an array."""
    return [kind.of] * kind.count if isinstance(kind, Array) else list(kind.members.values())


def part(value: Printed, i: int) -> Value:
    """The i-th part of a record or of an array."""
    kind = value.type
    if isinstance(kind, Array):
        return Printed(kind.of, f"{value.text}[{i}]" if kind.bare else f"{value.text}.at[{i}]", value.fixed)
    return member(value, list(kind.members)[i])


def member(value: Printed, name: str) -> Value:
    """A field of a record."""
    kind = value.type.members[name]
    if kind == NOTHING:
        return Known(value.type.texts.get(name, ()))
    return Printed(kind, f"{value.text}.{c_field(name)}", value.fixed)


def comment(text: str) -> str:
    """A text behind a line, as a comment."""
    return f"  /* {text.replace('*/', '')} */" if text else ""


@lru_cache
def units_of(of_class: Any) -> dict[str, str]:
    """Comments of a class behind its fields, or what their knobs say: mostly their units."""
    try:
        lines = getsource(of_class).splitlines()
    except (OSError, TypeError):
        return {}
    notes = {}
    for line in lines:
        if match := re.match(r"\s+(\w+): [^#]*#\s*(.*)$", line):
            notes[match[1]] = match[2]
    for name, hint in (get_type_hints(of_class, include_extras=True) if is_dataclass(of_class) else {}).items():
        for knob in getattr(hint, "__metadata__", ()):
            notes[name] = ", ".join(filter(None, (getattr(knob, "unit", ""), getattr(knob, "meaning", ""))))
    return notes
