"""A scene's own source: the tick's text with only the lines that the scene needs, its axes unrolled."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from teleop.law import At
from teleop.scene import Scene
from teleop.tick import END, ENDS, LIVE, LOOP, MASTER, START, End, columns, features


def loop_text(scene: Scene) -> str:
    """The source of the whole virtual-time loop of this scene."""
    return specialise(LOOP, scene, MASTER)


def live_text(scene: Scene, e: str) -> str:
    """The source of one live end of this scene, a generator."""
    return specialise(LIVE, scene, ENDS[e])


def compiled(scene: Scene, text: str, name: str, instead: Mapping[str, Any] | None = None) -> Callable[..., Any]:
    """The function `name` of a text made here, with the parts of the stack that it names, or others `instead`."""
    has = features(scene)
    from teleop.law import start_at

    parts: dict[str, Any] = {"new": tuple.__new__, "At": At, "start_at": start_at, "inf": float("inf"),
                             "nan": float("nan")}
    if has & {"sums_m", "sums_s"}:
        parts["over_axes"] = over_axes
    if has & {"encoder_m", "encoder_s"}:
        from teleop.device import encode

        parts["encode"] = encode
    if "popc_m" in has:
        from teleop.popc import damp

        parts["damp"] = damp
    if "observe_m" in has:
        from teleop.observer import coefficients, observe

        parts |= {"coefficients": coefficients, "observe": observe}
    if has & {"watchdog", "cap"}:
        from teleop.safety import cap, watch

        parts["watch"], parts["cap"] = watch, cap
    from teleop.plant import grip_force, move_free, move_gripped

    parts |= {"grip_force": grip_force, "move_free": move_free, "move_gripped": move_gripped}
    parts |= instead or {}
    exec(compile(text, f"<{name} of scene {scene.name}>", "exec"), parts)
    function: Callable[..., Any] = parts[name]
    return function


def over_axes(first: Any, *others: Any) -> Any:
    """Field by field sums over the axes, left to right (not `sum`, which compensates from Python 3.12)."""
    total = first
    for other in others:
        total = type(first)(*[a + b for a, b in zip(total, other, strict=True)])
    return total


def specialise(text: str, scene: Scene, end: End) -> str:
    """A text with the lines that this scene needs, its axes unrolled and its names filled in."""
    has = features(scene)
    lines = list(_unroll(_lines(text, scene, end, has), scene.axes))
    return "\n".join(lines) + "\n"


def _lines(text: str, scene: Scene, end: End, has: frozenset[str]) -> Iterator[str]:
    """The lines that this scene needs, with the ends' texts put in and the ends' names filled in."""
    for raw in text.strip("\n").splitlines():
        line, _, wanted = raw.partition("#?")
        line, wanted = line.rstrip(), wanted.replace("{e}", end.e)
        if not line or not all((w[1:] not in has) if w[0] == "!" else (w in has) for w in wanted.split()):
            continue
        inner = re.fullmatch(r"( *)\[(START|END) (\S+)\]", line.replace("{e}", end.e))
        if inner:
            block = {"START": START, "END": END}[inner[2]]
            yield from (inner[1] + line for line in _lines(block, scene, ENDS[inner[3]], has))
        else:
            yield _named(line, scene, end, has)


def _named(line: str, scene: Scene, end: End, has: frozenset[str]) -> str:
    e = end.e
    sensed, observed = f"sense_{e}" in has, f"observe_{e}" in has
    words = {
        "e": e, "end": end.end, "out": end.out, "in": end.inward, "sensor": end.sensor,
        "tx_wave": end.tx_wave, "rx_wave": end.rx_wave,
        "x": f"q_{e}@" if f"encoder_{e}" in has else f"x_{e}@",
        "v": f"v_hat_{e}@" if f"velocity_{e}" in has else f"v_{e}@",
        "touch": f"{end.sensor}@" if sensed else "f_h_hat@" if observed else "nan",
        "dx": f"dx_{e}@" if f"dx_{e}" in has else "nan",
        "age": f"age_{e}" if f"age_{e}" in has else "inf" if "alone" in has else "nan",
        "fresh": "False" if "alone" in has else "True" if "repeats" in has else f"got_{e}",
        "places": "((<<x_m@>>,),)" if "alone" in has else "((<<x_m@>>,), (<<x_s@>>,))",
        "inner": f"({_inner('m', has)}, {_inner('s', has)})",
        "over": "sum0" if scene.axes == 1 else "over_axes(<<sum@>>)",
        "row_e": _row(scene, e), "row_m": _row(scene, "m"),
        "row_s": "" if "alone" in has else _row(scene, "s"), "i": "@",
    }
    return re.sub(r"\{(\w+)\}", lambda found: words[found[1]], line)


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
