"""A link in figures, against the closed form of each effect."""

from __future__ import annotations

import pytest

from teleop import load_scene
from teleop.errors import Refused
from teleop.studies.advise.laws import link_text, one_way, playouts_for


def test_delay_jitter_and_loss_are_those_of_the_link() -> None:
    """0.06 s and up to 0.04 s more, uniform: median 0.08 s, 99.5 % within 0.0998 s; 3 % lost."""
    scene = load_scene("hard_wall", link="delay(0.06) | uniform(0.04) | bernoulli(0.03)")
    way = one_way(scene, 0, 1)
    assert way.least == pytest.approx(0.06, abs=1e-4)
    assert way.median == pytest.approx(0.08, abs=1e-3)
    assert way.late == pytest.approx(0.0998, abs=2e-4)
    assert way.greatest <= 0.1
    assert way.lost == pytest.approx(0.03, abs=0.006)
    assert "each way" in link_text((way, one_way(scene, 1, 1)))


def test_two_directions_that_differ_are_told_apart() -> None:
    scene = load_scene("hard_wall", link="delay(0.04) ; delay(0.2)")
    text = link_text((one_way(scene, 0, 0), one_way(scene, 1, 0)))
    assert text == "forward 40.0 ms, 0.0% of packets lost; backward 200 ms, 0.0% of packets lost"


@pytest.mark.parametrize(("law", "link", "playouts"), [
    ("wave", "delay(0.05)", ()),
    ("wave", "delay(0.02) | bernoulli(0.1)", ("integral", "fixed:0.02:integral")),
    ("pfra", "delay(0.02) | bernoulli(0.1)", ("zero", "fixed:0.02")),
])
def test_playouts_are_tried_where_there_is_something_to_choose(law: str, link: str, playouts: tuple[str, ...]) -> None:
    scene = load_scene("hard_wall", law=law, link=link)
    assert playouts_for(scene, (one_way(scene, 0, 0), one_way(scene, 1, 0))) == playouts


def test_a_fixed_playout_waits_for_all_but_half_a_percent() -> None:
    scene = load_scene("hard_wall", link="delay(0.06) | uniform(0.04)")
    assert playouts_for(scene, (one_way(scene, 0, 0), one_way(scene, 1, 0)))[1] == "fixed:0.1:integral"


def test_a_link_through_which_nothing_gets_is_refused() -> None:
    with pytest.raises(Refused, match="nothing gets through the link forward"):
        one_way(load_scene("hard_wall", link="blackout(0, 100)"), 0, 0)
