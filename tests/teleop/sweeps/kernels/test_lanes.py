"""What stands in a lane means there what it means in plain Python, to the last bit."""

from __future__ import annotations

import ctypes
import math
import subprocess
from collections.abc import Callable, Sequence
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest

from teleop.emit.compiler import find_compiler
from teleop.emit.primitives import FAULTS
from teleop.emit.types import NotPrinted, Printed
from teleop.simulation.masks import invert, one_by_one, select
from teleop.sweeps.kernels.c_kernel import FLAGS, target_of
from teleop.sweeps.kernels.lanes import LANES, LaneProgram, LaneStatements, header
from tests.programs import COMPILERS, program

ODD = [0.0, -0.0, 1.0, -1.5, 1e-310, -3e-320, 1e308, -1e308, math.inf, -math.inf, math.nan, math.pi]
PAIRS = np.array([*product(ODD, ODD), *[(0.1 * i, 7.0 - 0.3 * i) for i in range(8)]])
TEXT = """\
#include <math.h>
#include <stdbool.h>
#include <stdint.h>
{header}
enum {{ {faults} }};
{types}
{functions}
{entry}
"""


def bits(value: float) -> bytes:
    """The bits of a float; every NaN is the same."""
    return b"nan" if value != value else np.float64(value).tobytes()  # noqa: PLR0124


def on_lanes(functions: Sequence[Callable[..., Any]], lanes: int) -> tuple[list[list[bytes]], str]:
    """What each of several functions of two floats makes of all pairs, so many at a time, and the text of C."""
    made_by = LaneProgram(lanes)
    caller: Any = LaneStatements(made_by, on_lanes)
    lines = []
    for i, function in enumerate(functions):
        answer = caller.call(function, [Printed(LANES, "x"), Printed(LANES, "y")], {})
        lines.append(f"    vec_store(out + {i * lanes}, vec_truth(true), {caller.to(answer, LANES)});")
    entry = "\n".join(["void entry(const double *xs, const double *ys, double *out)", "{",
                       "    unsigned faults = 0, *const fault = &faults;",
                       "    const vec_real x = vec_load(xs), y = vec_load(ys);", *lines, "}"])
    text = TEXT.format(header=header(lanes), types=made_by.types.declarations(), functions=made_by.text(entry),
                       faults=", ".join([f"K_{name} = 1 << {i}" for i, name in enumerate(FAULTS)]), entry=entry)
    compiler = program(*COMPILERS)
    assert compiler == find_compiler()
    with TemporaryDirectory() as folder:
        (Path(folder) / "lanes.c").write_text(text)
        subprocess.run([compiler, *FLAGS, *target_of(compiler).flags, "lanes.c", "-lm", "-o", "lanes.so"], cwd=folder,
                       check=True)
        call = ctypes.CDLL(str(Path(folder) / "lanes.so")).entry
    answers = []
    for first in range(0, len(PAIRS), lanes):
        x, y = np.ascontiguousarray(PAIRS[first:first + lanes].T)
        out = np.zeros((len(functions), lanes))
        call(*[ctypes.c_void_p(each.ctypes.data) for each in (x, y, out)])
        answers.append(out)
    return [list(map(bits, each)) for each in np.concatenate(answers, axis=1).tolist()], text


def in_python(function: Callable[..., Any]) -> list[bytes]:
    """What Python makes of all pairs, where a division by zero is no error."""
    with np.errstate(all="ignore"):
        return [bits(float(function(*map(np.float64, pair)))) for pair in PAIRS]


