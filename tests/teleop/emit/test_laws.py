"""Printed ends beside Python: every law, tame, wild and in float; and the guard with odd messages and clocks."""

from __future__ import annotations

import random
import re
import struct
import subprocess
from dataclasses import replace
from math import isfinite, nan
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from teleop import Cap, PositionPosition, Refused, Scene, VirtualWall, Watchdog, check_law, load_scene, messages, run
from teleop.emit import compiled as compiled_module
from teleop.emit.compiled import float_error, ran
from teleop.emit.files import FLAGS, files
from teleop.emit.types import FLOAT, Types
from teleop.emit.vectors import ReferenceEnd, run_vectors
from teleop.law import BUILT_IN, find_law
from teleop.protocol.guard import BLIND_NS, CAUSES, ForceGuard, HeldForce
from teleop.protocol.states import Cause, Reason
from teleop.simulation.tick import LiveTick
from tests.programs import COMPILERS, program
from tests.teleop.emit.printed import assert_same, compiled, differences


def scene_with(law: str, **knobs: Any) -> Scene:
    """The canonical scene with this law, or one with one port."""
    return load_scene("canonical" if hasattr(find_law(law), "slave") else "virtual_wall", law=law, **knobs)


ORDINARY = ("tdpa", "model_mediated", "wave_prediction", "virtual_wall")


@pytest.mark.parametrize("law", [pytest.param(each, marks=[pytest.mark.full] * (each not in ORDINARY))
                                 for each in BUILT_IN])
def test_a_law_printed_as_c_has_the_bits_of_python(law: str, tmp_path: Path) -> None:
    scene = scene_with(law)
    for e in "ms" if scene.slave is not None else "m":
        assert_same(scene, e, tmp_path / e)


@pytest.mark.full
@pytest.mark.parametrize("law", BUILT_IN)
def test_a_law_keeps_its_bits_for_a_hundred_thousand_ticks(law: str, tmp_path: Path) -> None:
    scene = scene_with(law)
    for e in "ms" if scene.slave is not None else "m":
        assert_same(scene, e, tmp_path / e, count=100_000, again=2000)


def test_check_law_compares_the_law_in_c(monkeypatch: pytest.MonkeyPatch) -> None:
    program(*COMPILERS)
    seen: list[str] = []

    def differing(built: Path, rows: object = None) -> str:
        seen.append(built.name)
        return f"tick 3: force[0] is 0x1p+0, in Python 0x1p+1 {rows}\n"

    check_law(VirtualWall(), c=True)
    monkeypatch.setattr(compiled_module, "differences", differing)
    with pytest.raises(ValueError, match="PositionPosition is another law in C, at the end m: tick 3: force"):
        check_law(PositionPosition(), compiled=False, c=True)
    assert set(seen) == {"check"}


@pytest.mark.parametrize("law", [pytest.param(each, marks=[pytest.mark.full] * (each != "wave_prediction"))
                                 for each in BUILT_IN])
def test_over_a_run_a_float_is_near_double_or_refused_and_double_has_every_bit(law: str, tmp_path: Path) -> None:
    program(*COMPILERS)
    scene = scene_with(law, duration=3)
    trace = run(scene).trace
    for e in "ms" if scene.slave is not None else "m":
        made = files(scene, e, e)
        rows = run_vectors(scene, e, made.tick)
        forces = [row[2 + rows.width] for row in rows.rows[1:]]
        assert forces == trace[f"f_{e}"].tolist(), "the rows are those of the run"
        assert differences(compiled(made, tmp_path / e), rows) == ""
        try:
            made = files(scene, e, e, real=FLOAT)
        except Refused:
            continue
        done = ran(compiled(made, tmp_path / f"{e}_float"), rows)
        off, greatest = map(float, re.findall(r"([\d.e+-]+) N", done.stdout))
        assert off <= 5e-6 * greatest, done.stdout
        assert off > 0.0, "it is in float"


def test_an_error_beyond_a_thousandth_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    program(*COMPILERS)
    assert re.fullmatch(r"Over a run of the canonical scene: .* by up to .* N, \de-0[67] of the greatest, [\d.]+ N\.",
                        float_error(scene_with("p_d", duration=3), "m"))
    real_number: Any = Types.real_number
    monkeypatch.setattr(Types, "real_number", lambda self, value: real_number(self, float(f"{value:.2g}") * 1.01))
    with pytest.raises(Refused, match="in float p_d is too far from double over the canonical scene"):
        float_error(scene_with("p_d", duration=3), "m")


def test_a_printed_float_says_how_far_it_is_off(tmp_path: Path) -> None:
    program(*COMPILERS)
    scene = load_scene("bench_top", law="pp")
    made = files(scene, "s", "s", real=FLOAT, off=lambda: "Off by 1e-06 N.")
    assert "prints how far the force is off. Off by 1e-06 N." in made.texts["README.md"]
    assert not re.search(r"\bdouble\b", made.texts["bench_top_s.c"]), "not even the guard is in double"
    assert differences(compiled(made, tmp_path)) == ""


