"""The language of a law that can be printed as C: each row of the page's two tables, tried."""

from __future__ import annotations

import importlib.util
import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from teleop import Refused, load_scene
from teleop.emit.files import files
from tests.teleop.emit.printed import assert_same

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
