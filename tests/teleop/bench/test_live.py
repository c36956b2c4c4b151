"""The bench of a live run: what it calls the lateness beside C is that of one run, and its busy loops end with it."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path
from typing import Any

import pytest

from teleop.bench import __main__ as bench
from teleop.bench.live import Alone, Round, computing, rows
from teleop.bench.timing import compiled
from tests.programs import COMPILERS, program


def own(p50: float, p99: float, most: float, skipped: int) -> dict[str, Any]:
    return {"late_us": {"p50": p50, "p99": p99, "p100": most}, "cpu": 0.1, "skipped": skipped}


SLAVE = own(40.0, 80.0, 90.0, 2)
RUNS = [
    Round({"master": own(10.0, 30.0, 90.0, 1), "slave": SLAVE}, Alone(20.0, 40.0, 0.01, 100.0, 40.0)),
    Round({"master": own(30.0, 90.0, 90.0, 5), "slave": SLAVE}, Alone(10.0, 60.0, 0.01, 100.0, 40.0)),
    Round({"master": own(20.0, 60.0, 90.0, 9), "slave": SLAVE}, Alone(10.0, 20.0, 0.01, 100.0, 40.0)),
]


def test_ratios_are_taken_within_a_round() -> None:
    told = {what: (value, asked) for what, value, asked in rows(RUNS, realtime=True, busy=True)}
    assert told["master: tick late by, median"] == ("20 us", "2.00 times C; asked: at most 1.5")
    assert told["master: tick late by, 99 %"] == ("60 us", "1.50 times C; asked: at most 1.5")
    assert told["slave: tick late by, most"] == ("90 us", "0.90 times C")
    assert told["master: ticks left out, of 10000: median, most"] == ("5, 9", "")
    assert told["C loop beside it, SCHED_FIFO, 40: late by, median / 99 % / most"][0] == "10 / 40 / 100 us"


def test_without_a_compiler_the_ends_are_told_alone() -> None:
    told = rows([run._replace(c=None) for run in RUNS], realtime=False, busy=True)
    assert told[-1][0] == "C loop on a timerfd beside it"
    assert ("--no-realtime, master: tick late by, median", "20 us", "") in told


def test_the_c_loop_says_its_lateness_its_share_and_its_scheduling(tmp_path: Path) -> None:
    program(*COMPILERS)
    timing = compiled("timing", tmp_path)
    assert timing is not None
    told = subprocess.run([program(timing), "tick", "20", "0"], check=True, capture_output=True, text=True).stdout
    alone = Alone(*map(float, told.split()))
    assert 0.0 < alone.p50 <= alone.p99 <= alone.p100
    assert alone.priority == 0


@pytest.mark.live
def test_busy_loops_end_with_their_block() -> None:
    def children() -> set[str]:
        task = Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children")
        return set(task.read_text().split()) if task.exists() else set()

    before = children()
    with computing([0]):
        assert len(children() - before) == 1 or not Path("/proc/self").exists()
    assert children() == before


def test_only_the_live_bench_is_busy(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("sys.argv", ["bench", "flood", "--busy"])
    assert bench.main() == 2
    assert "python -m teleop.bench live --busy" in capsys.readouterr().err
