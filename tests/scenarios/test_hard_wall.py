"""The gains of `hard_wall`: what the page of the scenes says that they give and cost."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from scenarios.examples.gains import bounce, drag, overshoot
from teleop import PFRA, Direct, Result, Wave, load_scene, run
from teleop.analysis.stability.assess import is_stable, stability
from teleop.scene.library import ROOT

DELAYS = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2)  # s, each way
STIFF = (1e3, 2e4, 1e6)  # N/m


def told(title: str) -> list[list[str]]:
    """The cells of a table of the page, the one whose first heading begins with `title`, without headings."""
    lines = (ROOT / "scenarios" / "README.md").read_text().splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith(f"| {title}"))
    rows = lines[first + 2:lines.index("", first)]
    return [[cell.strip() for cell in row.strip("|").split("|")][1:] for row in rows]


def settling(result: Result) -> float:
    """The time from the first touch until the force at the hand stays within 5 % of that at the end, s."""
    f_m, touches = result.trace["f_m"], result.trace["f_env"] != 0.0
    return float(np.flatnonzero(np.abs(f_m / f_m[-1] - 1.0) > 0.05)[-1] + 1 - touches.argmax()) * result.dt


def column(knobs: dict[str, Any]) -> list[str]:
    """What the page says of the scene with these knobs."""
    pressed, free = run(load_scene("hard_wall", **knobs)), run(load_scene("hard_wall", **knobs, wall=1.0, duration=2.5))
    at_top_speed = free.trace["f_m"][free.trace["v_m"].argmax()]
    return [f"{pressed.metrics['f_m_end']:.2f} N", f"{100.0 * overshoot(pressed):.1f} %", f"{settling(pressed):.2f} s",
            f"{1e3 * bounce(pressed):.0f} ms", f"{drag(pressed):.2f} N", f"{at_top_speed:.2f} N"]


def test_what_the_gains_give_and_what_they_cost_is_as_the_page_says() -> None:
    before, chosen = zip(*told("over 50 ms each way"), strict=True)
    assert column({"law.b": 2.0, "law.K": 500.0}) == [*before]
    assert column({}) == [*chosen]


@pytest.fixture(scope="module")
def pressed() -> dict[tuple[float, float], Result]:
    """A run for each stiffness of the wall and each delay."""
    return {(k_e, delay): run(load_scene("hard_wall", k_e=k_e, delay=delay)) for k_e in STIFF for delay in DELAYS}


@pytest.mark.full
def test_over_other_delays_and_walls_it_is_as_the_page_says(pressed: dict[tuple[float, float], Result]) -> None:
    assert told("delay each way") == [
        *([f"{pressed[k_e, delay].metrics['f_m_end']:.2f} N" for delay in DELAYS] for k_e in STIFF),
        *([f"{100.0 * overshoot(pressed[k_e, delay]):.1f} %" for delay in DELAYS] for k_e in STIFF[1:]),
        *[[f"{drag(pressed[2e4, delay]):.2f} N" for delay in DELAYS]],
    ]


def test_it_comes_to_rest_passively_at_the_force_of_springs_in_series(
    pressed: dict[tuple[float, float], Result]
) -> None:
    for (k_e, delay), got in pressed.items():
        ways = 2.0 * max(delay, 1e-3)  # a message is played at the next tick at the earliest
        series = 1.0 / 200.0 + 1.0 / 1000.0 + 1.0 / k_e + ways / (2.0 * 20.0)
        assert got.metrics["f_m_end"] == pytest.approx(0.03 / series, rel=1e-3)
        assert (got.status, got.metrics["E_link_min"] >= -1e-9) == ("ok", True)
    assert pressed[2e4, 0.05].metrics["f_m_end"] > 3.0


def test_pressed_for_good_it_has_the_margins_that_the_page_says() -> None:
    text = (ROOT / "scenarios" / "README.md").read_text().replace("\n", " ")
    assert "every delay; at 50 ms b up to 145 N s/m, K up to 36 kN/m, B up to 499 N s/m, each by itself" in text
    assert "decays at 3.8 1/s, with `b=2, K=500` at 1.9" in text

    def bonded(**gains: float) -> Any:
        return load_scene("soft_tissue", k_e=2e4, d_e=10.0, law=Wave(**{"b": 20.0, "K": 1000.0, **gains}))

    chosen, before = stability(bonded()), stability(bonded(b=2.0, K=500.0))
    assert (chosen.verdict, chosen.delay_margin) == ("stable", None)
    assert [f"{-found.mode.growth:.1f}" for found in (chosen, before)] == ["3.8", "1.9"]
    for gain, below, above in (("b", 144.5, 145.5), ("K", 35.5e3, 36.5e3), ("B", 498.5, 499.5)):
        assert [is_stable(bonded(**{gain: value})) for value in (below, above)] == [True, False]


def test_one_gain_is_changed_by_itself_and_its_own_law_by_name_keeps_all_of_them() -> None:
    assert load_scene("hard_wall", **{"law.b": "2"}).law == Wave(b=2.0, K=1000.0, B=20.0)
    assert load_scene("hard_wall", **{"law.b": 2.0, "law.K": 500.0}).law == load_scene("canonical").law == Wave()
    assert load_scene("hard_wall", law="wave").law == load_scene("hard_wall").law == Wave(b=20.0, K=1000.0, B=20.0)
    assert load_scene("hard_wall", law="wave()").law == Wave() == Wave(b=2.0, K=500.0, B=20.0)
    assert [load_scene("hard_wall", law=name).law for name in ("pfra", "direct")] == [PFRA(), Direct()]
