"""Wrong forms of P+d and of its condition, each refused by `check_law`, which knows nothing of P+d."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from teleop import Refused, check_law
from teleop.laws import p_d

WRONG = {  # what is wrong: lines of the law's file, those in their place, what the refusal has to say
    "the slave flees its master": (
        "self.K * (apart - offset) - self.B * at.v, Back", "-self.K * (apart - offset) - self.B * at.v, Back",
        "turn the sign of f_s"),
    "the master goes on where the slave is stopped": (
        "self.K * (apart - offset) + self.B * at.v, Forth", "-self.K * (apart - offset) + self.B * at.v, Forth",
        "turn the sign of f_m"),
    "the other end is taken to stand at zero": (
        "PDampedEnd(0.0), Back(at.x)", "PDampedEnd(0.0), Back(0.0)", "would jump"),
    "where it was let go is kept in the law": (
        "offset = (s.offset", "self.__dict__['rejoin'] = 1.0; offset = (s.offset", "changes the law"),
    "the condition counts the damper once for both ends": (
        '"P+d", facts, self.K, 0.0, self.B)', '"P+d", facts, self.K, 0.0, 0.5 * self.B)', "broken still"),
    "the condition tells more than is needed": (
        "facts, self.K, 0.0, self.B)", "facts, self.K * (1.1 if self.B == 0.0 else 1.0), 0.0, self.B)",
        "is enough"),
    "what it is fitted with may be anything": ("check_knobs(self)", "pass", "accepts K=nan"),
}


@pytest.mark.parametrize("what", WRONG)
def test_a_wrong_form_is_refused(monkeypatch: pytest.MonkeyPatch, what: str) -> None:
    lines, wrong, said = WRONG[what]
    law = made(monkeypatch, lines, wrong)
    with pytest.raises(Refused, match=said):
        check_law(law, compiled=False)


def test_the_right_form_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    check_law(made(monkeypatch, "P+d: each end", "P+d, each end"), compiled=False)


def made(monkeypatch: pytest.MonkeyPatch, lines: str, instead: str) -> Any:
    """P+d without a damper of its own, with these lines of its file changed."""
    text = Path(p_d.__file__).read_text(encoding="utf-8")
    assert lines in text
    module = ModuleType("mutant")
    monkeypatch.setitem(sys.modules, "mutant", module)
    exec(compile(text.replace(lines, instead, 1), "mutant.py", "exec"), vars(module))
    return module.PDamped(B=0.0)
