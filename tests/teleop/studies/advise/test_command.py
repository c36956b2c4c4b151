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
from tests.live.killing import free_port
from tests.waiting import until

LINK = ["--link", "delay(0.03) | bernoulli(0.03)"]
QUICK = ["--set", "duration=3", "--laws", "wave,direct", "--budget", "24", "--workers", "1"]
LOG = "".join(f"[170000000{i // 10}.{i % 10}00000] 64 bytes from 192.0.2.1: icmp_seq={i} ttl=57 "
              f"time={60 + i % 3}.0 ms\n" for i in range(1, 60) if i % 20)


def test_a_ping_log_and_a_wall_are_answered_in_a_page_and_a_figure(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "ping.txt"
    log.write_text(LOG)
    assert main(["advise", "--ping", str(log), "--wall", "2000", *QUICK, "--out", str(tmp_path / "a"), "--plot"]) == 0
    told = capsys.readouterr().out
    assert "30.5 ms median" in told
    assert (tmp_path / "a/advice.txt").read_text() in told
    document = json.loads((tmp_path / "a/summary.json").read_text())
    assert document["rows"] >= 24
    assert {one["law"] for one in document["laws"]} == {"wave", "direct"}
    with (tmp_path / "a/laws.csv").open() as file:
        assert [row["law"] for row in csv.DictReader(file)] == [one["law"] for one in document["laws"]]
    assert (tmp_path / "a/advise.png").stat().st_size > 10_000
    assert f"ping_log('{log}')" in " ".join(document["run"])


def test_a_delivery_trace_and_a_law_of_ones_own_are_taken_as_well(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    trace = tmp_path / "up.txt"
    trace.write_text("".join(f"{ms}\n" for ms in range(20, 4000, 20)))  # 15 packets every 20 ms
    law = Path(__file__).resolve().parents[4] / "scenarios/examples/law.py"
    link = f"mahimahi('{trace}') | delay(0.02) ; delay(0.03)"
    assert main(["advise", "--link", link, "--wall", "500", "--laws", str(law), "--set", "duration=3", "--budget", "9",
                 "--workers", "1", "--out", str(tmp_path / "a")]) == 0
    told = capsys.readouterr().out
    assert "forward " in told
    assert "; backward 30.0 ms" in told
    assert json.loads((tmp_path / "a/summary.json").read_text())["laws"][0]["value"] is not None


def rows(folder: Path) -> list[str]:
    path = folder / "rows.jsonl"
    return path.read_text().splitlines() if path.is_file() else []


def answer(folder: Path) -> dict[str, Any]:
    """What is answered, but for times and the command."""
    document: dict[str, Any] = json.loads((folder / "summary.json").read_text())
    return {key: value for key, value in document.items() if key not in ("command", "seconds", "seconds_told")}


def test_the_same_command_again_runs_nothing_and_another_question_is_refused(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    typed = ["advise", *LINK, "--wall", "2000", *QUICK, "--out", str(tmp_path / "a")]
    assert main(typed) == 0
    there, first = rows(tmp_path / "a"), answer(tmp_path / "a")
    assert main(typed) == 0
    assert rows(tmp_path / "a") == there
    assert answer(tmp_path / "a") == first
    assert main(["report", str(tmp_path / "a")]) == 0
    capsys.readouterr()
    typed[typed.index("2000")] = "900"
    assert main(typed) == 2
    assert "k_e is 2000.0 there and 900.0 here" in capsys.readouterr().err
    assert answer(tmp_path / "a") == first


@pytest.mark.live
@pytest.mark.parametrize("signal_", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_an_advice_that_was_stopped_by_a_signal_began_anew(
        signal_: signal.Signals, process: Any, ended: Any, tmp_path: Path) -> None:
    typed = ["advise", *LINK, "--wall", "2000", "--set", "duration=3", "--laws", "wave,direct,pp", "--budget", "240",
             "--workers", "2"]
    running = process("-m", "teleop", *typed, "--out", "a")
    until(lambda: rows(tmp_path / "a") or running.poll() is not None)
    running.send_signal(signal_)
    stopped = ended(running)
    assert stopped.code in (130, -signal_)
    assert ("the same command goes on from here" in stopped.out) == (signal_ is signal.SIGINT)
    before = [line for line in rows(tmp_path / "a") if line.endswith("}")]
    assert before
    assert ended(process("-m", "teleop", *typed, "--out", "a")).code == 0
    assert rows(tmp_path / "a")[:len(before)] == before
    assert ended(process("-m", "teleop", *typed, "--out", "b", "--workers", "1")).code == 0
    assert answer(tmp_path / "a") == answer(tmp_path / "b")
    assert sorted(rows(tmp_path / "a")) == sorted(rows(tmp_path / "b"))


@pytest.mark.live
def test_the_lines_that_are_printed_start_the_answer_live(process: Any, ended: Any, tmp_path: Path) -> None:
    typed = ["advise", "--link", "delay(0.01) | uniform(0.004) | bernoulli(0.02)", "--wall", "1000", "--set",
             "duration=3", "--laws", "wave,two_layer", "--budget", "60", "--workers", "1", "--out", "a"]
    told = ended(process("-m", "teleop", *typed))
    assert told.code == 0, told.err
    starts = [shlex.split(line) for line in told.out.splitlines() if line.startswith("  python -m ")]
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


@pytest.mark.parametrize(("typed", "why"), [
    (["--wall", "2000"], "no link is given"),
    ([*LINK, "--ping", "p.txt"], "leave one of them out"),
    (["--ping", "no-such-file.txt"], "no-such-file.txt cannot be read"),
    ([*LINK, "--scene", "free_motion", "--wall", "5"], "has no knob k_e"),
    ([*LINK, "--wall", "5", "--set", "k_e=5"], "both give the stiffness"),
    ([*LINK, "--laws", "wavee"], "did you mean wave"),
    ([*LINK, "--laws", ","], "names none"),
    ([*LINK, "--wall", "-5"], "--wall must be at least 0 N/m, not -5; write for example --wall=0"),
    ([*LINK, "--budget", "5", "--laws", "wave,direct"], "write --budget 6 or more, or fewer --laws"),
    ([*LINK, "--budget", "0"], "at least 1"),
    ([*LINK, "--objective", "x"], "objective"),
    (["--link", "dely(0.1)"], "did you mean delay"),
])
def test_a_wrong_request_is_one_sentence_and_leaves_nothing(
        typed: list[str], why: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["advise", "--out", str(tmp_path / "a"), *typed]) == 2
    told = capsys.readouterr().err
    assert why in told
    assert told.count("\n") == 1
    assert not (tmp_path / "a").exists()


def test_a_log_with_text_in_it_is_refused_with_its_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "ping.txt"
    log.write_text(LOG.replace("icmp_seq=7 ", "icmp_seq "))
    assert main(["advise", "--ping", str(log), *QUICK, "--out", str(tmp_path / "a")]) == 2
    assert "ping.txt, line 7: " in capsys.readouterr().err
    assert not (tmp_path / "a").exists()
