"""What a row of a sweep costs a tick: the compiled kernels of the canonical scene beside a C program of the same scene.

The C program steps the bodies by semi-implicit Euler, one step a tick, and works out the same tracking error; it is
compiled here with -O3 and called in this process, in turn with ours, on the same packets. It plays zero in gaps;
over jitter and loss ours are timed so too, which is the comparison, and by the integral, the scene's own playout.
"""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from teleop.bench.kernels import kernel_of
from teleop.scene.loading import load_scene
from teleop.scene.scene import Scene

Row = tuple[str, str, str]
ROUGH = "delay(0.05) | uniform(0.02) | bernoulli(0.02)"
PROGRAM = r"""
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
/* p: dt b K B M_m b_m m_h k_h d_h M_s b_s k_e d_e wall; out: rms and greatest tracking error */
int row(const double *p, int64_t count, const int64_t *play_m, const int64_t *play_s, int64_t size, int64_t lag,
        const double *r, double *out) {
    double dt = p[0], b = p[1], K = p[2], B = p[3], m = p[4] + p[6], c = p[5] + p[8], kh = p[7], dh = p[8];
    double ms = p[9], bs = p[10], ke = p[11], de = p[12], at = p[13];
    double root = sqrt(2.0 * b), x_m = 0, v_m = 0, x_s = 0, v_s = 0, x_d = 0, w_m = 0, u_s = 0, sq = 0, top = 0;
    double *u = malloc(size * sizeof *u), *w = malloc(size * sizeof *w), *old = malloc((lag + 1) * sizeof *old);
    for (int64_t k = 0; k < count; k++) {
        int64_t s = play_m[k];
        w_m = s >= 0 ? w[s % size] : 0.0;
        s = play_s[k];
        u_s = s >= 0 ? u[s % size] : 0.0;
        double f_m = b * v_m - root * w_m;
        u[k % size] = root * v_m - w_m;
        double v_d = (root * u_s - K * (x_d - x_s) + B * v_s) / (b + B + K * dt);
        x_d += dt * v_d;
        double f_s = K * (x_d - x_s) + B * (v_d - v_s);
        w[k % size] = u_s - sqrt(2.0 / b) * f_s;
        old[k % (lag + 1)] = x_m;
        if (k >= lag) {
            double err = fabs(x_s - old[(k + 1) % (lag + 1)]);
            sq += err * err;
            if (err > top) top = err;
        }
        double slope = (r[k + 1] - r[k]) / dt;
        v_m += dt * (kh * (r[k] - x_m) + dh * slope - c * v_m - f_m) / m;
        x_m += dt * v_m;
        double deep = x_s - at, g = deep > 0 ? ke * deep + de * v_s : 0.0;
        if (g < 0) g = 0;
        v_s += dt * (f_s - bs * v_s - g) / ms;
        x_s += dt * v_s;
        if (!(fabs(x_m) < 1e6 && fabs(x_s) < 1e6)) break;
    }
    out[0] = sqrt(sq / (count - lag));
    out[1] = top;
    free(u); free(w); free(old);
    return 0;
}
"""


def sweep(rounds: int) -> list[Row]:
    """Rows of (what, measured, asked): nanoseconds a tick, the least of each round, medians over rounds of ratios."""
    from teleop.sweeps.kernels.compiled import need_numba

    need_numba("scalar")
    rows: list[Row] = []
    with TemporaryDirectory() as name:
        program = _program(Path(name))
        for what, link, ways in (("constant delay", None, CONSTANT), ("uniform jitter, 2 % loss", ROUGH, JITTER)):
            scene = _canonical(link)
            calls: dict[str, Callable[[], Any]] = {}
            first: dict[str, float] = {}
            for way in ways:
                began = time.perf_counter()
                calls[way.name] = way.ready(link)
                calls[way.name]()
                first.setdefault(way.engine, time.perf_counter() - began)
            rows += [(f"{engine}, first call of the structure, or from the cache", f"{took:.2f} s", "asked: at most 8")
                     for engine, took in first.items() if link is None]
            theirs = _theirs(program, scene) if program else None
            spent: dict[str, list[float]] = {way.name: [] for way in ways}
            in_c: list[float] = []
            for _ in range(4 * rounds):
                in_c.append(_seconds(theirs) / scene.ticks * 1e9 if theirs else float("nan"))
                for way in ways:
                    spent[way.name].append(_seconds(calls[way.name]) / scene.ticks / way.rows * 1e9)
            if theirs:
                rows.append((f"{what}: C, semi-implicit Euler", f"{median(in_c):.1f} ns a tick", ""))
            for way in ways:
                rows.append((f"{what}: {way.name}", f"{median(spent[way.name]):.1f} ns a tick", ""))
                if theirs:
                    ratio = median(a / b for a, b in zip(spent[way.name], in_c, strict=True))
                    rows.append(("  over C", f"{ratio:.2f} times", f"asked: at most {way.asked}" if way.asked else
                                 "C plays zero"))
    return rows


