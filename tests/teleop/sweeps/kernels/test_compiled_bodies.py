"""Bodies with an inner state and windows of readings are compiled too, and give the bits of plain Python.

The file is a scene as well (`scene`, below), so that a sweep can be asked for it.
"""

from __future__ import annotations

import random
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from channel.link import parse_link
from master.hand import Grip, Sine
from slave.hunt_crossley import HuntCrossley
from slave.moving import Moving
from slave.standard_linear_solid import StandardLinearSolid
from slave.tissue import Tissue
from slave.wall import Wall
from teleop import Scene, load_scene
from teleop.laws.wave import Wave
from teleop.physics.carried import at_rest, carried, is_carried
from teleop.physics.plant import MassDamper, free_space
from teleop.physics.relaxing import ElectricalDamping
from teleop.simulation.bodies import exact_bodies, with_inner
from teleop.stages.velocity.adaptive_window import BestFit, EndFit
from teleop.stages.velocity.backward_difference import BackwardDifference
from teleop.stages.velocity.levant import Levant
from teleop.stages.velocity.low_pass import LowPass
from teleop.sweeps.chunk import ChunkResult, Job, work

BODIES = ("relaxing, moved and none, electrical damping", "friction", "hunt-crossley")
PORTS: dict[str, tuple[Any, float, float | None]] = {  # estimator, friction, electrical damping of a one-port
    "end fit, friction": (lambda noise: EndFit(noise=noise), 0.3, None),
    "best fit, electrical damping": (lambda noise: BestFit(noise=noise, most=7), 0.0, 2.0),
    "end fit of one reading": (lambda noise: EndFit(noise=noise, most=1), 0.0, None),
    "best fit of many": (lambda noise: BestFit(noise=noise, most=40), 0.0, None),
    "levant": (lambda noise: Levant(L=noise * 1e6), 0.0, None),
    "low pass": (lambda noise: LowPass(cutoff=noise * 1e6), 0.0, None),
    "difference": (lambda _: BackwardDifference(), 0.0, None),
}
MEASURES = ("x_err_rms", "x_err_max", "f_err_rms", "f_m_max", "f_s_max", "f_h_max", "f_env_max", "E_port_min")


def scene(
    *, case: str = "friction", k: float = 1e3, d: float = 2.0, soft: float = 0.5, friction: float = 0.3,
    amplitude: float = 0.02, noise: float = 1e-5, duration: float = 0.25,
) -> Scene:
    """Any of the structures here."""
    if case in PORTS:
        estimator, rub, b_e = PORTS[case]
        return load_scene("virtual_wall", friction=rub and friction, b_e=b_e, velocity=estimator(noise), step=1e-5,
                          to=amplitude, duration=4.0 * duration)

    def moving(environment: Any) -> Moving:
        return Moving(environment=environment, path=Sine(amplitude=0.004, frequency=4.0))

    wall, tissue = Wall(k=k, d=d, at=0.004), Tissue(k=0.1 * k, d=d)
    ball = HuntCrossley(k=50.0 * k, n=1.0 + soft, lam=0.1 * d, at=0.003)
    solid = StandardLinearSolid(k=0.1 * k, k1=0.2 * k, tau=0.01 + 0.1 * soft)
    environment: tuple[Any, ...] = {
        "relaxing, moved and none, electrical damping": (solid, moving(wall), None),
        "friction": (wall, moving(tissue), None),
        "hunt-crossley": (ball, moving(replace(ball, n=1.5, side=-1.0)), moving(solid)),
    }[case]
    rub_m, rub_s = (0.5 * friction, friction) if case == "friction" else (0.0, 0.0)
    swing = (amplitude, 0.5 * amplitude, -amplitude)
    return Scene(
        law=Wave(), axes=3, hand=Grip(mass=0.2, k=400.0, d=3.0, reference=Sine(amplitude=swing, frequency=3.0)),
        master=MassDamper(mass=0.1, damping=0.5, friction=rub_m),
        slave=MassDamper(mass=0.3, damping=1.0, friction=rub_s), environment=environment,
        electrical=ElectricalDamping(b=d, cutoff=10.0 * soft) if "electrical" in case else None,
        link=parse_link("delay(0.01) | uniform(0.01) ; delay(0.02)"), energy=True, duration=duration)


