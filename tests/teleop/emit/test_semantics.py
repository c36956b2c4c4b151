"""Semantics of Python that C does not have, kept in printed C; and each row of both tables of a law's language."""

from __future__ import annotations

import importlib.util
import math
import re
import sys
from dataclasses import dataclass, replace
from math import copysign, exp, floor, inf, nan, sqrt
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import pytest

from teleop import At, Device, Refused, Scene, load_scene
from teleop.emit import files as files_module
from teleop.emit.expressions import c_word
from teleop.emit.files import files
from teleop.emit.primitives import PRIMITIVES, Primitive
from teleop.emit.types import DOUBLE, INT, Types
from teleop.emit.vectors import vectors
from tests.teleop.emit.printed import assert_same, compiled, differences, limited


class Sent(NamedTuple):
    x: float
    least: float = 0.0  # of values among which are NaN and zeros of both signs
    tie: float = 0.0
    truths: float = 0.0
    rest: float = 0.0
    whole_rest: float = 0.0
    chain: float = 0.0
    either: float = 0.0
    mode: float = 0.0
    window: float = 0.0
    helped: float = 0.0
    turns: float = 0.0
    rounded: float = 0.0
    swapped: float = 0.0
    chosen: float = 0.0


class Odd(NamedTuple):
    a: float


TABLE = (3.0, 1.0, 4.0, 1.0, 5.0, 9.0, 2.0, 6.0, 5.0, 3.0)


@dataclass(frozen=True, kw_only=True)
class Oddities:
    """A law whose messages are what Python makes of one odd expression each."""

    K: float = 100.0
    n: int = 3
    mode: str = "soft"
    gains: tuple[float, ...] = (1.0, -2.0, 3.0)
    claims: ClassVar[dict[str, str]] = {}

    def master_start(self, at: At) -> Any:
        return Odd(0.0), Sent(at.x)

    def slave_start(self, at: At) -> Any:
        return (), Sent(at.x)

    @property
    def twice(self) -> float:
        return 2.0 * self.K

    def master(self, s: Any, at: At, rx: Sent) -> Any:
        v, x = at.v, at.x
        past = (x, *((v, s.a, at.f_held) * 5)[1:-1], v)
        total, sign = 0.0, 1
        for each in past:
            total += sign * each
            if each > 4.0:
                break
            sign = -sign
        turns, f = 0, abs(v)
        while turns < 6 and f > 0.01:
            f = f / 2.0
            turns += 1
        for i in range(turns):
            f += TABLE[i] * past[i - 3]
        b, c = x, v
        b, c = c, b - c
        count = 9 if at.fresh else 4
        chosen = 0.0
        for g in self.gains:
            chosen = max(chosen, g * v)
        tx = Sent(
            x, min(nan if x > 0.05 else 0.0, x, v, 0.0 * v), max(-0.0, 0.0 * x),
            (v > 0.0) + (x > 0.0) * 2 - (not at.fresh),
            v % 0.3 + -v % -0.7 + x % inf, (count - 7) % self.n + (count % -4), 1.0 if -0.1 < v <= x < 5.0 else 0.0,
            (v > 0.1 and x) or s.a or 0.25, self.twice if self.mode == "soft" else 0.0, total + past[-1],
            limited(v, high=0.5), f + turns,
            floor(x * 10.0) * 0.1 + int(v * 10.0) + copysign(1.0, 0.0 * floor(-0.5 * at.fresh)),
            b - c, chosen)
        return self.K * (x - rx.x), tx, Odd(v if v < inf else 0.0)

    def slave(self, s: Any, at: At, rx: Sent) -> Any:
        return self.K * (rx.x - at.x), Sent(at.x), s


def scene(law: Any = None) -> Scene:
    """The canonical scene with such a law."""
    return replace(load_scene("canonical"), law=law or Oddities(), name="odd")


def test_odd_expressions_have_the_bits_of_python(tmp_path: Path) -> None:
    of = scene()
    made = files(of, "m", "m")
    built = compiled(made, tmp_path, "-O1")
    assert differences(built) == ""
    for wild in (0.0, 0.05):
        assert differences(built, vectors(of, "m", made.tick, count=3000, wild=wild, again=40)) == ""


def raising(v: float, x: float) -> float:
    """Divisions, roots, exponentials and whole numbers of what a device reads, some of which Python refuses."""
    steps = floor(v * 20.0)
    if x > 0.12:
        return 1.0 if (v > 0.0) | (1.0 / steps > 0.0) else 0.5
    if x > 0.1:
        return 1.0 if any((v > 0.0, 1.0 / steps > 0.0)) else 0.5
    if x > 0.08:
        for each in (v, 1.0 / steps):
            x += each if v < 0.0 else 1.0
        return x
    if x > 0.06:
        return 1.0 / steps
    if x > 0.0:
        return sqrt(v + 0.3)
    return exp(v * 3000.0) + x % floor(v * 20.0)


