"""A channel that is killed in the middle and started again: the two ends find each other again by themselves."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.live.conftest import pair_of_keys, summary

pytestmark = pytest.mark.live
SECONDS = 6


@pytest.mark.parametrize("sealed", [False, True], ids=["in the open", "sealed"])
def test_a_channel_that_is_killed_and_started_again_carries_the_session_on(
    sealed: bool, command: Callable[..., Any], tmp_path: Path
) -> None:
    keys = pair_of_keys(tmp_path) if sealed else {"master": [], "slave": []}
    scene = ["hard_wall", "--set", f"duration={SECONDS}", "--link", "delay(0.01)", "--json"]
    slave = command("slave", *scene, "--listen", "127.0.0.1:0", *keys["slave"], "--out", str(tmp_path / "s"))
    far = ["--peer", f"127.0.0.1:{slave.port()}"]
    channel = command("channel", *scene, "--listen", "127.0.0.1:0", *far)
    near = f"127.0.0.1:{channel.port()}"
    master = command("master", *scene, "--peer", near, *keys["master"], "--out", str(tmp_path / "m"))
    slave.event("live")
    time.sleep(0.5)
    channel.signal(signal.SIGKILL)
    channel.process.wait()
    command("channel", *scene, "--listen", near, *far).port()
    for end in (master, slave):
        code, out, err = end.end()
        assert code == 0, (out, err)
    for name, folder in (("m", "m"), ("s", "s")):
        assert summary(tmp_path / folder)["status"] == "ok"
        seq = np.load(tmp_path / folder / "trace.npz")[f"seq_{name}"]
        played = np.flatnonzero(seq >= 0)
        last = len(seq) - 800  # by then they have long met again
        assert np.count_nonzero(played > last) > 500
        assert np.diff(played).max() < 4000
