"""One table: what each engine makes of each structure, law and stage has the bits of a single run.

    tick     the loop that is made of the tick, beside the tick as it stands
    plain    a kernel in plain Python, beside single runs
    c        that kernel printed as C and compiled, beside the plain one
    alike    the same over lanes, for scenes side by side that share link and path
    apart    the same, each with a link and a path of its own
    stepped  two ends with their protocol, stepped in one process, beside a single run
    printed  each end printed as C and compiled, beside its generator, tame and wild (`teleop.emit`)

X: in the ordinary suite, f: with `-m full`, -: the engine refuses such a scene. Kernels are kept
in the user's cache folder, so each is compiled once.
"""

from __future__ import annotations

import re

import pytest

from teleop import Refused
from teleop.scene.library import built_in_scenes
from teleop.sweeps.kernels.kernel import NotVectorised
from tests.engines.cases import CASES
from tests.engines.engines import (
    assert_as_it_stands,
    assert_as_plain,
    assert_as_runs,
    assert_printed,
    assert_stepped,
    plain_rows,
    scenes_of,
)
from tests.programs import COMPILERS, program

TABLE = """
                                        tick  plain  c      alike  apart  stepped printed
waves by their integral                 X     X      X      f      X      X       f
waves of three axes                     f     f      f      f      f      f       f
waves, ticks left out                   X     f      X      f      f      -       f
waves, energy                           f     X      X      f      f      f       f
waves, energy, ticks left out           f     f      f      f      f      -       f
waves, fixed                            f     X      X      f      f      f       f
waves, fixed, ticks left out            f     f      f      f      f      -       f
waves, scaled, ticks left out           f     f      X      f      f      -       f
forces that diverge                     f     X      X      f      f      X       f
forces that diverge, constant delays    f     f      f      f      f      f       f
limits, devices and a watchdog          X     X      X      f      X      X       X
ticks left out                          X     X      X      X      f      -       f
a one-port                              X     X      X      X      X      -       f
a user's law, a clutch and gaps         X     X      X      f      X      X       X
a user's law in two axes                f     f      f      f      f      f       f
a policy                                X     X      X      -      -      X       X
a clutch of parts, scale and alignment  X     X      X      f      X      f       X
a policy in three axes, a clutch, skips f     f      f      -      -      -       f
a policy without actions                f     f      f      X      f      f       f
a policy, no motor at the leader        X     f      X      -      -      X       f
no actions and no motor                 f     f      f      f      f      f       f
a clutch and a small slew limit         f     f      f      f      f      f       f
a deadband                              X     X      X      f      f      -       f
stages around a law                     f     X      X      f      f      f       X
a coupling with branches                f     f      X      f      f      -       f
axes of their own                       X     X      f      f      f      X       f
a turned base                           f     X      X      f      X      X       f
a turned base of a pose                 X     f      f      f      f      f       X
eleven axes                             X     X      f      f      f      f       f
coupled axes without a link             X     X      X      f      f      f       f
rotations                               X     X      X      f      f      X       f
six axes                                f     f      f      f      f      f       f
position servos                         X     X      X      -      -      X       f
friction                                X     X      X      -      -      f       f
soft and relaxing bodies that move      X     X      X      -      -      f       f
relaxing, moved and none                f     f      X      -      -      f       f
windows of readings                     X     X      X      f      f      f       f
end fit, friction                       f     f      X      -      -      -       f
best fit, electrical damping            f     f      f      -      -      -       f
end fit of one reading                  f     f      f      f      f      -       f
levant                                  f     f      X      f      f      -       f
"""
HEAD, *LINES = TABLE.strip("\n").splitlines()
PLACES = {word.group(): word.start() for word in re.finditer(r"\S+", HEAD)}
CELLS = {(line[:40].strip(), engine): line[place:place + 1].strip()
         for line in LINES for engine, place in PLACES.items()}
COMPILED = ("canonical", "recorded_reach", "encoder_wall", "virtual_coupling", "jittery_wan")
CELLS |= {(name, engine): "f" for name in built_in_scenes() if name != "lte"
          for engine in ("tick", "plain", "c", "printed")}
CELLS |= {(name, "alike"): "f" for name in COMPILED} | {("beating_heart", "c"): "X"}  # a bound part
RUN = [pytest.param(name, engine, id=f"{engine}-{name.replace(' ', '_')}", marks=[pytest.mark.full] * (cell == "f"))
       for (name, engine), cell in CELLS.items() if cell in ("X", "f")]


def test_the_table_has_every_case() -> None:
    assert {name for name, _ in CELLS} == {*CASES}
    assert {*CELLS.values()} == {"X", "f", "-"}
    assert {engine for (_, engine), cell in CELLS.items() if cell == "X"} == {*PLACES}


@pytest.mark.parametrize(("name", "engine"), RUN)
def test_an_engine_gives_the_bits_of_a_single_run(name: str, engine: str) -> None:
    if engine in ("c", "alike", "apart"):
        program(*COMPILERS)
        assert_as_plain(name, engine)
    else:
        {"tick": assert_as_it_stands, "plain": assert_as_runs, "stepped": assert_stepped,
         "printed": assert_printed}[engine](name)


@pytest.mark.parametrize(("name", "engine"), [cell for cell, mark in CELLS.items() if mark == "-"])
def test_an_engine_refuses_what_it_cannot_run(name: str, engine: str) -> None:
    with pytest.raises(Refused if engine == "stepped" else NotVectorised):
        (assert_stepped(name) if engine == "stepped" else assert_as_plain(name, engine))


@pytest.mark.parametrize("name", [name for name, engine in CELLS if engine == "plain" and CELLS[name, engine] == "X"])
def test_scenes_of_a_case_differ(name: str) -> None:
    rows = plain_rows(name)
    assert len({repr(row) for row in rows}) == len(scenes_of(name)) > 1
    assert "ok" in {status for status, *_ in rows}
    if name in ("forces that diverge", "limits, devices and a watchdog"):
        assert "diverged" in {status for status, *_ in rows}
