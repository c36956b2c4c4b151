"""The check of a law against teleop/law/__init__.py: `check_law(MyLaw())` passes, or refuses with one sentence.

A law is probed in situations in a fixed sequence, extremes among them, so one that passes once passes always. The
contract, with its sentences, is `teleop.law.contract`; a probe asks for it in situations that a run may reach, and
reports the arguments. Every engine of a sweep has to give the figures of a single run, to the bit. A law that cannot be
compiled, or not over lanes, makes no mistake: it runs by the next plainer engine, and a sweep says so.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from itertools import islice
from math import inf, isfinite, nan
from typing import Any, NamedTuple

from teleop.checks.conformance import try_conformance
from teleop.checks.search import try_worst
from teleop.checks.trials import DURATION, LOOPS, LOW, Swing, Tones, spread, trials, try_claims
from teleop.errors import Refused
from teleop.knob import knobs_of_fields
from teleop.law import At, reads
from teleop.law.contract import REMEMBER, REST, LawMistake, Method, check_contract, in_bits
from teleop.physics.plant import MassDamper
from teleop.scene.scene import Scene
from teleop.simulation.plan import link_plans
from teleop.simulation.prepared import prepare
from teleop.simulation.virtual import run
from teleop.sweeps.engine import ENGINES, compiles, kernel_of
from teleop.sweeps.kernels.kernel import LinkSchedule, RowInputs, available, figures, path_of, tree_of

ENDS = ("master", "slave")
TWO_PORT = ("master_start", "master", "slave_start", "slave")
ONE_PORT = ("start", "force")
AWKWARD = (0.0, -0.0, 1e-300, -1e-300, 5e-324, 1e50, -1e50)
BEYOND = (inf, -inf, nan, 1e300, -1e300)  # the last tick of a run that diverges
REACHES = ((), (), AWKWARD, AWKWARD, AWKWARD + BEYOND)  # of the probing runs: extremes beside the usual numbers
TICKS = 60  # of each probing run
FAR = 1e100  # a state beyond this belongs to a law that diverges, which is no fault of form; it begins anew
FIRST_VARYING = 9  # trials from this one on have a link that varies
ENGINE_ROWS = 3  # rows that every engine runs
MEASURES = frozenset((  # all that a law does shows in these; more of them take longer to compile
    "x_err_rms", "f_err_rms", "f_m_max", "f_s_max", "E_link_end", "E_port_min", "E_port_end", "E_law_min", "E_law_end"))
ENGINE_RUN = 0.1  # s of each run by every engine


def check_law(law: Any, *, compiled: bool = True, c: bool = False) -> None:
    """Raise `Refused` with one sentence for the first thing in which `law` is not a law; else return.

    It tries, in this order:

    - the class and its knobs, and the contract that every scene holds its law to (`teleop.law.contract`);
    - types and shapes of all answers, tick after tick; purity; finite answers to finite inputs, and no exception for
      any input; that an end reads no field of `At` but those that `reads` sees;
    - signs, starts, messages and the values that its conditions tell to type (`teleop.checks.conformance`);
    - the claims (`teleop.checks.trials`): an end draws no more from the waves than they brought; in closed loops with
      random masses, walls and links no claimed ledger goes below zero; the energy that it keeps came in by its ports;
    - the same where an adversary chooses gains, bodies, hand, walls and link (`teleop.checks.search`);
    - that every engine of a sweep gives the figures of a single run to the bit. `compiled=False` skips the compiled
      engines, which take some seconds;
    - with `c=True` that each end can be printed as C (`teleop emit`) and, where there is a compiler, that the C has the
      bits of Python, with tame inputs and with infinite, NaN, subnormal and huge ones.

    A one-port law (`start`, `force`) is tried in the same spirit: its one end alone, and its claim in closed loops.
    """
    if is_one_port(law):
        _check_class(law, ONE_PORT)
        check_contract(law)
        _probe_one_port(law)
        _try_port(law)
        try_worst(law)
        if c:
            try_c(law, Scene(law=law, master=MassDamper(mass=1.0)))
        return
    _check_class(law, TWO_PORT)
    check_contract(law)
    for name in ENDS:
        _probe(LawEnd.of(law, name))
    try_conformance(law)
    try_claims(law)
    try_worst(law)
    try_engines(law, compiled=compiled)
    if c:
        try_c(law, replace(next(iter(trials(law, spread(type(law).__name__)))), axes=1, observer=200.0))


def try_c(law: Any, scene: Scene) -> None:
    """Refuse a law that cannot be printed as C, or whose C has other bits than Python."""
    from teleop.emit.compiled import compare
    from teleop.emit.compiler import find_compiler

    for e in ("m", "s") if scene.slave is not None else ("m",):
        for difference in compare(scene, e, find_compiler()):
            first = difference.splitlines()[0]
            raise Refused(f"{type(law).__name__} is another law in C, at the end {e}: {first}; this is a defect "
                          "of teleop emit, so report it with the law")


def is_one_port(law: Any) -> bool:
    """True if the law has a part of a one-port law, and none of a law with two ends."""
    return any(hasattr(law, name) for name in ONE_PORT) and not any(hasattr(law, name) for name in TWO_PORT)


def _check_class(law: Any, parts: tuple[str, ...]) -> None:
    """A frozen, keyword-only dataclass of floats, final, with `parts`; where it checks its knobs it refuses NaN."""
    if isinstance(law, type):
        raise Refused(f"check_law takes a law, not its class; write check_law({law.__name__}())")
    kind = type(law)
    name = kind.__name__
    if not is_dataclass(law) or not kind.__dataclass_params__.frozen:
        raise Refused(f"{name} is no frozen dataclass; write @dataclass(frozen=True, kw_only=True) above it")
    if kind.__bases__ != (object,):
        raise Refused(f"{name} inherits from {kind.__bases__[0].__name__}; write both ends out, "
                      "a law has no base class")
    for needed in parts:
        if not callable(getattr(law, needed, None)):
            kind_of_law = "a law" if parts == TWO_PORT else "a one-port law"
            raise Refused(f"{name} has no {needed}; {kind_of_law} has {', '.join(parts[:-1])} and {parts[-1]}")
    claims = getattr(law, "claims", None)
    if not isinstance(claims, Mapping):
        raise Refused(f"{name}.claims is {claims!r}; write claims: ClassVar[dict[str, str]] = {{}}, or "
                      '{"E_link": "any link"}')
    kinds = {name: declared.kind for name, declared in knobs_of_fields(kind).items()}
    for knob in fields(law):
        _check_knob(law, name, knob.name, kinds.get(knob.name, knob.type), keyword=knob.kw_only is True)


def _check_knob(law: Any, name: str, knob: str, kind: object, *, keyword: bool) -> None:
    value = getattr(law, knob)
    if kind not in (float, "float") or isinstance(value, bool) or not isinstance(value, (int, float)):
        shown = getattr(kind, "__name__", kind)
        raise Refused(f"{name}.{knob} is {value!r} of {shown}; every field of a law is a number: "
                      f"declare {knob}: float")
    if not keyword:
        raise Refused(f"{name}.{knob} may be given by position; add kw_only=True to the dataclass")
    try:
        same = replace(law, **{knob: value})
    except Exception as error:
        raise Refused(f"{name} does not accept its own {knob}={value}: {error}; "
                      "mend __post_init__") from error
    if same != law:
        raise Refused(f"{name} made again with the same {knob} is another law; "
                      "let __post_init__ check and change nothing")
    if not hasattr(law, "__post_init__"):
        return  # checks nothing; what comes from a command line was checked there
    try:
        replace(law, **{knob: nan})
    except Refused:
        return
    except Exception as error:
        raise Refused(f"{name} meets {knob}=nan with {type(error).__name__}; "
                      f"let number({knob!r}, self.{knob}) of teleop refuse it") from error
    raise Refused(f"{name} accepts {knob}=nan; "
                  f"call number({knob!r}, self.{knob}) of teleop in __post_init__")


class Call(NamedTuple):
    """The arguments of one tick of one end."""

    s: Any
    at: At
    rx: Any
    beside: Any  # the sums of another axis, or None


@dataclass(frozen=True, kw_only=True, slots=True)
class LawEnd:
    """End of a law under test."""

    law: Any
    name: str
    start: Method
    tick: Method
    sums: Method | None
    seen: frozenset[str]  # the fields of At that it reads
    rx: type[Any]
    kinds: dict[str, type]  # of its state and of the message that it sends

    @classmethod
    def of(cls, law: Any, end: str) -> LawEnd:
        """The end `end` of `law`, its types taken from the two starts."""
        starts = {each: answer(Method(law, f"{each}_start"), REST) for each in ENDS}
        peer = ENDS[1 - ENDS.index(end)]
        sums = Method(law, f"{end}_sums") if hasattr(law, f"{end}_sums") else None
        seen = reads(getattr(law, end)) | (reads(getattr(law, sums.name)) if sums else frozenset())
        return cls(law=law, name=f"{type(law).__name__}.{end}", start=Method(law, f"{end}_start"),
                   tick=Method(law, end), sums=sums, seen=seen, rx=type(starts[end][1]),
                   kinds={"state": type(starts[end][0]), "message": type(starts[peer][1])})

    def arguments(self, call: Call) -> tuple[Any, ...]:
        """The arguments of the end's method; with sums over the axes, the sum of this axis and of the one beside it."""
        sums = self.sums_of(call)
        if sums is None:
            return call.s, call.at, call.rx
        if call.beside is not None:
            sums = type(sums)(*[a + b for a, b in zip(sums, call.beside, strict=True)])
        return call.s, call.at, call.rx, sums

    def sums_of(self, call: Call) -> Any:
        """The sums of this axis alone; None for an end without."""
        return None if self.sums is None else answer(self.sums, call.s, call.at, call.rx, finite=False)


