"""A slave that may hold no force: its waves are those of the force that it holds, not of the one that its law asks."""

from __future__ import annotations

import numpy as np
import pytest

from teleop import Scene, load_scene
from tests.teleop.protocol.test_endpoint import Both

FROM, UNTIL = 2200, 3400  # ticks at which the slave's device is in trouble


def ran(scene: Scene, until: int) -> dict[str, np.ndarray]:
    both = Both(scene, trouble=lambda e, k: "the device: it is stuck" if e == "s" and FROM <= k < until else None).run()
    return dict(both.trace())


@pytest.mark.parametrize("playout", ["zero", "integral"])
def test_a_hand_feels_no_wall_of_a_slave_that_has_let_go_of_it(playout: str) -> None:
    """Up to 16.6 N came back from a slave without force, and 0.58 J: its law sent what it would have pressed with."""
    scene = load_scene("hard_wall", playout=playout, duration=3.4, link="delay(0.02) ; delay(0.02)")
    trace = ran(scene, UNTIL)
    assert trace["f_m"][FROM] > 3.0
    assert (trace["f_s"][-400:] == 0.0).all()
    assert abs(trace["f_m"][-200:]).max() < 0.3
    assert trace["E_port"].min() > -1e-3
    assert trace["E_link"].min() > -1e-9


def test_the_wall_is_felt_again_when_the_slave_holds_it_again_and_by_no_jump() -> None:
    scene = load_scene("hard_wall", duration=4.6, playout="zero", link="delay(0.02)")
    trace = ran(scene, UNTIL)
    calm = dict(Both(scene).run().trace())
    assert trace["f_m"][-1] == pytest.approx(calm["f_m"][-1], abs=0.2)
    assert np.abs(np.diff(trace["f_s"][FROM:])).max() < 2.0
