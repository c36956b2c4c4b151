"""The engines of a sweep on a law: each gives the figures of a single run, to the bit.

The compiled engines are tried where numba is installed. A law that cannot be compiled, or not over lanes, makes no
mistake: it runs by the next plainer engine, and a sweep says so.
"""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec
from itertools import islice
from typing import Any

from teleop.checks.trials import spread, trials
from teleop.errors import Refused
from teleop.simulation.plan import link_plans
from teleop.simulation.prepared import prepare
from teleop.simulation.virtual import run
from teleop.sweeps.engine import ENGINES, kernel_of
from teleop.sweeps.kernels.kernel import Inputs, LinkSchedule, available, figures, tree_of
from teleop.sweeps.shared import path_of

FIRST = 9  # trials from there on have a link that varies
ROWS = 3
MEASURES = frozenset((  # all that a law does shows in these; more of them take longer to compile
    "x_err_rms", "f_err_rms", "f_m_max", "f_s_max", "E_link_end", "E_port_min", "E_port_end", "E_law_min", "E_law_end"))
LASTS = 0.1  # s


def try_engines(law: Any, *, compiled: bool) -> None:
    """Raise `Refused` if an engine gives a figure of a run another bit. `compiled`: try the compiled ones too."""
    name = type(law).__name__
    engines = ENGINES if compiled and find_spec("numba") is not None else ENGINES[:1]
    drawn = islice(trials(law, spread(name)), FIRST, None)
    scenes = [replace(scene, axes=1, observer=200.0, playout=None, duration=LASTS) for scene in islice(drawn, ROWS)]
    runs = [run(scene) for scene in scenes]
    measures = tuple(sorted(MEASURES & available(scenes[0])))
    for engine in engines:
        kernel, _ = kernel_of(prepare(scenes[0]), measures, engine)
        rows = []
        for scene in scenes:
            prepared, schedule = prepare(scene), LinkSchedule.of(link_plans(scene, 0))
            _, flat = kernel_of(prepared, measures, engine)
            plain = kernel.engine == "plain"
            numbers = tree_of(scene, prepared.bodies, compiled=False) if plain else None
            rows.append(Inputs(numbers, flat, scene.ticks, schedule, path_of(scene, compiled=not plain)))
        for one, (status, _, got) in zip(runs, figures(kernel, rows), strict=True):
            for measure in measures:
                if status != "diverged" and got.get(measure) != one.metrics.get(measure):
                    raise Refused(f"{name} gives {measure} = {got.get(measure)!r} by the engine {kernel.engine}, and "
                                  f"{one.metrics.get(measure)!r} in a single run; let a method depend on its arguments "
                                  "alone, and write x*x for x**2")
