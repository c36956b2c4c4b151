"""A scene's loop with running figures in place of a record: run as it is, or compiled.

It is the text of `teleop.tick` and the functions that text names, so a sweep runs the very lines that a single run and
a live end run, in the same order, and gives the same bits. What is compiled is each of these functions as it stands;
fast-math is off, so every engine agrees with plain Python to the last bit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields
from math import isfinite
from typing import TYPE_CHECKING, Any, NamedTuple

from teleop.batch.measures import MAGNITUDES, SUMS, least, most, root_mean, sound
from teleop.bodies import Bodies, Held
from teleop.scene import Scene
from teleop.source import beginnings, parts, specialise
from teleop.tick import LOOP, MASTER, features

if TYPE_CHECKING:
    from teleop.playout import Plan


class Kernel(NamedTuple):
    """A loop made for one structure of scene."""

    engine: str
    measures: tuple[str, ...]  # the figures that it gives, in order
    loop: Callable[..., tuple[int, int, tuple[float, ...]]]
    given: Any = None  # the type that its numbers come in; None: as they are
    law: Any = None  # and that of the law's


def available(scene: Scene) -> frozenset[str]:
    """The figures that a kernel of this scene can give."""
    has = features(scene)
    named = {name for name, (feature, _) in SUMS.items()
             if feature in has or feature not in ("waves", "energy", "watchdog")}
    of_slave = {"x_err_rms", "x_err_max", "f_err_rms", "f_err_max", "f_s_max", "f_env_max", "g_s_min"}
    return frozenset(named if scene.slave is not None else named - of_slave)


def kernel_text(scene: Scene, measures: Sequence[str]) -> str:
    """The source of a scene's loop that works out `measures` as it goes, and at its end whether all is finite."""
    has = features(scene)
    last = ["<<x_m@>>", "<<v_m@>>", "<<f_m@>>"]
    last += ["<<x_s@>>", "<<v_s@>>", "<<f_s@>>"] * (scene.slave is not None)
    last += ["E_link"] * ("waves" in has) + ["E_port"] * ("energy" in has)
    measured = "".join(f"{SUMS[name][1]}, " for name in measures)
    text = LOOP.replace("{measured}", f"({measured}sound({', '.join(last)}))")
    more = {"kernel", *(SUMS[name][0] for name in measures)}
    more |= {"felt_s"} if more & {"f_err", "f_env_max"} else set()
    more |= {"felt_m"} if "f_h_max" in more else set()
    return specialise(text, scene, MASTER, frozenset(more))


def names_of(scene: Scene, bodies: Bodies) -> dict[str, Any]:
    """What the kernel's text names."""
    return {
        **parts(scene), **bodies.functions(), "most": most, "least": least, "root_mean": root_mean, "sound": sound,
        "magnitude": MAGNITUDES[scene.axes],
    }


def plain(scene: Scene, bodies: Bodies, measures: Sequence[str]) -> Kernel:
    """The kernel in plain Python."""
    names = names_of(scene, bodies)
    exec(compile(kernel_text(scene, measures), f"<kernel of scene {scene.name}>", "exec"), names)
    return Kernel("plain", tuple(measures), names["loop"])


class Water(NamedTuple):
    """The link of a row, drawn up front: what rows with the same link, seed and clock share."""

    plans: tuple[Plan | None, Plan | None]  # forth, back
    plays: tuple[Any, Any]  # the same as arrays
    lags: tuple[int, int]
    size: int  # of a ring of messages

    @classmethod
    def of(cls, plans: tuple[Plan | None, Plan | None]) -> Water:
        """That of two plans."""
        import numpy as np

        plays = tuple([np.asarray([] if plan is None else plan.play, dtype=np.int64) for plan in plans])
        lags = tuple([1 if plan is None else lag_of(play) for plan, play in zip(plans, plays, strict=True)])
        size = max((plan.lag for plan in plans if plan is not None), default=0) + 1
        return cls(plans, plays, lags, size)  # type: ignore[arg-type]  # there are two

    def lags_until(self, ran: int) -> tuple[int, int]:
        """Those of a run that ended early."""
        if ran == len(self.plays[0]):
            return self.lags
        forth, back = [1 if plan is None else lag_of(play[:ran]) for plan, play in
                       zip(self.plans, self.plays, strict=True)]
        return forth, back


def numbers(kernel: Kernel, scene: Scene, bodies: Bodies, reference: Any, water: Water) -> tuple[Any, ...]:
    """The arguments of a row but for the sizes of its rings: plain Python keeps lists, compiled code takes arrays."""
    starts = {e: scene.vector(f"start_{e}", getattr(scene, f"start_{e}")) for e in ("m", "s")}
    begins, law, held = beginnings(scene, starts), scene.law, bodies.held()
    forth, back = water.plays
    if kernel.given is None:
        forth, back = (None if plan is None else plan.play for plan in water.plans)
    else:
        begins = kernel.given(*begins)
        law = kernel.law(*[float(getattr(law, field.name)) for field in fields(law)])
        held = Held(tuple(held.grip), 0 if held.z_m is None else held.z_m, held.c,
                    tuple([0 if z is None else z for z in held.z_s]))
    return (begins, law, scene.dt_ns / 1e9, scene.ticks, scene.x_limit, starts["m"], starts["s"], back, forth,
            water.size, reference, held)


def lag_of(play: Any) -> int:
    """The median age of the messages that were played, in ticks, as `teleop.metrics` has it."""
    import numpy as np

    fresh = np.flatnonzero(play >= 0)
    ages = np.sort(fresh - play[fresh])
    return int(ages[len(ages) // 2]) if len(ages) else 0


def figures(kernel: Kernel, given: tuple[Any, ...], water: Water) -> tuple[str, int, dict[str, float]]:
    """Status, ticks and figures of one row; a figure that is not finite is left out, as in a single run."""
    ran, _, told = kernel.loop(*given, water.lags[0] + 1, water.lags[1] + 1)
    if ran < 0:
        own = water.lags_until(-ran)
        if own != water.lags:  # the lag of a run that ended early is that of the messages which came until then
            ran, _, told = kernel.loop(*given, own[0] + 1, own[1] + 1)
    status = "ok" if ran >= 0 and told[-1] == 1.0 else "diverged"
    named = zip(kernel.measures, told[:-1], strict=True)
    return status, abs(ran), {name: float(value) for name, value in named if isfinite(value)}
