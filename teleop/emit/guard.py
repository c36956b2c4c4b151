"""The guard around a printed tick: `begin` and `step`, from the functions of `teleop.protocol.guard`.

What stands here in C is the order of things, that of `teleop.protocol.endpoint.Endpoint.tick`; what decides is printed.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from teleop.emit.statements import Statements
from teleop.emit.ticks import WHAT, PrintedTick, record_line
from teleop.emit.types import BOOL, DOUBLE, INT, Printed, comment
from teleop.emit.vectors import places
from teleop.protocol.guard import (
    BLIND_NS,
    CAUSES,
    LAPSING,
    UNNAMED,
    guard_begin,
    guard_fall,
    guard_step,
    let_down,
)
from teleop.protocol.states import Cause
from teleop.scene.scene import Scene
from teleop.simulation.expressions import Known
from teleop.stages.force_cap import LONGEST, Cap, caps

LAW = "LAW", "the law had no finite force: a fault, or an unstable loop; only `begin` ends this"


class GuardNumbers(NamedTuple):
    """Numbers of the guard, in ticks of this end."""

    limits: Any
    lapses: float  # from one tick to the next after which the motor has let go by itself; inf: it never does
    longest: float  # without a share of the law's force, after which none is held
    blind: float  # without a reading, after which no force is held
    caps: tuple[Any, ...]  # for each axis


class Guard(NamedTuple):
    """The guard in C: what the header has of it, and its functions."""

    header: str
    text: str


def guard_numbers(scene: Scene, deadline: float | None = None) -> GuardNumbers:
    """The numbers of a scene's guard. `deadline`: seconds after which the motor lets go by itself; None: never."""
    dt = scene.dt_ns / 1e9
    limits = caps(scene) if scene.cap is not None else (Cap(),) * scene.axes
    return GuardNumbers(
        (scene.watchdog or UNNAMED).limits(dt), float("inf") if deadline is None else max(1.0, LAPSING * deadline / dt),
        LONGEST / dt + 0.5, BLIND_NS / scene.dt_ns, tuple([each.limits(dt) for each in limits]))


def with_guard(scene: Scene, tick: PrintedTick) -> tuple[PrintedTick, Guard]:
    """The tick with the guard's numbers among its parameters, and the guard."""
    program, types, prefix, axes = tick.program, tick.program.types, tick.prefix, scene.axes
    numbers = guard_numbers(scene)
    kind = types.of_value(numbers)
    caller = Statements(program, guard_step)

    def call(function: Any, *arguments: Any) -> Printed:
        values = [Printed(*each) if isinstance(each, tuple) else Known(each) for each in arguments]
        made = caller.call(function, values, {})
        assert isinstance(made, Printed)
        return made

    limits = (kind.members["limits"], "p->guard.limits")
    begun = call(guard_begin, (INT, "k"), 1)
    state = begun.type
    for _ in range(2):  # the second time with the types that the first one found
        stepped = call(guard_step, limits, (state, "e->guard"), (DOUBLE, "p->dt"), 1, (DOUBLE, "p->guard.lapses"),
                       (INT, "k"), (BOOL, "got"), (INT, "k"), (INT, "k - number"), (DOUBLE, "m->unheard"),
                       (INT, "trouble"), (INT, "over"))
        joined = types.join(state, stepped.type.members["part0"])
        state = joined
    held = kind.members["caps"]
    down = call(let_down, (held.of, "p->guard.caps.at[i]"), (DOUBLE, "part"), (DOUBLE, "e->held[i]"))
    fall = call(guard_fall, (DOUBLE, "e->guard.gain"), (DOUBLE, "p->guard.limits.step"), (INT, "passed"),
                (DOUBLE, "p->guard.lapses"))
    begun = Printed(state, caller.to(begun, state))
    records = {**tick.records, "params": {**tick.records["params"], "guard": kind}}
    inputs, outputs = records["in"], records["out"]
    scalars = "\n".join([f"    in->{name} = {text};" for name, text in FILL.items() if name in inputs])
    per_axis = "\n".join([f"        in->{name}[i] = {text};" for name, text in FILL_AXES.items() if name in inputs])
    causes = [("FINE", "the law's force is held"), *[(each.name, each.value) for each in CAUSES], LAW]
    pairs = {
        "fill": f"{scalars}\n    for (i = 0; i < {axes}; i++) {{\n{per_axis}\n    }}",
        "n": axes, "prefix": prefix, "upper": prefix.upper(), "real": types.c(DOUBLE), "begun": begun.text,
        "down": down.text,
        "stepped": stepped.text, "answer": types.c(stepped.type), "fall": fall.text, "state": types.c(state),
        "device": CAUSES.index(Cause.DEVICE), "over": CAUSES.index(Cause.SESSION_OVER), "law": len(CAUSES),
        "clock": CAUSES.index(Cause.CLOCK),
        "causes": ",\n".join([f"    {prefix.upper()}{word} = {i} /* {why} */"
                              for i, (word, why) in enumerate(causes, -1)]),
        "fields": _lines(types, inputs, ("touch", "heard", "rx", "clutch", "scale", "wants", "renewed", "action")) + (
            f"\n    {types.c(DOUBLE)} absent;  /* 1 while the operator is not there */" if "present" in inputs else ""),
        "out": _lines(types, outputs, ("tx", "sent")), "columns": outputs["row"].count,
        "row": comment(", ".join(tick.columns)),
        "finite_reading": _finite({name: inputs[name] for name in ("touch",) if name in inputs}, "m"),
        "finite_message": _finite({name: inputs[name] for name in ("rx", "heard") if name in inputs}, "m"),
        "finite_answer": _finite({name: outputs[name] for name in ("tx", "sent") if name in outputs}, "out"),
        "copy": "".join([f"    for (i = 0; i < {axes}; i++) a->{name}[i] = out->{name}[i];\n"
                         for name in ("tx", "sent") if name in outputs]),
    }

    def filled(text: str) -> str:
        for word, value in pairs.items():
            text = text.replace(f"@{word}@", str(value))
        return text

    literal = f"{tick.numbers[:-1]}, {types.literal(numbers, kind)}}}"
    return tick._replace(records=records, numbers=literal, public=(state,)), Guard(filled(HEADER), filled(TEXT))