DRIVER = """
#include "@name@.h"
#include <stdio.h>
int main(int words, char **word)
{
    static @p@end end; static @p@moment m; static @p@answer a;
    double r[8 + 3 * N + WIDTH], zero[N] = {0};
    FILE *file = fopen(word[words - 1], "rb");
    int i;
    while (fread(r, sizeof r, 1, file) == 1) {
        m.k = (uint32_t)(int64_t)r[1];
        m.ready = r[2] != 0.0;
        m.got = r[3] != 0.0;
        m.number = (uint32_t)(int64_t)r[4];
        m.unheard = r[5];
        m.over = r[6] != 0.0;
        for (i = 0; i < N; i++) { m.x[i] = r[8 + i]; m.v[i] = r[8 + N + i]; }
        for (i = 0; i < WIDTH; i++) ((double *)m.rx)[i] = r[8 + 3 * N + i];
        if (r[0] != 0.0) { @p@begin(&end, @p@of_scene(), m.k, m.x, m.v, zero, zero); continue; }
        @p@step(&end, @p@of_scene(), &m, &a);
        printf("%d %d %a", a.reason, a.send, end.guard.gain);
        for (i = 0; i < N; i++) printf(" %a", a.force[i]);
        printf("\\n");
    }
    return 0;
}
"""


class Moment(NamedTuple):
    """What is known at a tick."""

    begin: bool
    k: int
    ready: bool
    got: bool
    number: int
    unheard: float
    over: bool
    x: tuple[float, ...]
    v: tuple[float, ...]
    rx: tuple[Any, ...]


class Reference:
    """The end in Python, with the order of things that `Endpoint` has."""

    def __init__(self, scene: Scene, e: str) -> None:
        self.scene, self.e, self.end = scene, e, ReferenceEnd(scene, e, False)

    def begin(self, at: Moment) -> None:
        """A session begins."""
        self.guard = ForceGuard(self.scene.watchdog, self.scene.dt_ns / 1e9)
        self.guard.begin(at.k, "")
        self.held = HeldForce(self.scene, self.e, 1, self.guard)
        self.held.begin(at.k)
        self.k = self.ran = at.k - 1
        self.newest, self.failed = -1, False
        assert not self.end.begin(at.x, at.v, (0.0,) * len(at.x))

    def step(self, at: Moment) -> tuple[Any, ...]:
        """Reason, whether there is a message, gain and force."""
        guard, held, send = self.guard, self.held, False
        passed, self.k = at.k - self.k, at.k
        ready = at.ready and all(map(isfinite, (*at.x, *at.v)))
        if self.failed:
            held.over(None, passed)
        elif not ready:
            held.blind(at.k, self.ran, Reason(Cause.DEVICE, "no reading"))
        else:
            most = guard.timeout_ns / self.scene.dt_ns + 0.5
            got = at.got and at.number > self.newest and at.number - at.k <= most and all(
                isfinite(one) for each in at.rx for one in each)
            self.newest = at.number if got else self.newest
            gain = guard.step(at.k, got, over=Reason(Cause.SESSION_OVER, "over") if at.over else None,
                              unheard=at.unheard, age=at.k - at.number if got else 0)
            if guard.lapsed or guard.overdue:
                held.zero(at.k)
            answer = self.end.tick(LiveTick(at.k, at.x, at.v, None, got, float(self.newest), at.rx, None, gain,
                                            held.force, held.since(at.k), 0.0, 1.0))
            self.end.past = []
            self.ran = at.k
            self.failed = answer is None or not held.take(at.k, answer[0])
            send = answer is not None and all(isfinite(one) for each in answer[1] for one in each)
        if guard.overdue:
            held.force = (0.0,) * len(held.force)
        reason = len(CAUSES) if self.failed else -1 if guard.reason is None else CAUSES.index(guard.reason.cause)
        return reason, int(send), guard.gain, *held.force


def moments(scene: Scene, e: str, seed: int, count: int, *, start: int = 0, wild: float = 0.0) -> list[Moment]:
    """A run of an end: quiet for a while, then with everything that goes wrong."""
    dice, axes = random.Random(seed), range(scene.axes)
    kind: Any = messages(scene.laws[0], 1e-3)[e == "m"]
    k, x, sent, queue = start, [0.0 for _ in axes], start - 5, dict[int, int]()
    here = Moment(True, k, True, False, 0, 0.0, False, tuple(x), tuple(0.0 for _ in axes), ())
    made, silence, blind, over = [here], 0, 0, 0
    for _ in range(count):
        k += 1 if dice.random() < 0.98 else dice.choice((2, 5, 30, 300))
        v = tuple([0.2 * dice.gauss(0.0, 1.0) for _ in axes])
        x = [a + 1e-3 * b for a, b in zip(x, v, strict=True)]
        if dice.random() < 0.004:
            silence, blind, over = dice.choice(((150, 0, 0), (0, 20, 0), (0, 150, 0), (0, 0, 40), (30, 0, 0)))
        silence, blind, over = silence - 1, blind - 1, over - 1
        queue[k + dice.choice((1, 2, 3, 3000)) if dice.random() < 0.1 else k] = k - dice.choice((1, 3, 20))
        number = queue.pop(k, sent - dice.choice((0, 5)) if dice.random() < 0.5 else k - 2600)
        sent = max(sent, number)
        rx = tuple([kind(*[nan if dice.random() < wild else 0.05 * dice.gauss(0.0, 1.0) for _ in kind._fields])
                    for _ in axes])
        made.append(Moment(False, k, blind < 0, silence < 0 and dice.random() < 0.9, number,
                           dice.choice((0.0, 0.0, 0.3)) if dice.random() < 0.05 else 0.0, over >= 0,
                           tuple(x), tuple([nan if dice.random() < wild else each for each in v]), rx))
    return made


