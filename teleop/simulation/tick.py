"""The tick: ordinary Python, from which every run is made, in virtual time, live and compiled.

`tick` is one end's tick. `loop` is a run in virtual time, and `live` is one end by itself, a generator. They run as
they stand, which is the reference. What runs is made of them by `teleop.simulation.specialise`, for each structure of
scene: what a scene does not have is not there to be paid for. So a law, its observer, its watchdog and its ledgers see
the same arithmetic in the same order wherever they run.

What stands between a device and its law, and between the law and the motor, is in `teleop.stages`, one file each;
`teleop.stages.order` has the list.
"""

from __future__ import annotations

from collections.abc import Generator
from functools import reduce
from math import inf, nan
from operator import add
from typing import Any, NamedTuple

from teleop.law import At, start_at
from teleop.stages.end import Axis, End, Run, elapsed, held_of_law, law_of
from teleop.stages.memory import LEFT_OUT, at, get, put, ring


def begin(run: Run, e: End, numbers: Any) -> None:
    """An end before its first tick: its law at rest where the end is, nothing held, nothing received."""
    read_directly(e)
    for stage in e.stages:
        stage.begin(run, e, getattr(numbers, stage.name))
    for a in e.axes:
        a.at = start_at(a.x_read, a.v_read, a.f_read if e.has.touch else nan, run.dt)
    for stage in e.stages:
        stage.situate(run, e)
    for a in e.axes:
        if run.has.slave:
            a.s, a.rx = e.begin(law_of(run, a), a.at)
        else:
            a.s = e.begin(law_of(run, a), a.at)
        if e.has.dx:
            a.x_before = a.x_read
    for one in e.shown:
        one.value = 0.0
    if e.has.newest:
        e.newest = -1


def tick(run: Run, e: End, k: int) -> None:
    """Run one end's tick k: its readings, its law, and the force that is held until the next."""
    if e.has.age:
        e.age = (k - e.newest) * run.dt if e.newest >= 0 else inf
    read_directly(e)
    for stage in e.stages:
        stage.read(run, e, k)
    for a in e.axes:
        if e.has.dx:
            a.dx = a.x_read - a.x_before
            a.x_before = a.x_read
        a.at = situation(run, e, a)
    for stage in e.stages:
        stage.situate(run, e)
    for stage in e.stages:
        stage.receive(run, e)
    answer(run, e)
    for stage in e.stages:
        stage.act(run, e, k)
    for a in e.axes:
        a.f = a.f_cmd
    for one in e.shown:
        one.value = getattr(one.a.s, one.field)


def read_directly(e: End) -> None:
    """Read the device directly, where no stage stands between it and its law."""
    for a in e.axes:
        if not e.stage.encoder:
            a.x_read = a.x
        if not e.stage.velocity:
            a.v_read = a.v
        if e.has.sensed:
            a.f_read = a.f_ext


def situation(run: Run, e: End, a: Axis) -> Any:
    """Build the `At` passed to the law for one axis."""
    return At(a.x_read, a.v_read, a.f_read if e.has.touch else nan, held_of_law(e, a), a.dx if e.has.dx else nan,
              fresh(run, e), age(run, e), run.dt, span(run, e), gain(e))


def fresh(run: Run, e: End) -> Any:
    """True if there is a message to play at this tick."""
    if not run.has.slave:
        return False
    return True if run.has.repeats or run.has.integral else e.got


def age(run: Run, e: End) -> float:
    """The age of the newest message, s."""
    if not run.has.slave:
        return inf
    return e.age if e.has.age else nan


def span(run: Run, e: End) -> Any:
    """The time since the last tick of an end whose law reads it, s."""
    return elapsed(run, e) if e.has.span else nan


def gain(e: End) -> Any:
    """The watchdog's gain at the last tick of an end whose law reads it."""
    if not e.has.gain:
        return nan
    if e.has.live:
        return e.stage.watchdog.g_held
    return e.stage.watchdog.g if e.stage.watchdog else 1.0


def answer(run: Run, e: End) -> None:
    """The law's force, message and next state, for each axis."""
    if e.has.sums:
        for a in e.axes:
            a.sums = e.total(law_of(run, a), a.s, a.at, a.rx)
        # Field by field from left to right, not with `sum`, which compensates from Python 3.12 on.
        over = e.axes[0].sums if len(e.axes) == 1 else e.Sums(
            *[reduce(add, [getattr(a.sums, field) for a in e.axes]) for field in e.fields])
        for a in e.axes:
            a.f_cmd, a.tx, a.s = e.law(law_of(run, a), a.s, a.at, a.rx, over)
    elif run.has.slave:
        for a in e.axes:
            a.f_cmd, a.tx, a.s = e.law(law_of(run, a), a.s, a.at, a.rx)
    else:
        for a in e.axes:
            a.f_cmd, a.s = e.law(law_of(run, a), a.s, a.at)


