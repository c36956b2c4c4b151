"""Ends printed as C: bytes of code and constants, and the processor's time of a tick beside that of Python.

`arm-none-eabi-gcc`, `gcc-arm-none-eabi` of Debian, is needed for the bytes on a Cortex alone: without it they are left
out. No test needs it.
"""

from __future__ import annotations

import shutil
import subprocess
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from teleop.emit.compiled import build
from teleop.emit.compiler import find_compiler
from teleop.emit.files import FLAGS, files
from teleop.emit.types import DOUBLE, FLOAT
from teleop.emit.vectors import DrawnInputs
from teleop.scene.loading import load_scene
from teleop.scene.scene import Scene
from teleop.simulation.source import live_of
from teleop.simulation.structure import numbers_of
from teleop.stages.device import Device
from teleop.stages.encoder import Encoder
from teleop.stages.force_cap import Cap
from teleop.stages.velocity.low_pass import LowPass
from teleop.stages.watchdog import Watchdog

Row = tuple[str, str, str]
TICKS = 500_000
ENDS: dict[str, Callable[[], Scene]] = {
    "hard_wall --end m": lambda: load_scene("hard_wall"),
    "hard_wall --end m --set playout=integral": lambda: load_scene("hard_wall", playout="integral"),
    "bench_top --end m --set law=pp": lambda: load_scene("bench_top", law="pp"),
    "bench_top --end m --set law=pp --float": lambda: load_scene("bench_top", law="pp"),
    "canonical --end s --set law=tdpa": lambda: load_scene("canonical", law="tdpa"),
    "pfra, --end m with encoder, estimator, delay and every limit": lambda: replace(
        load_scene("canonical", law="pfra"), watchdog=Watchdog(timeout=0.05),
        cap=Cap(f_max=10.0, slew=300.0, v_max=1.0, power=0.1),
        device_m=Device(encoder=Encoder(step=1e-4), velocity=LowPass(cutoff=20.0), every=3, delay=2)),
    "pose --end s": lambda: load_scene("pose"),
}
CORTEX = {"Cortex-M4": "-mcpu=cortex-m4 -mthumb -mfloat-abi=hard -mfpu=fpv4-sp-d16",
          "Cortex-M7": "-mcpu=cortex-m7 -mthumb -mfloat-abi=hard -mfpu=fpv5-d16"}
LOOP = """
#include "@name@.h"
#include <stdio.h>
#include <time.h>
int main(void)
{
    static @name@_state s;
    static @name@_in in;
    static @name@_out out;
    const @real@ zero[16] = {0};
    double sum = 0;
    clock_t began;
    int k;
    @name@_init(&s, @name@_of_scene(), zero, zero, zero);
    began = clock();
    for (k = 0; k < @ticks@; k++) {
@set@
        @name@_tick(&s, @name@_of_scene(), &in, &out);
        sum += out.force[0];
    }
    printf("%g %g\\n", (double)(clock() - began) / CLOCKS_PER_SEC * 1e9 / @ticks@, sum);
    return 0;
}
"""
SET = {"k": "in.k = k;", "x": "in.x[0] = 1e-6 * (k & 1023);", "v": "in.v[0] = 1e-3 * (k & 7);", "gain": "in.gain = 1;",
       "got": "in.got = true;", "since": "in.since = 1;", "present": "in.present = 1;", "scale": "in.scale = 1;"}


def emit(rounds: int) -> list[Row]:
    """Rows of (what, measured, asked): bytes with the guard, the tick without it, the least of `rounds`."""
    compiler = find_compiler()
    if compiler is None:
        return [("no C compiler: cc", "", "")]
    rows: list[Row] = []
    for what, make in ENDS.items():
        scene, e, real = make(), "s" if "--end s" in what else "m", FLOAT if "--float" in what else DOUBLE
        rows.append((what, "", ""))
        with TemporaryDirectory() as folder:
            made = files(scene, e, e, real=real)
            build(made, Path(folder), compiler)
            name = next(each for each in made.texts if each.endswith(".h"))[:-2]
            rows += [(f"  {core}", f"{count:,} B", "") for core, count in sizes(Path(folder), name, compiler)]
            lines = [f"        {text}" for field, text in SET.items() if field in made.tick.records["in"]]
            loop = LOOP
            for word, text in {"name": name, "ticks": TICKS, "set": "\n".join(lines), "real": real}.items():
                loop = loop.replace(f"@{word}@", str(text))
            (Path(folder) / "loop.c").write_text(loop)
            subprocess.run([compiler, *FLAGS.split(), "-O2", f"{name}.c", "loop.c", "-lm", "-o", "loop"], cwd=folder,
                           check=True)
            in_c = min(float(subprocess.run([Path(folder) / "loop"], capture_output=True, text=True, check=True)
                             .stdout.split()[0]) for _ in range(rounds))
        rows += [("  a tick in C, -O2", f"{in_c:.0f} ns", ""),
                 ("  in Python", f"{min(python_us(scene, e) for _ in range(rounds)):.1f} us", "")]
    return rows


def sizes(folder: Path, name: str, compiler: str) -> list[tuple[str, int]]:
    """Bytes of code and constants at -Os, for each compiler that is there."""
    cross, made = shutil.which("arm-none-eabi-gcc"), []
    for what, program, flags in [*[(core, cross, flags) for core, flags in CORTEX.items()], ("here", compiler, "")]:
        if program is not None:
            subprocess.run([program, *FLAGS.split(), "-Os", *flags.split(), "-c", f"{name}.c", "-o", "code.o"],
                           cwd=folder, check=True)
            size = "arm-none-eabi-size" if program is cross else "size"
            done = subprocess.run([size, "code.o"], cwd=folder, capture_output=True, text=True, check=True)
            made.append((f"{what}, -Os", sum(map(int, done.stdout.splitlines()[1].split()[:2]))))
    return made


def python_us(scene: Scene, e: str, ticks: int = 3000) -> float:
    """Microseconds of a tick of the end's generator."""
    hand = DrawnInputs(scene, e, 1, 0.0)
    x, v, touch = hand.start()
    end = live_of(scene, e)(numbers_of(scene, {e: x}), scene.law, scene.dt_ns / 1e9, x, v, touch)
    end.send(None)
    inputs = [hand.tick((0.0,) * scene.axes) for _ in range(ticks)]
    began = time.process_time()
    for each in inputs:
        end.send(each)
    return (time.process_time() - began) / ticks * 1e6
