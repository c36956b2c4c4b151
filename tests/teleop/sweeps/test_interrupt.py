"""Ctrl-C during a sweep: what is done is kept, and nobody waits for work that cannot be stopped."""

from __future__ import annotations

import json
import signal
import time
from pathlib import Path
from threading import Event
from typing import Any

import pytest

import teleop.sweeps.runner
from teleop import sweep
from teleop.sweeps.chunk import ChunkResult, Job, work

FIXED = {"duration": 0.1}


def test_an_interrupt_while_a_job_compiles_waited_for_its_end(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A compiler asks nobody whether it may go on: the second row's job stands for it."""
    compiling, compiled, ended = Event(), Event(), Event()

    def compiles(job: Job, *told: Any) -> ChunkResult:
        if job.rows[0][0] == 0:
            return work(job, *told)
        compiling.set()
        compiled.wait(60.0)
        ended.set()
        return work(job, *told)

    def interrupt(done: int, _: int) -> None:
        if done:
            compiling.wait(60.0)
            raise KeyboardInterrupt

    monkeypatch.setattr(teleop.sweeps.runner, "work", compiles)
    with pytest.raises(KeyboardInterrupt):
        sweep("soft_tissue", {"k_e": [1.0, 2.0, 3.0]}, fixed=FIXED, workers=1, show=interrupt, out=tmp_path / "s")
    assert not ended.is_set()
    compiled.set()
    monkeypatch.undo()
    assert len(sweep("soft_tissue", {"k_e": [1.0, 2.0, 3.0]}, fixed=FIXED, out=tmp_path / "s")) == 3
    written = [json.loads(line)["row"] for line in (tmp_path / "s" / "rows.jsonl").read_text().splitlines()]
    assert sorted(written) == [0, 1, 2]


SLOW = """
import time
from pathlib import Path
from teleop import load_scene

def scene(*, k_e: float = 100.0):
    if k_e == 3.0:
        Path("busy").touch()
        time.sleep(600.0)
    return load_scene("soft_tissue", duration=0.1, k_e=k_e)
"""


@pytest.mark.live
@pytest.mark.parametrize("module", ["scenarios", "teleop"])
def test_a_process_that_was_interrupted_stayed_until_its_threads_were_done(
    process: Any, ended: Any, tmp_path: Path, module: str
) -> None:
    (tmp_path / "slow.py").write_text(SLOW)
    running = process("-m", module, "sweep", "slow.py", "--grid", "k_e=1,2,3", "--workers", "1", "--engine", "plain")
    began = time.monotonic()
    while not (tmp_path / "busy").exists():
        assert running.poll() is None
        assert time.monotonic() < began + 120.0
        time.sleep(0.01)
    running.send_signal(signal.SIGINT)
    answer = ended(running)
    assert time.monotonic() < began + 300.0  # of the 600 that its thread goes on for
    assert answer.code == 130
    assert "interrupted: the same command goes on from here" in answer.out
    assert "Traceback" not in answer.err
    assert json.loads((tmp_path / "runs/slow-sweep/summary.json").read_text())["status"] == "interrupted"
