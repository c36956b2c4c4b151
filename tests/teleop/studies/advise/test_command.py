"""`teleop advise`, as it is typed."""

from __future__ import annotations

import csv
import json
import shlex
import signal
from pathlib import Path
from typing import Any

import pytest

from teleop.__main__ import main
from tests.waiting import free_port, until

WALL = ["advise", "--link", "delay(0.03) | bernoulli(0.03)", "--wall", "2000"]
LOG = "".join(f"[170000000{i // 10}.{i % 10}00000] 64 bytes from 192.0.2.1: icmp_seq={i} ttl=57 "
              f"time={60 + i % 3}.0 ms\n" for i in range(1, 60) if i % 20)


def rows(folder: Path) -> list[str]:
    path = folder / "rows.jsonl"
    return path.read_text().splitlines() if path.is_file() else []


def answer(folder: Path) -> dict[str, Any]:
    """What is answered, but for times and the command."""
    document: dict[str, Any] = json.loads((folder / "summary.json").read_text())
    return {key: value for key, value in document.items() if key not in ("command", "seconds", "seconds_told")}


def test_a_ping_log_and_a_wall_are_answered_once_and_the_same_command_again_runs_nothing(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, folder = tmp_path / "ping.txt", tmp_path / "a"
    log.write_text(LOG)
    words = ["advise", "--ping", str(log), "--wall", "2000", "--set", "duration=2.5", "--laws", "wave,direct",
             "--budget", "9", "--workers", "1", "--out", str(folder), "--plot"]
    assert main(words) == 0
    page = capsys.readouterr().out
    assert "30.5 ms median" in page
    assert (folder / "advice.txt").read_text() in page
    document = json.loads((folder / "summary.json").read_text())
    assert 12 <= document["rows"] <= 18
    assert {one["law"] for one in document["laws"]} == {"wave", "direct"}
    with (folder / "laws.csv").open() as file:
        assert [row["law"] for row in csv.DictReader(file)] == [one["law"] for one in document["laws"]]
    assert (folder / "advise.png").stat().st_size > 10_000
    assert f"ping_log('{log}')" in " ".join(document["run"])
    before, first = rows(folder), answer(folder)
    assert main(words) == 0
    assert (rows(folder), answer(folder)) == (before, first)
    assert main(["report", str(folder)]) == 0
    capsys.readouterr()
    words[words.index("2000")] = "900"
    assert main(words) == 2
    assert "k_e is 2000.0 there and 900.0 here" in capsys.readouterr().err
    assert answer(folder) == first


def test_a_delivery_trace_and_a_law_of_ones_own_are_taken_as_well(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    trace = tmp_path / "up.txt"
    trace.write_text("".join(f"{ms}\n" for ms in range(20, 4000, 20)))  # 15 packets every 20 ms
    law = Path(__file__).resolve().parents[4] / "scenarios/examples/law.py"
    link = f"mahimahi('{trace}') | delay(0.02) ; delay(0.03)"
    assert main(["advise", "--link", link, "--wall", "500", "--laws", str(law), "--set", "duration=1.6", "--budget",
                 "3", "--workers", "1", "--out", str(tmp_path / "a")]) == 0
    page = capsys.readouterr().out
    assert "forward " in page
    assert "; backward 30.0 ms" in page
    assert json.loads((tmp_path / "a/summary.json").read_text())["laws"][0]["value"] is not None


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of an advice that nobody stopped, by one worker."""
    folder = tmp_path_factory.mktemp("undisturbed") / "a"
    assert main([*STOPPED, "--out", str(folder), "--workers", "1"]) == 0
    return folder


STOPPED = [*WALL, "--set", "duration=1.6", "--laws", "wave,direct", "--budget", "24"]


@pytest.mark.full
@pytest.mark.live
@pytest.mark.parametrize("signal_", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_an_advice_that_was_stopped_by_a_signal_began_anew(
        signal_: signal.Signals, process: Any, ended: Any, tmp_path: Path, undisturbed: Path) -> None:
    running = process("-m", "teleop", *STOPPED, "--workers", "2", "--out", "a")
    until(lambda: rows(tmp_path / "a") or running.poll() is not None)
    running.send_signal(signal_)
    stopped = ended(running)
    assert stopped.code in (130, -signal_)
    assert ("the same command goes on from here" in stopped.out) == (signal_ is signal.SIGINT)
    before = [line for line in rows(tmp_path / "a") if line.endswith("}")]
    assert 0 < len(before) < len(rows(undisturbed))
    assert main([*STOPPED, "--workers", "2", "--out", str(tmp_path / "a")]) == 0
    assert rows(tmp_path / "a")[:len(before)] == before
    assert answer(tmp_path / "a") == answer(undisturbed)
    assert sorted(rows(tmp_path / "a")) == sorted(rows(undisturbed))


@pytest.mark.full
@pytest.mark.live
def test_the_lines_that_are_printed_start_the_answer_live(process: Any, ended: Any, tmp_path: Path) -> None:
    words = ["advise", "--link", "delay(0.01) | uniform(0.004) | bernoulli(0.02)", "--wall", "1000", "--set",
             "duration=1.5", "--laws", "two_layer", "--budget", "12", "--workers", "1", "--out", "a"]
    advised = ended(process("-m", "teleop", *words))
    assert advised.code == 0, advised.err
    starts = [shlex.split(line) for line in advised.out.splitlines() if line.startswith("  python -m ")]
    lines = {words[2]: words[1:] for words in starts}
    assert [*lines] == ["master", "slave"]
    assert all("law.K=" in " ".join(words) for words in lines.values())
    port = str(free_port())
    ends = {name: process(*[word.replace("9001", port) for word in lines[name]], "--out", name)
            for name in ("slave", "master")}
    for name, running in ends.items():
        done = ended(running)
        assert done.code == 0, done.err
        summary = json.loads((tmp_path / name / "summary.json").read_text())
        assert summary["status"] == "ok", summary["sentence"]
