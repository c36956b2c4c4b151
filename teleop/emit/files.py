"""The files of a printed end: header, code, a check against Python, and how to call it."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import NamedTuple

from teleop.emit.guard import Guard, with_guard
from teleop.emit.primitives import FAULTS
from teleop.emit.ticks import WHAT, PrintedTick, printed_tick, record_line
from teleop.emit.types import BOOL, DOUBLE, FLOAT, NOTHING, NotPrinted
from teleop.emit.vectors import Vectors, vectors
from teleop.emit.wire import wire_header
from teleop.kind import totals
from teleop.law import law_name, messages
from teleop.protocol.guard import UNNAMED
from teleop.scene.playout import Fixed
from teleop.scene.scene import Scene
from teleop.simulation.structure import structure_of

FLAGS = "-std=c99 -ffp-contract=off -Wall -Wextra -Werror -pedantic"
TICKS = 500  # in check.c


class Files(NamedTuple):
    """The files by name, and what a summary says of them."""

    texts: dict[str, str]
    tick: PrintedTick
    vectors: Vectors


def files(scene: Scene, e: str, end: str, *, sensor: bool | None = None, real: str = DOUBLE,
          off: Callable[[], str] | None = None) -> Files:
    """Print the files of an end. Raises `NotPrinted` before any of them is there.

    `real`: double, or float; `off`: the sentence of a float's page on how far its force is off.
    """
    if real == FLOAT and (sums := grows(scene, e)):
        raise NotPrinted(f"scene {scene.name}, end {end}, adds to {' and '.join(sums)} as long as a session lasts, and "
                         "a float soon rounds away what is added; leave --float out")
    name = f"{re.sub(r'[^a-z0-9]+', '_', scene.name.lower()).strip('_')}_{end}"
    tick, guard = with_guard(scene, printed_tick(scene, e, f"{name}_", sensor=sensor, real=real))
    rows = vectors(scene, e, tick, count=TICKS, sensor=sensor)
    texts = {f"{name}.h": header(scene, end, name, tick, guard), f"{name}.c": code(scene, end, name, tick, guard),
             "check.c": check(name, tick, rows), "README.md": page(scene, end, name, tick, off)}
    if scene.slave is not None:
        texts[f"{name}_wire.h"] = wire_header(scene, e, name, title(scene, end))
    return Files(texts, tick, rows)


def grows(scene: Scene, e: str) -> list[str]:
    """Sums in what an end knows, which only grow during a session."""
    structure = structure_of(scene)
    both = messages(scene.laws[0], scene.dt_ns / 1e9) if scene.slave is not None else ()
    made = sorted({f"{name} of its law's messages" for each in both for name in totals(each)})
    return made + ["the integrals of its waves"] * structure.has.integral + ["the numbers of its messages"] * getattr(
        structure, e).has.age


HEAD = """\
/* {title}. Printed by `teleop emit`: do not edit. SI units.

   A tick that returns other than 0 leaves the state as it was, and its outputs are not for use: let the force go. */
#ifndef {upper}_H
#define {upper}_H
#include <float.h>
#include <math.h>
#include <stdbool.h>
#include <stdint.h>

#if defined(__FAST_MATH__)
#error "compile without -ffast-math: this end has the bits of Python's, and those need IEEE arithmetic"
#elif defined(__FP_FAST_FMA) && defined(__GNUC__) && !defined(__clang__) && !defined(__STRICT_ANSI__) \\
    && !defined(TELEOP_NO_CONTRACTION)
