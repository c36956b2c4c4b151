"""Left-out ticks in virtual time: nothing is read, asked or sent at them, the force is held, and the bodies move on."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from channel import LeftOut, LeftOutTicks, parse_link
from teleop import Refused, Scene, Zero, load_scene, run
from teleop.analysis.models.linear import linear_scene
from teleop.analysis.passivity.one_port import one_port
from teleop.analysis.passivity.surroundings import linear_parts
from teleop.scene.scene import both_ends
from teleop.simulation.source import rendered
from teleop.sweeps.chunk import Job, work

SOME = LeftOutTicks((25, 26, 27, 35, 50, 51, 90, 91, 92, 93, 94))


def pressed(**other: Any) -> Scene:
    """A scene in which both ends do something at every tick."""
    return replace(load_scene("canonical", link="delay(0.01)"), **{"duration": 0.3, "energy": True, **other})


def held(trace: Any, name: str) -> np.ndarray:
    """The ticks at which a column is what it was at the tick before."""
    column = trace[name]
    return np.flatnonzero(column[1:] == column[:-1]) + 1


def test_the_force_is_held_while_the_bodies_move() -> None:
    for e, peer in ("ms", "sm"):
        trace = run(pressed(**{f"left_out_{e}": SOME})).trace
        assert [k for k in held(trace, f"f_{e}").tolist() if k > 15] == [*SOME.ticks], e
        assert not np.isin(SOME.ticks, held(trace, f"x_{e}")).any(), e
        assert [k for k in held(trace, f"f_{peer}").tolist() if k > 15] == [], e


def test_a_packet_of_a_tick_that_is_left_out_is_never_sent_and_what_comes_at_one_waits() -> None:
    result = run(pressed(left_out_m=SOME, left_out_s=LeftOutTicks((40, 41))))
    forth, back = result.trace["seq_s"], result.trace["seq_m"]
    assert not np.isin(forth, SOME.ticks).any()
    assert not np.isin(back, (40, 41)).any()
    assert (forth[[40, 41]] == -1).all()
    assert forth[39] == 29
    assert forth[42] == 32  # 30 and 31 have come too, and the newest wins
    sent = result.packets["fwd"].sent
    assert sent == result.ticks - len(SOME.ticks)
    assert result.packets["fwd"].overtaken == 2
    assert result.packets["bwd"].sent == result.ticks - 2
    assert sent == result.packets["fwd"].received + result.packets["fwd"].in_flight


def test_with_a_fixed_delay_the_packet_of_a_tick_that_is_left_out_is_late() -> None:
    scene = pressed(left_out_s=LeftOutTicks((40, 41)))
    result = run(replace(scene, playout=load_scene("canonical", playout="fixed:0.02").playout))
    assert result.packets["fwd"].late == 2
    assert not np.isin((20, 21), result.trace["seq_s"]).any()


def test_no_link_is_a_delay_of_nothing() -> None:
    """Without a link the newest message of the other end's ticks until then is there."""
    none, zero = [run(replace(pressed(left_out_m=SOME, left_out_s=LeftOut(0.1)), link=each)).trace
                  for each in (None, parse_link("delay(0)"))]
    assert all(np.array_equal(none[name], zero[name]) for name in zero)


def test_a_scene_without_ticks_left_out_has_the_bits_and_the_lines_of_before() -> None:
    scene = replace(pressed(), playout=Zero())  # with ticks left out another would be the default
    assert rendered(replace(scene, left_out_m=None)) == rendered(scene)
    none = run(replace(scene, left_out_m=LeftOutTicks(()), left_out_s=LeftOutTicks(()))).trace
    full = run(scene).trace
    assert all(np.array_equal(none[name], full[name]) for name in full)


def test_a_one_port_scene_leaves_out_ticks_too() -> None:
    scene = replace(load_scene("virtual_wall", left_out=0.2), duration=1.5)
    result = run(scene, seed=2)
    assert "seq_m" not in result.trace
    assert result.packets == {}
    pressing = np.flatnonzero(result.trace["f_m"] > 0.0)
    late = np.flatnonzero(scene.left_out_m.left_out(0, scene.ticks, 2))  # type: ignore[union-attr]
    assert np.isin(late, pressing).mean() > 0.1
    assert np.isin(np.intersect1d(late, pressing), held(result.trace, "f_m")).all()


def test_a_sweep_over_the_share_gives_each_row_its_run() -> None:
    shares = (0.0, 0.05, 0.2)
    rows = [(i, {"left_out": share}, 3) for i, share in enumerate(shares)]
    told = work(Job("canonical", {"duration": 0.3, "link": "delay(0.01)"}, rows, ("x_err_rms", "fresh_fwd"), "plain"))
    for share, row in zip(shares, told.rows, strict=True):
        single = run(load_scene("canonical", left_out=share, duration=0.3, link="delay(0.01)"), seed=3)
        assert row["x_err_rms"] == single.metrics["x_err_rms"]
        assert row["fresh_fwd"] == single.metrics["fresh_fwd"]
    assert len({row["x_err_rms"] for row in told.rows}) == 3


def test_passivity_says_that_ticks_are_left_out_and_not_that_it_is_passive_with_them() -> None:
    port = one_port(load_scene("virtual_wall", left_out=0.1))
    assert port.passive is None
    assert port.verdict.sentence.startswith("not known with its left-out ticks; without them passive")
    _, left = linear_parts(load_scene("soft_tissue", law="direct", left_out=0.1))
    assert left[-2:] == ["ticks that the master leaves out", "ticks that the slave leaves out"]


def test_ticks_of_ones_own_that_are_no_truths_are_refused() -> None:
    """A list ended in a TypeError of numpy's, and numbers in place of truths in a run without a single packet."""
    class Own:
        out: Any = None

        def left_out(self, end: int, count: int, seed: int) -> Any:
            return self.out

    for Own.out in ([True] * 300, np.zeros(299, dtype=bool), np.zeros(300, dtype=int), None):
        with pytest.raises(Refused, match=r"^Own.left_out gives .*, not a truth for each of 300 ticks; return an arr"):
            run(pressed(left_out_m=Own()))


def test_an_end_that_runs_no_tick_is_not_said_to_have_too_long_a_link() -> None:
    note = next(note for note in run(pressed(left_out_s=LeftOut(1.0))).notes if "played none" in note)
    assert "none came before the last tick that the slave ran; type a smaller --set left_out" in note


def test_what_needs_every_tick_says_what_to_type() -> None:
    scene = load_scene("soft_tissue", law="direct", left_out=0.1)
    with pytest.raises(Refused, match="leave it out with --set left_out=0"):
        linear_scene(scene)
    with pytest.raises(Refused, match="in virtual time alone"):
        both_ends(scene)
    with pytest.raises(Refused, match="left_out_s"):
        replace(load_scene("virtual_wall"), left_out_s=SOME)
    with pytest.raises(Refused, match=r"LeftOut\(0.1\)"):
        pressed(left_out_m=0.1)