class Way(NamedTuple):
    """One way to run the rows."""

    name: str
    engine: str
    asked: float | None  # None: C does something else
    rows: int
    energy: bool = False  # the ledgers too, which the C program has not
    own: bool = False  # a seed for each row
    playout: str | None = None  # None: the scene's own

    def ready(self, link: str | None) -> Callable[[], Any]:
        """The rows of this way, to be run."""
        knobs = {} if self.playout is None else {"playout": self.playout}
        scenes = [_canonical(link, energy=self.energy, k_e=5000.0 + 10.0 * n, **knobs) for n in range(self.rows)]
        return kernel_of(self.engine, scenes, [1 + n if self.own else 1 for n in range(self.rows)])


CONSTANT = (Way("scalar", "scalar", 1.8, 1), Way("scalar with ledgers", "scalar", 1.8, 1, energy=True),
            Way("vector", "vector", 1.0, 8), Way("vector with ledgers", "vector", 1.0, 8, energy=True))
JITTER = tuple(Way(f"{name}, playout {playout}", engine, asked, rows, own=own, playout=playout)
               for playout, asked in (("zero", 1.8), ("integral", None))
               for name, engine, rows, own in (("scalar", "scalar", 1, False),
                                               ("vector, one schedule for eight rows", "vector", 8, False),
                                               ("vector, a schedule for each row", "vector", 8, True)))


def _canonical(link: str | None, *, energy: bool = False, k_e: float = 5000.0, **knobs: object) -> Scene:
    return load_scene("canonical", energy=energy, k_e=k_e, **({} if link is None else {"link": link}), **knobs)


def _seconds(call: Callable[[], Any]) -> float:
    best = float("inf")
    for _ in range(5):
        began = time.perf_counter()
        call()
        best = min(best, time.perf_counter() - began)
    return best


def _theirs(program: Any, scene: Scene) -> Callable[[], Any]:
    """The same row by the C program."""
    import numpy as np

    from teleop.simulation.bodies import reference_samples
    from teleop.simulation.plan import link_plans
    from teleop.sweeps.kernels.kernel import LinkSchedule

    law, hand, wall, slave = scene.law, scene.hand, scene.environments[0], scene.slave
    assert hand is not None
    assert slave is not None
    own: Any = wall
    parts = np.array([scene.dt, law.b, law.K, law.B, scene.master.mass, scene.master.damping, hand.mass, hand.k, hand.d,
                      slave.mass, slave.damping, own.k, own.d, own.at])
    schedule = LinkSchedule.of(link_plans(scene, 1))
    play = [schedule.plays[1], schedule.plays[0]]
    path, = reference_samples(scene) or ()
    r, out = np.asarray(path), np.zeros(2)
    kept = parts, *play, r, out  # the pointers below do not keep them

    def pointer(array: Any) -> ctypes.c_void_p:
        return ctypes.c_void_p(array.ctypes.data)

    arguments = (pointer(parts), ctypes.c_int64(scene.ticks), pointer(play[0]), pointer(play[1]),
                 ctypes.c_int64(schedule.size), ctypes.c_int64(schedule.lags[0]), pointer(r),
                 pointer(out))
    return lambda: (program.row(*arguments), kept)


def _program(folder: Path) -> Any:
    """The C program, if there is a compiler."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        return None
    (folder / "row.c").write_text(PROGRAM)
    flags = ["-O3", "-march=native", "-shared", "-fPIC"]
    subprocess.run([compiler, *flags, "-o", folder / "row.so", folder / "row.c", "-lm"], check=True)
    return ctypes.CDLL(str(folder / "row.so"))
