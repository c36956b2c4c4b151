"""What a row of a sweep costs a tick: the compiled kernel of the canonical scene beside a C program of the same scene.

The C program steps the bodies by semi-implicit Euler, one step a tick, and works out the same tracking error; it is
compiled here with -O3 and called in this process, in turn with ours, on the same packets.
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
from typing import Any

from teleop.scene import Scene, load_scene

Row = tuple[str, str, str]
MEASURES = ("x_err_rms", "x_err_max")
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
    from teleop.batch.compiled import need_numba

    need_numba("scalar")
    rows: list[Row] = []
    with TemporaryDirectory() as name:
        program = _program(Path(name))
        for what, link, asked in (("constant delay", None, "asked: at most 1.8"),
                                  ("uniform jitter, 2 % loss", ROUGH, "asked: at most 1.8 of its own scene in C")):
            scene = load_scene("canonical", **({} if link is None else {"link": link}))
            ours, first = _ours(scene)
            theirs = _theirs(program, scene) if program else None
            times: dict[str, list[float]] = {"ours": [], "theirs": []}
            for _ in range(4 * rounds):
                times["ours"].append(_seconds(ours))
                if theirs:
                    times["theirs"].append(_seconds(theirs))
            each = {one: [t / scene.ticks * 1e9 for t in several] for one, several in times.items()}
            rows.append((f"canonical, {what}, scalar engine, a tick", f"{median(each['ours']):.1f} ns", ""))
            rows.append(("  first call of the structure, or from the cache", f"{first:.2f} s", "asked: 8, or 1"))
            if theirs:
                ratio = median(a / b for a, b in zip(each["ours"], each["theirs"], strict=True))
                beside = f"  over C, semi-implicit Euler ({median(each['theirs']):.1f} ns)"
                rows.append((beside, f"{ratio:.2f} times", asked))
    return rows


def _seconds(call: Callable[[], Any]) -> float:
    best = float("inf")
    for _ in range(5):
        began = time.perf_counter()
        call()
        best = min(best, time.perf_counter() - began)
    return best


def _ours(scene: Scene) -> tuple[Callable[[], Any], float]:
    """One row by the compiled kernel, and how long the first call took."""
    import numpy as np

    from teleop.batch.compiled import scalar
    from teleop.batch.kernel import Water, numbers
    from teleop.bodies import exact_bodies, reference_samples
    from teleop.lockstep import link_plans

    water, bodies = Water.of(link_plans(scene, 1)), exact_bodies(scene)
    path = tuple([np.asarray(axis) for axis in reference_samples(scene) or ()])
    began = time.perf_counter()
    kernel = scalar(scene, bodies, MEASURES)
    given = numbers(kernel, scene, bodies, path, water)
    sizes = [lag + 1 for lag in water.lags]
    kernel.loop(*given, *sizes)
    took = time.perf_counter() - began
    return lambda: kernel.loop(*given, *sizes), took


def _theirs(program: Any, scene: Scene) -> Callable[[], Any]:
    """The same row by the C program."""
    import numpy as np

    from teleop.batch.kernel import Water
    from teleop.bodies import reference_samples
    from teleop.lockstep import link_plans

    law, hand, wall, slave = scene.law, scene.hand, scene.environments[0], scene.slave
    assert hand is not None
    assert slave is not None
    own: Any = wall
    parts = np.array([scene.dt, law.b, law.K, law.B, scene.master.mass, scene.master.damping, hand.mass, hand.k, hand.d,
                      slave.mass, slave.damping, own.k, own.d, own.at])
    water = Water.of(link_plans(scene, 1))
    play = [water.plays[1], water.plays[0]]
    path, = reference_samples(scene) or ()
    r, out = np.asarray(path), np.zeros(2)
    kept = parts, *play, r, out  # the pointers below do not keep them

    def pointer(array: Any) -> ctypes.c_void_p:
        return ctypes.c_void_p(array.ctypes.data)

    arguments = (pointer(parts), ctypes.c_int64(scene.ticks), pointer(play[0]), pointer(play[1]),
                 ctypes.c_int64(water.size), ctypes.c_int64(water.lags[0]), pointer(r),
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
