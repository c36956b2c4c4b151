"""A demo that is followed from beside while it runs: all that its ends record arrives."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from teleop import load_result
from tests.live.conftest import Command
from tests.teleop.export.test_stream import Receiver
from tests.waiting import until

pytestmark = pytest.mark.live


def test_every_row_of_a_demo_arrives_once_while_it_runs_and_the_stream_ends_with_it(
    command: Callable[..., Command], tmp_path: Path
) -> None:
    receiver = Receiver()
    try:
        demo = command("teleop", "demo", "hard_wall", "--set", "duration=600", "--out", "run", "--json")
        until((tmp_path / "run" / "master" / "record.bin").is_file)
        follower = command("teleop", "stream", "run", "--plotjuggler", f"127.0.0.1:{receiver.at[1]}", "--json")
        until(lambda: len(receiver.datagrams) > 20, "nothing arrived")
        assert demo.process.poll() is None
        demo.signal(signal.SIGINT)
        code, _, err = demo.end()
        assert code == 130, err
        code, out, err = follower.end()
        assert code == 0, err
        told = json.loads(out)
        assert told["over"]
        assert told["unheard"] == 0
    finally:
        got = receiver.close()
    rows = [row for datagram in got for row in datagram]
    assert len(rows) == told["rows"]
    for name, e in (("master", "m"), ("slave", "s")):
        trace, own = load_result(tmp_path / "run" / name).trace, [row for row in rows if name in row]
        assert [row["timestamp"] for row in own] == trace["t"].tolist()
        assert [row[name][f"x_{e}"]["x"] for row in own] == trace[f"x_{e}"].tolist()
        assert [row[name][f"f_{e}"]["x"] for row in own] == trace[f"f_{e}"].tolist()
