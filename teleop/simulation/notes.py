"""Notes on packets that were never played, and on what is played in the gaps; and what to type."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from math import inf
from typing import Any

import numpy as np

from teleop.errors import enumerated, number_of
from teleop.law import innermost, law_name
from teleop.law.offers import AgeRange, Facts, broken
from teleop.scene.axes import told_along
from teleop.scene.playout import Energy, Fixed, Hold, Integral, Playout, Scaled, Zero, as_typed, gaps_of
from teleop.scene.scene import Scene
from teleop.simulation.plan import LinkPlans, Packets, link_plans
from teleop.stages.memory import LEFT_OUT
from teleop.stages.slave_units import scales

SHARE = 0.99  # of the packets that come, which a longer playout is to play
FADES = 0.001  # of the ticks: where so many are gaps, a steady force has lost a twentieth of itself in ten seconds
ENOUGH = 1_000_000  # packets that tell how late those of a link come: an open-ended live run has 86 million
MARGIN = 0.01  # s, live: what the machine adds to the link


def untuned(scene: Scene) -> list[str]:
    """The note on a law that is not the scene's own and has its defaults, which nobody chose for this scene."""
    law, usual = scene.laws[0], scene.own_law[0] if isinstance(scene.own_law, tuple) else scene.own_law
    if usual is None or innermost(type(law)) is innermost(type(usual)) or not all(map(_has_defaults, scene.laws)):
        return []
    return [f"law {law_name(law)} runs with its defaults, which are not tuned for scene {scene.name}; set its gains "
            "with --set law.NAME=VALUE, or search them with teleop tune"]


def _has_defaults(law: Any) -> bool:
    """True if every number of a law, stages around it left out, is the law's default; False of one without numbers."""
    kind = innermost(type(law))
    numbers = [each for each in fields(kind) if each.init] if is_dataclass(kind) else []
    return bool(numbers) and all(getattr(law, each.name) == each.default for each in numbers)


def unplayed(scene: Scene, trace: Mapping[str, Any], packets: Mapping[str, Packets], *, seed: int, live: bool = False
             ) -> list[str]:
    """The notes on directions of the link in which no packet was played, or more came too late than were played.

    `packets`: the counts of each direction, "fwd" and "bwd".
    """
    return [note for direction, (way, seq, end) in enumerate((("fwd", "seq_s", "slave"), ("bwd", "seq_m", "master")))
            if way in packets and seq in trace
            for note in _unplayed(scene, direction, end, packets[way], int((trace[seq] >= 0).sum()), seed, live)]


def faded(scene: Scene, trace: Mapping[str, Any]) -> list[str]:
    """The note on waves that are played as zero in gaps, where more than `FADES` of an end's ticks are gaps."""
    if not isinstance(scene.wave_playout, Zero):
        return []
    clauses = []
    for seq, end in (("seq_s", "slave"), ("seq_m", "master")):
        if seq in trace and (played := trace[seq] >= 0).any():
            since = played[int(played.argmax()):]  # before the first message there is nothing to fade
            gaps = int((~since).sum())
            clauses += [f"{gaps} of {number_of(len(since), 'tick')} at the {end}"] * (gaps > FADES * len(since))
    if not clauses:
        return []
    return [f"waves were played as zero in gaps, {' and '.join(clauses)}: a steady force fades; "
            f"{_take_integral(scene)}"]


def in_gaps(scene: Scene) -> str:
    """Clause on how an end plays ticks for which there is no message."""
    gaps = scene.wave_playout
    if isinstance(gaps, Integral):
        return ("its queue of waves grows as long as the longest gap, and a gap that is longer than the queue is felt "
                "as a short dip of the force")
    if isinstance(gaps, Energy):
        return "it plays what it is owed of their waves late, in short bursts"
    if isinstance(gaps, Hold):
        return "it plays the last wave again in their place, which is active"
    if isinstance(gaps, Scaled):
        return "it plays the last wave again in their place, scaled down, so a steady force fades"
    if isinstance(gaps, Zero):
        cure = "" if scene.link is None else f" ({_take_integral(scene)}, at both ends)"
        return f"it plays waves as zero in their place, so a steady force fades{cure}"
    return "its law does without"