def _lines(types: Any, members: dict[str, Any], names: tuple[str, ...]) -> str:
    """The declarations of those of these fields that there are."""
    return "\n".join([record_line(types, name, members[name], WHAT[name]) for name in names if name in members])


def _finite(members: dict[str, Any], of: str) -> str:
    """Conditions that these numbers are finite."""
    return "".join([f" && isfinite({text})" for name, kind in members.items()
                    for text, _ in places(kind, f"{of}->{name}")])


FILL = {"k": "k", "got": "got", "newest": "(@real@)e->newest", "gain": "e->guard.gain", "since": "since",
        "clutch": "m->clutch", "present": "1 - m->absent", "scale": "m->scale > 0 ? m->scale : 1",
        "wants": "m->wants", "renewed": "m->renewed"}
FILL_AXES = {"x": "m->x[i] - e->origin[i]", "v": "m->v[i]", "touch": "m->touch[i]", "rx": "m->rx[i]",
             "heard": "m->heard[i]", "held": "e->held[i]", "action": "m->action[i] - e->origin[i]"}

HEADER = """
enum { /* why an end lets its force go */
@causes@
};

typedef struct { /* this end with its guard, between two ticks */
    @prefix@state law;
    @state@ guard;
    @real@ held[@n@];    /* the force that the motor holds, N */
    @real@ origin[@n@];  /* from where the law's positions count, m */
    int64_t k;           /* the last tick */
    int64_t set;         /* the tick at which the force was set last */
    int64_t ran;         /* the last tick with a reading */
    int64_t newest;      /* number of the newest message, -1 before the first */
    int64_t calls;       /* since the clock last went on */
    bool failed;
} @prefix@end;

typedef struct { /* what is known at a tick */
    uint32_t k;          /* number of this tick: what the clock shows, in ticks; it may wrap */
    bool ready;          /* the device was read: x, v and, where it is there, touch */
    @real@ x[@n@];       /* position, m */
    @real@ v[@n@];       /* velocity, m/s */
    bool got;            /* a message has come since the last tick: */
    uint32_t number;     /* the tick at which it was sent */
@fields@
    double unheard;      /* for how long the other end had heard nothing of this one when it sent the message, s */
    bool over;           /* the session is over */
} @prefix@moment;

typedef struct {
    @real@ force[@n@];   /* for the motor, N: to be held until the next tick */
    bool send;           /* there is a message to send, with the number of this tick: */
@out@
    int reason;          /* why the force goes, or has gone: -1, or one of the causes */
    unsigned faults;     /* of the law at this tick */
    @real@ row[@columns@];@row@
} @prefix@answer;

/* Begin a session at tick k, where the device is: x (m), v (m/s), external force touch (N), one number an axis; the
   law's positions count from `origin` (m). Messages of an earlier session do not count. Returns faults of the law. */
unsigned @prefix@begin(@prefix@end *e, const @prefix@params *p, uint32_t k, const @real@ *x, const @real@ *v,
    const @real@ *touch, const @real@ *origin);

/* One tick with the guard: to be called once a tick of the clock, whether or not a message has come. */
void @prefix@step(@prefix@end *e, const @prefix@params *p, const @prefix@moment *m, @prefix@answer *a);
"""

