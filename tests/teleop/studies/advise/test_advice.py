"""The advice over a few laws: ranked, run again by what it prints, with margins that were measured."""

from __future__ import annotations

from typing import Any

import pytest

from teleop import load_scene, run
from teleop.errors import Refused
from teleop.law import find_law
from teleop.studies.advise.advice import Advice, advise, two_port_laws
from teleop.studies.advise.report import avoid, text
from teleop.studies.tune.objective import SCENE
from teleop.studies.tune.search import judged

FIXED: dict[str, Any] = {"k_e": 2000.0, "duration": 3.0, "link": "delay(0.03) | uniform(0.01) | bernoulli(0.03)"}


@pytest.fixture(scope="module")
def found() -> Advice:
    return advise("hard_wall", 36, fixed=FIXED, laws=["direct", "wave", "virtual_wall"], workers=1)


def test_every_law_with_two_ends_is_asked() -> None:
    laws = two_port_laws()
    assert {"wave", "pfra", "direct"} <= {*laws}
    assert not {"virtual_wall", "virtual_coupling"} & {*laws}
    assert all(hasattr(find_law(law), "master") for law in laws)


@pytest.mark.parametrize(("scene", "why"), [("leader_follower", "parts of their own"), ("bench_top", "no hand")])
def test_a_scene_in_which_no_law_can_be_tuned_is_refused_at_once(scene: str, why: str) -> None:
    """Each law was refused by itself, and the advice was a softer wall, or a link of less delay."""
    with pytest.raises(Refused, match=why):
        advise(scene, 4, fixed={"link": "delay(0.02)", "duration": 0.1}, laws=["pp", "wave"])


def test_laws_are_ranked_and_the_best_runs_as_it_is_printed(found: Advice) -> None:
    values = [one.value for one in found.laws]
    assert values == sorted(values)
    best = found.best
    assert best is not None
    assert best.tuned is not None
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
    assert best is not None
    assert best.tuned is not None
    assert best.margins is not None
    assert best.margins.wall >= 4000.0  # the search asks for twice the wall
    held, _ = judged(best.tuned, [{"k_e": best.margins.wall}], tasks=[SCENE])
    assert not held[0].broken


def test_the_page_has_law_gains_figures_and_what_to_type(found: Advice) -> None:
    page = text(found)
    assert found.best is not None
    for part in (f"take       {found.best.law} with ", "rms of tracking", "margin", "promises",
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
