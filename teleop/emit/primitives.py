"""Python's functions of numbers that C has a line for, with the errors of Python as faults.

A fault is a bit in `*fault`. Python would have raised there, so nothing that is computed after it counts.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable
from typing import Any, NamedTuple

from teleop.emit.types import BOOL, DOUBLE, WHOLE
from teleop.stages import memory

FAULTS = {"DIVISION": "a division by zero", "DOMAIN": "a function outside its domain, as the root of -1",
          "OVERFLOW": "a number beyond the range of its type", "INDEX": "an index outside a tuple"}

# Helpers by name, in C. REAL is the type of a number with a point; @ stands behind its functions and literals.
HELPERS = {
    "py_min": "static REAL py_min(REAL a, REAL b) { return b < a ? b : a; } /* as Python: of NaN and -0.0 too */",
    "py_max": "static REAL py_max(REAL a, REAL b) { return b > a ? b : a; }",
    "py_imin": "static int64_t py_imin(int64_t a, int64_t b) { return b < a ? b : a; }",
    "py_imax": "static int64_t py_imax(int64_t a, int64_t b) { return b > a ? b : a; }",
    "py_div": """static REAL py_div(REAL a, REAL b, unsigned *fault)
{
    if (b == 0.0@) *fault |= PRE_DIVISION;
    return a / b;
}""",
    "py_sqrt": "static REAL py_sqrt(REAL a, unsigned *fault) { if (a < 0.0@) *fault |= PRE_DOMAIN; return sqrt@(a); }",
    "py_mod": """static REAL py_mod(REAL a, REAL b, unsigned *fault)
{
    REAL m;
    if (b == 0.0@) { *fault |= PRE_DIVISION; return b; }
    m = fmod@(a, b);
    if (m != 0.0@) return (b < 0.0@) != (m < 0.0@) ? m + b : m;
    return copysign@(0.0@, b);
}""",
    "py_imod": """static int64_t py_imod(int64_t a, int64_t b, unsigned *fault)
{
    int64_t m;
    if (b == 0) { *fault |= PRE_DIVISION; return 0; }
    if (a >= 0 && b > 0 && a <= (int64_t)UINT32_MAX && b <= (int64_t)UINT32_MAX) return (uint32_t)a % (uint32_t)b;
    m = a % b;
    return m != 0 && (m < 0) != (b < 0) ? m + b : m;
}""",
    "py_idiv": """static int64_t py_idiv(int64_t a, int64_t b, unsigned *fault)
{
    int64_t q;
    if (b == 0) { *fault |= PRE_DIVISION; return 0; }
    if (a >= 0 && b > 0 && a <= (int64_t)UINT32_MAX && b <= (int64_t)UINT32_MAX) return (uint32_t)a / (uint32_t)b;
    q = a / b;
    return a % b != 0 && (a < 0) != (b < 0) ? q - 1 : q;
}""",
    "py_whole": """static REAL py_whole(REAL a, unsigned *fault)
{
    if (!isfinite(a)) *fault |= PRE_DOMAIN;
    return a + 0.0@; /* 0 for -0.0, as Python's int has it */
}""",
    "py_count": """static int64_t py_count(REAL a, unsigned *fault)
{
    if (!(a > -9.0e15@ && a < 9.0e15@)) { *fault |= PRE_OVERFLOW; return 0; }
    return (int64_t)a;
}""",
    "py_index": """static int64_t py_index(int64_t i, int64_t n, unsigned *fault)
{
    if (i < 0) i += n;
    if (i < 0 || i >= n) { *fault |= PRE_INDEX; return 0; }
    return i;
}""",
    "py_libm": """static REAL py_libm(REAL y, REAL a, unsigned *fault)
{
    if ((isinf(y) && isfinite(a)) || (isnan(y) && !isnan(a))) *fault |= PRE_DOMAIN;
    return y;
}""",
}


class Primitive(NamedTuple):
    """A function of Python in C: `{0}` is its first argument, `@` the letter of float."""

    text: str
    takes: str = DOUBLE  # the type of its arguments
    gives: str = DOUBLE
    helper: str = ""
    faults: bool = False
    libm: str = ""  # the function of libm whose last digit is its own


def _libm(name: str, arguments: str = "{0}") -> Primitive:
    return Primitive(f"py_libm({name}@({arguments}), {{0}}, fault)", helper="py_libm", faults=True, libm=name)


PRIMITIVES: dict[Callable[..., Any], Primitive] = {
    math.sqrt: Primitive("py_sqrt({0}, fault)", helper="py_sqrt", faults=True),
    math.fabs: Primitive("fabs@({0})"),
    math.copysign: Primitive("copysign@({0}, {1})"),
    math.floor: Primitive("py_whole(floor@({0}), fault)", gives=WHOLE, helper="py_whole", faults=True),
    math.ceil: Primitive("py_whole(ceil@({0}), fault)", gives=WHOLE, helper="py_whole", faults=True),
    math.trunc: Primitive("py_whole(trunc@({0}), fault)", gives=WHOLE, helper="py_whole", faults=True),
    math.isfinite: Primitive("(bool)isfinite({0})", gives=BOOL),
    math.isnan: Primitive("(bool)isnan({0})", gives=BOOL),
    math.isinf: Primitive("(bool)isinf({0})", gives=BOOL),
    math.atan2: Primitive("atan2@({0}, {1})", libm="atan2"),
    **{getattr(math, name): _libm(name) for name in (
        "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "exp", "expm1", "log", "log1p")},
}

SIGNS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*"}
OF_CONSTANTS: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
    ast.Mod: operator.mod, ast.FloorDiv: operator.floordiv, ast.Pow: operator.pow}
COMPARISONS = {ast.Lt: ("<", operator.lt), ast.LtE: ("<=", operator.le), ast.Gt: (">", operator.gt),
               ast.GtE: (">=", operator.ge), ast.Eq: ("==", operator.eq), ast.NotEq: ("!=", operator.ne)}

REFUSED: dict[Any, str] = {  # what has no line of C, and what to write instead
    sum: "`sum` compensates from Python 3.12 on, and C does not; write a + b + c",
    round: "`round` rounds by the decimal digits; write floor(x + 0.5)",
    pow: "`pow` is rounded otherwise from one libm to the next; write x * x",
    math.pow: "`pow` is rounded otherwise from one libm to the next; write x * x",
    math.hypot: "`hypot` is rounded otherwise in Python than in libm; write sqrt(x * x + y * y)",
    math.fsum: "`fsum` has no line in C; write a + b + c",
    math.fmod: "`fmod` has no line in C; write %",
    memory.ring: "a ring of messages has no line in C; keep a tuple in the state",
}
