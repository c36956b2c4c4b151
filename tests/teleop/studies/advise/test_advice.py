"""The advice over a few laws: ranked, run again by what it prints, with measured margins; a link in figures."""

from __future__ import annotations

from statistics import stdev
from typing import Any

import pytest

from teleop import load_scene, run
from teleop.law import find_law, two_port_laws
from teleop.studies.advise.advice import Advice, advise, score_changes
from teleop.studies.advise.laws import MARGIN, Outlook, link_text, one_way, playouts_for
from teleop.studies.advise.report import avoid, text
from teleop.studies.tune.objective import SCENE
from teleop.studies.tune.search import LawSearch, SearchJob
from teleop.studies.tune.strategy import value_at
from teleop.sweeps.grid import Range, sampled
from teleop.terminal.table import si

HELD_OUT = ("delay(0.025) | gamma(0.012, 2.0) | gilbert_elliott(0.01, 0.3)", "delay(0.15) | uniform(0.01)",
            "delay(0.02) | bernoulli(0.01) ; delay(0.09) | uniform(0.06) | bernoulli(0.05)")
JUDGES = range(5000, 5064)
FIXED: dict[str, Any] = {"k_e": 2000.0, "duration": 3.0, "link": "delay(0.03) | uniform(0.01) | bernoulli(0.03)"}


@pytest.fixture(scope="module")
def found() -> Advice:
    return advise("hard_wall", 36, fixed=FIXED, laws=["direct", "wave", "virtual_wall"], workers=1)


@pytest.mark.full
def test_the_jumps_are_those_of_the_force_that_the_run_has(found: Advice) -> None:
    """The advised law jumped by newtons from tick to tick, and the page said nothing of it."""
    best = found.best
    scene = load_scene("hard_wall", **best.tuned.settings, link=FIXED["link"])
    forces = [run(scene, seed=seed).trace["f_m"] for seed in best.tuned.fresh]
    assert found.jumps.tick == max(float(abs(force[1:] - force[:-1]).max()) for force in forces)
    assert found.jumps.within == max(float(abs(force[10:] - force[:-10]).max()) for force in forces)
    assert 0.0 < found.jumps.tick <= found.jumps.message
    assert f"the force at the hand jumps by up to {si(found.jumps.tick, 'N')} from one tick to the next" in " ".join(
        text(found).split())


def test_the_printed_objective_was_that_of_the_seeds_it_was_chosen_by(found: Advice) -> None:
    """A wave was advised at 0.2107 +- 0.0007, and was 0.225 on other seeds."""
    best = found.best
    assert not {*best.tuned.seeds} & {*best.tuned.fresh}
    assert len(best.tuned.score.values) == len(best.tuned.fresh) >= 4
    mean = sum(best.tuned.score.values) / len(best.tuned.score.values)
    assert best.spread == pytest.approx(stdev(best.tuned.score.values))
    assert best.value == pytest.approx(mean, rel=0.1)
    assert f"standard deviation {best.spread:.3f}" in " ".join(text(found).split())


@pytest.mark.parametrize(("start", "each"), [(10.0, 0.001), (0.5, 0.01)])
def test_the_time_that_is_left_is_told_within_a_factor_of_two(start: float, each: float) -> None:
    """Two workers, eight laws of 2000 rows with kernels that take up to twice as long to compile as others."""
    outlook, left, events, ends = Outlook(8, 2000, 2, 12.0, 0.001), dict[float, float](), [], [0.0, 0.0]
    for law in range(8):
        worker = ends.index(min(ends))
        begun = ends[worker]
        first = begun + start * (0.7 + 0.6 * (law % 2))
        ends[worker] = first + 2000 * each
        events += [(begun, "begin", law, 0), (ends[worker], "end", law, 0)]
        events += [(first + each * rows, "rows", law, rows) for rows in range(100, 2001, 100)]
    for now, event, law, rows in sorted(events):
        arguments = {"begin": (law, now), "rows": (law, rows, now), "end": (law,)}[event]
        getattr(outlook, event)(*arguments)
        if now >= 20.0:
            left[now] = outlook.time_left(now)
    assert bool(left) == (max(ends) > 20.0)
    assert all(0.5 <= (now + after) / max(ends) <= 2.0 for now, after in left.items())
    assert outlook.time_left(max(ends)) == 0.0


def test_rows_that_were_there_are_no_measure_of_the_time_that_is_left() -> None:
    outlook = Outlook(1, 1000, 1, 7.0, 0.01)
    outlook.begin(0, 0.0, known=500)
    outlook.rows(0, 400, 0.001)
    outlook.rows(0, 500, 0.002)
    assert outlook.time_left(1.0) == pytest.approx(7.0 - 1.0 + 500 * 0.01)
    assert outlook.time_left(1.0, busy=3.0) == pytest.approx(21.0 - 1.0 + 3.0 * 500 * 0.01)
    outlook.rows(0, 600, 10.0)
    outlook.rows(0, 700, 20.0)
    assert outlook.time_left(20.0, busy=3.0) == pytest.approx(30.0)


def searching(law: str, link: str) -> tuple[SearchJob, LawSearch]:
    """A search over a link as `advise` makes them, and one that has not begun."""
    fixed = {"k_e": 2000.0, "link": link}
    scene = load_scene("hard_wall", **fixed, law=law)
    playouts = playouts_for(scene, (one_way(scene, 0, 0), one_way(scene, 1, 0)))
    job = SearchJob("hard_wall", law, 12_000, fixed=fixed, margin=MARGIN, playouts=playouts)
    return job, LawSearch(job._replace(budget=10**6, engine="vector"), workers=1)