def _take_integral(scene: Scene) -> str:
    playout = scene.played_as
    better: Playout = Fixed(playout.delay, Integral()) if isinstance(playout, Fixed) else Integral()
    return f"type --set playout={as_typed(better)}" if scene.knobs else f"in a scene of your own write playout={better}"


def _unplayed(scene: Scene, direction: int, end: str, counts: Packets, played: int, seed: int, live: bool
              ) -> list[str]:
    sender = "master" if end == "slave" else "slave"
    if not counts.sent or (played and counts.late <= played):
        return []
    if counts.late > played:
        late = number_of(counts.late, "packet")
        return [f"{late} came to the {end} too late to be played, and {played} were played: the playout "
                f"({as_typed(scene.played_as)}) is shorter than the link's delay and jitter; "
                f"{_longer(scene, direction, seed, live)}"]
    so = f"the {end} played none of the {number_of(counts.sent, 'packet')} that the {sender} sent, and ran without them"
    if counts.lost == counts.sent:
        return [f"{so}: the link lost them all; type another, for example --link 'delay(0.05)'"]
    if not counts.received and scene.leaves_out(end[0]) is not None:
        return [f"{so}: none came before the last tick that the {end} ran; type a smaller --set left_out, or a longer "
                "--set duration"]
    if not counts.received:
        return [f"{so}: none came within the {scene.duration:g} s of the run, so the link takes longer than the run; "
                "type a smaller --set delay, or a --set duration that is longer than the link's delay"]
    return [f"{so}: {counts.received} came, and their time to be played was after the end; type a longer "
            "--set duration, or a shorter playout"]


def _longer(scene: Scene, direction: int, seed: int, live: bool) -> str:
    """Words to type for a playout that is long enough for nearly all packets that the scene's link lets through."""
    count = min(scene.ticks, ENOUGH)
    arrivals = scene.link.arrivals(direction, count, scene.dt_ns, seed, scene.wire_size)  # type: ignore[union-attr]  # packets came late on one
    ages = arrivals.time_ns - arrivals.packet * scene.dt_ns
    enough = float(np.quantile(ages, SHARE, method="higher")) / 1e9 + MARGIN * live if len(ages) else 0.0
    ticks = max(1, int(np.ceil(round(enough / scene.dt, 6)))) * scene.dt
    longer = Fixed(float(f"{ticks:.9g}"), gaps_of(scene.played_as))
    return (f"type --set playout={as_typed(longer)}" if scene.knobs  # it was found by its name
            else f"in a scene of your own write playout={longer}")


_NUMBER = re.compile(r"\d+(\.\d+)?(e[+-]?\d+)?")


def facts_of(scene: Scene, seed: int = 0, axis: int = 0) -> Facts:
    """The facts of an axis of a scene with two ends, as a run in virtual time with this seed has them.

    Raises `Refused`.
    """
    return facts(scene, axis, *of_plans(scene, link_plans(scene, seed), scene.ticks))


def unmet(scene: Scene, seed: int = 0) -> list[str]:
    """The sentences on conditions of the law that link and bodies break in a run in virtual time with this seed."""
    return law_notes(scene, *of_plans(scene, link_plans(scene, seed), scene.ticks))


def fitted(scene: Scene, seed: int = 0) -> Scene:
    """The scene with the law of each axis fitted to link and bodies, where it knows how (`teleop.law.offers`).

    The knobs of the scene keep what was typed, so the command that runs it is that of the law's own numbers.
    """
    if scene.slave is None or not hasattr(scene.laws[0], "fitted"):
        return scene
    link = of_plans(scene, link_plans(scene, seed), scene.ticks)
    laws = tuple([law.fitted(facts(scene, i, *link)) for i, law in enumerate(scene.laws)])
    same = not isinstance(scene.law, tuple) and laws.count(laws[0]) == len(laws)
    return replace(scene, law=laws[0] if same else laws)


