"""A linear scene as two small state spaces and the whole ticks between them.

    x(k+1) = A x(k) + B rx(k)        tx(k) = C x(k) + D rx(k)

one for each end: its plant, sensor or observer, law and held force, in all axes. What an end does in a tick is not
written again here: `STEP` holds the lines of the tick itself (`teleop.simulation.tick`), made into a function of the
end's state and message. Its matrices are read off at unit vectors and then tried at random points over twelve decades;
what does not answer to them there is not linear and is refused. A message sent at tick k is used at tick k + delay:
that is kept beside the matrices as a number, since as a state it would be as long as the delay.

Constant forces and places of rest drop out: stability is that of the motion about them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import repeat
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from teleop.errors import Refused, enumerated
from teleop.law import law_name, messages
from teleop.law.analysis_offers import linear_hint, linear_law
from teleop.scene.playout import Fixed, Integral, Scaled, Zero, as_typed, gaps_of
from teleop.scene.scene import Scene
from teleop.simulation.bodies import exact_bodies
from teleop.simulation.source import functions, lines
from teleop.simulation.structure import NAMES, numbers_of, structure_of
from teleop.simulation.tick import begin as begin_end
from teleop.simulation.tick import move_master, move_slave, place_master, place_slave, sense_master, sense_slave, tick
from teleop.stages.end import End, Run

Matrix = NDArray[np.float64]
INSTEAD = "ask with --time, which runs it in virtual time"


class StateSpace(NamedTuple):
    """State space of an end: `A` (n, n), `B` (n, fields in), `C` (fields out, n), `D` (fields out, fields in)."""

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix


class LinearScene(NamedTuple):
    """Both ends of a linear scene, and the delays between them in whole ticks."""

    master: StateSpace  # from the messages it receives to those it sends
    slave: StateSpace
    forth: int
    back: int
    dt: float  # s

    @property
    def round_trip(self) -> int:
        """Ticks there and back."""
        return self.forth + self.back


def linear_scene(scene: Scene, *, seed: int = 0) -> LinearScene:
    """The matrices of a linear scene, at least one tick each way. Refused if something in it is not linear."""
    scene = about_rest(with_linear_law(scene))
    refuse_nonlinear_parts(scene)
    for name in ("device_m", "device_s"):
        if (device := scene.per_axis(name)[0]) is not None and device.every > 1:
            raise NotLinear(f"{name} renews its force every {device.every} ticks, so the loop is not time-invariant",
                            f", or {without(scene, 'set every=1', every='1')}")
    for name in ("master", "slave"):
        if any(getattr(body, "every", 1) > 1 for body in scene.per_axis(name)):
            raise NotLinear(f"the {name}'s servo hears of its goal every few ticks, so the loop is not time-invariant",
                            f", or {without(scene, 'give it every=1, and the scene the dt of its bus', every='1')}")
    forth, back = link_ticks(scene, seed)
    return LinearScene(_end(scene, "m", back), _end(scene, "s", forth), forth, back, scene.dt_ns / 1e9)


def with_linear_law(scene: Scene) -> Scene:
    """The scene with the linear law that its law offers in its place; as it is if the law offers none."""
    linear = [linear_law(law) for law in scene.laws]
    if linear[0] is None:
        return scene
    return replace(scene, law=tuple(linear) if isinstance(scene.law, tuple) else linear[0])


def about_rest(scene: Scene) -> Scene:
    """The scene about a place of rest: an environment that is moved along a path stands still in its own frame.

    An operator's clutch is closed: what it is opened for has no loop through the hand.
    """
    if scene.operator is not None:
        scene = replace(scene, operator=None)
    if not any(hasattr(one, "path") for one in scene.environments):
        return scene
    return replace(scene, environment=tuple(getattr(one, "environment", one) for one in scene.environments))


class NotLinear(Refused):
    """A refusal of a scene that has no eigenvalues: why, and what to type in place of --time, if anything helps."""

    def __init__(self, why: str, way_out: str = "") -> None:
        super().__init__(why, way_out)
        self.why, self._way_out = why, way_out

    def __str__(self) -> str:
        return f"{self.why}; {INSTEAD}{self._way_out}"


class InTheWay(NamedTuple):
    """A part of a scene that is not linear: its name in a sentence, and what takes it out, typed or in words."""

    what: str
    typed: str  # options of the command line; empty: no knob of the scene does
    words: str  # empty: nothing does


def refuse_nonlinear_parts(scene: Scene) -> None:
    """Refuse ticks left out, a queue of waves that is kept, and all at once a cap, a deadband, a passivity controller,
    an encoder, friction and environments not linear, with the law if that is neither."""
    if scene.leaves_out("m") is not None or scene.leaves_out("s") is not None:
        words = "leave left_out_m and left_out_s away; in place of a recorded link give --link 'delay(0.05)'"
        raise NotLinear("ticks are left out, so the loop is not time-invariant and its scene has no eigenvalues",
                        f", or {without(scene, words, left_out='0')}")
    if isinstance(gaps := scene.wave_playout, Integral) and gaps.target > 0.0:
        raise NotLinear(f"the playout {as_typed(scene.played_as)} keeps a queue of waves, which lags as their energy "
                        "has it, so its scene has no eigenvalues", ", or leave the seconds of the queue out")
    parts, bare = _nonlinear_parts(scene)
    sums = any(hasattr(scene.laws[0], f"{end}_sums") for end in ("master", "slave"))
    if sums and scene.rotations:
        parts.append(InTheWay(f"law {law_name(scene.laws[0])} over an orientation", "--set law=wave", ""))
    elif parts and (law := _law_in_the_way(replace(bare, rotations=()))) is not None:  # of axes that turn by themselves
        parts.append(law)
    if not parts:
        return
    if len(parts) == 1:
        (one,) = parts
        way_out = f", or {f'leave it out with {one.typed}' if one.typed else one.words}"
        raise NotLinear(f"{one.what} is not linear, so the scene has no eigenvalues", way_out)
    typed = " ".join(each.typed for each in parts if each.typed)
    cures = [*[f"make it linear with {typed}"] * bool(typed), *[each.words for each in parts if not each.typed]]
    way_out = f", or {' and '.join(cures)}" if all(cures) else ""  # a law that is never linear has none
    raise NotLinear(f"{enumerated([each.what for each in parts])} are not linear, so the scene has no eigenvalues",
                    way_out)


def _nonlinear_parts(scene: Scene) -> tuple[list[InTheWay], Scene]:
    """Parts of a scene beside its law that are not linear, and the scene without them."""
    parts: list[InTheWay] = []
    changes: dict[str, Any] = {}
    if scene.cap is not None:
        parts.append(InTheWay("a force cap", typed_off(scene, f_max="none", slew="none", v_max="none", power="none"),
                              "leave the cap out"))
        changes["cap"] = None
    if scene.deadband is not None:
        parts.append(InTheWay("a deadband", typed_off(scene, deadband="0"), "leave it away, deadband=None"))
        changes["deadband"] = None
    if scene.passivity is not None:
        parts.append(InTheWay("a passivity controller", typed_off(scene, cap="none"), "leave the controller out"))
        changes["passivity"] = None
    devices = {name: scene.per_axis(name) for name in ("device_m", "device_s")}
    if any(device is not None and device.encoder is not None for each in devices.values() for device in each):
        parts.append(InTheWay("an encoder", typed_off(scene, step="none"), "leave the encoder out"))
        changes |= {name: tuple([device and replace(device, encoder=None) for device in axes])
                    for name, axes in devices.items() if getattr(scene, name) is not None}
    bodies = {name: scene.per_axis(name) for name in ("master", "slave")}
    if any(body is not None and body.friction > 0.0 and not hasattr(body, "linear")
           for each in bodies.values() for body in each):
        typed = typed_off(scene, friction="0", friction_m="0", friction_s="0")
        parts.append(InTheWay("Coulomb friction", typed, "set friction=0"))
        changes |= {name: tuple([replace(body, friction=0.0) for body in axes])
                    for name, axes in bodies.items() if getattr(scene, name) is not None}
    if any(hasattr(body, "linear") and body.linear() != body for each in bodies.values() for body in each):
        typed = typed_off(scene, friction="0", backlash="0", counts="0", stall="none", dead="0")
        parts.append(InTheWay("friction, backlash, counts, stall or dead zone of a position servo", typed,
                              "take servo.linear()"))
        changes |= {name: tuple([body.linear() if hasattr(body, "linear") else body for body in axes])
                    for name, axes in bodies.items() if getattr(scene, name) is not None}
    bare = replace(scene, **changes)
    curved = _nonlinear_environments(bare)
    if curved:
        what = enumerated(list(dict.fromkeys(curved.values())))
        # Of one axis nothing touched would be left.
        typed = typed_off(scene, k_e="0", d_e="0", stop="none") if scene.axes > 1 else ""
        parts.append(InTheWay(what, typed, "put a bonded tissue in its place (the scene soft_tissue has one)"))
        bare = replace(bare, environment=tuple([None if i in curved else one
                                                for i, one in enumerate(scene.environments)]))
    return parts, bare


def _nonlinear_environments(scene: Scene) -> dict[int, str]:
    """The class of each environment that is not linear, by the index of its axis."""
    options = {}
    for i, (environment, plant) in enumerate(zip(scene.environments, exact_bodies(scene).slaves, strict=False)):
        def respond(at: Sequence[float], plant: Any = plant) -> list[float]:
            if plant.start is None:
                return [*plant.move(plant.c, *at)[:2], plant.force(plant.c, at[0], at[1])]
            inner = like(plant.start, iter(at[3:]))
            x, v, _, z = plant.move(plant.c, *at[:3], inner)
            return [x, v, *flat(z), plant.force(plant.c, at[0], at[1], inner)]

        if environment is not None and matrix(respond, 3 + len(flat(plant.start or ()))) is None:
            options[i] = type(environment).__name__
    return options


def _law_in_the_way(scene: Scene) -> InTheWay | None:
    """The law of a scene whose other parts are linear, if that is not; one with a single end is not judged here."""
    if scene.slave is None:
        return None
    try:
        for e in ("m", "s"):
            _end(scene, e, 1)
    except Refused:
        return InTheWay(f"law {law_name(scene.laws[0])}", linear_hint(scene.laws[0], ""), "")
    return None


def without(scene: Scene, words: str, **knobs: str) -> str:
    """Options that take a part out of a scene, by those of `knobs` that it has in use; else `words`."""
    typed = typed_off(scene, **knobs)
    return f"leave it out with {typed}" if typed else words


def typed_off(scene: Scene, **knobs: str) -> str:
    """The options that set those of these `knobs` that a scene has and has in use; empty if there are none."""
    values = {name: scene.knobs.get(name) for name in knobs}
    return " ".join(f"--set {name}={value}" for name, value in knobs.items()
                    if values[name] is not None and (value == "none" or values[name] != float(value)))


def linear_estimator(scene: Scene) -> str:
    """The option that names a linear velocity estimator."""
    if "velocity" in scene.knobs:
        return "take a linear one, --set 'velocity=backward_difference()' or 'velocity=low_pass(cutoff=30)'"
    return "take BackwardDifference or LowPass"


def link_ticks(scene: Scene, seed: int = 0) -> tuple[int, int]:
    """Whole ticks from sending to use, forth and back, as the scene's own run has them.

    Every packet of that run (of the first 100,000) must come, and all after the same number of ticks; jitter that a
    fixed playout takes up is as good as none. Refused otherwise.
    """
    if scene.link is None:
        return 1, 1
    count = min(scene.ticks, 100_000)
    fixed = scene.played_as.ticks(scene.dt_ns) if isinstance(scene.played_as, Fixed) else 0
    columns = []
    for direction in (0, 1):
        arrivals = scene.link.arrivals(direction, count, scene.dt_ns, seed, scene.wire_size)
        lag = np.maximum(1, -(-arrivals.time_ns // scene.dt_ns) - arrivals.packet)
        soonest = np.full(count, np.iinfo(np.int64).max)  # that of a packet that never comes
        np.minimum.at(soonest, arrivals.packet, lag)
        played = np.maximum(soonest, fixed)
        if (played != played[0]).any() or not 0 < played[0] <= (fixed or 1 << 62):
            raise NotLinear("the link does not bring every packet after the same number of ticks, so the loop is not "
                            "time-invariant", ", or write for example --link 'delay(0.05)'")
        columns.append(int(played[0]))
    return columns[0], columns[1]


def matrix(function: Callable[[Sequence[float]], Sequence[float]], size: int) -> Matrix | None:
    """The Jacobian of an affine function of `size` numbers, or None if the function is not affine.

    Read off at unit vectors about zero, then tried at 48 points: all sizes from 1e-6 to 1e6 alike, and mixed. A
    deviation above 1e-9 of the terms that meet there is one too many, or above the rounding of the largest
    coefficient of each number: a small one may be the difference of large ones.
    """
    def at(point: Matrix) -> Matrix:
        return np.array(function(point.tolist()), dtype=float)

    dice = np.random.Generator(np.random.Philox(key=1))  # the same points each time
    try:
        zero = at(np.zeros(size))
        columns = [at(row) - zero for row in np.eye(size)]
        jacobian = np.array(columns).T.reshape(len(zero), size)
        rounding = 1e-14 * np.abs(jacobian).max(axis=0, initial=0.0)
        for i in range(48):
            scale = 10.0 ** (dice.uniform(-6.0, 6.0, size) if i % 2 else np.full(size, i % 12 - 5.0))
            point = dice.uniform(-1.0, 1.0, size) * scale
            met = np.abs(jacobian) @ np.abs(point) + np.abs(zero)
            off = np.abs(at(point) - zero - jacobian @ point)
            if not (off <= 1e-9 * met + rounding @ np.abs(point) + 1e-300).all():
                return None
    except (ArithmeticError, ValueError, TypeError):
        return None
    return jacobian if np.isfinite(jacobian).all() else None


def end_function(scene: Scene, e: str, age: int) -> Callable[[Any], tuple[list[float], list[float]]]:
    """Make one tick of an end (m or s) a function of its state and message, to its next state and the message it sends.

    Given are the state and then the message, as one run of floats: for each axis x, v and the held force; the body's
    inner state; x of the tick before; what the stages keep; the law's state; the message's fields; of these only what
    the end has. `age` is that of the message, in ticks; without a slave it is the number of the tick.
    """
    function, numbers = _build_end(scene, e, step, [0.0] * scene.axes)
    return lambda state: function(*numbers, age, state)


def begin(scene: Scene, e: str, x0: float = 0.0) -> list[float]:
    """The state of `end_function` in which an end starts at `x0` (m)."""
    function, numbers = _build_end(scene, e, start, [x0] * scene.axes)
    state: list[float] = function(*numbers)
    return state


def _build_end(scene: Scene, e: str, entry: Callable[..., Any], places: list[float]) -> tuple[Callable[..., Any], Any]:
    # A watchdog leaves a link that always delivers alone, and over a constant delay these playouts play the same.
    gaps = gaps_of(scene.played_as)
    bare = replace(scene, energy=False, watchdog=None, playout=gaps if isinstance(gaps, Scaled) else Zero())
    bodies = exact_bodies(bare)
    made = lines(structure_of(bare), entry, ends=(e,)).function({**functions(bare), **bodies.functions()})
    return made, (numbers_of(bare, {e: places}), bare.law, bare.dt_ns / 1e9, places, [STILL] * bare.axes,
                  bodies.numbers())


def start(run: Run, e: End, values: Any, law: Any, dt: float, places: Any, ref: Any, held: Any) -> list[float]:
    """The state in which an end starts at `places`, m per axis."""
    run.law = law
    run.dt = dt
    if e.name == "m":
        place_master(run, places, ref, held)
    else:
        place_slave(run, places, held)
    for a in e.axes:
        if e.has.felt:
            a.f_ext = 0.0
    begin_end(run, e, getattr(values, e.name))
    return flat([getattr(record, field) for record, field in e.memory])


def step(run: Run, e: End, values: Any, law: Any, dt: float, places: Any, ref: Any, held: Any, k: int, numbers: Any
         ) -> tuple[list[float], list[float]]:
    """Carry out one tick of an end with the state and message in `numbers`: its next state, the message it sends."""
    start(run, e, values, law, dt, places, ref, held)
    if run.has.slave:
        e.got = True
    if e.has.newest:
        e.newest = 0
    take = iter(numbers)
    for record, field in e.memory:
        setattr(record, field, like(getattr(record, field), take))
    if run.has.slave:
        for a in e.axes:
            a.rx = like(a.rx, take)
    if e.name == "m":
        sense_master(run, k)
        tick(run, e, k)
        move_master(run, k)
    else:
        sense_slave(run)
        tick(run, e, k)
        move_slave(run)
    state = flat([getattr(record, field) for record, field in e.memory])
    return state, flat([a.tx for a in e.axes]) if run.has.slave else []


class ZeroReference:
    """A hand's reference that stays at zero."""

    def __getitem__(self, k: int) -> float:
        return 0.0