def in_c(scene: Scene, e: str, folder: Path, runs: list[Moment]) -> list[list[float]]:
    """What the printed end answers."""
    made = files(scene, e, e)
    name = next(each for each in made.texts if each.endswith(".h"))[:-2]
    width = next(len(each.rx) * len(each.rx[0]) for each in runs if each.rx)
    driver = DRIVER.replace("@name@", name).replace("@p@", f"{name}_")
    for file, text in {**made.texts, "drive.c": driver}.items():
        (folder / file).write_text(text)
    words = [program(*COMPILERS), *FLAGS.split(), "-Wno-unused-function", f"-DN={scene.axes}", f"-DWIDTH={width}",
             f"{name}.c", "drive.c", "-lm", "-o", "drive"]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[:3000]
    rows = [[float(each.begin), float(each.k % 2**32), float(each.ready), float(each.got), float(each.number % 2**32),
             each.unheard, float(each.over), 0.0, *each.x, *each.v, *(0.0,) * scene.axes,
             *([one for part in each.rx for one in part] or [0.0] * width)] for each in runs]
    (folder / "rows").write_bytes(b"".join([struct.pack(f"{len(row)}d", *row) for row in rows]))
    done = subprocess.run([program(folder / "drive"), str(folder / "rows")], capture_output=True, text=True, check=True)
    return [[float.fromhex(word) if "x" in word else float(word) for word in line.split()]
            for line in done.stdout.splitlines()]


CASES = {
    "bench": (lambda: load_scene("bench_top", law="pp"), "m"),
    "waves": (lambda: replace(load_scene("canonical"), watchdog=Watchdog(timeout=0.05, ramp=0.02, settle=0.03, age=1.0),
                              cap=Cap(f_max=10.0, slew=200.0)), "s"),
    "axes": (lambda: load_scene("bench_top", law="p_d", axes=3), "s"),
    "without": (lambda: replace(load_scene("canonical", law="pp"), watchdog=None, cap=None), "m"),
}


@pytest.mark.parametrize("case", [pytest.param(each, marks=[pytest.mark.full] * (each in ("axes", "without")))
                                  for each in CASES])
def test_a_printed_guard_lets_go_and_takes_up_as_that_of_python_does(case: str, tmp_path: Path) -> None:
    make, e = CASES[case]
    scene = make()
    runs = [*moments(scene, e, 1, 6000), *moments(scene, e, 2, 2000, start=2**32 - 1000),
            *moments(scene, e, 3, 1500, start=700, wild=0.002)]
    reference, expected = Reference(scene, e), []
    for each in runs:
        if each.begin:
            reference.begin(each)
        else:
            expected.append([*map(float, reference.step(each))])
    answers = in_c(scene, e, tmp_path, runs)
    assert len(answers) == len(expected)
    for n, (row, wanted) in enumerate(zip(answers, expected, strict=True)):
        assert row == wanted, (n, row, wanted)
    reasons = {int(row[0]) for row in answers}
    wanted = {-1, CAUSES.index(Cause.SILENCE), CAUSES.index(Cause.DEVICE), CAUSES.index(Cause.SESSION_OVER),
              CAUSES.index(Cause.NEW_SESSION)}
    assert reasons >= wanted
    assert BLIND_NS == 100_000_000


def test_without_a_clock_that_goes_on_there_is_no_force_for_long(tmp_path: Path) -> None:
    scene = replace(load_scene("canonical", law="pp"), watchdog=Watchdog(timeout=0.02, ramp=0.01, settle=0.01))
    kind: Any = messages(scene.laws[0], 1e-3)[1]
    first = Moment(True, 0, True, False, 0, 0.0, False, (0.0,), (0.0,), ())
    going = [Moment(False, k, True, True, k - 1, 0.0, False, (0.01,), (0.0,), (kind(0.0, 0.0),)) for k in range(1, 100)]
    still = [going[-1]._replace(k=k) for k in [99] * 30 + [50] * 10]
    rows = in_c(scene, "m", tmp_path, [first, *going, *still, *[each._replace(k=each.k + 100) for each in going]])
    assert abs(rows[98][3]) > 0.5
    assert [row[3] for row in rows[99:119]] == [rows[98][3]] * 20
    assert [(row[3], row[0]) for row in rows[120:139]] == [(0.0, float(CAUSES.index(Cause.CLOCK)))] * 19
    assert abs(rows[139][3]) < 0.1, "it comes back along the ramp"