# Both ends in virtual time


def loop(  # noqa: PLR0912 - of which a structure has few
        run: Run, numbers: Any, law: Any, dt: float, count: int, x_limit: Any, start_m: Any, start_s: Any,
        play_m: Any, play_s: Any, size: int, ref: Any, held: Any, request: Any) -> Any:
    """A run of `count` ticks; what it returns is the recorder's."""
    run.law = law
    run.dt = dt
    run.half_dt = 0.5 * dt
    place_master(run, start_m, ref, held)
    sense_master(run, 0)
    if run.has.slave:
        place_slave(run, start_s, held)
        sense_slave(run)
    begin(run, run.m, numbers.m)
    if run.has.slave:
        begin(run, run.s, numbers.s)
        connect(run, size)
    for e in run.ends:
        if e.has.leaves_out:
            e.ran = -1
    run.recorder.begin(run, request, size)
    for k in range(count):
        # 1. what is sensed
        sense_master(run, k)
        if run.has.slave:
            sense_slave(run)
        # 2. what the link delivers at this tick
        if run.has.link:
            deliver(run, run.m, run.s, play_m, size, k)
            deliver(run, run.s, run.m, play_s, size, k)
        elif run.has.slave:
            exchange(run, k)
        # 3. the ends
        for e in run.ends:
            if e.has.leaves_out:
                attend(run, e, k, play_m if e.name == "m" else play_s)
            else:
                tick(run, e, k)
        run.recorder.step(run, k)
        if run.has.link:
            send(run, play_m, play_s, size, count, k)
        # 4. the forces are held for one tick while the bodies move
        move_master(run, k)
        if run.has.slave:
            move_slave(run)
        if run.recorder.lost(run, x_limit, k):
            break
    else:
        return run.recorder.outcome(run, count, True)
    return run.recorder.outcome(run, k + 1, False)


def attend(run: Run, e: End, k: int, orders: Any) -> None:
    """Run one end's tick k unless it is skipped; a skipped tick is skipped whole, and the force is held."""
    if run.has.deadband:
        e.stage.deadband.send = 0.0  # unless the tick is run
    if at(orders, k) > LEFT_OUT:
        run_late(run, e, k)


def run_late(run: Run, e: End, k: int) -> None:
    """Run one end's tick k, before which ticks may have been skipped."""
    ticks = k - e.ran
    e.ran = k
    e.span = ticks * run.dt
    for stage in e.stages:
        stage.late(run, e, ticks, ticks)
    tick(run, e, k)


def place_master(run: Run, start: Any, ref: Any, held: Any) -> None:
    """The master's body at rest where it starts."""
    for a in run.m.axes:
        a.x = start[a.i]
        a.v = 0.0
        a.f = 0.0
        a.slope = 0.0
        a.c = held.c_m[a.i]
        if run.m.has.felt:
            a.f_ext = 0.0
        if run.m.has.inner:
            a.z = held.z_m[a.i]
        if run.has.hand:
            a.r = ref[a.i]


def place_slave(run: Run, start: Any, held: Any) -> None:
    """The slave's body at rest where it starts."""
    run.capped = 0
    for a in run.s.axes:
        a.x = start[a.i]
        a.v = 0.0
        a.f = 0.0
        a.c = held.c_s[a.i]
        if run.s.has.inner:
            a.z = held.z_s[a.i]


def sense_master(run: Run, k: int) -> None:
    """The force of the hand, where it is worked out: the left limit at t_k, the force of the last tick still acting."""
    for a in run.m.axes:
        if run.m.has.felt and run.has.hand and run.m.has.inner:
            a.f_ext = run.held_force(a.c, a.x, a.v, a.f, at(a.r, k), a.slope, a.z)
        elif run.m.has.felt and run.has.hand:
            a.f_ext = run.grip_force(a.c, a.x, a.v, a.f, at(a.r, k), a.slope)


def sense_slave(run: Run) -> None:
    """The force on what the slave touches, where it is worked out."""
    for a in run.s.axes:
        if run.s.has.felt:
            a.f_ext = a.force(a.c, a.x, a.v, a.z) if run.s.has.inner else a.force(a.c, a.x, a.v)


