"""The touch of a live run: a wall that is pressed stays pressed through ticks that are left out."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from teleop import load_result, load_scene, run

pytestmark = pytest.mark.live

SLOW = """
import random, time
from master.device import SimulatedMaster
from slave.robot import SimulatedSlave
from teleop.live.end import end_main

end, device = {"m": ("m", SimulatedMaster), "s": ("s", SimulatedSlave)}[%r]
chances = random.Random(end)


class Slow(device):
    def hold(self, force):
        super().hold(force)
        if chances.random() < 0.12:
            time.sleep(2.2e-3)  # the next tick is left out, or two are


raise SystemExit(end_main(end, Slow))
"""


def test_a_pressed_wall_keeps_its_force_with_a_tenth_of_the_ticks_left_out(
    command: Callable[..., Any], tmp_path: Path
) -> None:
    """With zeros in the gaps the force was 0.0 N at 44 % of ticks left out."""
    for e in "ms":
        (tmp_path / f"slow_{e}.py").write_text(SLOW % e)
    scene = ["hard_wall", "--set", "duration=5", "--json"]
    slave = command("slow_s", *scene, "--listen", "127.0.0.1:0", "--out", str(tmp_path / "s"))
    near = f"127.0.0.1:{slave.port()}"
    channel = command("channel", *scene, "--listen", "127.0.0.1:0", "--peer", near)
    master = command("slow_m", *scene, "--peer", f"127.0.0.1:{channel.port()}", "--out", str(tmp_path / "m"))
    for end in (master, slave):
        code, out, err = end.end()
        assert code == 0, (out, err)
    traces = {e: load_result(tmp_path / e).trace for e in "ms"}
    for trace in traces.values():
        assert len(trace["t"]) < 0.95 * 5000, "ticks were left out"
    felt, touched = traces["m"]["f_m"][-100:].mean(), traces["s"]["f_s"][-100:].mean()
    pressed = run(load_scene("hard_wall", duration=5.0)).metrics["f_m_end"]
    assert pressed > 3.0
    assert felt > 0.8 * pressed
    assert touched > 0.8 * pressed
