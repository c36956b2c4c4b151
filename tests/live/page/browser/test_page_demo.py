"""The page of a running `teleop demo --page`: a wall is pressed and felt, and a law is switched."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from teleop.scene.library import ROOT
from tests.browser import Page
from tests.waiting import PATIENCE, until

pytestmark = pytest.mark.live

PRESSED = "Math.abs(row.xs[0] - .03) < .005 && row.fm[0] > 1 && row.fe[0] > 1"


@pytest.fixture
def demo(tmp_path: Path) -> Iterator[tuple[str, int]]:
    """A demo of the default scene, until the test is over: the address of its page, its process id."""
    own = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    with (tmp_path / "said").open("w") as said:
        process = subprocess.Popen([sys.executable, "-u", "-m", "teleop", "demo", "--page", "--out", "out"],
                                   cwd=tmp_path, env={**own, "PYTHONPATH": str(ROOT)}, stdout=said, stderr=said)
    try:
        until(lambda: re.search(r"http://\S+\n", (tmp_path / "said").read_text()) or process.poll() is not None)
        found = re.search(r"http://\S+", (tmp_path / "said").read_text())
        assert found is not None, (tmp_path / "said").read_text()
        yield found.group(), process.pid
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(PATIENCE)


def test_a_drag_presses_the_wall_which_stays_felt_and_is_felt_again_when_the_law_is_switched(
    demo: tuple[str, int], tab: Callable[..., Page]
) -> None:
    page = tab(demo[0])
    page.until("row.t > 1")
    page.drag(page.place("#stage"), (page.evaluate("(.058 - base()[0]) * place().scale"), 0.0))  # the wall is at 30 mm
    page.until(PRESSED)
    t = page.evaluate("row.t")
    page.until(f"row.t > {t} + 1 && {PRESSED}")
    page.evaluate("document.getElementById('law').focus()")
    page.key("ArrowDown")  # the one below wave
    page.until("hello.law === 'wave_filter' && document.getElementById('law').value === 'wave_filter'")
    page.until("status.parts === 2")
    page.until("row.gain[0] > 0 && row.gain[1] > 0 && row.fm[0] > .3 && row.fe[0] > .3")
    page.key("Escape")
    page.until("Math.abs(row.fm[0]) < .5")
    assert page.console == []