def move_master(run: Run, k: int) -> None:
    """The master's body over one tick."""
    for a in run.m.axes:
        if run.has.hand and run.m.has.inner:
            a.x, a.v, a.z = run.move_held(
                a.c, a.x, a.v, a.f, at(a.r, k), at(a.r, k + 1), a.z)
        elif run.has.hand:
            a.x, a.v = run.move_gripped(a.c, a.x, a.v, a.f, at(a.r, k), at(a.r, k + 1))
        elif run.m.has.inner:
            a.x, a.v, a.z = run.move_held(a.c, a.x, a.v, a.f, 0.0, 0.0, a.z)
        else:
            a.x, a.v, a.overflowed = run.move_free(a.c, a.x, a.v, -a.f)
        if run.has.hand and run.m.has.felt:
            a.slope = (at(a.r, k + 1) - at(a.r, k)) / run.dt


def move_slave(run: Run) -> None:
    """The slave's body over one tick."""
    for a in run.s.axes:
        if run.s.has.inner:
            a.x, a.v, a.overflowed, a.z = a.move(a.c, a.x, a.v, a.f, a.z)
        else:
            a.x, a.v, a.overflowed = a.move(a.c, a.x, a.v, a.f)
        run.capped = run.capped + a.overflowed


# One end by itself


class LiveTick(NamedTuple):
    """Inputs of a live end at one tick; what stands per axis is a tuple. SI units."""

    k: int  # number of the tick, of this end
    x: Any  # the device's readings
    v: Any
    touch: Any  # the external force, or None
    got: bool  # there is a message to play
    newest: float  # number of the newest message, -1 before the first
    rx: Any  # the message
    heard: Any  # the integrals of the waves that came with it, or None
    gain: float  # of the guard
    held: Any  # the force that was held since the last tick
    since: int  # ticks since that force was set
    clutch: float  # 1.0 while the operator holds the clutch open, 2.0 or 3.0 of some axes, else 0.0
    present: float  # 1.0 while the operator is there, else 0.0
    scale: float = 1.0  # to which the operator's scale is set
    wants: float = 0.0  # 1.0 while the policy's switch is on
    renewed: float = 0.0  # 1.0 if an action of the policy came
    action: Any = None  # its newest one, or None without a policy


def live(
        run: Run, e: End, numbers: Any, law: Any, dt: float, x0: Any, v0: Any, touch0: Any
) -> Generator[Any, Any, None]:
    """A live end: a generator that is sent a `LiveTick`, and answers with force, message, the integrals of its waves
    where they are sent along, and row."""
    run.law = law
    run.dt = dt
    run.half_dt = 0.5 * dt
    for a in e.axes:
        a.x = x0[a.i]
        a.v = v0[a.i]
        if e.has.felt:
            a.f_ext = touch0[a.i]
    begin(run, e, getattr(numbers, e.name))
    if e.has.gain:
        e.stage.watchdog.g_held = 1.0
    (k, x, v, touch, e.got, newest, rx, heard, e.stage.watchdog.g, held, since, clutch, present, scale, wants, renewed,
     action) = yield
    k_before = k - 1
    while True:
        ticks = k - k_before
        k_before = k
        e.span = ticks * dt
        set_switches(e, clutch, present, scale)
        set_policy(e, wants, renewed, action)
        for stage in e.stages:
            stage.late(run, e, ticks, since)
        for a in e.axes:
            a.x = x[a.i]
            a.v = v[a.i]
            a.f = held[a.i]
            if e.has.felt:
                a.f_ext = touch[a.i]
        if e.got:
            if e.has.newest:
                e.newest = newest
            for a in e.axes:
                a.rx = rx[a.i]
                if run.has.integral:
                    a.heard = heard[a.i]
        tick(run, e, k)
        if e.has.gain:
            e.stage.watchdog.g_held = e.stage.watchdog.g
        (k, x, v, touch, e.got, newest, rx, heard, e.stage.watchdog.g, held, since, clutch, present, scale, wants,
         renewed, action) = yield (
            tuple([a.f for a in e.axes]), tuple([a.tx for a in e.axes]) if run.has.slave else None,
            tuple([a.sent for a in e.axes]) if run.has.integral else None, row(e))


def set_switches(e: End, clutch: float, present: float, scale: float) -> None:
    """The operator's switches as the device has them at this tick, and the scale that was ordered."""
    if e.stage.operator:
        e.stage.operator.clutch, e.stage.operator.present, e.stage.operator.scale_set = clutch, present, scale


def set_policy(e: End, wants: float, renewed: float, action: Any) -> None:
    """The policy's switch and its newest action at this tick."""
    if e.stage.handover:
        e.stage.handover.wants, e.stage.handover.renewed = wants, renewed
        for a, port in zip(e.axes, e.stage.handover.axes, strict=True):
            port.action = action[a.i]


def row(e: End) -> tuple[float, ...]:
    """Row of an end's record; its columns are `teleop.simulation.structure.columns`."""
    return tuple([getattr(record, field) for record, field in e.cells])


# The link of a run in virtual time: messages on their way between its ends


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
