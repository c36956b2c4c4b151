"""check_law lets every listed law pass, and tells an author of each kind of slip which one it is."""

# ruff: noqa: ARG001, ARG004, ARG005 - an end takes what it is given, used or not

from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

import numpy as np
import pytest

from teleop.checks.law import check_law
from teleop.errors import Refused, number
from teleop.law import At, find_law, known_laws
from teleop.laws.direct import Direct
from teleop.laws.pfra import PFRA
from teleop.laws.wave import Wave

NOTHING: dict[str, str] = {}


COMPILED = {"wave", "tdpa", "model_mediated"}  # a wave, sums over the axes with totals, and the longest state


@pytest.mark.parametrize("name", sorted(known_laws()))
def test_every_listed_law_conforms(name: str) -> None:
    check_law(find_law(name)(), compiled=name in COMPILED)


@pytest.mark.soak
@pytest.mark.parametrize("name", sorted(known_laws().keys() - COMPILED))
def test_every_listed_law_conforms_compiled_too(name: str) -> None:
    """Some ten seconds each, for the compiler."""
    check_law(find_law(name)())


@pytest.mark.parametrize("law", [
    Wave(b=1e-3, K=0.0, B=0.0), Wave(b=1e3, K=1e9, B=0.0), Wave(b=0.8, K=1e6, B=1e3),
    PFRA(alpha=1.0), PFRA(alpha=0.3, kf=1e3), Direct(kf=0.0, K=0.0, B=0.0),
])
def test_laws_conform_whatever_their_knobs(law: Any) -> None:
    check_law(law, compiled=False)


class X(NamedTuple):
    x: float


class F(NamedTuple):
    force: float


class S(NamedTuple):
    y: float


class Plain:
    """The working parts of a law that is in order; the laws below take them and spoil one."""

    @staticmethod
    def master_start(at: At) -> Any:
        return S(at.x), F(0.0)

    @staticmethod
    def slave_start(at: At) -> Any:
        return S(at.x), X(at.x)

    @staticmethod
    def master(s: Any, at: At, rx: Any) -> Any:
        return rx.force, X(at.x), S(at.x)

    @staticmethod
    def slave(s: Any, at: At, rx: Any) -> Any:
        return 100.0 * (rx.x - at.x) - at.v, F(at.f), S(rx.x)


def spoilt(claims: Any = NOTHING, **parts: Any) -> Any:
    """A law made of `Plain` with some of its parts replaced."""

    @dataclass(frozen=True, kw_only=True)
    class Spoilt:
        K: float = 1.0

        def __post_init__(self) -> None:
            number("K", self.K)

    Spoilt.claims = claims  # type: ignore[attr-defined]
    for part in ("master_start", "slave_start", "master", "slave"):
        function = parts.pop(part, getattr(Plain, part))
        setattr(Spoilt, part, function if isinstance(function, property) else staticmethod(function))
    for part, function in parts.items():
        setattr(Spoilt, part, staticmethod(function))
    return Spoilt()


def test_the_parts_that_are_spoilt_below_are_in_order() -> None:
    check_law(spoilt())


def counting() -> Any:
    calls = []

    def master(s: Any, at: At, rx: Any) -> Any:
        calls.append(at)
        return float(len(calls)), X(at.x), s

    return master


class Helper:
    spring = staticmethod(lambda at: at.x + at.v)


def hides(s: Any, at: At, rx: Any) -> Any:
    return at[1], X(0.0), s


def unguarded(s: Any, at: At, rx: Any) -> Any:
    return rx.force / at.x, X(at.x), s


def nearly_guarded(s: Any, at: At, rx: Any) -> Any:
    return at.v / (at.dx + 1e-320), X(at.x), s


def squares(s: Any, at: At, rx: Any) -> Any:
    return at.v**2, X(at.x), s


def roots(s: Any, at: At, rx: Any) -> Any:
    return math.sqrt(at.x), X(at.x), s


