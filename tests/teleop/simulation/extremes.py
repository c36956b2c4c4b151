"""The extreme matrix: its rows, the scene that each of them is, and what comes of running it.

A row is a point of a Latin hypercube over the knobs, most of them in the logarithm, or has two of them pinned at a
corner of their ranges: every corner of every pair of knobs is there. Runs are short; a stiff scene needs no more.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from itertools import combinations, product
from typing import Any, NamedTuple

import numpy as np
import pytest

from channel.bernoulli import Bernoulli
from channel.blackout import Blackout
from channel.delay import Delay
from channel.duplicate import Duplicate
from channel.gamma import GammaJitter
from channel.gilbert_elliott import GilbertElliott
from channel.in_order import InOrder
from channel.link import Link
from channel.normal import NormalJitter
from channel.uniform import UniformJitter
from master.hand import Grip, Reach, Rest, Sine
from slave import Tissue, Wall
from teleop import PFRA, Cap, Direct, Fixed, Hold, MassDamper, Result, Scene, Watchdog, Wave, Zero, run
from teleop.simulation import source
from teleop.terminal.run_table import table

TICKS, SPREAD, SEED = 240, 320, 5


class Range(NamedTuple):
    """A knob from `low` to `high`, evenly in the logarithm; every tenth is exactly 0 where that is allowed."""

    low: float
    high: float
    zero: bool = False

    def at(self, u: float) -> float:
        """The value at u in [0, 1]; 0 and 1 are the ends."""
        if self.zero:
            if u < 0.1:
                return 0.0
            u = (u - 0.1) / 0.9
        return float(np.clip(self.low * (self.high / self.low) ** u, self.low, self.high))


RANGES = {
    "k_e": Range(1e1, 1e9), "d_e": Range(1e-3, 1e5, zero=True),  # N/m, N s/m
    "M_m": Range(1e-4, 1e3), "b_m": Range(1e-3, 1e5, zero=True),  # kg, N s/m
    "M_s": Range(1e-4, 1e3), "b_s": Range(1e-3, 1e5, zero=True),
    "b": Range(1e-6, 1e6), "K": Range(1e1, 1e9, zero=True), "B": Range(1e-3, 1e5, zero=True),
    "delay": Range(1e-5, 10.0, zero=True), "loss": Range(1e-3, 1.0, zero=True),  # s, 1
    "jitter": Range(0.1, 100.0, zero=True), "dt": Range(1e-5, 0.1),  # ticks, s
}
LAWS = ("wave", "wave", "pfra", "direct")
CHOICES: dict[str, tuple[Any, ...]] = {
    "law": LAWS, "alpha": (0.0, 0.0, 0.3, 1.0), "kf": (1.0, 0.0, 1e3), "observer": (200.0, None, 1e6),
    "axes": (1, 1, 3), "side": (1.0, -1.0), "at": (0.0, 0.01, -0.01),
    "environment": ("wall", "wall", "tissue", "free"), "beside": ("wall", "free"),
    "hand": (True, True, True, False), "m_h": (0.0, 0.4), "k_h": (200.0, 0.0, 1e5), "d_h": (5.0, 0.0, 1e3),
    "reference": ("sine", "reach", "rest"), "amplitude": (0.05, 0.0, 1.0),
    "start": (0.0, -0.005, 0.001),  # depth in the wall, m
    "jitter of": (UniformJitter, NormalJitter, GammaJitter), "loss in": ("bernoulli", "bursts"),
    "link": ("plain", "plain", "in order", "copies", "one way", "blackout", "constant", "none"),
    "playout": (Zero, Zero, Hold, Fixed), "gaps": (Zero, Zero, Hold),
    "watchdog": (None, None, 0.0, 10.0), "cap": (None, None, 20.0, 1e6), "slew": (None, 2e3),
    "x_limit": (1e6, 1e6, 1e2, 1e300),  # the last lets numbers grow until they overflow
}


def rows() -> list[dict[str, Any]]:
    """The matrix: for each row a value of every knob, and which of them were pinned at a corner."""
    matrix = []
    for i, row in enumerate(hypercube(RANGES, CHOICES, combinations(RANGES, 2), SPREAD)):
        pinned = row["pinned"]
        if "b" in pinned:
            row["law"] = "wave"
        if "delay" not in pinned and i % 3:  # else most messages would come after the end
            row["delay"] = min(row["delay"], 0.25 * TICKS * row["dt"])
        matrix.append(row)
    return matrix


def hypercube(
    ranges: dict[str, Range], choices: dict[str, tuple[Any, ...]], pairs: Iterable[tuple[str, str]], spread: int
) -> list[dict[str, Any]]:
    """`spread` rows with nothing pinned, then one for each of the four corners of each of the pairs of ranges."""
    from scipy.stats import qmc

    corners = list(product((0.0, 1.0), repeat=2))
    pins: list[dict[str, float]] = [{}] * spread
    pins += [dict(zip(pair, ends, strict=True)) for pair in pairs for ends in corners]
    cube = qmc.LatinHypercube(len(ranges) + len(choices), seed=SEED).random(len(pins)).tolist()
    found = []
    for point, pinned in zip(cube, pins, strict=True):
        row: dict[str, Any] = {
            name: r.at(pinned.get(name, u)) for (name, r), u in zip(ranges.items(), point, strict=False)}
        row |= {name: c[int(u * len(c))] for (name, c), u in zip(choices.items(), point[len(ranges):], strict=True)}
        found.append({**row, "pinned": pinned})
    return found


def scene_of(row: dict[str, Any], mirror: float = 1.0) -> Scene:
    """The scene of a row, or its mirror image: every position the other way round."""
    dt = round(row["dt"] * 1e9) / 1e9
    span, side, at = TICKS * dt, mirror * row["side"], mirror * row["at"]
    start = at + side * row["start"]
    coupling = {"K": row["K"], "B": row["B"]}
    law = {
        "wave": Wave(b=row["b"], **coupling), "pfra": PFRA(alpha=row["alpha"], kf=row["kf"], **coupling),
        "direct": Direct(kf=row["kf"], **coupling),
    }[row["law"]]
    wall, tissue = Wall(k=row["k_e"], d=row["d_e"], at=at, side=side), Tissue(k=row["k_e"], d=row["d_e"], at=at)
    touch = {"wall": wall, "tissue": tissue, "free": None}
    three = row["axes"] == 3
    environment = (touch[row["environment"]], touch[row["beside"]], tissue) if three else touch[row["environment"]]
    to = (side * row["amplitude"], mirror * 0.02, mirror * -0.03) if three else side * row["amplitude"]
    reference = {
        "sine": Sine(amplitude=to, frequency=2.0 / span), "reach": Reach(to=to, duration=span / 3), "rest": Rest(at=to),
    }[row["reference"]]
    hand = Grip(mass=row["m_h"], k=row["k_h"], d=row["d_h"], reference=reference) if row["hand"] else None
    return Scene(
        law=law, hand=hand, environment=environment, axes=row["axes"], dt=dt, duration=span, energy=True,
        master=MassDamper(mass=row["M_m"], damping=row["b_m"]), start_m=start,
        slave=MassDamper(mass=row["M_s"], damping=row["b_s"]), start_s=start, x_limit=row["x_limit"],
        link=link_of(row, dt), playout=playout_of(row, dt), observer=row["observer"],
        watchdog=None if row["watchdog"] is None else Watchdog(timeout=20 * dt, ramp=row["watchdog"] * dt),
        cap=None if row["cap"] is None else Cap(f_max=row["cap"], slew=row["slew"]),
    )


def link_of(row: dict[str, Any], dt: float) -> Any:
    """The water of a row."""
    jitter = row["jitter"] * dt
    knobs = {UniformJitter: (jitter,), NormalJitter: (jitter, 0.5 * jitter), GammaJitter: (jitter, 0.5)}
    loss = {"bernoulli": Bernoulli(row["loss"]), "bursts": GilbertElliott(row["loss"], 0.1)}[row["loss in"]]
    constant = Delay(row["delay"])
    plain = constant | row["jitter of"](*knobs[row["jitter of"]]) | loss
    return {
        "plain": plain, "in order": plain | InOrder(), "copies": Duplicate(0.3, after=2 * dt) | plain,
        "one way": Link(constant, plain), "blackout": plain | Blackout(40 * dt, 40 * dt), "constant": constant,
        "none": None,
    }[row["link"]]


def playout_of(row: dict[str, Any], dt: float) -> Any:
    """The playout of a row; a fixed one waits for most of the jitter."""
    if row["playout"] is not Fixed:
        return row["playout"]()
    return Fixed(row["delay"] + (row["jitter"] + 1.0) * dt, gaps=row["gaps"]())


@dataclass(frozen=True, kw_only=True)
class Case:
    """A row of the matrix and what came of it: a result, or the trouble that kept it from one."""

    seed: int
    row: dict[str, Any]
    scene: Scene
    result: Result | None
    trouble: str = ""

    def __str__(self) -> str:
        return f"row {self.seed} {self.row}: {self.result.sentence if self.result else self.trouble}"

    def axes(self, *names: str) -> list[np.ndarray]:
        """Columns of the trace with the axes as the second dimension, whether there are several or not."""
        assert self.result
        return [self.result.trace[name].reshape(self.result.ticks, -1) for name in names]


def tried(seed: int, row: dict[str, Any], scene: Scene | None = None) -> Case:
    """Run a row, or another scene made of it; a warning is trouble as much as an exception."""
    scene = scene or scene_of(row)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            result = run(scene, seed=seed)
            json.dumps(result.summary(), allow_nan=False, default=str)
            table(result)
        except Exception as error:  # whatever it is, it is to be seen beside its row
            return Case(seed=seed, row=row, scene=scene, result=None, trouble=repr(error))
    return Case(seed=seed, row=row, scene=scene, result=result)


@contextmanager
def lines_kept() -> Iterator[None]:
    """The lines of every structure are written once: a matrix has more structures than a process keeps otherwise."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(source, "lines", cache(source.lines.__wrapped__))
        yield


def failing(cases: list[Case], holds: Callable[[Case], bool]) -> list[str]:
    """The cases for which it does not hold, the first few of them, as text."""
    with np.errstate(all="ignore"):
        return [str(case) for case in cases if not holds(case)][:3]
