"""check_law lets every listed law pass, and tells an author of each kind of slip which one it is."""

# ruff: noqa: ARG005 - an end takes what it is given, used or not

from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import field, make_dataclass, replace
from itertools import count
from typing import Any, NamedTuple

import numpy as np
import pytest

from teleop import PFRA, Direct, Refused, VirtualCoupling, VirtualWall, Wave, check_law, find_law, number, run
from teleop.checks import law as law_module
from teleop.checks.conformance import try_conformance
from teleop.checks.law import try_engines
from teleop.checks.trials import try_claims
from teleop.law import At, known_laws

SLOW = ("pspm", "two_layer")  # the search takes some seconds of a law that keeps energy, which `tdpa` shows


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.full] * (name in SLOW))
                                  for name in known_laws()])
def test_every_listed_law_conforms(name: str) -> None:
    check_law(find_law(name)(), compiled=False)


@pytest.mark.parametrize("name", SLOW)
def test_a_law_that_is_searched_in_the_night_keeps_what_it_claims_in_the_trials(name: str) -> None:
    try_conformance(find_law(name)())
    try_claims(find_law(name)())


@pytest.mark.full
@pytest.mark.parametrize("name", known_laws())
def test_every_listed_law_conforms_compiled_too(name: str) -> None:
    check_law(find_law(name)())


@pytest.mark.parametrize("law", [
    Wave(b=1e3, K=1e9, B=0.0), PFRA(alpha=0.3, kf=1e3), VirtualWall(K=1e9, B=1e4, at=-3.0), VirtualCoupling(mass=0.0),
    VirtualCoupling(theta_f=0.0, theta_x=0.0, K=1e12, mass=1e-6),  # diverges, which is no fault of form
    *[pytest.param(law, marks=pytest.mark.full) for law in (
        Wave(b=1e-3, K=0.0, B=0.0), Wave(b=0.8, K=1e6, B=1e3), PFRA(alpha=1.0), Direct(kf=0.0, K=0.0, B=0.0),
        VirtualWall(K=0.0), VirtualCoupling(K=1e9, B=0.0, k_e=1e12, d_e=1e3),
        VirtualCoupling(theta_f=0.5, theta_x=0.5, mass=0.0, d_e=5.0), VirtualCoupling(theta_f=0.0, theta_x=1.0),
        VirtualCoupling(theta_f=0.01, theta_x=0.01, d_e=5.0))]])
def test_laws_conform_whatever_their_knobs(law: Any) -> None:
    check_law(law, compiled=False)


class X(NamedTuple):
    x: float


class F(NamedTuple):
    force: float


class S(NamedTuple):
    y: float


class T(NamedTuple):
    y: float


TWO_PORT: dict[str, Any] = {  # the parts of laws that are in order; those below take them and spoil one
    "master_start": lambda at: (S(at.x), F(0.0)), "master": lambda s, at, rx: (rx.force, X(at.x), S(at.x)),
    "slave_start": lambda at: (S(at.x), X(at.x)),
    "slave": lambda s, at, rx: (100.0 * (rx.x - at.x) - at.v, F(at.f), S(rx.x))}
ONE_PORT: dict[str, Any] = {
    "start": lambda at: S(at.x), "force": lambda s, at: (10.0 * (at.x - s.y), S(0.5 * (at.x + s.y)))}


def checks_its_knob(self: Any) -> None:
    number("K", self.K)


NOTHING: dict[str, str] = {}


def a_class(parts: dict[str, Any] = TWO_PORT, *, name: str = "Spoilt", K: Any = 1.0, kind: type = float,
            bases: tuple[type, ...] = (), claims: Any = NOTHING, post: Any = checks_its_knob, **how: Any) -> Any:
    """A class of these parts and one knob; `how`: of its dataclass."""
    space = {"claims": claims, **{part: staticmethod(each) for part, each in parts.items()},
             **({"__post_init__": post} if post else {})}
    return make_dataclass(name, [("K", kind, K)], bases=bases, namespace=space,
                          **{"frozen": True, "kw_only": True, **how})


def spoilt(claims: Any = NOTHING, **parts: Any) -> Any:
    """A law that is in order but for these parts; one that is None it has not."""
    whole = {**(ONE_PORT if not {"start", "force"}.isdisjoint(parts) else TWO_PORT), **parts}
    return a_class({part: each for part, each in whole.items() if each}, claims=claims)()


def test_the_laws_that_are_spoilt_below_are_in_order() -> None:
    check_law(spoilt(), compiled=False)
    check_law(spoilt(start=ONE_PORT["start"]))
    check_law(a_class(post=None)(), compiled=False)  # a law need not check its knobs


calls = count()
FUNCTIONS: list[Any] = [lambda at: at.x + at.v]  # in a list, where they are not followed
seen: dict[At, int] = {}


