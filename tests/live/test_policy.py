"""A policy of another process at a live master of three joints: authority, silence, leaps, an outage, a replay."""

from __future__ import annotations

import signal
import time
from pathlib import Path
from threading import Event, Thread
from typing import Any

import numpy as np
import pytest

from teleop import PolicyWriter, Refused
from teleop.__main__ import main
from teleop.live.policy_page import NAME, PolicyPage
from teleop.live.records.merge import merge, scene_of
from teleop.protocol.policy import SAYS, PolicyWord
from teleop.stages.authority import Standing
from tests.live.ordered import Ordered

LATE, LEAP = SAYS[Standing.LATE], "of the policy refused: farther than 0.9"


def test_a_page_hands_over_each_action_once_and_the_switch_as_it_was_left(tmp_path: Path) -> None:
    with PolicyPage(tmp_path, 2) as page:
        assert page.read() is None
        writer = PolicyWriter(tmp_path)
        writer.send((0.1, -0.2))
        assert page.read() == PolicyWord(None, (0.1, -0.2))
        assert page.read() is None
        writer.switch(on=True)
        assert page.read() == PolicyWord(True, None)
        writer.send((0.3, 0.4))
        writer.switch(on=False)
        assert page.read() == PolicyWord(False, (0.3, 0.4))
        for action in ((0.1,), (float("nan"), 0.0), "ab"):
            with pytest.raises(Refused):
                writer.send(action)  # type: ignore[arg-type]
        assert page.read() is None
        writer._words[0] += 1  # somebody is writing
        assert page.read() is None
        writer.close()
    assert not (tmp_path / NAME).exists()
    with pytest.raises(Refused, match="no folder of a master that runs"):
        PolicyWriter(tmp_path)


class Rolling:
    """A policy at 60 Hz in a thread of its own, until `stop`; it goes to `to`, and is silent while that is None."""

    def __init__(self, folder: Path) -> None:
        self.writer, self.to, self._over = PolicyWriter(folder), (0.0, 0.0, 0.0), Event()
        self.silent = False
        self._thread = Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._over.wait(1.0 / 60.0):
            if not self.silent:
                self.writer.send(self.to)

    def stop(self) -> None:
        self._over.set()
        self._thread.join()
        self.writer.close()


def says(run: Ordered, sentence: str, since: int) -> dict[str, Any]:
    """The master's event with this sentence in it."""
    return run.event("m", lambda event: sentence in str(event.get("why", "")), since)


@pytest.mark.live
def test_a_policy_takes_three_joints_over_and_its_whole_run_can_be_run_again(tmp_path: Path) -> None:
    run = Ordered("handover", tmp_path, {"duration": "86400", "axes": "3", "takes": "none", "law": "wave"})
    try:
        run.happens("ms", "met")
        run.order("m", order="hand", to=None)  # it lets go
        policy = Rolling(tmp_path / "01")
        by_page(run, policy)
        by_orders(run)
        since = run.now()["m"]
        policy.stop()
        says(run, LATE, since)
    finally:
        run.close()
    for end in ("master", "slave"):
        assert main(["replay", str(tmp_path / "01" / end)]) == 0
    master = tmp_path / "01" / "master"
    trace = merge(scene_of(master), master, tmp_path / "01" / "slave").trace
    had = trace["policy_m"] == Standing.POLICY
    assert had.sum() > 200
    assert trace["f_policy_m"].shape[1] == 3
    assert np.abs(trace["f_policy_m"][trace["authority_m"] == 0.0]).max() == 0.0
    assert np.abs(np.diff(trace["f_policy_m"], axis=0)).max() < 0.05
    assert trace["E_policy_m"][-1] > 1e-3


def by_page(run: Ordered, policy: Rolling) -> None:
    """Authority, silence, a leap and an outage of the link, while another process sends the actions."""
    since = run.now()["m"]
    policy.writer.switch(on=True)
    says(run, SAYS[Standing.POLICY], since)
    for x in np.linspace(0.0, 0.3, 10):
        policy.to = (float(x), float(-x), 0.0)
        time.sleep(0.05)
    run.live("m", lambda event: event["x"] > 0.2)
    since = run.now()["m"]
    policy.silent = True
    says(run, LATE, since)
    policy.silent = False
    says(run, SAYS[Standing.POLICY], since)
    since = max(i for i, event in enumerate(run.events["m"]) if SAYS[Standing.POLICY] in str(event.get("why", "")))
    policy.to = (2.0, 0.0, 0.0)
    says(run, LEAP, since)
    says(run, LATE, since)
    policy.to = (0.3, -0.3, 0.0)
    says(run, SAYS[Standing.POLICY], since)
    since = run.now()["m"]
    run.processes["c"].send_signal(signal.SIGSTOP)  # the link is gone, with authority at the policy
    try:
        says(run, SAYS[Standing.PAUSED], since)
    finally:
        run.processes["c"].send_signal(signal.SIGCONT)
    since = run.now()["m"]
    says(run, SAYS[Standing.POLICY], since)


def by_orders(run: Ordered) -> None:
    """The switch and an action by orders, and what is refused."""
    since = run.now()["m"]
    run.order("m", order="policy", takes=False)
    says(run, SAYS[Standing.OPERATOR], since)
    run.order("m", order="policy", takes=True, to=[0.25, -0.25, 0.0])
    says(run, SAYS[Standing.POLICY], since)
    run.order("m", order="policy", to=[0.1])
    run.event("m", lambda event: "an action has one number for each of 3 axes" in str(event.get("sentence")), since)
    run.order("s", order="policy", takes=True)
    run.event("s", lambda event: "orders `policy` are for the master" in str(event.get("sentence")))