def counts_steps(s: Any, at: At, rx: Any) -> Any:
    return float(round(at.x)), X(at.x), s


class Sums(NamedTuple):
    n: int


ENDS: list[tuple[dict[str, Any], str]] = [
    ({"master_start": lambda at: F(0.0)}, "returns F.*write return state, message"),
    ({"slave_start": lambda at: (S(0.0), (0.0,))}, "NamedTuple of floats"),
    ({"slave_start": lambda at: (S(0.0), X(0))}, "x=0 of type int; write it as a float"),
    ({"master_start": lambda at: ([0.0], F(0.0))}, "returns the state .* NamedTuple of floats"),
    ({"master_start": lambda at: (S(at.f), F(0.0))}, r"master_start \(.*py:\d+\) reads f, but Spoilt.master does not"),
    ({"master_start": lambda at: 1 / 0}, r"master_start \(.*py:\d+\) raised ZeroDivisionError"),
    ({"master": lambda s, at, rx: (rx.force, X(at.x))}, "returns 2 values; write return force, message, state"),
    ({"master": lambda s, at, rx: (0, X(at.x), s)}, "returns the force 0 of type int"),
    ({"master": lambda s, at, rx: (np.float64(1.0), X(at.x), s)}, "of type float64"),
    ({"master": lambda s, at, rx: (rx.force, X(at.fresh), s)}, "x=(True|False) of type bool"),
    ({"master": lambda s, at, rx: (rx.force, X(at.x), S(1))}, "y=1 of type int"),
    ({"master": lambda s, at, rx: (rx.force, F(at.x), s)}, "a message of type F, but slave_start one of type X"),
    ({"master": lambda s, at, rx: (rx.force, X(at.x), ())}, "a state of type tuple, but master_start one of type S"),
    ({"slave": lambda s, at, rx: (rx.x, F(at.f), S(math.inf))}, "for finite arguments"),
    ({"master": counting()}, "answers the same arguments differently"),
    ({"master": hides}, "reads v where it cannot be seen; write at.v in Spoilt.master"),
    ({"master": unguarded}, "raised ZeroDivisionError.*max"),
    ({"master": nearly_guarded}, "for finite arguments"),
    ({"master": squares}, "raised OverflowError.*for x\\*\\*2"),
    ({"master": roots}, "raised ValueError.*range"),
    ({"master": lambda s, at, rx: (at.force, X(at.x), s)},
     "reads at.force, but an At has x, v, f, f_held, dx, fresh, age, dt"),
    ({"master": lambda s, at, rx: (rx.f, X(at.x), s)}, "reads rx.f, but F has force$"),
    ({"master": lambda s, at, rx: (s.nothing.x, X(at.x), s)}, "reads s.nothing, but S has y$"),
    ({"master": lambda s, at, rx: (gone, X(at.x), s)}, "NameError: .*; mend that line$"),  # type: ignore[name-defined] # noqa: F821
    ({"master": counts_steps}, "raised (OverflowError|ValueError)"),
    ({"master_sums": lambda s, at, rx: Sums(1), "master": lambda s, at, rx, over: (0.0, X(at.x), s)},
     "returns the sums with n=1 of type int"),
    ({"master_sums": lambda s, at, rx: 1.0, "master": lambda s, at, rx, over: (0.0, X(at.x), s)},
     "returns the sums 1.0 of type float; make it a NamedTuple"),
]


@pytest.mark.parametrize(("parts", "sentence"), ENDS)
def test_what_an_end_answers_wrongly_is_named(parts: dict[str, Any], sentence: str) -> None:
    with pytest.raises(Refused, match=sentence):
        check_law(spoilt(**parts))


def test_a_field_read_inside_a_method_that_reads_does_not_follow_is_named() -> None:
    with pytest.raises(Refused, match="reads v where it cannot be seen"):
        check_law(spoilt(master=lambda s, at, rx: (Helper.spring(at), X(at.x), s)))


