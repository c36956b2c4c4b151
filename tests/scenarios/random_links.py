"""Random links and scenes to put them in: `drawn` gives the knobs of this file's own scene, all from one seed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from channel.link import parse_link
from master.hand import Grip, Reach, Rest, Sine
from teleop import Energy, Fixed, Integral, Law, Playout, Reference, Refused, Scene, Zero, load_scene
from teleop.scene.knobs import knobs_of
from teleop.scene.library import built_in_scenes, scene_function
from teleop.scene.playout import Gaps

Dice = np.random.Generator
RECORDINGS = 6  # of either kind
MOTIONS = ("sine", "reach", "hold")


def scene(
    *,
    law: Law,
    base: str = "canonical",  # the scene that this one is, but for its hand
    playout: Playout = Zero(),  # noqa: B008 - frozen
    motion: str = "sine",  # sine, reach, or hold: the hand is let go beside the place where it wants to be
    amplitude: float = 0.05,  # m
    rate: float = 1.0,  # Hz, or 1/s of a reach
    m_h: float = 0.4,  # kg, of the hand
    k_h: float = 200.0,  # N/m
    d_h: float = 5.0,  # N s/m
    k_e: float = 5e3,  # N/m, where the base has an environment that this can be said of
    d_e: float = 5.0,  # N s/m
    wall: float = 0.03,  # m
    axes: int = 1,  # of a base that has one
    dt: float = 1e-3,  # s
    duration: float = 0.8,  # s
) -> Scene:
    """Any scene of the library, with a hand and a playout of one's own."""
    known = knobs_of(scene_function(base))
    own = {name: value for name, value in (("k_e", k_e), ("d_e", d_e), ("wall", wall)) if name in known}
    made = load_scene(base, law=law, dt=dt, duration=duration, energy=True, **own)
    count = axes if made.axes == 1 else made.axes
    to = (amplitude, -0.6 * amplitude, 0.3 * amplitude)[:count]
    references: dict[str, Reference] = {
        "sine": Sine(amplitude=to, frequency=rate), "reach": Reach(to=to, duration=1.0 / rate), "hold": Rest(at=to)}
    units = made.axis_units if made.axes == count else made.axis_units * count
    return replace(made, axes=count, units=units, playout=playout,
                   hand=Grip(mass=m_h, k=k_h, d=d_h, reference=references[motion]))


@cache
def bases() -> tuple[str, ...]:
    """The scenes of up to three axes that have a slave and need no file of the user's."""
    whole = [name for name in built_in_scenes()
             if all(default is not ... for _, default, _ in knobs_of(scene_function(name)).values())]
    made = {name: load_scene(name) for name in whole}
    # A policy is drawn beside random links in tests/teleop/stages/test_handover.py.
    return tuple(name for name in whole if made[name].slave is not None and made[name].axes <= 3 and
                 made[name].handover is None)


# -- links


def _within(dice: Dice, low: float, high: float) -> float:
    """A number from `low` to `high`, one time in four the one or the other."""
    at = float(dice.random())
    return low if at < 0.125 else high if at > 0.875 else float(dice.uniform(low, high))


def _jitter(dice: Dice, dt: float) -> float:
    """s: up to some ticks, or up to half a second."""
    return _within(dice, 0.0, 10.0 * dt if dice.random() < 0.5 else 0.5)


def _blackout(dice: Dice, run: float) -> str:
    start, gone = _within(dice, 0.0, run), _within(dice, 0.0, 0.25 * run)
    every = "" if dice.random() < 0.5 else f", every={gone + 1e-6 + float(dice.uniform(0.0, run))!r}"
    return f"blackout({start!r}, {gone!r}{every})"


def _delay(dice: Dice, run: float, dt: float) -> str:
    some = [0.0, dt * int(dice.integers(100)), 2e-4 * run * 1e4 ** float(dice.random())]
    return f"delay({some[int(dice.integers(3))]!r})"


def makers(run: float, dt: float, files: Mapping[str, list[Path]]) -> dict[str, Callable[[Dice], str]]:
    """How each effect is drawn, as text, for runs of `run` s in ticks of `dt` s; ends of ranges come up often."""
    def replayed(dice: Dice, name: str) -> str:
        return f"{name}({str(files[name][int(dice.integers(RECORDINGS))])!r}, start={_within(dice, 0.0, 1.0)!r}"

    return {
        "bernoulli": lambda dice: f"bernoulli({_within(dice, 0.0, 0.9)!r})",
        "blackout": lambda dice: _blackout(dice, run),
        "delay": lambda dice: _delay(dice, run, dt),
        "duplicate": lambda dice: f"duplicate({_within(dice, 0.0, 0.5)!r}, after={_jitter(dice, dt)!r})",
        "gamma": lambda dice: f"gamma({_jitter(dice, dt)!r}, {10.0 ** _within(dice, -1.3, 2.0)!r})",
        "gilbert_elliott": lambda dice: (
            f"gilbert_elliott({_within(dice, 0.001, 1.0)!r}, {_within(dice, 0.01, 1.0)!r}, "
            f"loss_good={_within(dice, 0.0, 0.2)!r}, loss_bad={_within(dice, 0.0, 1.0)!r})"),
        "in_order": lambda dice: "in_order()",  # noqa: ARG005
        "mahimahi": lambda dice: f"{replayed(dice, 'mahimahi')}, queue={int(dice.integers(1, 300))})",
        "normal": lambda dice: f"normal({_jitter(dice, dt)!r}, {_jitter(dice, dt)!r})",
        "ping_log": lambda dice: f"{replayed(dice, 'ping_log')})",
        "uniform": lambda dice: f"uniform({_jitter(dice, dt)!r})",
    }


