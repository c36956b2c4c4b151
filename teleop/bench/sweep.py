"""The cost of a sweep: kernels beside C, whole rows from a thousand to a million, rows of a user's own law.

`sweep`: the compiled kernels of the canonical scene beside a C program of the same scene. The C program steps the
bodies by semi-implicit Euler, one step a tick, and works out the same tracking error. It is compiled here with -O3 and
called in this process, in turn with ours, on the same packets. It plays zero in gaps; over jitter and loss ours are
timed so too, which is the comparison, and by the integral, the scene's own playout.

`scale`: whole sweeps, with all that a row costs beside its kernel: scene, coefficients, schedule, its line in the
table. That part is a row's time in a sweep less the kernel's, both measured in turn in this process.

`own_laws`: the law of a plug-in and of a user's file over a built-in one. All three are the lines of
`teleop.laws.wave`: the built-in law itself, a copy in a package with an entry point, and a copy in a file. The rows are
so short that most of their time goes into preparing each of them, the look-up of the law included.
"""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import invalidate_caches
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from teleop.bench.laws import MEASURES, kernel_of, seconds
from teleop.scene.library import ROOT
from teleop.scene.loading import load_scene
from teleop.scene.scene import Scene
from teleop.simulation.bodies import reference_samples
from teleop.simulation.plan import link_plans
from teleop.sweeps.engine import need_compiler
from teleop.sweeps.grid import grid
from teleop.sweeps.runner import sweep as run_sweep

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
    need_compiler("c")
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
                    rows.append(("  over C", f"{ratio:.2f} times", f"asked: at most {way.bound}" if way.bound else
                                 "C plays zero"))
    return rows


class KernelRun(NamedTuple):
    """Rows with an engine, a schedule and a playout, to be timed."""

    name: str
    engine: str
    bound: float | None  # None: C does something else
    rows: int
    energy: bool = False  # the ledgers too, which the C program has not
    apart: bool = False  # a seed for each row
    playout: str | None = None  # None: the scene's own

    def ready(self, link: str | None) -> Callable[[], Any]:
        """The rows of this way, to be run."""
        knobs = {} if self.playout is None else {"playout": self.playout}
        scenes = [_canonical(link, energy=self.energy, k_e=5000.0 + 10.0 * n, **knobs) for n in range(self.rows)]
        return kernel_of(self.engine, scenes, [1 + n if self.apart else 1 for n in range(self.rows)])


CONSTANT = (KernelRun("c", "c", 1.8, 1), KernelRun("c with ledgers", "c", 1.8, 1, energy=True),
            KernelRun("vector", "vector", 1.0, 8), KernelRun("vector with ledgers", "vector", 1.0, 8, energy=True))
JITTER = tuple(KernelRun(f"{name}, playout {playout}", engine, bound, rows, apart=apart, playout=playout)
               for playout, bound in (("zero", 1.8), ("integral", None))
               for name, engine, rows, apart in (("c", "c", 1, False),
                                                 ("vector, one schedule for eight rows", "vector", 8, False),
                                                 ("vector, a schedule for each row", "vector", 8, True)))


def _canonical(link: str | None, *, energy: bool = False, k_e: float = 5000.0, **knobs: object) -> Scene:
    return load_scene("canonical", energy=energy, k_e=k_e, **({} if link is None else {"link": link}), **knobs)


def _seconds(call: Callable[[], Any]) -> float:
    return min(wall_seconds(call) for _ in range(5))


def _theirs(program: Any, scene: Scene) -> Callable[[], Any]:
    """The same row by the C program."""
    from teleop.sweeps.kernels.kernel import LinkSchedule

    law, hand, wall, slave = scene.law, scene.hand, scene.environments[0], scene.slave
    assert hand is not None
    assert slave is not None
    contact: Any = wall
    parts = np.array([scene.dt, law.b, law.K, law.B, scene.master.mass, scene.master.damping, hand.mass, hand.k, hand.d,
                      slave.mass, slave.damping, contact.k, contact.d, contact.at])
    schedule = LinkSchedule.of(link_plans(scene, 1))
    play = [schedule.plays[1], schedule.plays[0]]
    path, = reference_samples(scene) or ()
    r, out = np.asarray(path), np.zeros(2)
    buffers = parts, *play, r, out  # the pointers below do not keep them

    def pointer(array: Any) -> ctypes.c_void_p:
        return ctypes.c_void_p(array.ctypes.data)

    arguments = (pointer(parts), ctypes.c_int64(scene.ticks), pointer(play[0]), pointer(play[1]),
                 ctypes.c_int64(schedule.size), ctypes.c_int64(schedule.lags[0]), pointer(r),
                 pointer(out))
    return lambda: (program.row(*arguments), buffers)


