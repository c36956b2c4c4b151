"""A scene's own source: the tick's text with only the lines that the scene needs, its axes unrolled."""

from __future__ import annotations

import re
from collections import namedtuple
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from inspect import getattr_static
from types import FunctionType
from typing import Any

from teleop.law import At, start_at
from teleop.scene.scene import Scene
from teleop.simulation.tick import BLOCKS, ENDS, LIVE, LOOP, MASTER, End, columns, features


def loop_text(scene: Scene) -> str:
    """The source of the whole virtual-time loop of this scene."""
    return specialise(LOOP, scene, MASTER)


def live_text(scene: Scene, e: str) -> str:
    """The source of one live end of this scene, a generator."""
    return specialise(LIVE, scene, ENDS[e], frozenset(("live", "watched")))


def compiled(scene: Scene, text: str, name: str, instead: Mapping[str, Any] | None = None) -> Callable[..., Any]:
    """The function `name` of a text made here, with the parts of the stack that it names, or others `instead`."""
    names = {**parts(scene), "new": tuple.__new__, **(instead or {})}
    exec(compile(text, f"<{name} of scene {scene.name}>", "exec"), names)
    function: Callable[..., Any] = names[name]
    return function


def parts(scene: Scene) -> dict[str, Any]:
    """What the texts of a scene name: its law's functions, and those of the stack that it needs."""
    from teleop.physics.plant import grip_force, move_free, move_gripped

    has, law = features(scene), scene.law
    found: dict[str, Any] = {
        "At": At, "start_at": start_at, "inf": float("inf"), "nan": float("nan"),
        "grip_force": grip_force, "move_free": move_free, "move_gripped": move_gripped,
    }
    if scene.slave is None:
        ends = {"begin_m": "start", "law_m": "force"}
    else:
        ends = {"begin_m": "master_start", "law_m": "master", "begin_s": "slave_start", "law_s": "slave"}
    found |= {word: _end_of(law, name) for word, name in ends.items()}
    for end in ENDS.values():
        if f"sums_{end.e}" in has:
            found |= {f"sums_{end.e}": _end_of(law, f"{end.end}_sums"),
                      f"Sums_{end.e}": sums_type(scene.law, end, scene.dt_ns / 1e9)}
        if f"velocity_{end.e}" in has:
            found[f"estimate_{end.e}"] = _device(scene, end.e).velocity.step
    if has & {"encoder_m", "encoder_s"}:
        from teleop.stages.device import encode

        found["encode"] = encode
    if "popc_m" in has:
        from teleop.stages.passivity_controller import damp

        found["damp"] = damp
    if "observe_m" in has:
        from teleop.stages.observer import coefficients, observe

        found |= {"coefficients": coefficients, "observe": observe}
    if has & {"watchdog", "cap"}:
        from teleop.stages.safety import cap, watch

        found["watch"], found["cap"] = watch, cap
    if "v_max" in has:
        from teleop.stages.safety import fade

        found["fade"] = fade
    if "power" in has:
        from teleop.stages.safety import pay, ration, refill

        found |= {"pay": pay, "ration": ration, "refill": refill}
    return found


def _end_of(law: Any, name: str) -> Callable[..., Any]:
    """An end of a law as a function of the law and the rest; of a law that wraps another, whatever it answers with."""
    own = getattr_static(type(law), name, None)
    if isinstance(own, FunctionType):
        return own
    end: Callable[..., Any] = getattr(law, name)
    return lambda _, *rest: end(*rest)


def beginnings(scene: Scene, places: Mapping[str, Sequence[float]]) -> Any:
    """The numbers that the texts of a scene begin with, as a NamedTuple; `places` are those of its ends, per axis."""
    has, dt = features(scene), scene.dt_ns / 1e9
    found: dict[str, Any] = {}
    for e, at in places.items():
        device = _device(scene, e)
        if f"encoder_{e}" in has:
            from teleop.stages.device import encode

            found[f"c_enc_{e}"] = c = device.encoder.coefficients()
            at = [encode(c, x) for x in at]  # noqa: PLW2901 - what is read there
        if f"velocity_{e}" in has:
            found[f"c_est_{e}"] = device.velocity.coefficients(dt)
            found[f"est_{e}"] = tuple([device.velocity.start(x) for x in at])
        if f"late_{e}" in has:
            found[f"line_{e}"] = (0.0,) * device.delay
        if f"slow_{e}" in has:
            found[f"every_{e}"] = device.every
    if "observe_m" in has and "m" in places:
        from teleop.stages.observer import coefficients

        assert scene.observer is not None  # what the feature means
        found["c_obs"] = coefficients(scene.observer, scene.master.mass, scene.master.damping, dt)
    for name, part in (("c_pc", scene.passivity), ("c_dog", scene.watchdog), ("c_cap", scene.cap)):
        if part is not None:
            found[name] = part.limits(dt)
    if "v_max" in has:
        found["c_speed"] = scene.cap.speed()  # type: ignore[union-attr]  # what the feature means
    if "power" in has:
        found["c_power"] = scene.cap.budget(dt)  # type: ignore[union-attr]  # the same
    return record("Given", tuple(found))(*found.values())


@lru_cache
def record(name: str, names: tuple[str, ...]) -> Any:
    """A NamedTuple of these fields: one and the same class whenever it is asked for."""
    return namedtuple(name, names)


