"""What is said of laws: failing is never better than working, and what is within the spread is a tie."""

from __future__ import annotations

from math import inf, isnan
from typing import Any

import pytest

from teleop.studies.compare.figures import BY_KEY, endings, held_back_laws, judge_laws, ranking, rankings, text


def row(law: str, link: str, seed: int, ended: str = "ok", place: str = "wall", **figures: float) -> dict[str, Any]:
    return {"law": law, "link": link, "environment": place, "seed": seed, "ended": ended, **figures}


def test_a_law_that_fails_where_it_is_hard_is_not_the_better_for_it() -> None:
    rows = [row("frail", "near", 0, x_err_rms=0.001), row("frail", "far", 0, "diverged", x_err_rms=0.0),
            row("frail", "lost", 0, "unsettled", x_err_rms=0.0),
            *[row("firm", link, 0, x_err_rms=0.005) for link in ("near", "far", "lost")]]
    found = judge_laws(rows, ["frail", "firm"])
    assert [one.figures["x_err_rms"].failed for one in found] == [True, False]
    ranked = ranking(BY_KEY["x_err_rms"], found)
    assert ranked.groups == ((("firm", 0.005),),)
    assert ranked.failed == ("frail",)


def test_laws_closer_than_their_spread_over_seeds_tie_and_without_dice_those_within_one_percent() -> None:
    """Half the force of the rod is as far from it as double."""
    cases: tuple[tuple[str, str, dict[str, tuple[float, ...]], list[list[str]]], ...] = (
        ("x_err_rms", "loss", {"c": (0.0110, 0.0111), "b": (0.0104, 0.0106), "a": (0.01, 0.0104)}, [["a", "b"], ["c"]]),
        ("jerk_rms", "delay", {"a": (100.0,), "b": (100.9,), "c": (102.0,)}, [["a", "b"], ["c"]]),
        ("wall_late", "delay", {"off": (0.5,), "hard": (2.0,), "near": (1.1,)}, [["near"], ["off", "hard"]]))
    for key, link, laws, expected in cases:
        rows = [row(law, link, seed, **{key: value}) for law, values in laws.items()
                for seed, value in enumerate(values)]
        groups = ranking(BY_KEY[key], judge_laws(rows, [*laws])).groups
        assert [[name for name, _ in group] for group in groups] == expected, key


def test_a_row_without_dice_counts_for_every_seed() -> None:
    rows = [row("a", "delay", 0, x_err_rms=0.001), *[row("a", "loss", seed, x_err_rms=0.002 + 0.001 * seed)
                                                    for seed in range(3)]]
    told = judge_laws(rows, ["a"])[0].figures["x_err_rms"]
    assert told.value == pytest.approx(0.003)  # of two cases the worse one is the median
    assert told.spread == pytest.approx(0.002)


def test_drag_counts_where_nothing_is_touched_and_force_where_something_is() -> None:
    rows = [row("a", "delay", 0, place="free", felt_drag=1.0, x_err_rms=0.001),
            row("a", "delay", 0, felt_drag=9.0, wall_late=0.9, x_err_rms=0.003)]
    figures = judge_laws(rows, ["a"])[0].figures
    assert figures["felt_drag"].value == 1.0
    assert figures["wall_late"].value == 0.9
    assert isnan(figures["felt_share"].value)


def test_a_case_ends_as_the_worst_of_its_seeds() -> None:
    rows = [row("a", "loss", 0), row("a", "loss", 1, "limit cycle"), row("a", "loss", 2, "unsettled")]
    assert endings(rows) == {("wall", "loss"): "limit cycle"}


def test_a_law_that_tracks_because_the_wall_is_hardly_touched_is_named() -> None:
    rows = [row("drag", "delay", 0, x_err_rms=0.001, wall_late=0.2), row("good", "delay", 0, x_err_rms=0.002,
            wall_late=0.9), row("slow", "delay", 0, x_err_rms=0.01, wall_late=0.1)]
    found = judge_laws(rows, ["drag", "good", "slow"])
    assert [one.law for one in held_back_laws(found)] == ["drag"]
    assert {one.column.key for one in rankings(found)} == {"x_err_rms", "wall_late"}


def test_a_margin_is_that_of_the_loop_whatever_its_runs_came_to_and_none_is_as_good_as_an_infinite_one() -> None:
    rows = [row("a", "delay", 0, "diverged", gain_margin=0.5), row("b", "delay", 0, gain_margin=3.0),
            row("c", "delay", 0, gain_margin=inf), row("d", "delay", 0)]
    ranked = ranking(BY_KEY["gain_margin"], judge_laws(rows, ["a", "b", "c", "d"]))
    assert ranked.groups == ((("c", inf),), (("b", 3.0),), (("a", 0.5),))
    assert ranked.failed == ()


def test_laws_that_tie_from_both_sides_of_the_rod_are_told_with_the_value_of_each() -> None:
    peaks = {"soft": 0.8, "hard": 1.25, "also soft": 0.5, "softer": 0.499}
    rows = [row(law, "delay", 0, wall_late=1.0, wall_peak=peak) for law, peak in peaks.items()]
    found = judge_laws(rows, [*peaks])
    told = text(found, rankings(found), [], "")
    assert "peak force on the wall  soft 80.0 = hard 125, also soft = softer 50.0 %" in told
