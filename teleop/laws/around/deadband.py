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
from typing import Annotated, Any, ClassVar

from teleop.knob import Knob, check_knobs
from teleop.laws.around.compose import EndLines, InnerEnd

BIG = 1.7e308  # beyond every number that a message may have; twice as much would be no number


def moved(k: float, floor: float, q: float, last: float) -> float:
    """1.0 if a value is sent, 0.0 if the last one stands for it."""
    away = abs(q - last)
    return max(1.0 - (away <= max(k * abs(last), floor)) * 1.0, (k <= 0.0) * 1.0)


def unpaid(q: float, last: float, account: float, dt: float) -> float:
    """1.0 if a wave cannot be held, since its account does not pay for the last one again, else 0.0."""
    return (last * last > q * q + 2.0 * account / dt) * 1.0


def sent_value(send: float, q: float, last: float) -> float:
    """`q` to the bit where `send` is 1.0, else `last`."""
    return min(max(q, last - send * BIG), last + send * BIG)


def within(wave: float, q: float, account: float, dt: float) -> float:
    """`wave`, smaller where the account is below zero."""
    most = sqrt(max(q * q + 2.0 * min(account, 0.0) / dt, 0.0)) + (account >= 0.0) * BIG
    return min(max(wave, -most), most)


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
    def lines(cls, end: InnerEnd) -> EndLines:
        """At each end: what is sent last, of waves its account and the power above it, and how many were sent."""
        state = {"deadband_begun": "0.0", "deadband_sent": "0.0"}
        after = ["deadband_send = 1.0 - s.deadband_begun"]
        decides = {name: of_kind for name, of_kind in end.sends.items() if of_kind != "total"}
        for name, of_kind in decides.items():
            state[f"deadband_{name}"] = "0.0"
            last = f"s.deadband_{name}"
            after.append("deadband_send = max(deadband_send, moved(self.deadband_k, self.deadband_floor, "
                         f"tx_{name}, {last}))")
            if of_kind == "wave":
                state |= {f"deadband_A_{name}": "0.0", f"deadband_P_{name}": "0.0"}
                after += [f"deadband_A_{name} = s.deadband_A_{name} + (at.span - at.dt) * s.deadband_P_{name}",
                          f"deadband_send = max(deadband_send, unpaid(tx_{name}, {last}, deadband_A_{name}, at.dt))"]
        for name, of_kind in decides.items():
            after.append(f"deadband_{name} = sent_value(deadband_send, tx_{name}, s.deadband_{name})")
            if of_kind == "wave":
                after += [f"deadband_{name} = within(deadband_{name}, tx_{name}, deadband_A_{name}, at.dt)",
                          f"deadband_P_{name} = 0.5 * (tx_{name} * tx_{name} - deadband_{name} * deadband_{name})",
                          f"deadband_A_{name} = deadband_A_{name} + at.dt * deadband_P_{name}"]
            after.append(f"tx_{name} = deadband_{name}")
        after += ["deadband_begun = 1.0", "deadband_sent = s.deadband_sent + deadband_send"]
        positions = tuple([f"deadband_{name}" for name, of_kind in decides.items() if of_kind == "position"])
        return EndLines(state=state, after=tuple(after), positions=positions)

    @classmethod
    def words(cls) -> Mapping[str, Any]:
        """The functions of this file that the lines name."""
        return {"moved": moved, "unpaid": unpaid, "sent_value": sent_value, "within": within}

    @classmethod
    def claims_of(cls, claims: Any) -> Any:
        """Claims of the law but `E_port`."""
        return {ledger: condition for ledger, condition in claims.items() if ledger != "E_port"}
