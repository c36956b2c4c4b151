"""A second extreme matrix: bodies without a closed form, devices, one-port laws, what moves and what relaxes.

Two families in the manner of `extremes.py`. *Plants* are scenes of two ends whose slave rubs, or meets Hunt-Crossley
bodies, relaxing tissue or what moves by itself. *Displays* are a handle, its device and a one-port law. Runs are as
short as their ticks are dear: one that is integrated may take a thousand sub-steps in each.
"""

from __future__ import annotations

from collections.abc import Set
from dataclasses import dataclass
from itertools import combinations
from typing import Any, ClassVar, NamedTuple

import numpy as np

from channel import Bernoulli, Delay, UniformJitter
from master.hand import Grip, Reach, Rest, Sine
from slave import HuntCrossley, Moving, StandardLinearSolid, Tissue, Wall
from teleop.law import At
from teleop.laws.direct import Direct
from teleop.laws.pfra import PFRA
from teleop.laws.virtual_coupling import VirtualCoupling
from teleop.laws.virtual_wall import VirtualWall
from teleop.laws.wave import Wave
from teleop.physics.plant import MassDamper
from teleop.physics.relaxing import ElectricalDamping
from teleop.scene.playout import Hold, Zero
from teleop.scene.scene import Scene
from teleop.stages.device import Device
from teleop.stages.encoder import Encoder
from teleop.stages.force_cap import Cap
from teleop.stages.passivity_controller import PassivityController
from teleop.stages.velocity.adaptive_window import BestFit, EndFit
from teleop.stages.velocity.backward_difference import BackwardDifference
from teleop.stages.velocity.levant import Levant
from teleop.stages.velocity.low_pass import LowPass
from tests.teleop.simulation.extremes import Range, hypercube

EPS = float(np.finfo(float).eps)
SPREAD = 60  # rows of each family with nothing pinned
TICKS, INTEGRATED = 120, 24


class Family(NamedTuple):
    """The knobs of one family; all four corners of each of the `pairs` of ranges are in the matrix."""

    ranges: dict[str, Range]
    choices: dict[str, tuple[Any, ...]]
    pairs: list[tuple[str, str]]


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
)
FAMILIES = {"plants": PLANTS, "displays": DISPLAYS}


def rows() -> list[dict[str, Any]]:
    """The matrix: both families, each row with its family and with what makes its pinned knobs count."""
    return [fitted({**row, "family": name}) for name, family in FAMILIES.items()
            for row in hypercube(family.ranges, family.choices, family.pairs, SPREAD)]


def fitted(row: dict[str, Any]) -> dict[str, Any]:
    """The row with those choices that its pinned knobs ask for, and without what does not go together."""
    pinned = row["pinned"].keys()
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
    dear = row.get("f_s", 0.0) > 0.0 or row["f_m"] > 0.0 or row.get("environment") == "hunt crossley"
    return INTEGRATED if dear else TICKS


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
