# ruff: noqa: ARG001 - functions for the evaluator are handed what they do not ask
"""The partial evaluator: what it decides, unrolls and writes out, what it leaves as it is, and what it refuses."""

from __future__ import annotations

import ast
import re
import sys
import traceback
from collections.abc import Callable
from functools import reduce
from importlib import import_module
from operator import add
from pathlib import Path
from textwrap import dedent, indent
from types import ModuleType
from typing import Any, NamedTuple

import pytest

from teleop.simulation.specialise import NotSpecialised, specialise
from teleop.stages.end import End as StageEnd
from teleop.stages.end import EndHas, Record, Run


class Has(NamedTuple):
    encoder: bool = False
    pair: bool = True


class Axis(Record):
    x: float
    y: float

    def __init__(self, suffix: str, i: int) -> None:
        super().__init__(suffix)
        self.i = i


class End(Record):
    has: Has
    total: float
    law: Callable[..., Any]

    def __init__(self, has: Has | None = None, axes: int = 2) -> None:
        super().__init__("m")
        self.has = has or Has()
        self.axes = tuple([Axis(f"m{i}", i) for i in range(axes)])
        self.law = abs


def text(function: Callable[..., Any], end: End | None = None) -> str:
    """What a function over an end comes to."""
    return ast.unparse(specialise(function, end or End()).tree).partition("\n")[2]


def called(function: Callable[..., Any], *arguments: Any, end: End | None = None) -> Any:
    """What that answers."""
    made = specialise(function, end or End())
    names = dict(made.names)
    exec(compile(ast.Module([made.tree], []), made.file, "exec"), names)
    return names[function.__name__](*arguments)


def double(e: End, a: Axis) -> None:
    kept = a.x + a.x
    a.y = kept


def reading(e: End, a: Axis) -> float:
    if e.has.encoder:
        return a.y
    return a.x


def whole(e: End, start: Any) -> Any:
    for a in e.axes:
        a.x = start[a.i]
        double(e, a)
    e.total = 0.0
    for a in e.axes:
        e.total += reading(e, a) * 2.0 * 3.0
    return e.total, tuple([a.y for a in e.axes])


class TestWhatItMakes:
    def test_is_straight_lines_over_variables_that_give_what_the_function_itself_gives(self) -> None:
        assert text(whole).split("\n") == [
            "    x_m0 = start[0]", "    kept_m0 = x_m0 + x_m0", "    y_m0 = kept_m0",
            "    x_m1 = start[1]", "    kept_m1 = x_m1 + x_m1", "    y_m1 = kept_m1",
            "    total_m = 0.0", "    total_m += x_m0 * 2.0 * 3.0", "    total_m += x_m1 * 2.0 * 3.0",
            "    return (total_m, (y_m0, y_m1))"]
        assert called(whole, (0.1, 0.7)) == whole(End(), (0.1, 0.7))

    def test_has_the_branch_that_was_decided_alone_and_a_condition_of_numbers_with_a_decided_one_together(self) -> None:
        assert "x_m0 * 2.0 * 3.0" in text(whole)
        assert "y_m0 * 2.0 * 3.0" in text(whole, End(Has(encoder=True)))
        assert "if k > 0:" in text(both)
        assert "if" not in text(both, End(Has(pair=False)))

    def test_leaves_arithmetic_as_it_is_and_adds_from_left_to_right(self) -> None:
        line = "return x + (0.1 + 0.2) + 0.3 * (1.0 - 1.0)"
        assert line in text(body(line))
        assert "return x_m0 + x_m1 + x_m2" in text(added, End(axes=3))

    def test_names_the_functions_that_a_record_is_made_with(self) -> None:
        made = specialise(asks, End())
        assert "law_m(x)" in ast.unparse(made.tree)
        assert made.names["law_m"] is abs


def added(e: End, start: Any) -> Any:
    for a in e.axes:
        a.x = start[a.i]
    return reduce(add, [a.x for a in e.axes])


def both(e: End, k: int) -> int:
    if e.has.pair and k > 0:
        return 1
    return 0


def asks(e: End, x: float) -> Any:
    return e.law(x)


def body(lines: str) -> Callable[..., Any]:
    """A function over an end of these lines, with its source."""
    source = "def made(e, x):\n" + indent(dedent(lines).strip("\n"), "    ") + "\n"
    module = ModuleType(f"made_{len(source)}_{hash(source)}")

    class Loader:
        def get_source(self, _: str) -> str:
            return source

    module.__dict__.update(globals(), __name__=module.__name__, __loader__=Loader())
    exec(compile(source, __file__, "exec"), vars(module))
    sys.modules[module.__name__] = module
    made: Callable[..., Any] = vars(module)["made"]
    return made


