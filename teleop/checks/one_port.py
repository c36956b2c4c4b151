"""What `check_law` tries of a one-port law: its one end, probed alone, and its claim in closed loops.

See teleop/law.py for what such a law is, and teleop/checks/two_port.py for the probes, which are the same.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import inf, isfinite
from typing import Any

from teleop.checks.trials import DURATION, LOOPS, LOW, Swing, Tones, spread
from teleop.checks.two_port import AWKWARD, BEYOND, REST, TICKS, check_state, guarded, in_bits, situation, without
from teleop.errors import Refused
from teleop.law import At, reads
from teleop.physics.plant import MassDamper
from teleop.scene.scene import Scene
from teleop.simulation.virtual import run

FAR = 1e100  # a state beyond this belongs to a law that diverges, which is no fault of form; it begins anew


@dataclass(frozen=True, kw_only=True, slots=True)
class Port:
    """The one end of a law under test."""

    law: Any
    name: str
    seen: frozenset[str]  # the fields of At that it reads

    def start(self, at: At) -> Any:
        """The state at rest, checked."""
        began = guarded(f"{self.name}.start", self.law.start, at)
        check_state(f"{self.name}.start", began)
        return began

    def force(self, s: Any, at: At) -> Any:
        """What the law answers at a tick; `Refused` if it raises."""
        return guarded(f"{self.name}.force", self.law.force, s, at)


def probe(law: Any) -> None:
    """Ask a one-port law in many situations, tick after tick, and again in another order."""
    name = type(law).__name__
    port = Port(law=law, name=name, seen=reads(law.force))
    port.start(REST)
    asked: list[tuple[Any, At, str]] = []
    dice = spread(name)
    before = repr(law)
    for reach in ((), (), AWKWARD, AWKWARD, AWKWARD + BEYOND):
        at = situation(dice, reach)._replace(v=0.0, f_held=0.0, dx=0.0, fresh=False, age=inf)
        began = s = port.start(at)
        if "f" not in port.seen and in_bits(port.start(without(at, "f"))) != in_bits(began):
            raise Refused(f"{name}.start reads f, but {name}.force does not, so nobody measures it; start without it")
        for _ in range(TICKS):
            at = situation(dice, reach)
            got = port.force(s, at)
            _answered(port, s, at, got, finite=inf not in reach)
            _again(port, s, at, in_bits(got))
            _unseen(port, s, at, in_bits(got))
            asked.append((s, at, in_bits(got)))
            s = got[1] if all(isfinite(each) and abs(each) < FAR for each in got[1]) else began
    for s, at, bits in reversed(asked):
        _again(port, s, at, bits)
    if repr(law) != before:
        raise Refused(f"{name}.force changed the law from {before} to {law!r}; use the state")


def _answered(port: Port, s: Any, at: At, got: Any, *, finite: bool) -> None:
    """Type and shape of an answer, the same as ever, and finite."""
    if not isinstance(got, tuple) or len(got) != 2:
        raise Refused(f"{port.name}.force answered {got!r}; it answers (force, state)")
    if type(got[0]) is not float:
        raise Refused(f"{port.name}.force: the force is {got[0]!r} of type {type(got[0]).__name__}; answer a float")
    check_state(f"{port.name}.force", got[1])
    if type(got[1]) is not type(s):
        raise Refused(f"{port.name}.force answered a state of type {type(got[1]).__name__} where the start gave "
                      f"{type(s).__name__}; use one type throughout")
    if finite and not all(map(isfinite, (got[0], *got[1]))):
        raise Refused(f"{port.name}.force answered {got!r} to finite arguments {s}, {at}; "
                      "guard denominators with max(.., eps)")


def _again(port: Port, s: Any, at: At, bits: str) -> None:
    """The same arguments have the same answer."""
    if in_bits(port.force(s, at)) != bits:
        raise Refused(f"{port.name}.force answers the same arguments differently the second time; "
                      "keep what it remembers in its state, and nowhere else")


def _unseen(port: Port, s: Any, at: At, bits: str) -> None:
    """What the law does not visibly read may be anything."""
    for field in At._fields:
        if field not in port.seen and in_bits(port.force(s, without(at, field))) != bits:
            raise Refused(f"{port.name}.force reads {field} where it cannot be seen; write at.{field} in force "
                          "itself or in a plain function that it calls by name")


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