def _program(folder: Path) -> Any:
    """The C program, if there is a compiler."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        return None
    (folder / "row.c").write_text(PROGRAM)
    flags = ["-O3", "-march=native", "-shared", "-fPIC"]
    subprocess.run([compiler, *flags, "-o", folder / "row.so", folder / "row.c", "-lm"], check=True)
    return ctypes.CDLL(str(folder / "row.so"))


FEW, MANY = 1_000, 100_000
SHARED = 30_000  # rows for one thread and for two
MILLION = """
import resource
from teleop.bench.sweep import million
rows = million()
print(rows, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


def scale(rounds: int) -> list[Row]:
    """Rows of (what, measured, asked)."""
    need_compiler("vector")
    ticks = load_scene("canonical").ticks
    rows: list[Row] = []
    for engine in ("c", "vector"):
        _sweep_seconds(engine, 16, 1)  # compiles
        kernel = kernel_of(engine, [load_scene("canonical", k_e=k_e) for k_e in _stiffnesses(FEW)], [0] * FEW)
        few, many, ratios, gains, alone = [], [], [], [], []
        for _ in range(rounds):
            few.append(_sweep_seconds(engine, FEW, 1) / FEW)
            alone.append(wall_seconds(kernel) / FEW)
            gains.append(_sweep_seconds(engine, SHARED, 1) / _sweep_seconds(engine, SHARED, 2))
        for _ in range(max(1, rounds // 3)):
            many.append(_sweep_seconds(engine, MANY, 1) / MANY)
            ratios.append(many[-1] / median(few))
        rows += [
            *[(f"{engine}, canonical, a row of {count:,}", f"{median(each) * 1e6:.0f} us",
               f"{median(each) / ticks * 1e9:.1f} ns a tick") for count, each in ((FEW, few), (MANY, many))],
            ("  beside its kernel", f"{median(a - b for a, b in zip(few, alone, strict=True)) * 1e6:.0f} us",
             f"kernel {median(alone) * 1e6:.0f} us; asked: at most 60"),
            ("  over that of few", f"{median(ratios):.2f} times", "asked: at most 1.15"),
            (f"{engine}, two threads over one", f"{median(gains):.2f} times", "asked: at least 1.8"),
        ]
    done = subprocess.run([sys.executable, "-c", MILLION], cwd=ROOT, capture_output=True, text=True, check=True)
    count, memory = map(int, done.stdout.split())
    rows.append((f"{count:,} rows of 20 ticks", f"{memory / 1e6:.2f} GB", "asked: at most 1"))
    return rows


def _sweep_seconds(engine: str, rows: int, threads: int) -> float:
    """Seconds for a sweep of the canonical scene over the wall's stiffness."""
    points = grid({"k_e": _stiffnesses(rows)})
    return wall_seconds(lambda: run_sweep("canonical", points, metrics=MEASURES, engine=engine, workers=threads))


def _stiffnesses(count: int) -> list[float]:
    """So many values of the wall's stiffness, N/m."""
    return [2500.0 + 5000.0 * n / count for n in range(count)]


def wall_seconds(call: Callable[[], object]) -> float:
    """Time of a call, s."""
    began = time.perf_counter()
    call()
    return time.perf_counter() - began


def million() -> int:
    """A sweep of a million short rows over two knobs and seeds."""
    points = grid({"k_e": [1000.0 + n for n in range(1000)], "d_e": [0.1 * n for n in range(100)]}, 10)
    return len(run_sweep("canonical", points, metrics=MEASURES, engine="vector", fixed={"duration": 0.02}))


SHORT_ROWS = {"plain": 300, "vector": 3000}
SHORT_TICKS = 50
OWN_LAW_BOUND = "asked: at most 1.1"


def own_laws(rounds: int) -> list[Row]:
    """Rows of (what, measured, asked)."""
    rows: list[Row] = []
    with TemporaryDirectory() as folder, _copies(Path(folder)) as (plug_in, file):
        names = {"built in": "wave", "of a plug-in": plug_in, "of a file": file}
        for engine, count in SHORT_ROWS.items():
            if engine != "plain":
                need_compiler(engine)
            for law in names.values():
                _short_rows_seconds(engine, law, 8)  # compiles
            spent: dict[str, list[float]] = {name: [] for name in names}
            for _ in range(rounds):
                for name, law in names.items():  # in turn
                    spent[name].append(_short_rows_seconds(engine, law, count) / count)
            rows += _over_built_in(engine, spent)
    return rows


def _over_built_in(engine: str, spent: dict[str, list[float]]) -> list[Row]:
    best = {name: min(each) for name, each in spent.items()}  # what else the machine does only adds to them
    built_in = best.pop("built in")
    rows: list[Row] = [(f"{engine}, a row of {SHORT_TICKS} ticks, law built in", f"{built_in * 1e6:.0f} us", "")]
    return rows + [(f"  law {name}, over it", f"{each / built_in:.2f} times", OWN_LAW_BOUND)
                   for name, each in best.items()]


def _short_rows_seconds(engine: str, law: str, rows: int) -> float:
    """Processor time (s) of a sweep of soft tissue over its stiffness."""
    return seconds(lambda: run_sweep("soft_tissue", {"law": [law], "k_e": [100.0 + n for n in range(rows)]},
                                     engine=engine, workers=1, fixed={"duration": 1e-3 * SHORT_TICKS}))


@contextmanager
def _copies(folder: Path) -> Iterator[tuple[str, str]]:
    """The law's lines in a package that is found by its entry point, and in a file: what each is named in a sweep."""
    source = (ROOT / "teleop" / "laws" / "wave.py").read_text(encoding="utf-8")
    (folder / "bench_waves.py").write_text(source, encoding="utf-8")
    (folder / "waves_of_a_file.py").write_text(source, encoding="utf-8")
    info = folder / "bench_waves-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: bench-waves\nVersion: 1.0\n", encoding="utf-8")
    (info / "entry_points.txt").write_text("[teleop.laws]\nbench_waves = bench_waves:Wave\n", encoding="utf-8")
    sys.path.append(str(folder))
    invalidate_caches()
    try:
        yield "bench_waves", f"{folder / 'waves_of_a_file.py'}:Wave"
    finally:
        sys.path.remove(str(folder))