#error "compile with -std=c99 -ffp-contract=off: a fused multiply-add rounds otherwise than Python"
#elif defined(FLT_EVAL_METHOD) && FLT_EVAL_METHOD > 0
#error "compile for arithmetic without excess precision, as with -mfpmath=sse"
#endif
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#endif
#ifdef __cplusplus
extern "C" {{
#endif

enum {{ /* faults, where Python raises: bits of what `init` and `tick` return */
{faults}
}};

{records}
/* The numbers of the scene. */
const {prefix}params *{prefix}of_scene(void);

/* The end before its first tick: x0 (m), v0 (m/s) and the external force touch0 (N), one number an axis. 0, or faults.
*/
{init};

/* One tick. 0, or faults. */
{step};
{guard}#ifdef __cplusplus
}}
#endif
#endif
"""


def header(scene: Scene, end: str, name: str, tick: PrintedTick, guard: Guard) -> str:
    """NAME_e.h."""
    prefix = tick.prefix
    faults = ",\n".join([f"    {prefix.upper()}{word} = {1 << i} /* {what} */"
                         for i, (word, what) in enumerate(FAULTS.items())])
    heads = re.findall(r"^unsigned [^{]*\)$", tick.text, re.M)
    return HEAD.format(title=title(scene, end), upper=name.upper(), faults=faults, records=records(tick),
                       prefix=prefix, init=heads[0], step=heads[1],
                       guard=guard.header)


def records(tick: PrintedTick) -> str:
    """The types of the parameters, the state, the inputs and the outputs."""
    types = tick.program.types
    of_records = [kind for members in tick.records.values() for kind in members.values()]
    text = [types.declarations([*of_records, *tick.public])]
    for name, members in tick.records.items():
        lines = [record_line(types, word, kind, "" if name == "state" else WHAT.get(word, ""))
                 for word, kind in members.items() if kind != NOTHING]
        if name == "out":
            lines[-1] = lines[-1].rstrip("*/ ") + ": " + ", ".join(tick.columns) + " */"
        text.append("\n".join(["typedef struct {", *(lines or ["    char nothing;"]), f"}} {tick.prefix}{name};", ""]))
    return "\n".join(text)


def title(scene: Scene, end: str) -> str:
    """Scene, end, law, axes and tick in one line."""
    axes = "1 axis" if scene.axes == 1 else f"{scene.axes} axes"
    return f"{scene.name}, end {end}: law {law_name(scene.laws[0])}, {axes}, tick {scene.dt_ns / 1e6:g} ms"


def code(scene: Scene, end: str, name: str, tick: PrintedTick, guard: Guard) -> str:
    """NAME_e.c."""
    return (f"/* {title(scene, end)}. Printed by `teleop emit`: do not edit.\n   A number behind a line is that of the "
            f"Python line that it was printed from. */\n#include \"{name}.h\"\n\n"
            f"static const {tick.prefix}params scene_numbers = {tick.numbers};\n\n"
            f"const {tick.prefix}params *{tick.prefix}of_scene(void) {{ return &scene_numbers; }}\n\n"
            f"{tick.program.types.declarations(known=records(tick))}\n{tick.program.text(tick.text + guard.text)}\n"
            f"{tick.text}{guard.text}")


CHECK = """\
/* Ticks of {name} beside those of Python: {how}. Printed by `teleop emit`.

   cc {flags} {name}.c check.c -lm -o check && ./check */
#include "{name}.h"
#include <stdio.h>

enum {{ INPUTS = {inputs}, ANSWERS = {answers}, WIDTH = 2 + INPUTS + ANSWERS, ROWS = {rows}, AXES = {axes} }};
static const char *const names[ANSWERS] = {{{names}}};

{differ}

static void fill({prefix}in *in, const double *r)
{{
{fill}
}}

static void take(const {prefix}out *out, double *r)
{{
{take}
}}

static int wrong(const double *row, long n)
{{
    static {prefix}state state;
    static {prefix}in in;
    static {prefix}out out;
    double answer[ANSWERS];
    unsigned fault;
    int i, bad = 0;
    if (row[0] == 0.0) {{
        {real} start[3][AXES];
        for (i = 0; i < 3 * AXES; i++) start[i / AXES][i % AXES] = ({real})row[2 + i];
        fault = {prefix}init(&state, {prefix}of_scene(), start[0], start[1], start[2]);
    }} else {{
        fill(&in, row + 2);
        fault = {prefix}tick(&state, {prefix}of_scene(), &in, &out);
    }}
    if ((fault != 0) != (row[1] != 0.0)) {{
        printf("tick %ld: faults %u, and Python %s\\n", n, fault, row[1] != 0.0 ? "raised" : "did not raise");
        return 1;
    }}
    if (row[0] == 0.0 || fault) return 0;
    take(&out, answer);
    for (i = 0; i < ANSWERS; i++)
        if (differ(i, answer[i], row[2 + INPUTS + i])) {{
            if (++bad <= 3) printf("tick %ld: %s is %a, in Python %a\\n", n, names[i], answer[i], row[2 + INPUTS + i]);
        }}
    return bad > 0;
}}

{vectors}
int main(int words, char **word)
{{
    long n = 0, bad = 0;
    if (words > 1) {{ /* a file of such rows, as doubles of this machine */
        static double row[WIDTH];
        FILE *file = fopen(word[1], "rb");
        if (!file) {{ perror(word[1]); return 2; }}
        while (fread(row, sizeof row, 1, file) == 1 && bad < 10) bad += wrong(row, n++);
        fclose(file);
    }} else
        for (; n < ROWS && bad < 10; n++) bad += wrong(vectors[n], n);
    {verdict}
}}
"""

EVERY_BIT = (
    "prints what differs and returns 1",
    """static int differ(int i, double a, double b)
{
    (void)i;
    return a == b ? !signbit(a) != !signbit(b) : a == a || b == b;
}""",
    """printf(bad ? "%ld of %ld ticks differ\\n" : "%ld of %ld ticks differ: all bits are those of Python\\n", bad, n);
    return bad > 0;""")
WITHIN = (
    "prints how far its force is off in float, and returns 1 if that is more than a thousandth of the greatest",
    """static double off, greatest; /* N: the greatest difference of a force from that of double, the greatest force */