STILL = ZeroReference()


def flat(values: Sequence[Any]) -> list[float]:
    """The numbers of these values, numbers and tuples of numbers, as one list."""
    return [number for each in values for number in (flat(each) if isinstance(each, tuple) else (each,))]


def like(sample: Any, take: Iterator[float]) -> Any:
    """The next number, or of a tuple one of the same type, and of those in it, with the next numbers in it."""
    return tuple.__new__(type(sample), [like(each, take) for each in sample]) if isinstance(
        sample, tuple) else next(take)


def _end(scene: Scene, e: str, age: int) -> StateSpace:
    step = end_function(scene, e, age)
    forth, back = messages(scene.laws[0], scene.dt_ns / 1e9)
    fields_in = len((back if e == "m" else forth)._fields) * scene.axes
    n = len(step(repeat(0.0))[0])
    jacobian = matrix(lambda numbers: [number for part in step(numbers) for number in part], n + fields_in)
    if jacobian is None:
        raise not_linear(scene, e)
    return StateSpace(jacobian[:n, :n], jacobian[:n, n:], jacobian[n:, :n], jacobian[n:, n:])


def not_linear(scene: Scene, e: str) -> NotLinear:
    """The answer to a law that is not linear at one of its ends."""
    device = scene.per_axis(f"device_{e}")[0]
    estimator = device and device.velocity
    if estimator is not None and not is_linear(estimator, scene.dt_ns / 1e9):
        return NotLinear(f"the velocity estimator {type(estimator).__name__} is not linear, so the scene has no "
                         "eigenvalues", f", or {linear_estimator(scene)}")
    name = law_name(scene.laws[0])
    hint = linear_hint(scene.laws[0], ", or write ")
    where = "where it is in contact" if scene.slave is None else f"at the {NAMES[e]}"
    return NotLinear(f"law {name} is not linear {where}, so the scene has no eigenvalues", hint)


def is_linear(estimator: Any, dt: float) -> bool:
    """True if the velocity that an estimator makes is a linear function of the positions."""
    start, c = estimator.start(0.0), estimator.coefficients(dt)

    def respond(numbers: Sequence[float]) -> list[float]:
        v, s = estimator.step(c, tuple(numbers[1:]), numbers[0], dt)
        return [v, *s]

    return matrix(respond, 1 + len(start)) is not None