def burns(s: Any, at: At) -> Any:
    """Answers twice as ever, and differently when it is asked the same for a third time, much later."""
    seen[at] = seen.get(at, 0) + 1
    return 1.0 if seen[at] > 2 and not any(map(math.isnan, at)) else 0.0, s


TWICE = "answers the same arguments differently the second time"
SUMMED = {"master": lambda s, at, rx, over: (0.0, X(at.x), s)}
SLIPS: list[tuple[dict[str, Any], str]] = [  # those that every scene finds are in tests/teleop/law/test_contract.py
    ({"master_start": lambda at: F(0.0)}, "returns F.*write return state, message"),
    ({"slave_start": lambda at: (S(0.0), (0.0,))}, "NamedTuple of floats"),
    ({"slave_start": lambda at: (S(0.0), X(0))}, "x=0 of type int; write it as a float"),
    ({"master_start": lambda at: ([0.0], F(0.0))}, "returns the state .* NamedTuple of floats"),
    ({"master_start": lambda at: (S(at.f), F(0.0))}, r"master_start \(.*py:\d+\) reads f, but Spoilt.master does not"),
    ({"master_start": lambda at: 1 / 0}, r"master_start \(.*py:\d+\) raised ZeroDivisionError"),
    ({"master": lambda s, at, rx: (0, X(at.x), s)}, "returns the force 0 of type int"),
    ({"master": lambda s, at, rx: (np.float64(1.0), X(at.x), s)}, "of type float64"),
    ({"master": lambda s, at, rx: (rx.force, X(at.fresh), s)}, "x=(True|False) of type bool"),
    ({"master": lambda s, at, rx: (rx.force, X(at.x), S(1))}, "y=1 of type int"),
    ({"slave": lambda s, at, rx: (rx.x, F(at.f), S(math.inf))}, "for finite arguments"),
    ({"master": lambda s, at, rx: (float(next(calls)), X(at.x), s)}, TWICE),
    ({"master": lambda s, at, rx: (at[1], X(0.0), s)}, "reads v where it cannot be seen; write at.v in Spoilt.master"),
    ({"master": lambda s, at, rx: (FUNCTIONS[0](at), X(at.x), s)}, "reads v where it cannot be seen"),
    ({"master": lambda s, at, rx: (rx.force / at.x, X(at.x), s)}, "raised ZeroDivisionError.*max"),
    ({"master": lambda s, at, rx: (at.v / (at.dx + 1e-320), X(at.x), s)}, "for finite arguments"),
    ({"master": lambda s, at, rx: (at.v**2, X(at.x), s)}, r"raised OverflowError.*for x\*\*2"),
    ({"master": lambda s, at, rx: (math.sqrt(at.x), X(at.x), s)}, "raised ValueError.*range"),
    ({"master": lambda s, at, rx: (float(round(at.x)), X(at.x), s)}, "raised (OverflowError|ValueError)"),
    ({"slave": lambda s, at, rx: ((rx.x - at.x) / (at.span - 2.0 * at.dt), F(at.f), s)}, "slave .*ZeroDivisionError"),
    ({"master": lambda s, at, rx: (gone, X(at.x), s)}, "NameError: .*; mend that line$"),  # type: ignore[name-defined] # noqa: F821
    ({"master_sums": lambda s, at, rx: S(1), **SUMMED}, "returns the sums with y=1 of type int"),
    ({"master_sums": lambda s, at, rx: 1.0, **SUMMED}, "returns the sums 1.0 of type float; make it a NamedTuple"),
    ({"claims": frozenset({"E_link"})}, r"claims is frozenset\(\{'E_link'\}\); write claims: ClassVar"),
    ({"claims": {"E_port": "good links"}}, "claims E_port over 'good links', which is no condition"),
    ({"claims": {"E_law": "any link"}}, "claims E_law, but has no master_stored"),
    ({"claims": {"E_lnk": "any link"}}, "claims 'E_lnk', which is no ledger; did you mean E_link"),
    # of one port
    ({"start": ONE_PORT["start"], "force": None}, "has no force; a one-port law has start and force"),
    ({"start": None}, "has no start; a one-port law has start and force"),
    ({"start": lambda at: [at.x]}, "returns the state"),
    ({"start": lambda at: S(0)}, "start .* returns the state with y=0 of type int"),
    ({"start": lambda at: S(1.0 / at.x)}, "raised ZeroDivisionError"),
    ({"start": lambda at: S(at.f)}, "reads f, but Spoilt.force does not"),
    ({"force": lambda s, at: (at.x > 0.0, s)}, "returns the force (True|False) of type bool; write it as a float"),
    ({"force": lambda s, at: (at.x, T(at.x))}, "returns a state of type T, but start one of type S"),
    ({"force": lambda s, at: (at.x, S(1))}, "force .* returns the state with y=1 of type int"),
    ({"force": lambda s, at: (at.x / (at.v + 1e-320), s)}, "for finite arguments"),
    ({"force": lambda s, at: (at.x, S(math.inf))}, "for finite arguments"),
    ({"force": lambda s, at: (at.x**2, s)}, "raised OverflowError"),
    ({"force": lambda s, at: (float(next(calls)), s)}, TWICE),
    ({"force": burns}, TWICE),
    ({"force": lambda s, at: (at[1], s)}, "reads v where it cannot be seen"),
    ({"start": ONE_PORT["start"], "claims": {"E_link": "any link"}}, "a one-port law has no link"),
    ({"start": ONE_PORT["start"], "claims": {"E_prt": "any link"}}, "which is no ledger"),
    ({"force": lambda s, at: (500.0 * at.x, s), "claims": {"E_port": "any link"}}, "claims E_port, which fell to -"),
    ({"start": ONE_PORT["start"], "slave": TWO_PORT["slave"]},
     "has no master_start; a law has master_start, master, slave_start and slave"),
]


