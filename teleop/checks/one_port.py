"""The part of `check_law` for a one-port law: its one end, probed alone, and its claim in closed loops.

See teleop/law/__init__.py for what such a law is, and teleop/checks/probing.py for the probes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from math import inf, isfinite
from typing import Any

from teleop.checks.probing import REACHES, TICKS, answer, ask_again, check_blind_start, situation, unseen, without
from teleop.checks.trials import DURATION, LOOPS, LOW, Swing, Tones, spread
from teleop.errors import Refused
from teleop.law import At, reads
from teleop.law.contract import REST, Method, in_bits
from teleop.physics.plant import MassDamper
from teleop.scene.scene import Scene
from teleop.simulation.virtual import run

FAR = 1e100  # a state beyond this belongs to a law that diverges, which is no fault of form; it begins anew


def probe(law: Any) -> None:
    """Ask a one-port law in many situations, tick after tick, and again in another order."""
    name = type(law).__name__
    start, force, seen = Method(law, "start"), Method(law, "force"), reads(law.force)
    kinds = {"state": type(answer(start, REST))}
    asked: list[tuple[Any, At, str]] = []
    dice = spread(name)
    before = repr(law)
    for reach in REACHES:
        at = situation(dice, reach)._replace(v=0.0, f_held=0.0, dx=0.0, fresh=False, age=inf)
        began = s = answer(start, at, finite=False)
        check_blind_start(start, force, at, seen, in_bits(began))
        for _ in range(TICKS):
            at = situation(dice, reach)
            got = answer(force, s, at, kinds=kinds, finite=inf not in reach)
            bits = in_bits(got)
            ask_again(force, (s, at), bits)
            for field in At._fields:
                if field not in seen and in_bits(force.call(s, without(at, field))) != bits:
                    raise unseen(force, field)
            asked.append((s, at, bits))
            s = got[1] if all(isfinite(each) and abs(each) < FAR for each in got[1]) else began
    for s, at, bits in reversed(asked):
        ask_again(force, (s, at), bits)
    if repr(law) != before:
        raise Refused(f"{name}.force changed the law from {before} to {law!r}; use the state")


def try_port(law: Any) -> None:
    """Raise `Refused` if the law claims E_port and it falls below zero in one of its trials, or claims E_link."""
    name = type(law).__name__
    if "E_link" in law.claims:
        raise Refused(f"{name} claims E_link, but a one-port law has no link; leave E_link out of its claims")
    if "E_port" not in law.claims:
        return
    for scene in trials(law, spread(name)):
        trace = run(scene).trace
        least, through = float(trace["E_port"].min()), float(abs(trace["E_port"]).max())
        if not least >= -max(LOW, 1e-12 * through):
            raise Refused(f"{name} claims E_port, which fell to {least:.3g} J with {scene.hand} and {scene.master}; "
                          "mend the law, or leave E_port out of its claims")


def trials(law: Any, dice: Iterator[float]) -> Iterator[Scene]:
    """Scenes of a hand and a master on the law, with the energy ledger: hands and masters at random."""
    def between(low: float, high: float) -> float:
        """Evenly spread in the logarithm."""
        return float(low * (high / low) ** next(dice))

    scene = Scene(law=law, master=MassDamper(mass=1.0), energy=True, duration=DURATION, x_limit=1e3)
    for i in range(LOOPS):
        yield replace(
            scene, axes=3 if i % 6 == 5 else 1, observer=None if i % 2 else 200.0,
            master=MassDamper(mass=between(0.02, 2.0), damping=2.0 * next(dice)),
            hand=Swing(mass=next(dice), k=between(10.0, 1000.0), d=between(0.1, 20.0),
                       reference=Tones(amplitude=0.05, rate=between(3.0, 60.0))),
        )
