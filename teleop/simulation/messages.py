"""The link within the tick: messages on their way between the ends of a run in virtual time."""

from __future__ import annotations

from typing import Any

from teleop.stages.end import Axis, End, Run
from teleop.stages.memory import at, get, put, ring


def connect(run: Run, size: int) -> None:
    """Between the ends: room for the messages on their way, or without a link the message that is held."""
    for a, b in zip(run.m.axes, run.s.axes, strict=True):
        if run.m.has.leaves_out:
            a.tx = b.rx
        if run.s.has.leaves_out:
            b.tx = a.rx
        if run.has.link:
            a.ring = ring(message_at(run, b), size)
            b.ring = ring(message_at(run, a), size)
        else:
            a.tx = b.rx
            b.tx = a.rx


def message_at(run: Run, a: Axis) -> Any:
    """Make the message that an axis received last: the law's, and with it the integrals of the waves.

    Where some messages are not sent, each has its number behind it, counted from 1, for 0 is none: a room is then for
    the tick at which a message comes, and keeps the newest of those that come there.
    """
    if run.has.deadband:
        return (a.rx, a.heard, 0.0) if run.has.integral else (a.rx, 0.0)
    return (a.rx, a.heard) if run.has.integral else a.rx


def deliver(run: Run, e: End, sender: End, play: Any, size: int, k: int) -> None:
    """The message that an end plays at tick k, if there is one; `play` has its number, or -1."""
    if run.has.deadband:
        deliver_sent(run, e, sender, size, k)
    else:
        seq = at(play, k)
        e.got = seq >= 0
        if e.got:
            if e.has.newest:
                e.newest = seq
            for a, b in zip(e.axes, sender.axes, strict=True):
                if run.has.integral:
                    a.rx, a.heard = get(b.ring, seq, size)
                else:
                    a.rx = get(b.ring, seq, size)


def deliver_sent(run: Run, e: End, sender: End, size: int, k: int) -> None:
    """The same where some messages are not sent: the newest that comes at tick k, if none newer has come before."""
    for comings, b in zip(e.stage.deadband.axes, sender.axes, strict=True):
        comings.coming = get(b.ring, k, size)
    e.got = e.stage.deadband.axes[0].coming[-1] - 1.0 > e.newest
    if e.got:
        e.newest = e.stage.deadband.axes[0].coming[-1] - 1.0
        for a, comings in zip(e.axes, e.stage.deadband.axes, strict=True):
            a.rx = comings.coming[0]
            if run.has.integral:
                a.heard = comings.coming[1]


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


def send(run: Run, play_m: Any, play_s: Any, size: int, count: int, k: int) -> None:
    """The messages of tick k on their way; of a deadband, if they are sent: what the link does was drawn beforehand.

    In the other end's orders there stand behind its ticks, for each packet, the tick at which it comes and its number.
    One that never comes has its own tick, of which the room is free, and the number -1, so it is none.
    """
    for e in run.ends:
        if run.has.deadband:
            e.stage.deadband.due = at(play_s if e.name == "m" else play_m, count + k)
            e.stage.deadband.number = at(play_s if e.name == "m" else play_m, count + count + k) + 1.0
        for a in e.axes:
            if not run.has.deadband:
                put(a.ring, k, size, (a.tx, a.sent) if run.has.integral else a.tx)
            elif e.stage.deadband.send > 0.0:
                put(a.ring, e.stage.deadband.due, size, (a.tx, a.sent, e.stage.deadband.number)
                    if run.has.integral else (a.tx, e.stage.deadband.number))
