"""The link within the tick: messages on their way between the ends of a run in virtual time."""

from __future__ import annotations

from typing import Any

from teleop.stages.end import Axis, End, Run
from teleop.stages.lanes import came, packet, received, ring, sent, where


def connect(run: Run, size: int) -> None:
    """Between the ends: room for the messages on their way, or without a link the message that is held."""
    for a, b in zip(run.m.axes, run.s.axes, strict=True):
        if run.m.has.leaves_out:
            a.tx = b.rx
        if run.s.has.leaves_out:
            b.tx = a.rx
        if run.has.link and run.has.compiled:
            a.ring = ring(message_at(run, b), size)
            b.ring = ring(message_at(run, a), size)
        elif run.has.link:
            a.ring = [message_at(run, b)] * size
            b.ring = [message_at(run, a)] * size
        else:
            a.tx = b.rx
            b.tx = a.rx


def message_at(run: Run, a: Axis) -> Any:
    """What an axis received last: the law's message, and with it what the waves have come to."""
    return (a.rx, a.heard) if run.has.integral else a.rx


def deliver(run: Run, e: End, sender: End, play: Any, size: int, k: int) -> None:
    """The message that an end plays at tick k, if there is one; `play` has its number, or -1."""
    if run.has.compiled:
        seq = packet(play, k)
        e.got = came(seq)
        if e.has.newest:
            e.newest = where(e.got, seq, e.newest)
        for a, b in zip(e.axes, sender.axes, strict=True):
            if run.has.integral:
                a.rx, a.heard = received(b.ring, seq, (a.rx, a.heard))
            else:
                a.rx = received(b.ring, seq, a.rx)
    else:
        seq = play[k]
        e.got = seq >= 0
        if e.got:
            if e.has.newest:
                e.newest = seq
            for a, b in zip(e.axes, sender.axes, strict=True):
                if run.has.integral:
                    a.rx, a.heard = b.ring[seq % size]
                else:
                    a.rx = b.ring[seq % size]


def exchange(run: Run, k: int) -> None:
    """Without a link each end has the message of the tick before."""
    run.m.got = run.s.got = k > 0
    for e in run.ends:
        if e.has.newest:
            e.newest = k - 1
    for a, b in zip(run.m.axes, run.s.axes, strict=True):
        a.rx = b.tx
        b.rx = a.tx
        if run.has.integral:
            a.heard = b.sent
            b.heard = a.sent


def send(run: Run, size: int, k: int) -> None:
    """The messages of tick k on their way."""
    for e in run.ends:
        for a in e.axes:
            if run.has.integral and run.has.compiled:
                sent(a.ring, k, (a.tx, a.sent))
            elif run.has.compiled:
                sent(a.ring, k, a.tx)
            elif run.has.integral:
                a.ring[k % size] = (a.tx, a.sent)
            else:
                a.ring[k % size] = a.tx
