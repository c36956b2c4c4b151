"""Deadband: a message that differs little from the last one is not sent, and the other end goes on with that one.

Source: P. Hinterseer, S. Hirche, S. Chaudhuri, E. Steinbach and M. Buss, "Perception-based data reduction and
transmission of haptic data in telepresence and teleaction systems", IEEE Trans. Signal Processing 56(2), 2008: people
do not feel a change of less than some share k of what they feel (Weber). So a sample q is sent where

    |q - last| > max(k |last|, floor),        last: its value in the message that was sent last.

A message is sent whole, as soon as one of its samples or waves asks for it; in its place a message that is not sent has
the values of the last one. With k = 0 every message is sent, and the law is the one inside, bit for bit. Each axis
decides by itself. Nothing is left out of the link: this is what a deadband does to a law, and `deadband_sent` counts
what it would have saved. Messages that are really not sent are the scene's: `--set deadband=0.1`.

Waves. The last wave again has another energy than the one that there is. Held as a sample is, it would give the link
energy that no port has brought. So each end keeps account, A (J, never below zero) of what the waves that it had were
above those that it sent, and a wave u is held only where that pays for it,

    held:  A + dt (u^2 - last^2)/2 >= 0        A += dt (u^2 - sent^2)/2.

Over ticks that were left out what was sent went on, so A goes on by the last difference; where that is below zero, the
next wave is smaller by as much, |sent|^2 <= u^2 + 2 A/dt. So what is sent never has more energy than what there was:
`E_link` is kept over any link, as the law inside keeps it. What waves come to is not kept: a coupling of waves drifts,
by up to k of the way. Totals, which tell of energy, are always told, for an end that couples its axes tells the same in
each of them.

Claims: `E_link` and `E_law` as the law has them. `E_port` is not claimed: a held position is no late position, and the
conditions of laws of positions are conditions on a delay.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import sqrt
from typing import Annotated, Any, ClassVar, NamedTuple

from teleop.knob import Knob, check_knobs
from teleop.law import At
from teleop.laws.around.compose import Message, StageEnd, bind, flat_record, nothing

BIG = 1.7e308  # beyond every number that a message may have; twice as much would be no number


@dataclass(frozen=True)
class DeadbandWrapper:
    """A message that differs by less than a share k from the last one goes out with the values of that (Weber)."""

    k: Annotated[float, Knob("", "share by which a value differs that is sent; 0: all are", low=0.0, high=1.0)] = 0.1
    floor: Annotated[float, Knob("", "least difference that is sent, in the unit of each value", low=0.0)] = 1e-3

    name: ClassVar[str] = "deadband"
    shows: ClassVar[tuple[str, ...]] = ("deadband_sent",)

    def __post_init__(self) -> None:
        check_knobs(self)

    @classmethod
    def end(cls, name: str, sends: Mapping[str, str]) -> StageEnd[Any, Any, Any, Any]:
        """At each end: what is sent last, of waves its account and the power above it, and how many were sent."""
        state: dict[str, str] = {}
        rest: Any = FIELDS["end"]["rest"]
        for field, of_kind in reversed([*sends.items()]):
            words = FIELDS.get(of_kind, FIELDS["sample"])
            rest = bind(fields_held, f"{name} {field}", **words, rest=rest)
            names = {"total": (), "wave": (field, f"A_{field}", f"P_{field}")}.get(of_kind, (field,))
            state = dict.fromkeys(names, "position" if of_kind == "position" else "sample") | state
        Last = flat_record("Last", {"begun": "sample", "sent": "sample", **state})
        return StageEnd(
            bind(lambda _, _at: (Record(*zeros), ()), name, Record=Last, zeros=(0.0,) * len(Last._fields)),
            bind(send, name, Record=Last, rest=rest))

    @classmethod
    def claims_of(cls, claims: Any) -> Any:
        """Claims of the law but `E_port`."""
        return {ledger: condition for ledger, condition in claims.items() if ledger != "E_port"}


class HeldSample(NamedTuple):
    last: float  # as it was sent last


class HeldWave(NamedTuple):
    last: float  # as it was sent last
    A: float  # its account, J
    P: float  # power above the one that was sent, W


def asks(deadband: DeadbandWrapper, s: HeldSample | HeldWave, _at: At, q: float) -> float:
    """1.0 if a sample asks for its message, 0.0 if the last one stands for it."""
    away = abs(q - s.last)
    return max(1.0 - (away <= max(deadband.k * abs(s.last), deadband.floor)) * 1.0, (deadband.k <= 0.0) * 1.0)


def hold(s: HeldSample, _at: At, is_sent: float, q: float) -> tuple[float, HeldSample]:
    """`q` to the bit where `is_sent` is 1.0, else the last one."""
    q = min(max(q, s.last - is_sent * BIG), s.last + is_sent * BIG)
    return q, HeldSample(q)


def account(s: HeldWave, at: At) -> float:
    """The account of a wave, which went on over ticks that were left out (J)."""
    return s.A + (at.span - at.dt) * s.P


def wave_asks(deadband: DeadbandWrapper, s: HeldWave, at: At, q: float) -> float:
    """1.0 if a wave asks for its message, for its account does not pay for the last one again either, else 0.0."""
    unpaid = (s.last * s.last > q * q + 2.0 * account(s, at) / at.dt) * 1.0
    return max(asks(deadband, s, at, q), unpaid)


def hold_wave(s: HeldWave, at: At, is_sent: float, q: float) -> tuple[float, HeldWave]:
    """The wave or the last one, smaller where the account is below zero."""
    A = account(s, at)
    most = sqrt(max(q * q + 2.0 * min(A, 0.0) / at.dt, 0.0)) + (A >= 0.0) * BIG
    last = min(max(hold(HeldSample(s.last), at, is_sent, q)[0], -most), most)
    P = 0.5 * (q * q - last * last)
    return last, HeldWave(last, A + at.dt * P, P)


# The fields of a message one after the other: `bind` gives each its own of these names, and `rest` for those behind it

ask = hold_field = rest = Record = nothing
size = 0
zeros: tuple[float, ...] = ()
FIELDS: dict[str, dict[str, Any]] = {
    "sample": {"ask": asks, "hold_field": hold, "Record": HeldSample, "size": 1},
    "wave": {"ask": wave_asks, "hold_field": hold_wave, "Record": HeldWave, "size": 3},
    "total": {"ask": lambda _deadband, _s, _at, _q: 0.0, "hold_field": lambda _s, _at, _is_sent, q: (q, ())},
    "end": {"rest": lambda _deadband, _s, _at, is_sent, _tx: (is_sent, (), ())}}


def fields_held(deadband: DeadbandWrapper, s: Message, at: At, is_sent: float, tx: Message) -> Any:
    """If the message is sent, its fields from this one on, and their state."""
    held, q = Record(*s[:size]), tx[0]
    is_sent, tx, s = rest(deadband, s[size:], at, max(is_sent, ask(deadband, held, at, q)), tx[1:])
    q, held = hold_field(held, at, is_sent, q)
    return is_sent, (q,) + tx, held[:] + s  # noqa: RUF005 - lanes make no lists


def send(deadband: DeadbandWrapper, s: Any, at: At, _rx: tuple[()], _over: tuple[()], f: float, tx: Message) -> Any:
    """The message, or the last one in its place."""
    is_sent, tx, held = rest(deadband, s[2:], at, 1.0 - s.begun, tx)
    return f, tx, (), Record(*((1.0, s.sent + is_sent) + held))  # noqa: RUF005 - as above