def _probe(end: LawEnd) -> None:
    """Ask an end in many situations, tick after tick, and again in another order."""
    probed: list[tuple[tuple[Any, ...], str]] = []
    dice = spread(end.name)
    before = repr(end.law)
    for reach in REACHES:
        at = situation(dice, reach)._replace(f_held=0.0, dx=0.0, fresh=False, age=inf)
        began = answer(end.start, at, finite=False)
        check_blind_start(end.start, end.tick, at, end.seen, in_bits(began))
        s, beside = began[0], None
        for _ in range(TICKS):
            at = situation(dice, reach)
            rx = end.rx(*[value(dice, reach) for _ in end.rx._fields])
            call = Call(s, at, rx, beside)
            arguments = end.arguments(call)
            got = answer(end.tick, *arguments, kinds=end.kinds, finite=inf not in reach)
            bits = in_bits(got)
            ask_again(end.tick, arguments, bits)
            _check_unseen(end, call, bits)
            probed.append((arguments, bits))
            s, beside = got[2], end.sums_of(call)
            if not all(map(isfinite, s)):
                s = began[0]
    for arguments, bits in reversed(probed):
        ask_again(end.tick, arguments, bits)
    if repr(end.law) != before:
        raise Refused(f"{end.name} changed the law from {before} to {end.law!r}; use the state")