OPERATIONS: dict[str, Callable[[Any, Any], Any]] = {
    "x + y": lambda x, y: x + y,
    "x - y": lambda x, y: x - y,
    "x * y": lambda x, y: x * y,
    "x / y": lambda x, y: x / y,
    "-x": lambda x, y: -x,  # noqa: ARG005
    "-0.0 * x": lambda x, y: -0.0 * x,  # noqa: ARG005
    "abs(x)": lambda x, y: abs(x),  # noqa: ARG005
    "sqrt(abs(x))": lambda x, y: math.sqrt(abs(x)),  # noqa: ARG005
    "fabs(y)": lambda x, y: math.fabs(y),  # noqa: ARG005
    "max(x, y)": lambda x, y: max(x, y),  # noqa: PLW0108 - lines are printed
    "min(x, y)": lambda x, y: min(x, y),  # noqa: PLW0108
    "max(x, 0.0, y)": lambda x, y: max(x, 0.0, y),
    "max(0.0, x)": lambda x, y: max(0.0, x),  # noqa: ARG005
    "min(-0.0, y)": lambda x, y: min(-0.0, y),  # noqa: ARG005
    "x * (x < y)": lambda x, y: x * (x < y),
    "x * (x <= y)": lambda x, y: x * (x <= y),
    "y * (x > y)": lambda x, y: y * (x > y),
    "y * (x >= 1)": lambda x, y: y * (x >= 1),
    "y * (x == y)": lambda x, y: y * (x == y),
    "y * (x != y)": lambda x, y: y * (x != y),
    "2 * x + True": lambda x, y: 2 * x + True,  # noqa: ARG005
    "x * x * x - y / 3.0": lambda x, y: x * x * x - y / 3.0,
}


def leaves_early(x: float, y: float) -> float:
    if x < 0.0:
        if not y > x:
            return y - 1.0
        x = x + 2.0
    elif x < 1.0 < y or x == y:
        return x * y
    total = 0.0
    if -1.0 < x <= y and not x > 5.0:
        total = total + x
    else:
        y = y - 1.0
        if y > x or total > 0.0:
            total = total - y
    return total if total < 2.0 else y


def sorted_pair(x: float, y: float) -> tuple[float, float]:
    if x > y:
        x, y = y, x
    return x, y


def calls_another(x: float, y: float) -> float:
    low, high = sorted_pair(x, y)
    return leaves_early(low, high) if low > -2.0 else high


def many_lines(x: float, y: float) -> float:
    a = b = c = d = 0.0
    if x > 0.5:
        a = x + y
        b = a * x
        c = b - y
        d = c / x
        a = d - a
        b = b + a * d
        c = min(a, b)
        d = max(c, d)
    return a + b + c + d


def either(x: float, y: float) -> float:
    return select((x < y) | (x == 1.0), x, -1.0) + select(invert(x < y) & (y > 0.0), y, 0.0)


def halved(x: float, y: float) -> tuple[float, float]:
    """How often x is halved is another number in each lane."""
    n = 0.0
    while 1.0 < x < 1e9:
        x = 0.5 * x
        n = n + 1.0
    return x - y, n


def halves(x: float, y: float) -> float:
    rest, n = halved(x, y)
    return rest + 2.0 * n


def halves_some(x: float, y: float) -> float:
    rest, n = one_by_one(y > 0.0, halved, (x, -1.0), x, y)
    return rest + 2.0 * n


def looped(x: float, y: float) -> float:
    for _ in range(3):
        if x < y:
            x = x + 0.25 * y
    return x


BRANCHING = (leaves_early, calls_another, many_lines, either, halves, halves_some, looped)


@pytest.mark.parametrize("lanes", [2, 4, 8])
def test_an_operation_on_lanes_is_pythons_in_each_of_them(lanes: int) -> None:
    """Of all pairs of zeros of both signs, subnormal and huge numbers, infinities and NaN."""
    answers, _ = on_lanes([*OPERATIONS.values()], lanes)
    for (name, python), values in zip(OPERATIONS.items(), answers, strict=True):
        assert values == in_python(python), name


@pytest.mark.parametrize("lanes", [2, 4, 8])
def test_a_function_that_branches_has_masks_or_runs_for_one_lane_after_the_other(lanes: int) -> None:
    answers, text = on_lanes(BRANCHING, lanes)
    for function, values in zip(BRANCHING, answers, strict=True):
        assert values == in_python(function), function.__name__
    assert "vec_any(mask" in text  # of many lines under a mask
    assert text.count("one lane after the other") == 2  # halved, with a mask and without


def test_what_no_lane_can_have_is_refused() -> None:
    made_by = LaneProgram(4)
    with pytest.raises(NotPrinted, match="`sum` compensates"):
        made_by.function(lambda x, y: sum((x, y)), [Printed(LANES, "x"), Printed(LANES, "y")],
                         LaneStatements(made_by, on_lanes))
