"""A device of one's own, as `scenarios/examples/device.py` has it: an end of a live run like any other."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.live.conftest import summary

pytestmark = pytest.mark.live


def test_the_device_of_the_examples_is_driven_against_its_stop(command: Callable[..., Any], tmp_path: Path) -> None:
    scene = ["hard_wall", "--set", "duration=3", "--set", "law=direct", "--link", "none", "--json"]
    slave = command("scenarios.examples.device", *scene, "--listen", "127.0.0.1:0", "--out", str(tmp_path / "s"))
    near = f"127.0.0.1:{slave.port()}"
    master = command("master", *scene, "--peer", near, "--out", str(tmp_path / "m"))
    for end in (master, slave):
        code, out, err = end.end()
        assert code == 0, (out, err)
    assert summary(tmp_path / "s")["status"] == "ok"
    trace = np.load(tmp_path / "s" / "trace.npz")
    assert trace["x_s"].max() > 0.03, "it came to the stop"
    assert trace["f_env"].max() > 0.5, "which pushed back"
