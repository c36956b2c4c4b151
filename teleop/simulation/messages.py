"""The link within the tick: messages on their way between the ends of a run in virtual time."""

from __future__ import annotations

from typing import Any

from teleop.stages.end import End, Run
from teleop.stages.lanes import came, packet, received, ring, sent, where


def connect(run: Run, size: int) -> None:
    """Between the ends: room for the messages on their way, or without a link the message that is held."""
    for a, b in zip(run.m.axes, run.s.axes, strict=True):
        if run.m.has.leaves_out:
            a.tx = b.rx
        if run.s.has.leaves_out:
            b.tx = a.rx
        if run.has.link and run.has.compiled:
            a.ring = ring(b.rx, size)
            b.ring = ring(a.rx, size)
        elif run.has.link:
            a.ring = [b.rx] * size
            b.ring = [a.rx] * size
        else:
            a.tx = b.rx
            b.tx = a.rx


def deliver(run: Run, e: End, sender: End, play: Any, size: int, k: int) -> None:
    """The message that an end plays at tick k, if there is one; `play` has its number, or -1."""
    if run.has.compiled:
        seq = packet(play, k)
        e.got = came(seq)
        if e.has.newest:
            e.newest = where(e.got, seq, e.newest)
        for a, b in zip(e.axes, sender.axes, strict=True):
            a.rx = received(b.ring, seq, a.rx)
    else:
        seq = play[k]
        e.got = seq >= 0
        if e.got:
            if e.has.newest:
                e.newest = seq
            for a, b in zip(e.axes, sender.axes, strict=True):
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


def send(run: Run, size: int, k: int) -> None:
    """The messages of tick k on their way."""
    for e in run.ends:
        for a in e.axes:
            if run.has.compiled:
                sent(a.ring, k, a.tx)
            else:
                a.ring[k % size] = a.tx