def _device(scene: Scene, e: str) -> Any:
    return scene.device_m if e == "m" else scene.device_s


def sums_type(law: Any, end: End, dt: float) -> Any:
    """The NamedTuple that an end of a law sums over the axes, as a call at rest shows it."""
    still = start_at(0.0, 0.0, 0.0, dt)
    state, rx = getattr(law, f"{end.end}_start")(still)
    return type(getattr(law, f"{end.end}_sums")(state, still, rx))


def specialise(text: str, scene: Scene, end: End, more: frozenset[str] = frozenset(),
               blocks: Mapping[str, str] = BLOCKS) -> str:
    """A text with the lines that this scene needs, its axes unrolled and its names filled in.

    `more`: features beside those of the scene. `blocks`: the texts that stand within this one.
    """
    has = features(scene) | more
    lines = list(_unroll(_lines(text, scene, end, has, blocks), scene.axes))
    return "\n".join(lines) + "\n"


def _lines(text: str, scene: Scene, end: End, has: frozenset[str], blocks: Mapping[str, str]) -> Iterator[str]:
    """The lines that this scene needs, with the ends' texts put in and the ends' names filled in."""
    words = _words(scene, end, has)
    for raw in text.strip("\n").splitlines():
        line, _, wanted = raw.partition("#?")
        line, wanted = line.rstrip(), wanted.replace("{e}", end.e)
        if not line or not all((w[1:] not in has) if w[0] == "!" else (w in has) for w in wanted.split()):
            continue
        inner = re.fullmatch(r"( *)\[([A-Z]+)(?: (\S+))?\]", line.replace("{e}", end.e))
        if inner:
            block, whose = blocks[inner[2]], ENDS[inner[3] or end.e]
            yield from (inner[1] + line for line in _lines(block, scene, whose, has, blocks))
        else:
            yield re.sub(r"\{(\w+)\}", lambda found: words[found[1]], line)


def _words(scene: Scene, end: End, has: frozenset[str]) -> dict[str, str]:
    """What stands for the words in braces at one end."""
    e = end.e
    sensed, observed = f"sense_{e}" in has, f"observe_{e}" in has
    v, forth = f"v_hat_{e}@" if f"velocity_{e}" in has else f"v_{e}@", "-" if e == "m" else ""
    return {
        "e": e, "end": end.end, "out": end.out, "in": end.inward, "sensor": end.sensor,
        "tx_wave": end.tx_wave, "rx_wave": end.rx_wave,
        "x": f"q_{e}@" if f"encoder_{e}" in has else f"x_{e}@",
        "v": v, "along": f"{forth}{v}", "moved": f"{forth}dx_{e}@",  # the last two in the sense of the end's force
        "touch": f"{end.sensor}@" if sensed else "f_h_hat@" if observed else "nan",
        "dx": f"dx_{e}@" if f"dx_{e}" in has else "nan",
        "age": f"age_{e}" if f"age_{e}" in has else "inf" if "alone" in has else "nan",
        "fresh": "False" if "alone" in has else "True" if "repeats" in has else f"got_{e}",
        "places": "((<<x_m@>>,),)" if "alone" in has else "((<<x_m@>>,), (<<x_s@>>,))",
        "inner": f"({_inner('m', has)}, {_inner('s', has)})",
        "first_m": _packed("rx_s@", scene.axes), "first_s": _packed("rx_m@", scene.axes),
        "over": _over(scene, end, has),
        "row_e": _row(scene, e), "row_m": _row(scene, "m"),
        "row_s": "" if "alone" in has else _row(scene, "s"), "i": "@",
        "asked": "lag_x, lag_f, out, zero" if "lanes" in has else "lag_x, lag_f",
        "zero": "zero" if "lanes" in has else "0.0",
        **{f"r_{name}": f"sample(r@, {at})" if "compiled" in has else f"r@[{at}]"
           for name, at in (("0", "0"), ("k", "k"), ("next", "k + 1"))},
    }


def _over(scene: Scene, end: End, has: frozenset[str]) -> str:
    """Field by field sums over the axes, left to right (not `sum`, which compensates from Python 3.12)."""
    if f"sums_{end.e}" not in has or scene.axes == 1:
        return "sum0"
    fields = sums_type(scene.law, end, scene.dt_ns / 1e9)._fields
    sums = (" + ".join(f"sum{i}.{field}" for i in range(scene.axes)) for field in fields)
    return f"Sums_{end.e}({', '.join(sums)})"


def _packed(name: str, axes: int) -> str:
    return f"<<{name}>>" if axes == 1 else f"(<<{name}>>)"


def _inner(e: str, has: frozenset[str]) -> str:
    return f"(<<z_{e}@>>,)" if f"inner_{e}" in has else "()"


def _row(scene: Scene, e: str) -> str:
    return ", ".join(f"<<{name}>>" if "@" in name else name for name in columns(scene, e))


def _unroll(lines: Iterator[str], axes: int) -> Iterator[str]:
    for line in lines:
        flat = re.sub(r"<<(.*?)>>", lambda m: ", ".join(m[1].replace("@", str(i)) for i in range(axes)), line)
        if "@" in flat:
            yield from (flat.replace("@", str(i)) for i in range(axes))
        else:
            yield flat