@dataclass(frozen=True, kw_only=True)
class Raising:
    """A law that raises at some ticks, and counts the others."""

    claims: ClassVar[dict[str, str]] = {}

    def master_start(self, at: At) -> Any:
        return Odd(0.0), Sent(at.x)

    def slave_start(self, at: At) -> Any:
        return (), Sent(at.x)

    def master(self, s: Any, at: At, rx: Sent) -> Any:
        return (raising(at.v, at.x) if s.a > 10.0 else 0.0) + s.a, Sent(at.x), Odd(s.a + 1.0)

    def slave(self, s: Any, at: At, rx: Sent) -> Any:
        return 0.0, Sent(at.x), s


def test_where_python_raises_the_tick_faults_and_leaves_the_state_as_it_was(tmp_path: Path, monkeypatch: Any) -> None:
    of = scene(Raising())
    made = files(of, "m", "m")
    rows = vectors(of, "m", made.tick, count=2000, wild=0.02, again=60)
    raised = sum(row[1] for row in rows.rows)
    assert 100 < raised < 1500
    assert differences(compiled(made, tmp_path), rows) == ""
    monkeypatch.setitem(PRIMITIVES, math.sqrt, Primitive("sqrt@({0})"))
    made = files(of, "m", "m")
    assert "Python raised" in differences(compiled(made, tmp_path / "without"), rows)


def test_an_end_begins_where_its_device_is_and_not_where_the_scene_does(tmp_path: Path) -> None:
    """A window of readings was printed as full of the scene's own start."""
    from teleop.stages.encoder import Encoder
    from teleop.stages.velocity.adaptive_window import EndFit

    of = replace(load_scene("canonical", law="pp"), start_m=0.02, device_m=Device(
        encoder=Encoder(step=1e-4), velocity=EndFit(noise=1e-4, most=30), every=3))
    made = files(of, "m", "m")
    begins = [row[2] for row in made.vectors.rows if row[0] == 0.0]
    assert begins
    assert 0.02 not in begins
    assert differences(compiled(made, tmp_path)) == ""
    assert made.texts["canonical_m.c"].count("for (") >= 3, "a long window is copied by a loop"


def test_a_long_window_is_no_longer_in_c_than_a_short_one() -> None:
    from teleop.stages.velocity.adaptive_window import EndFit

    def printed(most: int) -> str:
        of = replace(load_scene("canonical", law="pp"), device_m=Device(velocity=EndFit(noise=1e-4, most=most)))
        text: str = files_module.printed_tick(of, "m", "m_").text
        return text

    assert printed(30).count("\n") == printed(900).count("\n")


def test_names_in_c_were_taken_twice_by_a_second_record_of_a_class_and_by_a_variable_called_as_a_helper() -> None:
    types = Types("t_")
    first = types.struct("Odd", {"a": DOUBLE}, Odd)
    kinds = [first, types.array(first, 2), types.struct("Odd", {"a": INT}, Odd), types.array(first, 3)]
    assert len({types.c(each) for each in kinds}) == len(kinds)
    assert [c_word(name) for name in ("py_min", "vec_max", "v_max")] == ["py_min_", "vec_max_", "v_max"]