REFUSED = {
    """
    for k in range(9):
        for a in e.axes:
            if x > k:
                break
            a.x = x
    """: "`break` stands in a loop that is unrolled",
    """
    for a in e.axes:
        if x > 0.0:
            continue
        a.x = x
    """: "`continue` stands in a loop that is unrolled",
    "x.append(e)": "escapes",
    "return e": "End m escapes",
    "return 1.0 if e.has.encodr else x": "Has has no encodr",
    "e.totl = x": "End declares no variable totl",
    """
    e.total = sign(e, x)
    return e.total
    """: "may not return",
    "return x + with_lines(e, x)": "stands in the midst of an expression",
    "itself(e, x)": "calls itself",
    """
    for k in range(3):
        a = e.axes[0]
        a.x = x + k
    """: "cannot be set under a condition of numbers, or in a loop that stays one",
    """
    try:
        e.total = x
    finally:
        pass
    """: "Try is not for the tick",
}


def sign(e: End, x: float) -> float:
    if x > 0.0:
        return 1.0
    return -1.0


def with_lines(e: End, x: float) -> float:
    e.total = x
    return e.total


def itself(e: End, x: float) -> None:
    itself(e, x)


@pytest.mark.parametrize("lines", REFUSED)
def test_what_is_not_for_the_tick_is_refused_with_its_place(lines: str) -> None:
    with pytest.raises(NotSpecialised) as refused:
        text(body(lines))
    assert REFUSED[lines] in str(refused.value)
    assert str(refused.value).startswith(f"{__file__}:")


class TestNames:
    def test_one_name_in_two_functions_is_two_variables_and_two_records_with_one_variable_are_refused(self) -> None:
        made = called(two_names, 2.0)
        assert made == two_names(End(), 2.0) == (14.0, 2.0)
        end = End()
        end.axes[1].suffix = "m0"
        with pytest.raises(NotSpecialised, match="two records have a field x"):
            specialise(whole, end)

def two_names(e: End, x: float) -> Any:
    kept = x
    for a in e.axes:
        a.x = kept + 5.0
        double(e, a)
    return e.axes[1].y, kept


class TestLines:
    def test_keep_their_numbers_and_their_file(self) -> None:
        with pytest.raises(TypeError) as error:
            called(whole, (0.1, None))
        frame = traceback.extract_tb(error.value.__traceback__)[-1]
        assert Path(frame.filename) == Path(__file__)
        assert frame.line == "kept = a.x + a.x"

    def test_of_another_file_have_the_number_of_their_call(self) -> None:
        from teleop.scene.loading import load_scene
        from teleop.simulation import tick
        from teleop.simulation.source import lines
        from teleop.simulation.structure import structure_of

        made = lines(structure_of(load_scene("hard_wall")), tick.loop)
        source = Path(tick.__file__).read_text().splitlines()
        sets = [each for each in ast.walk(made.made.tree) if isinstance(each, ast.Assign)]
        capped = [each for each in sets if "cap(" in ast.unparse(each)]
        assert {source[each.lineno - 1].strip() for each in capped} >= {"stage.act(run, e, k)"}


PAGE = """from typing import Any
from teleop.stages.end import End, Run, Stage
from teleop.stages.memory import get, put


def act(run: Run, e: End, k: int) -> None:
    for stage in e.stages:
        stage.act(run, e, k)


"""


class Passing(Axis):
    passing = ("y",)


def chosen(e: End, here: Any) -> None:
    for a in e.axes:
        a.y = 1.0
        if here > 0.0:
            a.y = 2.0
        e.total = a.y


def test_a_field_of_one_tick_that_a_branch_of_lanes_set_was_set_in_all_lanes() -> None:
    e = End(axes=1)
    for kind in (Axis, Passing):
        e.axes = (kind("m0", 0),)
        made = ast.unparse(specialise(chosen, e, engine="vector").tree)
        assert "y_m0 = select(mask, y_m0, y_was)" in made.replace("y_m0_was", "y_was"), made


def test_the_page_of_the_evaluator_shows_what_it_makes_of_a_stage(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (Path(specialise.__code__.co_filename).parent / "EVALUATOR.md").read_text()
    blocks = dict(re.findall(r"```python (\w+)\n(.*?)```", page, re.DOTALL))
    (tmp_path / "stage_of_the_page.py").write_text(PAGE + blocks["stage"])
    monkeypatch.syspath_prepend(str(tmp_path))
    module = import_module("stage_of_the_page")
    e = StageEnd("m", 1, EndHas(touch=True))
    e.stages = (module.BrakeStage(e, None),)
    for engine in ("plain", "c", "vector"):
        made = specialise(module.act, Run(), e, engine=engine)
        assert ast.unparse(made.tree).strip() == blocks[engine].strip(), engine