TEXT = """
unsigned @prefix@begin(@prefix@end *e, const @prefix@params *p, uint32_t now, const @real@ *x, const @real@ *v,
    const @real@ *touch, const @real@ *origin)
{
    const int64_t k = now;
    @real@ from[@n@];
    int i;
    for (i = 0; i < @n@; i++) {
        e->origin[i] = origin[i];
        from[i] = x[i] - origin[i];
        e->held[i] = 0;
    }
    e->guard = @begun@;
    e->k = e->set = e->ran = k - 1;
    e->newest = -1;
    e->calls = 0;
    e->failed = false;
    return @prefix@init(&e->law, p, from, v, touch);
}

static void @prefix@hold(@prefix@end *e, const @prefix@params *p, @real@ before)
{
    const @real@ part = before > 0 ? e->guard.gain / before : 0;
    int i;
    for (i = 0; i < @n@; i++) e->held[i] = @down@;
}

static bool @prefix@run(@prefix@end *e, const @prefix@params *p, const @prefix@moment *m, int64_t k, bool got,
    int64_t since, @prefix@answer *a)
{
    @prefix@in inputs, *const in = &inputs;
    @prefix@out outputs, *const out = &outputs;
    bool finite = true;
    int i;
    (void)since;
    (void)got;
    (void)k;
@fill@
    a->faults = @prefix@tick(&e->law, p, in, out);
    if (a->faults) return false;
    for (i = 0; i < @n@; i++) finite = finite && isfinite(out->force[i]);
    for (i = 0; i < @columns@; i++) a->row[i] = out->row[i];
    a->send = true@finite_answer@;
@copy@    for (i = 0; finite && i < @n@; i++) e->held[i] = out->force[i];
    return finite;
}

void @prefix@step(@prefix@end *e, const @prefix@params *p, const @prefix@moment *m, @prefix@answer *a)
{
    const int64_t k = e->k + (int32_t)(m->k - (uint32_t)e->k), passed = k - e->k, since = k - e->set;
    const int64_t number = k + (int32_t)(m->number - (uint32_t)k);
    const @real@ before = e->guard.gain;
    int64_t trouble = -1, over = m->over ? @over@ : -1;
    bool ready = m->ready, got = m->got@finite_message@;
    int i;
    a->send = false;
    a->faults = 0;
    if (passed <= 0) { /* the clock stands still, or went back: no tick, and no force for long */
        if (++e->calls > p->guard.limits.timeout_ticks)
            for (i = 0; i < @n@; i++) e->held[i] = 0;
        a->reason = e->calls > p->guard.limits.timeout_ticks ? @clock@ : e->failed ? @law@ : (int)e->guard.cause;
    } else {
        if (e->calls > p->guard.limits.timeout_ticks) e->guard.gain = 0;
        e->calls = 0;
        for (i = 0; i < @n@; i++) ready = ready && isfinite(m->x[i]) && isfinite(m->v[i]);
        ready = ready@finite_reading@;
        got = got && ready && number > e->newest && number - k <= p->guard.limits.timeout_ticks;
        if (got) e->newest = number;
        if (e->failed) {
            e->guard.gain = @fall@;
            e->guard.shareless = e->guard.gain > 0 ? 0 : e->guard.shareless + passed;
        } else {
            if (!ready) trouble = @device@;
            const @answer@ next = @stepped@;
            e->guard = next.part0;
        }
        const bool lapsed = passed > p->guard.lapses, blind = !ready && k - e->ran > p->guard.blind;
        if (blind || (!ready && lapsed)) e->guard.gain = 0;
        if (lapsed || blind || e->guard.shareless > p->guard.longest)
            for (i = 0; i < @n@; i++) e->held[i] = 0;
        e->k = e->set = k;
        if (!ready || e->failed) @prefix@hold(e, p, before);
        else if (!@prefix@run(e, p, m, k, got, since, a)) e->failed = true;
        if (ready) e->ran = k;
        a->reason = e->failed ? @law@ : (int)e->guard.cause;
    }
    for (i = 0; i < @n@; i++) a->force[i] = e->held[i];
}
"""