def best_of_random(search: LawSearch, count: int) -> tuple[Any, ...]:
    """The best of so many random points within the law's conditions, chosen by other seeds as a search chooses."""
    search.seeds, search.left = range(4000, 4001), count
    spans = {name: Range(0.0, 1.0) if isinstance(span, Range) else span for name, span in search.spans.items()}
    drawn = sampled(spans, count, key=77, latin=False).rows(range(count))
    search._try([search._repair(tuple([value_at(span, values[name]) if isinstance(span, Range) else values[name]
                                     for name, span in search.spans.items()])) for _, values, _ in drawn])
    ranked = sorted(search.scores, key=lambda point: search.scores[point].order)
    points = search._select_stable([point for point in ranked if not search.scores[point].broken], 60)
    for seeds, most in ((range(4100, 4108), 60), (range(4200, 4224), 10)):
        scores = search._score_points(points[:most], seeds)
        points = [points[i] for i in sorted(range(len(scores)), key=lambda i: scores[i].order)]
    return points[0]


@pytest.mark.soak
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("link", HELD_OUT)
@pytest.mark.parametrize("law", two_port_laws())
def test_a_search_was_worse_than_the_best_of_5000_random_points(law: str, link: str) -> None:
    """Two of seven knobs of two_layer were moved in 300 rows. Both are judged by seeds that neither has seen.

    The links were not used while the search was written.
    """
    job, search = searching(law, link)
    tuned = LawSearch(job, workers=1).run()
    theirs = best_of_random(search, 5000)
    ours = tuple([tuned.best[name] for name in search.names])
    found, reference = search._score_points([ours, theirs], JUDGES)
    print(f"{law} over {link}: {found.value:.4f} {found.broken}, best of 5000 random points {reference.value:.4f} "
          f"{reference.broken}")
    assert found.value <= 1.03 * reference.value


def test_every_law_with_two_ends_is_asked() -> None:
    laws = two_port_laws()
    assert {"wave", "pfra", "direct"} <= {*laws}
    assert not {"virtual_wall", "virtual_coupling"} & {*laws}
    assert all(hasattr(find_law(law), "master") for law in laws)


def test_laws_are_ranked_and_the_best_runs_as_it_is_printed(found: Advice) -> None:
    values = [one.value for one in found.laws]
    assert values == sorted(values)
    best = found.best
    assert best.value == values[0] < 1.0
    scene = load_scene("hard_wall", **best.tuned.settings, link=FIXED["link"])
    errors = [run(scene, seed=seed).metrics["x_err_rms"] for seed in (1, 2, 3, 4)]
    assert best.tuned.score.figures[SCENE]["x_err_rms"] == pytest.approx(sum(errors) / 4.0, rel=1e-12)


def test_a_law_that_does_not_go_with_the_scene_is_said_to_be_refused(found: Advice) -> None:
    assert found.laws[-1].law == "virtual_wall"
    assert "one-port" in found.laws[-1].refused
    assert any(line.startswith("virtual_wall: ") for line in avoid(found))


def test_the_margin_is_the_last_wall_that_the_gains_stand(found: Advice) -> None:
    best = found.best
    assert best.tuned is not None
    assert best.margins.wall >= 4000.0  # the search asks for twice the wall
    held, _ = score_changes(best.tuned, [{"k_e": best.margins.wall}], tasks=[SCENE])
    assert not held[0].broken


def test_the_page_has_law_gains_figures_and_what_to_type(found: Advice) -> None:
    page = " ".join(text(found).split())
    for part in (f"take {found.best.law} with ", "rms of tracking", "margin", "promises",
                 "run it: teleop run hard_wall --set law="):
        assert part in page
    assert any("playout hold" in line and "active" in line for line in avoid(found)) == (found.best.law == "wave")


def test_where_no_law_keeps_the_constraints_the_page_says_what_comes_nearest() -> None:
    none = advise("hard_wall", 6, fixed={**FIXED, "x_limit": 0.01}, laws=["direct", "wave"], workers=1)
    assert none.best is None
    page = text(none)
    assert "none: no law keeps the constraints" in page
    assert "diverged" in page
    assert "run it" not in page


def test_delay_jitter_and_loss_of_each_direction_are_those_of_the_link() -> None:
    """0.06 s and up to 0.04 s more, uniform: median 0.08 s, 99.5 % within 0.0998 s; 3 % lost."""
    scene = load_scene("hard_wall", link="delay(0.06) | uniform(0.04) | bernoulli(0.03)")
    way = one_way(scene, 0, 1)
    assert way.least == pytest.approx(0.06, abs=1e-4)
    assert way.median == pytest.approx(0.08, abs=1e-3)
    assert way.late == pytest.approx(0.0998, abs=2e-4)
    assert way.greatest <= 0.1
    assert way.lost == pytest.approx(0.03, abs=0.006)
    assert "each way" in link_text((way, one_way(scene, 1, 1)))
    scene = load_scene("hard_wall", link="delay(0.04) ; delay(0.2)")
    assert link_text((one_way(scene, 0, 0), one_way(scene, 1, 0))) == (
        "forward 40.0 ms, 0.0% of packets lost; backward 200 ms, 0.0% of packets lost")


def test_playouts_are_tried_where_there_is_something_to_choose_and_a_fixed_one_waits_for_nearly_all() -> None:
    for law, link, playouts in (
            ("wave", "delay(0.05)", ()), ("wave", "delay(0.02) | bernoulli(0.1)", ("integral", "fixed:0.02:integral")),
            ("pfra", "delay(0.02) | bernoulli(0.1)", ("zero", "fixed:0.02")),
            ("wave", "delay(0.06) | uniform(0.04)", ("integral", "fixed:0.1:integral"))):  # all but half a percent
        scene = load_scene("hard_wall", law=law, link=link)
        assert playouts_for(scene, (one_way(scene, 0, 0), one_way(scene, 1, 0))) == playouts, (law, link)
