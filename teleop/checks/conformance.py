"""Conformance of laws with two ends, whatever they claim: signs, starts, messages, conditions.

The scene of these trials is soft and slow: a hand of 100 N/m and 10 N s/m reaches 30 mm into a wall of 300 N/m, without
a link, so a message takes one tick.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

from teleop.checks.trials import Block, Swing, spread
from teleop.errors import Refused
from teleop.kind import totals
from teleop.law import start_at
from teleop.law.contract import Method, in_bits
from teleop.law.offers import AgeRange, Facts
from teleop.physics.plant import MassDamper
from teleop.protocol.packet import Kind, Packet, decode, encode
from teleop.scene.playout import Zero
from teleop.scene.scene import Scene
from teleop.simulation.virtual import run

REACH, RISE, LASTS = 0.03, 0.5, 2.0  # m, s, s
AGAINST = 0.01  # of the force on the wall, at which a force has a sign
SET_OUT = 1e-7  # m, at which a slave has set out
DT = 1e-3  # s
NEAR = 0.02  # of a value that is said to be the least: so much beyond it the condition is broken again
_CURE = re.compile(r"--set law\.(\w+)=(\S+?)(?=[\s,;:)]|$)")
_NUMBER = re.compile(r"[-+]?\d[\d.]*(e[-+]?\d+)?")


class Condition(NamedTuple):
    """Condition that a law breaks, read from the sentence that the law answers with, as a person reads it."""

    sentence: str
    name: str  # the statement without its numbers and values to type, alike for any gains
    cure: dict[str, float]  # knob -> the value that the sentence says to type
    law: str | None  # another law that it says to take, with gains of that law

    @classmethod
    def read(cls, sentence: str) -> Condition:
        """Read a sentence."""
        cure = {knob: float(text) for knob, text in _CURE.findall(sentence)}
        law = re.search(r"--set law=(\S*)", sentence)
        statement = re.split("[;:]", _CURE.sub("", sentence))[0]
        return cls(sentence, _NUMBER.sub("#", statement), cure, law and law[1])


def conditions_of(law: Any, facts: Facts) -> list[Condition]:
    """The conditions of a law that these facts break. `Refused` if it answers with anything but sentences."""
    broken = []
    for sentence in law.conditions(facts) if hasattr(law, "conditions") else ():
        if not isinstance(sentence, str) or not sentence:
            raise Refused(f"{type(law).__name__}.conditions returns {sentence!r}; return sentences, one for each "
                          "condition that is broken")
        broken.append(Condition.read(sentence))
    return broken
def try_conformance(law: Any) -> None:
    """Raise `Refused` with one sentence for the first of these that `law` does not keep to."""
    _try_start(law)
    _try_messages(law)
    _try_totals(law)
    _try_signs(law)
    _try_conditions(law)


def _try_start(law: Any) -> None:
    """An end, wherever it starts, holds no force at rest before a message has come; in motion it may brake.

    A session may begin while a device is moved, and after an interruption another one begins in mid-motion.
    """
    name = type(law).__name__
    for x, v in ((0.0, 0.0), (0.3, 0.0), (-2.0, 0.0), (0.3, 0.4), (0.3, -0.4)):
        began = start_at(x, v, 0.0, DT)
        for end, sign in (("master", 1.0), ("slave", -1.0)):
            s, rx = getattr(law, f"{end}_start")(began)
            force, at = 0.0, began
            for k in range(3):
                arguments = (s, at, rx)
                sums = getattr(law, f"{end}_sums", None)
                force, _, s = getattr(law, end)(*arguments, *([sums(*arguments)] if sums else []))
                before = f"{name}.{end} begins at {x:g} m and {v:g} m/s with {force:.3g} N before any message has come"
                if v == 0.0 and not abs(force) <= 1e-9:
                    raise Refused(f"{before}: the device would jump; return from {name}.{end}_start the message of a "
                                  "peer that stands where this end does")
                if not sign * force * v >= -1e-9:
                    acts = "f_m, which acts against" if end == "master" else "f_s, which acts along"
                    raise Refused(f"{before}, which drives it on; turn the sign of {acts} the motion of the {end}: "
                                  "with no message yet it may only brake")
                at = at._replace(x=x + (k + 1) * v * DT, f_held=force, dx=v * DT)


def _try_messages(law: Any) -> None:
    """A packet carries a message to the bit."""
    still = start_at(0.1, 0.0, 0.0, DT)
    for start, kind in (("slave_start", Kind.FORTH), ("master_start", Kind.BACK)):
        message = Method(law, start).call(still)[1]
        dice = spread(start)
        sent = type(message)(*[1e3 * (next(dice) - 0.5) for _ in message])
        packet = Packet(kind=kind, session=1, seq=7, sent_ns=1, echo=None, payload=tuple(sent), E_in=None)
        decoded = decode(encode(packet), len(sent))
        numbers: Any = decoded.payload if isinstance(decoded, Packet) else None
        if numbers is None or in_bits(type(message)(*numbers)) != in_bits(sent):
            raise Refused(f"{type(law).__name__} sends {type(message).__name__}, which a packet does not carry as it "
                          "is; use fewer fields, each a float")


def _try_totals(law: Any) -> None:
    """An end that couples its axes sends the same total in each of them: over a network it is sent once."""
    name, axes, started = type(law).__name__, 3, start_at(0.0, 0.0, 0.0, DT)
    for end, peer in (("master", "slave"), ("slave", "master")):
        s, first = getattr(law, f"{end}_start")(started)
        sent_totals = totals(type(getattr(law, f"{peer}_start")(started)[1]))
        if not sent_totals or not hasattr(law, f"{end}_sums"):
            continue
        dice, states, force = spread(f"{name}.{end}"), [s] * axes, [0.0] * axes
        energies = dict.fromkeys(totals(type(first)), 0.0)
        for _ in range(200):
            energies = {field: energy + 1e-3 * next(dice) for field, energy in energies.items()}
            fresh, arguments = next(dice) < 0.7, []
            for i in range(axes):
                x, v, touch = (0.02 * (next(dice) - 0.5), 2.0 * next(dice) - 1.0, 4.0 * next(dice) - 2.0)
                at = started._replace(x=x, v=v, f=touch, f_held=force[i], dx=v * DT, fresh=fresh, age=DT)
                rx = type(first)(*[energies.get(field, 0.02 * (next(dice) - 0.5)) for field in first._fields])
                arguments.append((states[i], at, rx))
            parts = [getattr(law, f"{end}_sums")(*each) for each in arguments]
            over = type(parts[0])(*[sum(column) for column in zip(*parts, strict=True)])
            answers = [getattr(law, end)(*each, over) for each in arguments]
            force, states = [answer[0] for answer in answers], [answer[2] for answer in answers]
            for field in sent_totals:
                if len({getattr(answer[1], field) for answer in answers}) > 1:
                    raise Refused(f"{name}.{end} couples its axes and tells another {field} in each; keep one energy "
                                  f"for all axes, out of its sums, or write kind.Sample for {field}")


def _try_signs(law: Any) -> None:
    """A slave goes the way of its master, and the force on a hand that presses is against it, or none."""
    name = type(law).__name__
    for side in (1.0, -1.0):
        trace = run(_reach(law, side, touch=False)).trace
        x_m, x_s = side * trace["x_m"], side * trace["x_s"]
        k = int((abs(x_s) > SET_OUT).argmax())  # with gains beyond reason it may turn later, and diverge
        if x_s[k] < -SET_OUT and x_m[k] > 0.0:
            raise Refused(f"{name} sets its slave going by {1e6 * side * x_s[k]:.3g} um while the master goes by "
                          f"{1e6 * side * x_m[k]:.3g} um, against it; turn the sign of f_s, the force of the stack on "
                          "the slave")
        pressed = run(_reach(law, side, touch=True))
        last = len(pressed.trace["t"]) // 10
        force, wall = (side * float(pressed.trace[column][-last:].mean()) for column in ("f_m", "f_env"))
        if wall > 0.0 and force < -AGAINST * wall:
            raise Refused(f"{name} pulls the hand into the wall with {-force:.3g} N while the slave presses it with "
                          f"{wall:.3g} N; turn the sign of f_m, the force of the stack against the hand")


def _try_conditions(law: Any) -> None:
    """A sentence on a condition that names a knob's least sufficient value is right: with it the condition holds."""
    knobs = {knob.name for knob in fields(law)}
    for facts in _facts(spread(type(law).__name__)):
        for condition in conditions_of(law, facts):
            if condition.law is None and condition.cure and condition.cure.keys() <= knobs:
                _try_cure(law, facts, condition)


