"""What a scene's deadband does not send: by content, over every link, in every engine."""

# ruff: noqa: ARG005 - an end takes what it is given, used or not

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest

from channel import Bernoulli, Delay, UniformJitter
from teleop import Deadband, Refused, Scene, facts_of, load_scene, run
from teleop.analysis.models.linear import refuse_nonlinear_parts
from teleop.scene.playout import read_playout
from teleop.simulation.plan import link_plans
from tests.fakes import law_of

ENDS = ("master", "slave")


class Number(NamedTuple):
    x: float


class State(NamedTuple):
    n: float
    heard: float


PARTS: dict[str, Any] = {
    **{f"{e}_start": lambda self, at: (State(0.0, -1.0), Number(-1.0)) for e in ENDS},
    **{e: lambda self, s, at, rx: (0.0, Number(s.n), State(s.n + 1.0, rx.x)) for e in ENDS}}
Numbered = law_of(name="Numbered", shows=("heard",), **PARTS)  # sends the numbers of its ticks, shows the newest it got


def scene(**parts: Any) -> Scene:
    made = load_scene("canonical", law="direct", duration=0.4)
    return replace(made, **{"law": Numbered(), "link": Delay(0.01), "deadband": Deadband(k=0.1), **parts})


@pytest.mark.parametrize(("link", "playout"), [
    (None, "zero"), (Delay(0.0), "zero"), (Delay(0.02), "fixed:0.025"), (Delay(0.01) | UniformJitter(0.02), "zero"),
    (Delay(0.01) | UniformJitter(0.02) | Bernoulli(0.2), "zero"),
    (Delay(0.01) | UniformJitter(0.02) | Bernoulli(0.2), "fixed:0.025")], ids=str)
def test_a_tick_plays_the_newest_of_the_packets_that_were_sent_and_came(link: Any, playout: str) -> None:
    asked = scene(link=link, playout=read_playout("playout", playout))
    result = run(asked, seed=3)
    trace, count = result.trace, result.ticks
    fwd, bwd = link_plans(asked, 3, count, [trace["sent_m"] > 0.0, trace["sent_s"] > 0.0])
    for plan, e, sender in ((fwd, "s", "m"), (bwd, "m", "s")):
        assert plan is not None
        newest = np.maximum.accumulate(np.maximum(plan.played_at, -1))
        assert np.array_equal(trace[f"heard_{e}"], newest)
        assert np.array_equal(trace[f"seq_{e}"], np.maximum(plan.played_at, -1))
        sent = int(trace[f"sent_{sender}"].sum())
        counts = result.packets["fwd" if e == "s" else "bwd"]
        assert (counts.sent, counts.saved) == (sent, count - sent)
        assert counts.sent == counts.received + counts.lost + counts.in_flight
        assert counts.saved > count // 2


def test_what_is_sent_differs_from_the_last_by_more_than_a_share_or_keeps_alive() -> None:
    own = Deadband(k=0.2, floor=0.5, keep_alive=0.03)
    trace = run(scene(deadband=own)).trace
    last, silent, wanted = 0.0, np.inf, []
    for n in range(len(trace["t"])):  # the messages are the numbers of their ticks
        silent += 1.0
        sends = abs(n - last) > max(0.2 * last, 0.5) or silent >= 30
        last, silent = (n, 0.0) if sends else (last, silent)
        wanted.append(float(sends))
    assert trace["sent_m"].tolist() == wanted
    assert 10 < sum(wanted) < 60


def test_messages_that_are_all_sent_give_the_run_without_a_deadband() -> None:
    for law in ("direct", "wave"):
        made = load_scene("canonical", law=law, delay=0.02, duration=0.5, playout="integral")
        sends = run(replace(made, deadband=Deadband(k=0.0, floor=0.0, keep_alive=1e-3)), seed=1)
        alone = run(made, seed=1)
        assert sends.packets["fwd"].saved == 0
        assert all(np.array_equal(alone.trace[name], sends.trace[name], equal_nan=True) for name in alone.trace)


def test_a_law_that_couples_axes_sends_all_of_them_or_none() -> None:
    made = load_scene("recorded_reach", deadband=0.1, duration=0.3)
    assert made.axes == 3
    assert 0.0 < run(made).metrics["sent_fwd"] < 1.0


@pytest.mark.parametrize("law", ["wave", pytest.param("direct", marks=pytest.mark.full)])
def test_a_tenth_of_a_share_saves_most_packets_and_costs_a_little_tracking(law: str) -> None:
    knobs: dict[str, Any] = {"law": law, "delay": 0.02, "duration": 2.0, "playout": "integral"}
    every, some = [run(load_scene("free_motion", deadband=k, **knobs)) for k in (0.0, 0.1)]
    assert some.packets["fwd"].saved > 0.6 * every.packets["fwd"].sent
    assert some.metrics["x_err_rms"] < 1.6 * every.metrics["x_err_rms"] + 1e-3


def test_waves_that_are_not_sent_take_no_energy_out_of_the_link_and_ends_that_leave_out_ticks_send_nothing() -> None:
    made = load_scene("jittery_wan", deadband=0.2, duration=1.0)
    result = run(replace(made, energy=True), seed=2)
    assert result.packets["fwd"].saved > 0
    assert result.metrics["E_link_min"] > -1e-9
    result = run(load_scene("canonical", law="direct", left_out=0.3, deadband=0.05, duration=0.5), seed=4)
    counts = result.packets["fwd"]
    assert counts.sent + counts.saved < 0.85 * result.ticks
    assert counts.sent == counts.received + counts.lost + counts.in_flight


def test_conditions_on_a_delay_count_the_silence_before_it_is_known() -> None:
    fwd = facts_of(load_scene("canonical", law="direct", delay=0.02, deadband=0.1)).fwd
    assert fwd is not None
    assert (fwd.least, fwd.greatest) == pytest.approx((0.02, 0.03))


def test_an_analysis_of_the_linear_loop_refuses_it() -> None:
    with pytest.raises(Refused, match="a deadband and Wall are not linear"):
        refuse_nonlinear_parts(scene())