def test_a_law_that_keeps_count_in_itself_is_caught() -> None:
    @dataclass(frozen=True, kw_only=True)
    class Counter:
        n: float = 0.0
        claims: ClassVar[dict[str, str]] = NOTHING
        master_start = staticmethod(Plain.master_start)
        slave_start = staticmethod(Plain.slave_start)
        slave = staticmethod(Plain.slave)

        def __post_init__(self) -> None:
            number("n", self.n)

        def master(self, s: Any, at: At, rx: Any) -> Any:
            object.__setattr__(self, "n", self.n + 1.0)
            return rx.force, X(at.x), s

    with pytest.raises(Refused, match=r"Counter.master \(.*py:\d+\) changes the law, n=1.0; keep"):
        check_law(Counter())


def class_of(**how: Any) -> Any:
    """A decorator for a law that is in order but for how its class is made."""

    def made(cls: type) -> Any:
        for part in ("master_start", "slave_start", "master", "slave"):
            setattr(cls, part, staticmethod(getattr(Plain, part)))
        if not hasattr(cls, "claims"):
            cls.claims = NOTHING  # type: ignore[attr-defined]
        return dataclass(**how)(cls)()

    return made


@class_of(kw_only=True)
class Thawed:
    K: float = 1.0


@class_of(frozen=True)
class Positional:
    K: float = 1.0


@class_of(frozen=True, kw_only=True)
class Whole:
    K: int = 1


@class_of(frozen=True, kw_only=True)
class Loose:
    K: float = 1.0

    def __post_init__(self) -> None:
        if self.K < 0.0:
            raise Refused("K must be at least 0")


@class_of(frozen=True, kw_only=True)
class Unchecked:
    K: float = 1.0


@class_of(frozen=True, kw_only=True)
class Asserting:
    K: float = 1.0

    def __post_init__(self) -> None:
        assert self.K == self.K


@class_of(frozen=True, kw_only=True)
class Restless:
    K: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "K", self.K * 2.0)


@class_of(frozen=True, kw_only=True)
class Fixed:
    K: float = field(default=1.0, init=False)


@class_of(frozen=True, kw_only=True)
class Child(Exception):
    K: float = 1.0


class Endless:
    claims = NOTHING


CLASSES = [
    (Wave, r"write check_law\(Wave\(\)\)"),
    (3.0, "no frozen dataclass"),
    (Thawed, "frozen=True, kw_only=True"),
    (Positional, "by position; add kw_only=True"),
    (Whole, "K is 1 of int; every field of a law is a number: declare K: float"),
    (Loose, "accepts K=nan; call number"),
    (Asserting, "meets K=nan with AssertionError"),
    (Restless, "made again with the same K is another law"),
    (Fixed, "does not accept its own K=1.0"),
    (Child, "inherits from Exception"),
    (dataclass(frozen=True, kw_only=True)(Endless)(), "Endless has no master_start"),
    (spoilt(claims=frozenset({"E_link"})), r"claims is frozenset\(\{'E_link'\}\); write claims: ClassVar"),
    (spoilt(claims={"E_port": "good links"}), "claims E_port over 'good links', which is no condition"),
    (spoilt(claims={"E_law": "any link"}), "claims E_law, but has no master_stored"),
    (spoilt(claims={"E_lnk": "any link"}), "claims 'E_lnk', which is no ledger; did you mean E_link"),
]


@pytest.mark.parametrize(("law", "sentence"), CLASSES)
def test_what_is_wrong_with_the_class_is_named(law: Any, sentence: str) -> None:
    with pytest.raises(Refused, match=sentence):
        check_law(law)


def test_a_law_need_not_check_its_knobs() -> None:
    check_law(Unchecked)


def test_it_needs_no_test_library() -> None:
    program = ("import sys; from teleop import check_law, find_law; check_law(find_law('wave')(), compiled=False); "
               "others = 'pytest', 'hypothesis', 'scipy', 'asyncio', 'random', 'master', 'channel'; "
               "print([name for name in others if name in sys.modules])")
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
