"""A law's mistake in a line that runs in the middle of a live run: both ends let go, and say whose line it was."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.live

SCENE = '''
from dataclasses import dataclass
from teleop import Scene, load_scene
from teleop.laws.direct import Direct, Forth

@dataclass(frozen=True, kw_only=True)
class Mine(Direct):
    def master(self, s, at, rx):
        if at.x > 0.005:
            return {answer}  # the tenth line
        return 0.0, Forth(at.x, at.v), s

def scene(*, duration: float = 0.5) -> Scene:
    """A law with a mistake in it."""
    return load_scene("canonical", duration=duration, law=Mine())
'''


@pytest.mark.parametrize("stepping", [["--lockstep"], []], ids=["lockstep", "by the clock"])
@pytest.mark.parametrize(("answer", "said"), [
    ("rx.f_env / 0.0, Forth(at.x, at.v), s", "Mine.master (mine.py:10) raised ZeroDivisionError: "),
    ('"much", Forth(at.x, at.v), s', "the answer of Mine.master (mine.py:8) raised TypeError: "),
])
def test_a_mistake_in_the_middle_of_a_run_is_told_with_its_line_and_holds_no_force(
    answer: str, said: str, stepping: list[str], tmp_path: Path
) -> None:
    (tmp_path / "mine.py").write_text(SCENE.format(answer=answer))
    command = [sys.executable, "-m", "teleop", "demo", "mine.py", "--out", "d", *stepping]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 2, done.stderr
    assert said in done.stderr
    assert "Traceback" not in done.stderr
    ends: list[dict[str, Any]] = [json.loads((tmp_path / "d" / end / "summary.json").read_text())
                                  for end in ("master", "slave")]
    assert all(said in end["sentence"] for end in ends)
    assert all(end["status"] == "stopped" for end in ends)
