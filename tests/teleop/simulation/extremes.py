"""The extreme matrices: their rows, the scene that each of them is, and what comes of running it.

A row is a point of a Latin hypercube over the knobs of a family, most of them in the logarithm, or has two of them
pinned at a corner of their ranges: every corner of every pair of knobs is there. *Ends* are two ends over a link.
*Plants* are two ends whose slave rubs, or meets Hunt-Crossley bodies, relaxing tissue or what moves by itself.
*Displays* are a handle, its device and a one-port law. Runs are short; a stiff scene needs no more, and one that is
integrated may take a thousand sub-steps in each tick.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Iterator, Set
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from itertools import combinations, product
from typing import Any, ClassVar, NamedTuple

import numpy as np
import pytest

from channel import Bernoulli, Blackout, Delay, Duplicate, GilbertElliott, InOrder, Link, NormalJitter, UniformJitter
from channel.gamma import GammaJitter
from master.hand import Grip, Reach, Rest, Sine
from slave import HuntCrossley, Moving, StandardLinearSolid, Tissue, Wall
from teleop import PFRA, At, Cap, Device, Direct, Encoder, Fixed, Hold, Result, Scene, Watchdog, Wave, Zero, run
from teleop.laws.virtual_coupling import VirtualCoupling
from teleop.laws.virtual_wall import VirtualWall
from teleop.physics.plant import MassDamper
from teleop.physics.relaxing import ElectricalDamping
from teleop.simulation import source
from teleop.stages.passivity_controller import PassivityController
from teleop.stages.velocity.adaptive_window import BestFit, EndFit
from teleop.stages.velocity.backward_difference import BackwardDifference
from teleop.stages.velocity.levant import Levant
from teleop.stages.velocity.low_pass import LowPass
from teleop.terminal.run_table import table

TICKS, DEVICE_TICKS, INTEGRATED, SEED = 240, 120, 24, 5
EPS = float(np.finfo(float).eps)


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


class Family(NamedTuple):
    """The knobs of one family; all four corners of each of the `pairs` of ranges are in the matrix."""

    ranges: dict[str, Range]
    choices: dict[str, tuple[Any, ...]]
    pairs: list[tuple[str, str]]
    spread: int  # rows with nothing pinned


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


DEVICES = {  # at either end
    "velocity": ("none", "none", "difference", "low pass", "levant", "end fit", "best fit"),
    "phase": (0.5, 0.5, 0.0, 1.0), "every": (1, 1, 2, 7), "late": (0, 0, 1, 9), "f_max": (None, 20.0, 1e-3, 1e6),
    "x_limit": (1e6, 1e2, 1e300),
    "hand": (True, True, False), "m_h": (0.0, 0.4), "k_h": (200.0, 0.0, 1e5), "d_h": (5.0, 0.0, 1e3),
    "reference": ("sine", "reach", "rest"), "amplitude": (0.05, 0.0, 1.0), "axes": (1, 1, 1, 3),
    "at": (0.0, 0.01, -0.01), "start": (0.0, -0.005, 0.001),  # m; the second is a depth
    "passivity": (None, None, 0.0, 0.01),  # m/s, the controller's v_min
}
CORE = ("k_e", "d_e", "M_s", "f_s", "M_m", "f_m", "beat", "tolerance", "dt", "b")
PLANTS = Family(
    ranges={
        "k_e": Range(1e1, 1e9), "d_e": Range(1e-3, 1e5, zero=True), "k1": Range(1e1, 1e9, zero=True),
        "tau": Range(1e-7, 1e4), "lam": Range(1e-3, 1e3, zero=True), "beat": Range(1e-6, 1.0, zero=True),
        "M_s": Range(1e-4, 1e3), "b_s": Range(1e-3, 1e5, zero=True), "f_s": Range(1e-3, 1e3, zero=True),
        "M_m": Range(1e-4, 1e3), "b_m": Range(1e-3, 1e5, zero=True), "f_m": Range(1e-3, 1e3, zero=True),
        "b": Range(1e-6, 1e6), "K": Range(1e1, 1e9, zero=True), "B": Range(1e-3, 1e5, zero=True),
        "step": Range(1e-15, 1.0, zero=True), "gain": Range(1e-6, 1e6), "pc": Range(1e-3, 1e6, zero=True),
        "b_e": Range(1e-3, 1e5, zero=True), "cutoff": Range(1e-3, 1e6),
        "tolerance": Range(1e-15, 1e-3), "dt": Range(1e-5, 0.1),
    },
    choices={
        **DEVICES, "law": ("wave", "wave", "pfra", "direct", "nothing"), "observer": (200.0, None),
        "environment": ("hunt crossley", "hunt crossley", "wall", "tissue", "relaxing", "free"), "side": (1.0, -1.0),
        "n": (1.5, 1.0, 2.0, 10.0),
        "electrical": (False, True), "link": ("delay", "rough", "none"), "playout": (Zero, Zero, Hold),
        "beats": (0.5, 3.0, 30.0),  # in a run
    },
    pairs=[*combinations(CORE, 2), *combinations(("k_e", "k1", "tau", "M_s"), 2), ("tau", "dt"), ("k1", "dt"),
           ("lam", "k_e"), ("lam", "M_s"), ("lam", "f_s"), ("lam", "dt"), ("lam", "tolerance"), ("step", "dt")],
    spread=60,
)
DISPLAYS = Family(
    ranges={
        "K": Range(1e1, 1e9, zero=True), "B": Range(1e-3, 1e5, zero=True), "M_m": Range(1e-4, 1e3),
        "b_m": Range(1e-3, 1e5, zero=True), "f_m": Range(1e-3, 1e3, zero=True), "step": Range(1e-15, 1.0, zero=True),
        "gain": Range(1e-6, 1e6), "pc": Range(1e-3, 1e6, zero=True), "b_e": Range(1e-3, 1e5, zero=True),
        "cutoff": Range(1e-3, 1e6), "m_t": Range(1e-6, 1e3, zero=True), "b_t": Range(1e-3, 1e5, zero=True),
        "k_t": Range(1e1, 1e9, zero=True), "d_t": Range(1e-3, 1e5, zero=True),  # the tool and its wall
        "tolerance": Range(1e-15, 1e-3), "dt": Range(1e-5, 0.1),
    },
    choices={**DEVICES, "law": ("wall", "coupling"), "theta_f": (1.0, 0.5, 0.0), "theta_x": (1.0, 0.5, 0.0),
             "electrical": (False, True)},
    pairs=[*combinations(("K", "B", "M_m", "f_m", "step", "dt", "pc"), 2), ("b_m", "K"), ("b_m", "dt"), ("b_m", "M_m"),
           ("b_e", "cutoff"), ("b_e", "M_m"), ("b_e", "dt"), ("cutoff", "dt"), ("cutoff", "M_m"), ("gain", "step"),
           ("gain", "dt"), ("m_t", "K"), ("m_t", "k_t"), ("m_t", "d_t"), ("k_t", "K"), ("k_t", "dt"), ("b_t", "m_t")],
    spread=60,
)
ENDS = Family(RANGES, CHOICES, [*combinations(RANGES, 2)], 320)
FAMILIES = {"ends": ENDS, "plants": PLANTS, "displays": DISPLAYS}


def rows(*families: str) -> list[dict[str, Any]]:
    """The matrix of these families: for each row a value of every knob, and which of them were pinned at a corner."""
    return [fitted({**row, "family": name}, i) for name in families for i, row in enumerate(hypercube(FAMILIES[name]))]


def hypercube(family: Family) -> list[dict[str, Any]]:
    """Rows with nothing pinned, then one for each of the four corners of each of the pairs of ranges."""
    from scipy.stats import qmc

    corners = list(product((0.0, 1.0), repeat=2))
    pins: list[dict[str, float]] = [{}] * family.spread
    pins += [dict(zip(pair, ends, strict=True)) for pair in family.pairs for ends in corners]
    ranges, choices = family.ranges, family.choices
    cube = qmc.LatinHypercube(len(ranges) + len(choices), seed=SEED).random(len(pins)).tolist()
    found = []
    for point, pinned in zip(cube, pins, strict=True):
        row: dict[str, Any] = {
            name: r.at(pinned.get(name, u)) for (name, r), u in zip(ranges.items(), point, strict=False)}
        row |= {name: c[int(u * len(c))] for (name, c), u in zip(choices.items(), point[len(ranges):], strict=True)}
        found.append({**row, "pinned": pinned})
    return found


def fitted(row: dict[str, Any], i: int) -> dict[str, Any]:
    """The row with those choices that its pinned knobs ask for, and without what does not go together."""
    pinned = row["pinned"].keys()
    if row["family"] == "ends":
        if "delay" not in pinned and i % 3:  # else most messages would come after the end
            row["delay"] = min(row["delay"], 0.25 * TICKS * row["dt"])
        return {**row, "law": "wave"} if "b" in pinned else row
    if "f_m" in pinned:
        row["electrical"] = False
    if pinned & {"b_e", "cutoff"}:
        row["electrical"] = True
    if row["electrical"]:
        row["f_m"] = 0.0  # friction beside electrical damping is refused
    if "gain" in pinned and row["velocity"] in ("none", "difference"):
        row["velocity"] = "levant"
    if "pc" in pinned and row["passivity"] is None:
        row["passivity"] = 0.0
    if row["family"] == "displays":
        row["law"] = "coupling" if pinned & {"m_t", "b_t", "k_t", "d_t"} else row["law"]
        return row
    row["environment"] = environment_for(row, pinned)
    if row["environment"] == "relaxing":
        row["f_s"] = 0.0  # friction beside tissue that relaxes is refused
    if "b" in pinned:
        row["law"] = "wave"
    return row


def environment_for(row: dict[str, Any], pinned: Set[str]) -> str:
    """The environment that the pinned knobs are knobs of."""
    if pinned & {"k1", "tau"}:
        return "relaxing"
    if "lam" in pinned:
        return "hunt crossley"
    if "d_e" in pinned:
        return "tissue" if row["environment"] == "tissue" else "wall"
    known: str = row["environment"]
    useless = ("f_s" in pinned and known == "relaxing") or ("k_e" in pinned and known == "free")
    return "hunt crossley" if useless else known


def ticks_of(row: dict[str, Any]) -> int:
    """How many ticks the row is run for."""
    if row["family"] == "ends":
        return TICKS
    dear = row.get("f_s", 0.0) > 0.0 or row["f_m"] > 0.0 or row.get("environment") == "hunt crossley"
    return INTEGRATED if dear else DEVICE_TICKS


@dataclass(frozen=True, kw_only=True)
class Turned:
    """The mirror image of a one-port law: what it renders lies on the other side."""

    law: Any
    claims: ClassVar[dict[str, str]] = {}

    def start(self, at: At) -> Any:
        return self.law.start(At(-at.x, -at.v, at.f, at.f_held, at.dx, at.fresh, at.age, at.dt, at.span))

    def force(self, s: Any, at: At) -> tuple[float, Any]:
        f, s = self.law.force(s, At(-at.x, -at.v, 0.0, 0.0, 0.0, False, 0.0, at.dt, at.span))
        return -f, s


def scene_of(row: dict[str, Any], mirror: float = 1.0) -> Scene:
    """The scene of a row, or its mirror image: every position the other way round."""
    return (scene_of_ends if row["family"] == "ends" else scene_of_bodies)(row, mirror)


def scene_of_ends(row: dict[str, Any], mirror: float) -> Scene:
    """Scene of two ends over a link."""
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


def scene_of_bodies(row: dict[str, Any], mirror: float) -> Scene:
    """Scene of a plant or a display."""
    dt, ticks = round(row["dt"] * 1e9) / 1e9, ticks_of(row)
    span = ticks * dt
    side = mirror * row.get("side", 1.0)
    start = mirror * row["at"] + side * row["start"]
    to: Any = side * row["amplitude"]
    if row["axes"] == 3:
        to, start = (to, mirror * 0.02, mirror * -0.03), (start, 0.0, mirror * 0.01)
    reference = {
        "sine": Sine(amplitude=to, frequency=2.0 / span), "reach": Reach(to=to, duration=span / 3), "rest": Rest(at=to),
    }[row["reference"]]
    scene = {
        "hand": Grip(mass=row["m_h"], k=row["k_h"], d=row["d_h"], reference=reference) if row["hand"] else None,
        "master": MassDamper(mass=row["M_m"], damping=row["b_m"], friction=row["f_m"]), "start_m": start,
        "electrical": ElectricalDamping(b=row["b_e"], cutoff=row["cutoff"]) if row["electrical"] else None,
        "passivity": None if row["passivity"] is None else PassivityController(cap=row["pc"], v_min=row["passivity"]),
        "cap": None if row["f_max"] is None else Cap(f_max=row["f_max"]), "device_m": device_of(row),
        "axes": row["axes"], "dt": dt, "duration": span, "energy": True, "x_limit": row["x_limit"],
        "tolerance": row["tolerance"],
    }
    if row["family"] == "displays":
        return Scene(law=display_of(row, mirror), **scene)
    coupling = {"K": row["K"], "B": row["B"]}
    law = {"wave": Wave(b=row["b"], **coupling), "pfra": PFRA(alpha=0.3, **coupling), "direct": Direct(**coupling),
           "nothing": Direct(K=0.0, B=0.0)}[row["law"]]
    environment = environment_of(row, mirror, dt * ticks)
    water = {"delay": Delay(3 * dt), "rough": Delay(dt) | UniformJitter(3 * dt) | Bernoulli(0.2), "none": None}
    return Scene(
        law=law, slave=MassDamper(mass=row["M_s"], damping=row["b_s"], friction=row["f_s"]), start_s=start,
        environment=(environment, Tissue(k=row["k_e"], d=row["d_e"]), None) if row["axes"] == 3 else environment,
        link=water[row["link"]], playout=row["playout"](), observer=row["observer"], device_s=device_of(row), **scene,
    )


def display_of(row: dict[str, Any], mirror: float) -> Any:
    """The one-port law of a row. A tool without mass has a velocity only where something damps it."""
    if row["law"] == "wall":
        law: Any = VirtualWall(K=row["K"], B=row["B"], at=row["at"])
    else:
        held = row["theta_f"] * (row["B"] + row["b_t"] + row["K"] * row["theta_x"])
        law = VirtualCoupling(
            K=row["K"], B=row["B"], mass=row["m_t"] if held else row["m_t"] or 1e-6, damping=row["b_t"], at=row["at"],
            k_e=row["k_t"], d_e=row["d_t"], theta_f=row["theta_f"], theta_x=row["theta_x"])
    return law if mirror > 0.0 else Turned(law=law)


def environment_of(row: dict[str, Any], mirror: float, span: float) -> Any:
    """What the slave of a row meets, carried along a path if it beats."""
    k, at, side = row["k_e"], mirror * row["at"], mirror * row["side"]
    still = {
        "wall": Wall(k=k, d=row["d_e"], at=at, side=side), "tissue": Tissue(k=k, d=row["d_e"], at=at), "free": None,
        "hunt crossley": HuntCrossley(k=k, n=row["n"], lam=row["lam"], at=at, side=side),
        "relaxing": StandardLinearSolid(k=k, k1=row["k1"], tau=row["tau"], at=at),
    }[row["environment"]]
    if still is None or row["beat"] == 0.0:
        return still
    rate = min(row["beats"] / span, 0.4 / row["dt"])
    return Moving(environment=still, path=Sine(amplitude=side * row["beat"], frequency=rate))


def device_of(row: dict[str, Any]) -> Device:
    """What stands between an end and its law."""
    noise = row["step"] or row["gain"]
    estimator = {
        "none": None, "difference": BackwardDifference(), "low pass": LowPass(cutoff=row["gain"]),
        "levant": Levant(L=row["gain"]), "end fit": EndFit(noise=noise), "best fit": BestFit(noise=noise),
    }[row["velocity"]]
    encoder = Encoder(step=row["step"], phase=row["phase"]) if row["step"] else None
    return Device(encoder=encoder, velocity=estimator, every=row["every"], delay=row["late"])


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

    @property
    def device(self) -> Device:
        """Device between the master and its law."""
        return self.scene.device_m or Device()

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


def made(families: tuple[str, ...], stride: int) -> list[Case]:
    """The rows of a matrix, run."""
    with lines_kept():
        return [tried(seed, row) for seed, row in list(enumerate(rows(*families)))[::stride]]


def failing(cases: list[Case], holds: Callable[[Case], bool]) -> list[str]:
    """The cases for which it does not hold, the first few of them, as text."""
    with np.errstate(all="ignore"):
        return [str(case) for case in cases if not holds(case)][:3]


def balance(scene: Scene, one: Any, error: Any, x: np.ndarray, v: np.ndarray, f: np.ndarray, f_env: np.ndarray
            ) -> tuple[np.ndarray, np.ndarray]:
    """Energy that one axis of the slave made in each tick, and how much it may for errors; only where both are finite.

    An error e of position in a tick, and e/dt of speed: m w e/dt of it in the motion, g e in what it touches.
    """
    body, dt = scene.slave, scene.dt
    still, r = (one.environment, path_of(scene, one, len(x))) if isinstance(one, Moving) else (one, 0.0 * x)
    k, n, at = getattr(still, "k", 0.0), getattr(still, "n", 1.0), getattr(still, "at", 0.0)
    s, y = np.diff(r) / dt, x - r
    p = y - at
    if hasattr(still, "side"):
        p = np.maximum(still.side * p, 0.0)
        assert (still.side * f_env[np.isfinite(f_env)] >= 0.0).all(), "it pulls"
    held = k * np.abs(p) ** (n + 1.0) / (n + 1.0)
    if getattr(still, "k1", 0.0) > 0.0:
        held = held + 0.5 * (f_env - k * p) ** 2 / still.k1
    w0, w1, f, dy, push = v[:-1] - s, v[1:] - s, f[:-1] - body.damping * s, np.diff(y), k * np.abs(p) ** n
    before, after = 0.5 * body.mass * w0**2 + held[:-1], 0.5 * body.mass * w1**2 + held[1:]
    off = 4.0 * EPS * (np.abs(x[:-1]) + np.abs(x[1:]) + np.abs(r[:-1]) + np.abs(r[1:]) + abs(at))
    far = [np.maximum(np.abs(step) - off - 2.0 * error, 0.0) for step in (dy, np.diff(x))]
    made = after - before - f * dy + body.damping * far[0] ** 2 / dt + body.friction * (far[1] - np.abs(s) * dt)
    fast, pushed = np.maximum(np.abs(w0), np.abs(w1)), np.maximum(push[1:], push[:-1])
    allowed = (3.0 * error + off) * (body.mass * fast / dt + pushed + np.abs(f) + body.friction)
    allowed = allowed + body.mass * (3.0 * error / dt) ** 2 + k * (3.0 * error) ** (n + 1.0)
    allowed = allowed + 1e-12 * (before + after + np.abs(f * dy) + (f * f / k if k else 0.0))
    known = np.isfinite(made) & np.isfinite(allowed)
    return made[known], allowed[known]


def path_of(scene: Scene, one: Moving, count: int) -> np.ndarray:
    """Where what moves is at the ticks 0 .. count-1."""
    return np.array(one.path.samples(1, count, scene.dt_ns)[0])