def a_link(dice: Dice, effects: Mapping[str, Callable[[Dice], str]], run: float) -> str:
    """One to four effects each way; once in eight times the ways are alike. One link in three is of `late_copies`."""
    names = list(effects)
    while True:
        ways = [" | ".join(effects[names[i]](dice) for i in dice.integers(len(names), size=int(dice.integers(1, 5))))
                for _ in range(1 if dice.random() < 0.125 else 2)]
        if dice.random() < 1.0 / 3.0:
            ways = [late_copies(dice, run) for _ in range(2)]
        with suppress(Refused):  # in_order() behind a queue that receives out of order
            parse_link(" ; ".join(ways))
            return " ; ".join(ways)


def late_copies(dice: Dice, run: float) -> str:
    """A link that is dark when the copies of what came before come: where they were played, it would be active.

    Most random chains lose more than copies could bring back.
    """
    start, gone = float(dice.uniform(0.05, 0.6)) * run, float(dice.uniform(0.05, 0.25)) * run
    return (f"delay({float(dice.uniform(0.0, 0.1)) * run!r}) | blackout({start!r}, {gone!r}) | "
            f"duplicate({_within(dice, 0.5, 1.0)!r}, after={float(dice.uniform(0.2, 1.0)) * gone!r})")


def record(folder: Path, dice: Dice) -> dict[str, list[Path]]:
    """Recordings for the effects that replay one, in files in `folder`: smooth and ragged, quick and slow."""
    files: dict[str, list[Path]] = {"mahimahi": [], "ping_log": []}
    for i in range(RECORDINGS):
        steps = dice.integers(0, int(dice.choice([2, 4, 60])), size=300)
        files["mahimahi"].append(folder / f"trace_{i}")
        files["mahimahi"][-1].write_text("".join(f"{ms}\n" for ms in [*np.cumsum(steps).tolist(), 1 + steps.sum()]))
        rtt = dice.gamma(2.0, float(dice.choice([1.0, 20.0, 200.0])), size=200)  # ms
        ends = [(1.7e9 + 0.02 * n + ms / 1e3, n, ms) for n, ms in enumerate(rtt.tolist(), 1) if dice.random() > 0.1]
        files["ping_log"].append(folder / f"ping_{i}")
        files["ping_log"][-1].write_text("".join(
            f"[{t:.6f}] 64 bytes from 192.0.2.1: icmp_seq={n} ttl=57 time={ms:.3f} ms\n" for t, n, ms in sorted(ends)))
    return files


# -- rows


def turned(law: Any, dice: Dice) -> Any:
    """The law with each of its numbers up to five times greater or less, where it takes that."""
    for knob in fields(law):
        with suppress(Refused):
            law = replace(law, **{knob.name: getattr(law, knob.name) * 5.0 ** float(dice.uniform(-1.0, 1.0))})
    return law


def drawn(law: Any, dice: Dice, ticks: int, files: Mapping[str, list[Path]]) -> dict[str, Any]:
    """The knobs of a row: a link, and a scene with a playout that puts nothing in the gaps."""
    dt = 1e-6 * round(1e6 * _within(dice, 5e-4, 3e-3))
    run = ticks * dt
    return {
        "law": turned(law, dice), "link": a_link(dice, makers(run, dt, files), run), "dt": dt, "duration": run,
        "playout": "zero" if dice.random() < 0.5 else f"fixed:{dt * (1 + int(dice.integers(ticks // 3)))!r}",
        "axes": 3 if dice.random() < 0.125 else 1,
        "motion": MOTIONS[int(dice.integers(3))], "amplitude": float(dice.uniform(-0.1, 0.1)),
        "rate": 0.5 * 20.0 ** float(dice.random()), "m_h": float(dice.uniform(0.1, 1.0)),
        "k_h": 20.0 * 50.0 ** float(dice.random()), "d_h": float(dice.uniform(0.5, 20.0)),
        "k_e": 10.0 * 1e4 ** float(dice.random()), "d_e": float(dice.uniform(0.0, 20.0)),
        "wall": float(dice.uniform(-0.02, 0.03)), "x_limit": 10.0,  # a law may diverge; rounding is not to show
    }


def integrated(knobs: Mapping[str, Any], dice: Dice) -> dict[str, Any]:
    """The same row with waves played by their integral, or at once within the energy."""
    dt, playout = float(knobs["dt"]), str(knobs["playout"])
    own = Integral(
        [0.0, dt * int(dice.integers(1, 20))][int(dice.integers(2))],
        settle=10.0 ** _within(dice, -3.0, 1.0), memory=[0.0, 10.0 ** _within(dice, -2.0, 1.0)][int(dice.integers(2))],
        ahead=[0.0, _within(dice, 0.0, 0.2)][int(dice.integers(2))])
    gaps: Gaps = [Integral(), own, Energy()][int(dice.integers(3))]
    return {**knobs, "playout": gaps if playout == "zero" else Fixed(float(playout.partition(":")[2]), gaps)}


def late(knobs: Mapping[str, Any], dice: Dice) -> dict[str, Any]:
    """The same row with ticks left out at both ends."""
    return {**knobs, "left_out": _within(dice, 0.01, 0.6)}


def held(knobs: Mapping[str, Any]) -> dict[str, Any]:
    """The same row with the last message played again in the gaps, which no law can keep passive."""
    playout = str(knobs["playout"])
    return {**knobs, "playout": "hold" if playout == "zero" else f"{playout}:hold"}
