"""The link within the tick: messages on their way between the ends of a run in virtual time."""

from __future__ import annotations

from typing import Any

from teleop.stages.end import Axis, End, Run, zero
from teleop.stages.lanes import came, chosen, packet, placed, received, ring, sent, where, whole


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
    """What an axis received last: the law's message, and with it what the waves have come to.

    Where some messages are not sent, each has its number behind it, counted from 1, for 0 is none: a room is then for
    the tick at which a message comes, and keeps the newest of those that come there.
    """
    if run.has.deadband:
        return (a.rx, a.heard, zero(run)) if run.has.integral else (a.rx, zero(run))
    return (a.rx, a.heard) if run.has.integral else a.rx


def deliver(run: Run, e: End, sender: End, play: Any, size: int, k: int) -> None:
    """The message that an end plays at tick k, if there is one; `play` has its number, or -1."""
    if run.has.deadband:
        deliver_sent(run, e, sender, size, k)
    elif run.has.compiled:
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


def deliver_sent(run: Run, e: End, sender: End, size: int, k: int) -> None:
    """The same where some messages are not sent: the newest that comes at tick k, if none newer has come before."""
    for a, b in zip(e.axes, sender.axes, strict=True):
        if run.has.compiled:
            a.coming = received(b.ring, k, message_at(run, a))
        else:
            a.coming = b.ring[k % size]
    e.got = e.axes[0].coming[-1] - 1.0 > e.newest
    if run.has.compiled:
        e.newest = where(e.got, e.axes[0].coming[-1] - 1.0, e.newest)
        for a in e.axes:
            a.rx = chosen(e.got, a.coming[0], a.rx)
            if run.has.integral:
                a.heard = chosen(e.got, a.coming[1], a.heard)
    elif e.got:
        e.newest = e.axes[0].coming[-1] - 1.0
        for a in e.axes:
            a.rx = a.coming[0]
            if run.has.integral:
                a.heard = a.coming[1]


def send_some(run: Run, e: End, orders: Any, size: int, count: int, k: int) -> None:
    """The message of tick k on its way, if it is sent; what the link does with it was drawn beforehand.

    `orders`: of the other end. Behind its ticks stand, for each packet, the tick at which it comes and its number. One
    that never comes has its own tick, of which the room is free, and the number -1, so it is none.
    """
    e.due = packet(orders, count + k)
    e.number = whole(packet(orders, count + count + k)) + (zero(run) + 1.0)
    for a in e.axes:
        if run.has.integral and run.has.compiled:
            placed(a.ring, e.due, e.send > 0.0, (a.tx, a.sent, e.number))
        elif run.has.compiled:
            placed(a.ring, e.due, e.send > 0.0, (a.tx, e.number))
        elif e.send > 0.0 and run.has.integral:
            a.ring[e.due % size] = (a.tx, a.sent, e.number)
        elif e.send > 0.0:
            a.ring[e.due % size] = (a.tx, e.number)


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
    """The messages of tick k on their way."""
    for e in run.ends:
        if run.has.deadband:
            send_some(run, e, play_s if e.name == "m" else play_m, size, count, k)
        else:
            send_all(run, e, size, k)


def send_all(run: Run, e: End, size: int, k: int) -> None:
    """Those of one end."""
    for a in e.axes:
        if run.has.integral and run.has.compiled:
            sent(a.ring, k, (a.tx, a.sent))
        elif run.has.compiled:
            sent(a.ring, k, a.tx)
        elif run.has.integral:
            a.ring[k % size] = (a.tx, a.sent)
        else:
            a.ring[k % size] = a.tx