def by(engine: str, case: str) -> ChunkResult:
    """Rows of random knobs, the last of them beyond what a body bears."""
    dice = random.Random(case)
    drawn: list[dict[str, object]] = [{
        "k": 10.0**dice.uniform(1.0, 4.0), "d": dice.uniform(0.0, 10.0), "soft": dice.uniform(0.1, 1.0),
        "friction": dice.choice([1e-3, 0.3, 2.0]), "amplitude": dice.uniform(0.005, 0.05),
        "noise": 10.0**dice.uniform(-6.0, -4.0)} for _ in range(5)]
    drawn.append({**drawn[0], "amplitude": 1e6, "k": 1e9})
    rows = [(number, knobs, number) for number, knobs in enumerate(drawn)]
    return work(Job(__file__, {"case": case}, rows, MEASURES, engine))


@pytest.mark.parametrize("case", [*BODIES, *PORTS])
def test_each_is_compiled_and_gives_the_bits_of_plain_python(case: str) -> None:
    fast = by("scalar", case)
    assert list(fast.ran) == [("scalar", "")]
    assert repr(fast.rows) == repr(by("plain", case).rows)  # repr: every digit, and the sign of a zero
    assert "ok" in {row["status"] for row in fast.rows}


def test_what_moves_in_the_same_kind_of_environment_is_the_same_part() -> None:
    """Or every row of a sweep would have a kernel of its own."""
    one, other = (load_scene("beating_heart", k_e=k) for k in (100.0, 200.0))
    assert exact_bodies(one).functions() == exact_bodies(other).functions()
    free = free_space(one.master, 1e-3)
    assert with_inner(free).move is with_inner(free._replace(c=(1.0,) * 4)).move


def test_a_carried_plant_knows_the_one_that_it_carries() -> None:
    body = MassDamper(mass=0.5)
    for still in (Wall(k=1e3, d=1.0).plant(body, 1e-3), StandardLinearSolid(k=1.0, k1=2.0, tau=0.1).plant(body, 1e-3)):
        assert not is_carried(still)
        moving = carried(still, [0.0, 0.1, 0.0], body, 1e-3)
        assert is_carried(moving)
        assert at_rest(moving) == still


OWN = """
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple
from teleop import Plant, Scene, load_scene

class Word(NamedTuple):
    x: float

@dataclass(frozen=True, kw_only=True)
class Mine:
    K: float = 100.0
    claims: ClassVar[dict[str, str]] = {}
    def master_start(self, at): return (), Word(at.x)
    def slave_start(self, at): return (), Word(at.x)
    def master(self, s, at, rx): return self.K * (at.x - rx.x), Word(at.x), s
    def slave(self, s, at, rx): return self.K * (rx.x - at.x) - 4.0 * at.v, Word(at.x), s

def move(c, x, v, f):
    k, table = c
    return x + 1e-3 * v, v + 1e-3 * (f - k * table[1] * x - 2.0 * v), 0

def force(c, x, v):
    return c[0] * c[1][1] * x

@dataclass(frozen=True, kw_only=True)
class Springs:
    k: float
    def plant(self, body, dt): return Plant(move, force, (1.0, [0.0, self.k]))
    def resistance(self): raise NotImplementedError

def scene(*, k: float = 10.0, law: object = Mine()) -> Scene:
    return replace(load_scene("canonical", duration=0.2), law=Mine(), environment=Springs(k=k))
"""


@pytest.mark.parametrize("engine", ["scalar", "vector"])
def test_a_law_and_a_body_of_a_scene_file_are_compiled_and_each_row_has_its_own_lists(
    engine: str, tmp_path: Path
) -> None:
    (tmp_path / "own.py").write_text(OWN)
    rows = [(n, {"k": 5.0 * n}, 0) for n in range(9)]
    own = str(tmp_path / "own.py")
    done = {one: work(Job(own, {}, rows, ("x_err_rms", "f_s_max"), one)) for one in (engine, "plain")}
    assert repr(done[engine].rows) == repr(done["plain"].rows)
    assert len({row["f_s_max"] for row in done[engine].rows}) == 9
    ((ran, _), _), = done[engine].ran.items()
    assert ran == "scalar"


def test_a_recorded_hand_that_was_recorded_anew_moves_anew(tmp_path: Path) -> None:
    told = []
    for x in (0.01, 0.05):
        (tmp_path / "hand.csv").write_text(f"t,x\n0,0\n1,{x}\n")
        rows = [(0, {"motion": str(tmp_path / "hand.csv"), "duration": 0.5}, 0)]
        told.append(work(Job("recorded_reach", {}, rows, ("x_err_max",), "plain")).rows[0])
    assert told[0]["x_err_max"] != told[1]["x_err_max"]
