"""Processes that are killed, started again, stopped and continued: who is left lets go, and all resume again."""

from __future__ import annotations

import random
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from tests.live.conftest import pair_of_keys, summary
from tests.live.killing import Site
from tests.live.verdict import judge

pytestmark = [
    pytest.mark.live,
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="processes are looked for in /proc"),
]


class Form(NamedTuple):
    """How many blows to one run; each joining process first has to simulate the run so far."""

    blows: int
    sealed: bool
    seed: int
    timeout: float = 0.2  # s, of the watchdogs
    knobs: tuple[str, ...] = ()


SHORT = [pytest.param(Form(4, False, 56), id="in the open"), pytest.param(Form(2, True, 4), id="sealed")]
LONG = [
    pytest.param(Form(25, sealed, seed), id=f"{'sealed' if sealed else 'in the open'} {seed}",
                 marks=[pytest.mark.soak, pytest.mark.timeout(600)])
    for seed in range(10, 14) for sealed in (False, True)
]
LONG += [  # a session ends before such a watchdog lets go: its force is there still when the next one begins
    pytest.param(Form(10, False, 20, timeout=1.5, knobs=("law=direct", "friction=6")), id="with patient watchdogs",
                 marks=[pytest.mark.soak, pytest.mark.timeout(600)])
]


@pytest.mark.parametrize("form", SHORT + LONG)
def test_whoever_is_left_lets_go_and_all_resume(form: Form, command: Callable[..., Any], tmp_path: Path) -> None:
    keys = pair_of_keys(tmp_path) if form.sealed else {}
    dice = random.Random(form.seed)
    site = Site(command, tmp_path, keys, 60 + 15 * form.blows, form.timeout, form.knobs)
    site.resumed(site.every[-1].began)
    for _ in range(form.blows):
        site.upset(dice)
    site.end()
    print(judge(site))


@pytest.mark.parametrize("sealed", [  # in the open: tests/live/test_kill.py
    pytest.param(False, marks=pytest.mark.full, id="in the open"), pytest.param(True, id="sealed")])
def test_a_channel_that_is_killed_and_started_again_carries_the_session_on(
    sealed: bool, command: Callable[..., Any], tmp_path: Path
) -> None:
    keys = pair_of_keys(tmp_path) if sealed else {"master": [], "slave": []}
    scene = ["hard_wall", "--set", "duration=600", "--link", "delay(0.01)", "--json"]
    slave = command("slave", *scene, "--listen", "127.0.0.1:0", *keys["slave"], "--out", str(tmp_path / "s"))
    far = ["--peer", f"127.0.0.1:{slave.port()}"]
    channel = command("channel", *scene, "--listen", "127.0.0.1:0", *far)
    near = f"127.0.0.1:{channel.port()}"
    master = command("master", *scene, "--peer", near, *keys["master"], "--out", str(tmp_path / "m"))
    ends = {"m": master, "s": slave}
    for end in ends.values():
        end.live(lambda numbers: numbers["gain"] == 1.0 and numbers["delay"] is not None)
    channel.signal(signal.SIGKILL)
    channel.process.wait()
    let_go = {e: end.live(lambda numbers: numbers["gain"] == 0.0)["k"] for e, end in ends.items()}
    command("channel", *scene, "--listen", near, *far).port()
    for end in ends.values():
        end.live(lambda numbers: numbers["gain"] == 1.0)
    master.signal(signal.SIGTERM)
    for e, end in ends.items():
        code, out, err = end.end()
        assert code == 0, (out, err)
        assert summary(tmp_path / e)["status"] == "stopped"
        trace = np.load(tmp_path / e / "trace.npz")
        again = trace[f"seq_{e}"][trace["t"] > let_go[e] * 1e-3]
        assert again.max() > let_go[e], "what was sent after the outage is played"