@pytest.mark.parametrize(("parts", "sentence"), SLIPS, ids=range(len(SLIPS)))
def test_what_a_law_does_wrongly_is_told_in_one_sentence(parts: dict[str, Any], sentence: str) -> None:
    with pytest.raises(Refused, match=sentence) as refused:
        check_law(spoilt(**parts), compiled=False)
    assert "\n" not in str(refused.value)


def test_a_claim_of_its_port_that_a_one_port_law_keeps_is_let_pass() -> None:
    check_law(spoilt({"E_port": "any link"}, force=lambda s, at: (0.0, s)))


def doubles(self: Any) -> None:
    object.__setattr__(self, "K", self.K * 2.0)


def accepts_nan(self: Any) -> None:
    if self.K < 0.0:
        raise Refused("K must be at least 0")


def asserts(self: Any) -> None:
    assert self.K == self.K


CLASSES: list[tuple[Any, str]] = [
    (Wave, r"write check_law\(Wave\(\)\)"),
    (3.0, "no frozen dataclass"),
    (a_class(frozen=False)(), "frozen=True, kw_only=True"),
    (a_class(kw_only=False)(), "by position; add kw_only=True"),
    (a_class(ONE_PORT, kw_only=False)(), "kw_only=True"),
    (a_class(K=1, kind=int)(), "K is 1 of int; every field of a law is a number: declare K: float"),
    (a_class(post=accepts_nan)(), "accepts K=nan; call number"),
    (a_class(post=asserts)(), "meets K=nan with AssertionError"),
    (a_class(post=doubles)(), "made again with the same K is another law"),
    (a_class(K=field(default=1.0, init=False), post=None)(), "does not accept its own K=1.0"),
    (a_class(bases=(Exception,))(), "inherits from Exception"),
    (a_class({})(), "Spoilt has no master_start"),
    (spoilt(None, start=ONE_PORT["start"]), "claims is None"),
]


@pytest.mark.parametrize(("law", "sentence"), CLASSES, ids=range(len(CLASSES)))
def test_what_is_wrong_with_the_class_is_named(law: Any, sentence: str) -> None:
    with pytest.raises(Refused, match=sentence):
        check_law(law)


def test_a_law_that_changes_itself_is_caught() -> None:
    def master(self: Any, s: Any, at: At, rx: Any) -> Any:
        object.__setattr__(self, "K", self.K + 1.0)
        return rx.force, X(at.x), s

    def force(self: Any, s: Any, at: At) -> Any:
        object.__setattr__(self, "K", 2.0)
        return at.x, s

    for of, end in ((TWO_PORT, master), (ONE_PORT, force)):
        kind = a_class(of)
        setattr(kind, end.__name__, end)
        with pytest.raises(Refused, match=rf"Spoilt.{end.__name__} \(.*py:\d+\) changes the law, K=2.0; keep"):
            check_law(kind())


def test_it_needs_no_test_library() -> None:
    program = ("import sys; from teleop import check_law, find_law; check_law(find_law('wave')(), compiled=False); "
               "others = 'pytest', 'hypothesis', 'scipy', 'asyncio', 'random', 'master', 'channel'; "
               "print([name for name in others if name in sys.modules])")
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("compiled", [False, True])
def test_every_engine_has_the_bits_of_a_single_run(compiled: bool) -> None:
    try_engines(Direct(), compiled=compiled)


def test_a_figure_that_is_off_by_a_bit_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    def off(scene: Any) -> Any:
        result = run(scene)
        return replace(result, metrics={**result.metrics, "f_m_max": math.nextafter(result.metrics["f_m_max"], 1e9)})

    monkeypatch.setattr(law_module, "run", off)
    with pytest.raises(Refused, match=r"Direct gives f_m_max = .* by the engine plain, and .* in a single run"):
        try_engines(Direct(), compiled=False)