def _check_unseen(end: LawEnd, call: Call, bits: str) -> None:
    """Refuse an end with an answer that depends on a field it does not visibly read."""
    for field in At._fields:
        if field in end.seen:
            continue
        arguments = end.arguments(call._replace(at=without(call.at, field)))
        if in_bits(end.tick.call(*arguments)) != bits:
            raise unseen_read(end.tick, field)


def _probe_one_port(law: Any) -> None:
    """Ask a one-port law in many situations, tick after tick, and again in another order."""
    name = type(law).__name__
    start, force, seen = Method(law, "start"), Method(law, "force"), reads(law.force)
    kinds = {"state": type(answer(start, REST))}
    probed: list[tuple[Any, At, str]] = []
    dice = spread(name)
    before = repr(law)
    for reach in REACHES:
        at = situation(dice, reach)._replace(v=0.0, f_held=0.0, dx=0.0, fresh=False, age=inf)
        began = s = answer(start, at, finite=False)
        check_blind_start(start, force, at, seen, in_bits(began))
        for _ in range(TICKS):
            at = situation(dice, reach)
            got = answer(force, s, at, kinds=kinds, finite=inf not in reach)
            bits = in_bits(got)
            ask_again(force, (s, at), bits)
            for field in At._fields:
                if field not in seen and in_bits(force.call(s, without(at, field))) != bits:
                    raise unseen_read(force, field)
            probed.append((s, at, bits))
            s = got[1] if all(isfinite(each) and abs(each) < FAR for each in got[1]) else began
    for s, at, bits in reversed(probed):
        ask_again(force, (s, at), bits)
    if repr(law) != before:
        raise Refused(f"{name}.force changed the law from {before} to {law!r}; use the state")


def _try_port(law: Any) -> None:
    """Raise `Refused` if the law claims E_port and it falls below zero in one of its trials, or claims E_link."""
    name = type(law).__name__
    if "E_link" in law.claims:
        raise Refused(f"{name} claims E_link, but a one-port law has no link; leave E_link out of its claims")
    if "E_port" not in law.claims:
        return
    for scene in _port_trials(law, spread(name)):
        trace = run(scene).trace
        least, through = float(trace["E_port"].min()), float(abs(trace["E_port"]).max())
        if not least >= -max(LOW, 1e-12 * through):
            raise Refused(f"{name} claims E_port, which fell to {least:.3g} J with {scene.hand} and {scene.master}; "
                          "mend the law, or leave E_port out of its claims")


def _port_trials(law: Any, dice: Iterator[float]) -> Iterator[Scene]:
    """Scenes of a hand and a master on the law, with the energy ledger: hands and masters at random."""
    def between(low: float, high: float) -> float:
        """Draw a number, evenly in the logarithm."""
        return float(low * (high / low) ** next(dice))

    scene = Scene(law=law, master=MassDamper(mass=1.0), energy=True, duration=DURATION, x_limit=1e3)
    for i in range(LOOPS):
        yield replace(
            scene, axes=3 if i % 6 == 5 else 1, observer=None if i % 2 else 200.0,
            master=MassDamper(mass=between(0.02, 2.0), damping=2.0 * next(dice)),
            hand=Swing(mass=next(dice), k=between(10.0, 1000.0), d=between(0.1, 20.0),
                       reference=Tones(amplitude=0.05, rate=between(3.0, 60.0))),
        )