def of_plans(scene: Scene, plans: LinkPlans, ran: int) -> tuple[AgeRange | None, AgeRange | None, bool, float]:
    """Facts on the link and the skipped ticks of the first `ran` ticks of a run in virtual time."""
    dt = scene.dt_ns / 1e9
    delays = [AgeRange(dt, dt) if plan is None else delay(np.arange(ran), plan.played_at[:ran], dt) for plan in plans]
    if scene.deadband is not None:  # of what could be sent, before it is known what is: a silence more
        silence = inf if scene.deadband.keep_alive is None else scene.deadband.keep_alive
        delays = [each if each is None or plan is None or plan.due is None else
                  each._replace(greatest=each.greatest + silence) for each, plan in zip(delays, plans, strict=True)]
    held = max([longest(np.flatnonzero(plan.played_at[:ran] > LEFT_OUT), ran) for plan in plans if plan is not None],
               default=1)
    return delays[0], delays[1], any(plan is not None and plan.lost > 0 for plan in plans), held * dt


def longest(ticks: Any, end: int | None = None) -> int:
    """The most ticks from one of these that were run to the next, and to the `end` of the run; 1 at least."""
    at = np.asarray(ticks, dtype=np.int64)
    return int(np.diff(at if end is None else np.append(at, end)).max(initial=1))


def delay(ticks: Any, played: Any, dt: float) -> AgeRange | None:
    """The delay of one direction. `played`: at each of these ticks the packet played, below zero for none."""
    at, newest = np.asarray(ticks, dtype=np.int64), np.maximum.accumulate(np.asarray(played, dtype=np.int64))
    ages = (at - newest)[newest >= 0]
    return AgeRange(float(ages.min()) * dt, float(ages.max()) * dt) if len(ages) else None


def facts(scene: Scene, axis: int, fwd: AgeRange | None, bwd: AgeRange | None, lossy: bool, held: float) -> Facts:
    """The facts of an axis of a scene whose link did this, and whose forces were held for as long as `held` (s).

    The slave's body is as the law meets it, in the master's metres and newtons: of m_s a_s = f_s with x_s = scale_x x
    and f_s = scale_f f a mass m_s scale_x/scale_f (`teleop.stages.scaling`).
    """
    master, slave = [scene.per_axis(name)[axis] for name in ("master", "slave")]
    master, slave = getattr(master, "body", master), getattr(slave, "body", slave)
    scale_x, scale_f = scales(scene)[axis]
    felt = scale_x / scale_f
    return Facts(scene.dt_ns / 1e9, scene.axes, master.mass, master.damping, felt * slave.mass, felt * slave.damping,
                 fwd, bwd, lossy, _word(scene.played_as), held)


def law_notes(scene: Scene, fwd: AgeRange | None, bwd: AgeRange | None, lossy: bool, held: float) -> list[str]:
    """The notes on conditions of the law that a run broke; none of a scene with one end.

    A condition that is broken on some axes alone is told with their names.
    """
    if scene.slave is None:
        return []
    clauses: dict[str, list[tuple[str, str]]] = {}  # by what is left without the numbers
    alike = scene.frame is None and not any(
        isinstance(getattr(scene, name), tuple) for name in ("law", "master", "slave", "scaling"))
    for i, name in enumerate(scene.axis_names[:1] if alike else scene.axis_names):
        for sentence in broken(scene.laws[i], facts(scene, i, fwd, bwd, lossy, held)):
            condition = told_along(sentence, scene.axis_units[i])
            clauses.setdefault(_NUMBER.sub("", condition), []).append((name, condition))
    return [each[0][1] if alike else _of_axes(each, scene.axes) for each in clauses.values()]


def _of_axes(clauses: list[tuple[str, str]], axes: int) -> str:
    """A sentence on some of so many axes, each with its numbers: that of the first, and the names of the others."""
    names, sentences = zip(*clauses, strict=True)
    if len(set(sentences)) > 1:
        return f"{names[0]}: {sentences[0]} (and {enumerated(names[1:])}, with their own numbers)"
    return sentences[0] if len(names) == axes else f"{enumerated(names)}: {sentences[0]}"


def _word(playout: Playout) -> str:
    """The word for what is played in gaps; "fixed" where that is nothing, at a fixed delay."""
    gaps = gaps_of(playout)
    return type(playout if isinstance(gaps, Zero) else gaps).__name__.lower()