LAW = """
from dataclasses import dataclass
from math import *
from typing import ClassVar, NamedTuple
class Message(NamedTuple):
    x: float
    v: float
class Memory(NamedTuple):
    a: float
from tests.teleop.emit.printed import limited
def signed(x, sign=1):
    if x < 0.0:
        sign = -1.5
    return sign * x
def mean(*sizes):
    share = 0.5
    return share * (sizes[0] + sizes[1])
@dataclass(frozen=True, kw_only=True)
class Tried:
    K: float = 100.0
    mode: str = "soft"
    gains: tuple = (1.0, 2.0, 3.0)
    claims: ClassVar = {}
    def master_start(self, at):
        return Memory(0.0), Message(at.x, 0.0)
    def slave_start(self, at):
        return Memory(0.0), Message(at.x, 0.0)
    def slave(self, s, at, rx):
        return self.K * (rx.x - at.x), Message(at.x, at.v), s
    def master(self, s, at, rx):
        f = self.K * (at.x - rx.x)
        @line@
        return f, Message(at.x, at.v), s
"""
ALLOWED = {
    "early return": "if at.v > 0.1: return 0.0, Message(at.x, at.v), s",
    "a loop over a tuple": "for g in self.gains: f = f + g * at.v",
    "a loop over a range": "for k in range(20): f = f + k * at.v",
    "while": "n = 0; \n        while n < 5 and f > 1.0: f = f / 2.0; n += 1",
    "a helper with defaults and names": "f = limited(f, high=2.0)",
    "a text knob": "f = f if self.mode == 'soft' else 2.0 * f",
    "a comprehension over what is known": "f = max([g * at.v for g in self.gains])",
    "abs": "f = f + abs(at.v)",
    "tuples within tuples, swapped": "(p, q), r = (at.v, at.x), f; (p, q), r = (q, r), p; f = p + 2.0 * q + 0.1 * r",
    "a loop over a tuple that it sets":
        "t = (at.x, at.v, f)\n        for e in t: t = (t[1], t[2], t[0]); f = f + e * t[0]",
    "a loop over values of what it sets": "for e in (f, f + 1.0): f = 0.5 * f + e",
    "a loop over rows of what it sets": "for i, e in enumerate(t, 1): t = (t[1], t[2], e); f = f + i * t[0]",
    "names that C has":
        "i1 = t1 = NAN = at.v; t1, INFINITY = NAN + 1.0, t1 + f\n        for k in range(20): i1 = i1 + k * t1",
    "numbers of them": "fault = i1; fault_ = INFINITY; f = fault + 2.0 * fault_; n_i1 = f",
    "whole numbers, whose 0 has no sign":
        "f = f + copysign(1.0, -floor(at.v)) + copysign(2.0, int(at.v) * -1) + copysign(4.0, floor(at.v) % -3)",
    "a star, and lines of its own": "f = f + mean(at.x, at.v)",
    "arguments that are set under an `if`": "f = f + signed(at.v) + signed(at.x, at.v > 0.0)",
    "a loop's name that is set under an `if`":
        "for k in range(3):\n            if at.v > 0.0: k = 7\n            f = f + k * at.x",
    "exp": "f = f + exp(-abs(at.v))",
}
REFUSED = {
    "f = f + at.v ** 2": "`**` is rounded otherwise from one libm to the next; write x * x",
    "f = f + hypot(at.v, at.x)": "`hypot` is rounded otherwise in Python than in libm; write sqrt(x * x + y * y)",
    "f = sum((at.v, at.x))": "`sum` compensates from Python 3.12 on, and C does not; write a + b + c",
    "f = log(abs(f) + 1.0, 2.0)": "math.log has no line in C with 2 arguments",
    "f = max(f, at.v, key=abs)": "max has no line in C with key=",
    "f = (f, 1.0 / (at.x + 9.0))[0]": "what may be a division by zero is made and not read; leave it out",
    "f = -max(0, f)": "the sign of a 0 that is once a whole number and once a float; write 0.0",
    "f = f // 2.0": "`//` has no line in C; write floor(a / b)",
    "f = round(f, 3)": "`round` rounds by the decimal digits; write floor(x + 0.5)",
    "f = f + len(f'{f}')": "an f-string has no line in C",
    "g = [f]; f = g[0]": "a list has no line in C; write a tuple: [f]",
    "g = {1: f}; f = g[1]": "a dict has no line in C",
    "f = (lambda x: 2.0 * x)(f)": "a lambda within a function has no line in C",
    "def g(x): return x": "a function within a function has no line in C",
    "try: f = f / at.v\n        except ZeroDivisionError: f = 0.0": "`try` has no line in C",
}


def scene_of(line: str, folder: Path) -> Any:
    """The canonical scene with a law that has this line."""
    file = folder / "tried.py"
    file.write_text(LAW.replace("@line@", line))
    name = f"tried_{folder.name}_{abs(hash(line))}"
    spec = importlib.util.spec_from_file_location(name, file)
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return replace(load_scene("canonical"), law=module.Tried(), name="tried")


def test_what_may_stand_in_a_law_has_the_bits_of_python(tmp_path: Path) -> None:
    """All of them in one law: each changes the force."""
    whole = "\n        ".join(ALLOWED.values())
    assert_same(scene_of(whole, tmp_path), "m", tmp_path / "c")


def test_what_may_not_is_refused_with_file_line_and_what_to_write(tmp_path: Path) -> None:
    for line, why in REFUSED.items():
        with pytest.raises(Refused) as refused:
            files(scene_of(line, tmp_path), "m", "m")
        text = str(refused.value)
        assert f"tried.py:32: Tried.master: {why}" in text, text
        assert "\n" not in text


UNDER_AN_IF = {  # each was another number in C than in Python where the `if` was not taken
    "m = None\n        if f > 0.0: m = f\n        f = 9.0 if m is None else m": "33: Tried.master: m is None, which no",
    "t = (f, f)\n        if f > 0.0: t = ()\n        for e in t: f = f + e": "33: Tried.master: t is (), which no",
    "k = 5\n        if f > 0.0:\n            for k in range(3): f = f + k\n        f = f + k":
        "35: Tried.master: k is not set on every way to here",
}


def test_a_name_is_set_under_an_if_to_what_a_variable_of_c_can_hold(tmp_path: Path) -> None:
    for lines, why in UNDER_AN_IF.items():
        with pytest.raises(Refused, match=re.escape(f"tried.py:{why}")):
            files(scene_of(lines, tmp_path), "m", "m")