def answer(method: Method, *arguments: Any, kinds: Mapping[str, type] | None = None, finite: bool = True) -> Any:
    """The method's answer for `arguments`, judged by the contract with every number a float; `Refused` otherwise."""
    try:
        got = method.call(*arguments)
        method.judge(arguments, got, kinds, exact=True, finite=finite)
    except LawMistake as mistake:
        raise LawMistake(f"{mistake} (given {', '.join(map(repr, arguments))})") from None
    return got


def ask_again(method: Method, arguments: tuple[Any, ...], bits: str) -> None:
    """Refuse a method whose answer to the same arguments, `bits` as `in_bits` has it, is another one now."""
    if in_bits(method.call(*arguments)) != bits:
        raise method.refuse(arguments, f"answers the same arguments differently the second time; {REMEMBER}")


def unseen_read(method: Method, field: str) -> LawMistake:
    """The refusal of a method that reads a field of `At` which its lines do not name."""
    return LawMistake(f"{method.label}{method.first_line()} reads {field} where it cannot be seen; write at.{field} in "
                   f"{method.label} itself or in a plain function that it calls by name")


def check_blind_start(start: Method, end: Method, at: At, seen: frozenset[str], bits: str) -> None:
    """Refuse a start that reads `f` although its end does not: a force that no end reads is not measured."""
    if "f" not in seen and in_bits(start.call(without(at, "f"))) != bits:
        raise start.refuse((at,), f"reads f, but {end.label} does not, so it is not measured; start without it")


def without(at: At, field: str) -> At:
    """`at` with one field made to show: NaN, or for `fresh` the opposite."""
    changed: Mapping[str, Any] = {"fresh": not at.fresh} if field == "fresh" else {field: nan}
    return at._replace(**changed)


def value(dice: Iterator[float], reach: tuple[float, ...]) -> float:
    """A number of `reach`, or of either sign between 1e-4 and 10."""
    if reach and next(dice) < 0.5:
        return reach[int(next(dice) * len(reach))]
    size: float = 10.0 ** (5.0 * next(dice) - 4.0)
    return size if next(dice) < 0.5 else -size


def situation(dice: Iterator[float], reach: tuple[float, ...]) -> At:
    """A situation in SI units: numbers as `value` draws them; tick, span, age and gain within their own bounds."""
    x, v, f, f_held, dx = (value(dice, reach) for _ in range(5))
    age = (inf, 0.0, 1e-3, 0.05, 1e5)[int(next(dice) * 5)]
    fresh, dt = next(dice) < 0.5, (1e-3, 1e-3, 1e-6, 10.0)[int(next(dice) * 4)]
    ticks, gain = (1, 1, 2, 100)[int(next(dice) * 4)], (1.0, 1.0, 0.0, next(dice))[int(next(dice) * 4)]
    return At(x, v, f, f_held, dx, fresh, age, dt, ticks * dt, gain)


def try_engines(law: Any, *, compiled: bool) -> None:
    """Refuse a law if an engine gives other bits than a single run. `compiled`: try the compiled engines too."""
    name = type(law).__name__
    engines = ENGINES if compiled and compiles() else ("plain",)
    drawn = islice(trials(law, spread(name)), FIRST_VARYING, None)
    scenes = [replace(scene, axes=1, observer=200.0, playout=None, duration=ENGINE_RUN)
              for scene in islice(drawn, ENGINE_ROWS)]
    runs = [run(scene) for scene in scenes]
    measures = tuple(sorted(MEASURES & available(scenes[0])))
    for engine in engines:
        kernel, _ = kernel_of(prepare(scenes[0]), measures, engine)
        rows = []
        for scene in scenes:
            prepared, schedule = prepare(scene), LinkSchedule.of(link_plans(scene, 0))
            _, flat = kernel_of(prepared, measures, engine)
            plain = kernel.engine == "plain"
            numbers = tree_of(scene, prepared.bodies, compiled=False) if plain else None
            rows.append(RowInputs(numbers, flat, scene.ticks, schedule, path_of(scene, compiled=not plain)))
        for single, (status, _, swept) in zip(runs, figures(kernel, rows), strict=True):
            for measure in measures:
                if status != "diverged" and swept.get(measure) != single.metrics.get(measure):
                    raise Refused(f"{name} gives {measure} = {swept.get(measure)!r} by the engine {kernel.engine}, and "
                                  f"{single.metrics.get(measure)!r} in a single run; let a method depend on its "
                                  "arguments alone, and write x*x for x**2")