def _try_cure(law: Any, facts: Facts, condition: Condition) -> None:
    """The values that a sentence says to type mend its condition, and a single one that is a little less does not."""
    name, sentence = type(law).__name__, condition.sentence

    def is_broken(values: dict[str, float]) -> bool:
        """True if the law with these values still breaks the condition."""
        try:
            broken = conditions_of(replace(law, **values), facts)
        except Refused:  # out of the knob's own domain
            return True
        return any(each.name == condition.name for each in broken)

    typed = ", ".join(f"{knob}={value:.12g}" for knob, value in condition.cure.items())
    if is_broken(condition.cure):
        raise Refused(f"{name}.conditions says {sentence!r}, and with {typed} that condition is broken still; name a "
                      "value that is enough")
    if len(condition.cure) > 1:
        return
    (knob, value), = condition.cure.items()
    side = 1.0 if value > getattr(law, knob) else -1.0
    less = value - side * NEAR * abs(value)
    if side * (less - getattr(law, knob)) > 0.0 and not is_broken({knob: less}):
        raise Refused(f"{name}.conditions says {sentence!r}, and less than {typed} is enough; name the least value "
                      "that is")



def _facts(dice: Iterator[float]) -> Iterator[Facts]:
    """Facts of links and bodies at random."""
    for i in range(20):
        least = [0.2 * next(dice) ** 2 + DT for _ in range(2)]
        spans = [0.0 if i % 2 else 0.1 * next(dice) for _ in range(2)]
        fwd, bwd = [AgeRange(low, low + span) for low, span in zip(least, spans, strict=True)]
        yield Facts(
            dt=DT, axes=1 if i % 3 else 3, fwd=fwd, bwd=bwd, lossy=i % 2 == 0, held=DT * (1 + 9 * (i % 5 == 4)),
            mass_m=2.0 * next(dice) + 0.01, damping_m=2.0 * next(dice), mass_s=5.0 * next(dice) + 0.01,
            damping_s=2.0 * next(dice), playout=("zero", "integral", "hold", "fixed")[i % 4])


@dataclass(frozen=True, kw_only=True)
class Ramp:
    """Straight way of `reach` m within `RISE`, and rest."""

    reach: float

    def samples(self, axes: int, count: int, dt_ns: int) -> tuple[list[float], ...]:
        """Positions (m) per axis."""
        along = [self.reach * min(k * dt_ns / 1e9 / RISE, 1.0) for k in range(count)]
        return tuple(along if i == 0 else [0.0] * count for i in range(axes))


def _reach(law: Any, side: float, *, touch: bool) -> Scene:
    """The scene of this file, into a wall at a third of the way or past it."""
    hand: Any = Swing(mass=0.0, k=100.0, d=10.0, reference=Ramp(reach=side * REACH))
    wall = Block(k=300.0, d=5.0, at=REACH / 3.0 if side > 0.0 else -REACH / 3.0, side=side)
    return Scene(law=law, master=MassDamper(mass=0.2, damping=1.0), slave=MassDamper(mass=0.2, damping=1.0), hand=hand,
                 environment=wall if touch else None, playout=Zero(), observer=200.0, duration=LASTS, x_limit=10.0)

