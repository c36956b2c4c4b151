"""`teleop study run` as it is typed, with real ends: blinded everywhere, cut, resumed, and its trials run again."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("websockets", reason="the extra `page` is not installed")

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from teleop import load_result
from teleop.__main__ import main
from teleop.live.page.rows import RecordTail
from teleop.people.journal import read_journal
from tests.live.study import NAMES, PLAN, StudySession, readable
from tests.waiting import PATIENCE, until

pytestmark = pytest.mark.live


def screen_of(session: StudySession) -> ClientConnection:
    """The socket of a screen."""
    from websockets.typing import Origin

    host, _, token = session.url.removeprefix("http://").partition("/?token=")
    return connect(f"ws://{host}/ws?token={token}", origin=Origin(f"http://{host}"), proxy=None, open_timeout=PATIENCE)


def sit(session: StudySession, over: Callable[[dict[str, Any]], bool]) -> list[str]:
    """Take part until a message shows that it is over; what the screen was sent."""
    sent: list[str] = []
    with screen_of(session) as socket:
        while True:
            sent.append(str(socket.recv(PATIENCE)))
            message = json.loads(sent[-1])
            if over(message):
                return sent
            answer: dict[str, Any] | None = None
            if message["type"] == "rows":
                answer = {"type": "hand", "to": [0.05]}
            elif message["type"] == "screen":
                answer = {"consent": {"type": "consent", "code": "P1"}, "instructions": {"type": "next"},
                          "stopped": {"type": "next"}}.get(message["screen"])
            if answer is not None:
                socket.send(json.dumps(answer))


def test_nothing_that_anybody_can_see_names_a_condition_and_a_cut_trial_runs_again(tmp_path: Path) -> None:
    (tmp_path / "plan.toml").write_text(PLAN.format(task='kind = "free"\nseconds = 0.5\nrepeats = 2',
                                                    primary="peak_force"))
    with StudySession(tmp_path) as session:
        sent = sit(session, lambda message: message.get("screen") == "trial" and message["done"] == 1)
        lines = session.command_lines()
        assert len(lines) == 3, lines
        printed = session.interrupt()
    assert "1 of 4 trials" in printed
    with StudySession(tmp_path, "--resume") as again:
        sent += sit(again, lambda message: message.get("screen") == "end")
        printed += again.wait()
    study = tmp_path / "study"
    rows = [row for row in read_journal(study / "sub-01" / "journal.jsonl") if row["kind"] == "trial"]
    assert [(row["number"], row["again"]) for row in rows] == [(1, 0), (2, 1), (3, 0), (4, 0)]
    assert {row["letter"] for row in rows} == {"A", "B"}
    assert all(row["peak_force"] > 1.0 and 0.03 < row["delay"] < 1.0 for row in rows)
    for seen in (*sent, *lines, printed, *session.lines, *again.lines, readable(study)):
        found = NAMES.search(seen)
        assert found is None, seen[max(0, found.start() - 80):found.end() + 80]
    assert {path.name for path in (study / "sub-01" / "trial-003").rglob("*") if path.is_file()} == {
        "hand.bin", "ends.bin"}
    assert not (study / ".live-01").exists()
    rerun = ["study", "rerun", str(study), "--trial", "sub-01/3", "--out"]
    assert main([*rerun, str(tmp_path / "blind")]) == 2
    assert main(["study", "unblind", str(study), "--name", "somebody"]) == 0
    assert main([*rerun, str(tmp_path / "again"), "--law", "direct"]) == 0
    assert json.loads((tmp_path / "again" / "interval-1" / "summary.json").read_text())["status"] == "ok"
    assert main([*rerun, str(tmp_path / "own")]) == 0
    own = load_result(tmp_path / "own" / "interval-1" / "master")
    at_peak = float(abs(own.trace["f_m"]).max())
    assert at_peak >= next(row["peak_force"] for row in rows if row["number"] == 3) > 1.0
    assert main(["replay", str(tmp_path / "own" / "interval-1" / "master")]) == 0, "and runs again to the bit"


def newest_force(study: Path) -> float | None:
    """The master's force of the newest row that it has written while nobody steers, N."""
    files = sorted(study.glob(".live-01/*/master/idle.bin"))
    if not files:
        return None
    tail = RecordTail(files[-1].parent, files[-1].name)
    tail.read()
    tail.close()
    return float(tail.newest[-1][tail.slices["f_m"].start]) if tail.newest else None


def test_stop_takes_the_force_away_and_whoever_withdraws_then_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "plan.toml").write_text(PLAN.format(task='kind = "free"\nseconds = 60.0', primary="peak_force"))
    with StudySession(tmp_path) as session:
        with screen_of(session) as socket:
            for message in ({"type": "consent", "code": "P1"}, {"type": "next"}):
                socket.send(json.dumps(message))
            pressing: dict[str, Any] = {}
            while not pressing.get("xm", [0.0])[0] > 0.035:  # beyond the wall's surface
                pressing = json.loads(socket.recv(PATIENCE))
                socket.send(json.dumps({"type": "hand", "to": [0.06]}))
            with screen_of(session) as second, pytest.raises(ConnectionClosed, match="1 page is open already"):
                second.recv(PATIENCE)
            socket.send(json.dumps({"type": "stop"}))
            until(lambda: newest_force(tmp_path / "study") == 0.0, "the force stays")
            rows = read_journal(tmp_path / "study" / "sub-01" / "journal.jsonl")
            assert [row["stopped"] for row in rows[1:]] == [True]
            socket.send(json.dumps({"type": "withdraw"}))
            while json.loads(socket.recv(PATIENCE)).get("screen") != "withdrawn":
                pass
        assert "nothing of the person is left" in session.wait()
    assert not (tmp_path / "study" / "sub-01").exists()
    assert not (tmp_path / "study" / ".live-01").exists()
