"""A channel that is killed in the middle and started again: the two ends find each other again by themselves."""

from __future__ import annotations

import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.live.conftest import pair_of_keys, summary

pytestmark = pytest.mark.live


@pytest.mark.parametrize("sealed", [False, True], ids=["in the open", "sealed"])
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
