"""What a person did on a page, run again in virtual time. The three processes are the real ones."""

from __future__ import annotations

import json
from collections.abc import Callable

import numpy as np
import pytest

from master.hand_record import HandRecording
from teleop import load_scene, run
from teleop.live.records.merge import load_result, scene_of
from teleop.physics.plant import grip_force
from teleop.simulation.bodies import master_coefficients
from tests.live.page.conftest import Served

pytestmark = pytest.mark.live
LAWS = ("wave", "pfra", "tdpa", "two_layer", "pd_d", "direct")


def test_a_drag_on_a_page_is_what_the_sensor_felt_and_runs_again_under_six_laws(
        served: Callable[..., Served]) -> None:
    async def scenario(page: Served) -> None:
        async with page.open() as browser:
            await browser.until("rows", lambda rows: rows["fh"])
            await browser.say("hand", to=[-0.02])
            await browser.until("rows", lambda rows: rows["xm"][0] < -0.018)
            await browser.say("hand", to=[0.05])
            await browser.until("rows", lambda rows: rows["xm"][0] > 0.035)
            await browser.say("turn", law="pfra")
            await browser.until("hello", lambda message: message["law"] == "pfra")
            await browser.say("hand", to=[-0.03])
            await browser.until("rows", lambda rows: rows["xm"][0] < -0.025)

    page = served(scenario, program=())
    hand = HandRecording(str(page.folder))
    r = np.array(hand.samples(1, hand.ticks + 1, hand.dt_ns)[0])
    assert r.min() < -0.02
    assert r.max() > 0.035
    shown = 0
    for part in json.loads((page.folder / "page.json").read_text())["parts"]:
        folder = page.folder / part["folder"] / "master"
        own = load_result(folder).trace
        k = np.rint(np.asarray(own["t"]) * 1e3).astype(int)
        follows = np.flatnonzero((np.diff(k) == 1) & (k[:-1] > 0)) + 1  # the force held over the last tick is known
        x, v, f, felt = (np.asarray(own[name]) for name in ("x_m", "v_m", "f_m", "f_h"))
        c, at = master_coefficients(scene_of(folder))[0], k[follows]
        again = grip_force(c, x[follows], v[follows], f[follows - 1], r[at], (r[at] - r[at - 1]) / 1e-3)  # type: ignore[arg-type]  # rows at once
        np.testing.assert_allclose(again, felt[follows], rtol=0.0, atol=1e-12)  # N, of up to 10; the rest is rounding
        shown += len(follows)
    assert shown > 500
    for law in LAWS:
        result = run(load_scene("hard_wall", hand=page.folder, law=law))
        assert (result.status, result.ticks) == ("ok", hand.ticks), law