static int differ(int i, double a, double b)
{
    if (i < AXES) {
        off = fmax(off, fabs(a - b));
        greatest = fmax(greatest, fabs(b));
    }
    return !isfinite(a);
}""",
    """printf("%ld of %ld ticks fail; the force is off by up to %.2g N, %.1g of the greatest, %.3g N\\n", bad, n, off,
        greatest > 0 ? off / greatest : 0, greatest);
    return bad > 0 || !(off <= 0.001 * greatest);""")


def check(name: str, tick: PrintedTick, rows: Vectors) -> str:
    """check.c: the rows as hex floats, and what compares them."""
    def number(value: float) -> str:
        return tick.program.types.literal(value, "double") if value - value != 0.0 else (
            "0" if value == 0.0 and str(value)[0] != "-" else value.hex())

    body = ",\n".join(["    {" + ", ".join(map(number, row)) + "}" for row in rows.rows])
    c = tick.program.types.c
    fill = [f"    {place} = r[{i}] != 0.0;" if kind == BOOL else f"    {place} = ({c(kind)})r[{i}];"
            for i, (place, kind) in enumerate(rows.inputs)]
    take = [f"    r[{i}] = (double){place};" for i, (place, kind) in enumerate(rows.answers)]
    names = [f'"{tick.columns[int(place[9:-1])] if place.startswith("out->row") else place[5:]}"'
             for place, _ in rows.answers]
    how, differ, verdict = WITHIN if tick.program.types.real == FLOAT else EVERY_BIT
    return CHECK.format(
        how=how, differ=differ, verdict=verdict,
        name=name, flags=FLAGS, prefix=tick.prefix, real=c("double"), inputs=rows.width, answers=len(rows.answers),
        rows=len(rows.rows), axes=tick.axes, names=", ".join(names), fill="\n".join(fill), take="\n".join(take),
        vectors=f"static const double vectors[ROWS][WIDTH] = {{\n{body}\n}};\n")


PAGE = """\
# {title}

Printed by `teleop emit`: the tick of this end as C99, without malloc and without a library beyond `<math.h>`.

```sh
cc {flags} -O2 {name}.c check.c -lm -o check && ./check
```

`check.c` compares {ticks} ticks with those of Python, {compared}

At every tick of a clock, whether or not a message has come:

```c
#include "{name}.h"
static {prefix}end end;
{prefix}params params = *{prefix}of_scene();       /* the numbers of the scene, yours to change */
{prefix}begin(&end, &params, k, x, v, f, origin);  /* a session: where the device is, m, m/s, N */
moment.k = k; moment.x[0] = ...; moment.got = ...; /* what is known at this tick: see the header */
{prefix}step(&end, &params, &moment, &answer);     /* answer.force[i] is for the motor, N */
```

`step` is the tick within the guard: no force before messages have come for {settle:g} s, and the ramp to zero
({ramp:g} s) {timeout:g} s after the last one, at readings that are not finite, after ticks that were missed, with a
clock that stands, or a law that fails. `answer.reason` says why (`{upper}SILENCE`, ...).
Of messages give {playing}, with the number of the tick at which it was sent; old, repeated and NaN ones are none.

What you still owe:

- **the motor's own lapse:** it lets go by itself where `step` is not called in time; tell how many ticks that takes by
  `params.guard.lapses`. No line of this runs in a processor that hangs;
- **a deadline:** each tick within its {dt:g} ms, by a timer, not by a loop that runs as it can;
- **true readings**, in m, m/s and N, with the sign that `teleop check device` tries;
- **the network:** packets, session and keys, as in scenarios/examples/c, and `moment.unheard` of its echoes.

`init` and `tick` are the law and its stages without the guard: for tests, and not for a motor. A fault says that Python
would have raised: {faults}. The state is then as it was.
"""


BITS = """every bit.
{libm}
With `-ffast-math`, or with fused multiply-adds, which gcc makes without `-std=c99` or `-ffp-contract=off`, they are
others: the header refuses what it can see of that."""
IN_FLOAT = """which are in double where these are in float, and
prints how far the force is off. {off}"""


def page(scene: Scene, end: str, name: str, tick: PrintedTick, off: Callable[[], str] | None) -> str:
    """README.md."""
    libm = ("It needs nothing of libm but what is exact (sqrt, fabs, floor), so they are the same everywhere."
            if not tick.program.libm else
            f"It calls {', '.join(sorted(tick.program.libm))} of libm: the last digit of these is that of your libm.")
    dog, played = scene.watchdog or UNNAMED, scene.played_as
    ago = f"that of {played.ticks(scene.dt_ns)} ticks ago" if isinstance(played, Fixed) else "the newest that has come"
    compared = BITS.format(libm=libm) if off is None else IN_FLOAT.format(off=off())
    return PAGE.format(title=title(scene, end), flags=FLAGS, name=name, prefix=tick.prefix, ticks=TICKS,
                       compared=compared,
                       faults=", ".join(FAULTS.values()), upper=tick.prefix.upper(), settle=dog.settle, ramp=dog.ramp,
                       timeout=dog.timeout, dt=scene.dt_ns / 1e6, playing=ago)
