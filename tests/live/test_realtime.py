"""--realtime asks, says what it got, and the run is there either way."""

from __future__ import annotations

import gc
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from teleop.live.process import realtime
from tests.live.conftest import summary

pytestmark = pytest.mark.live


@pytest.fixture(autouse=True)
def collector() -> Any:
    yield
    gc.enable()


def test_what_is_refused_is_said_with_what_would_grant_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse() -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(realtime, "_first", refuse)
    monkeypatch.setattr(realtime, "_lock", lambda: None)
    told = realtime.ask()
    assert told == {"scheduler": "no (Operation not permitted)", "memory": "locked", "garbage collection": "off"}
    assert not gc.isenabled()
    said = realtime.sentence(told)
    assert "CAP_SYS_NICE" in said
    assert "\n" not in said
    assert "CAP_SYS_NICE" not in realtime.sentence({"scheduler": "SCHED_FIFO", "memory": "locked"})


def test_a_system_without_such_a_word_is_no_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(realtime, "_lock", lambda: None)
    monkeypatch.delattr("os.sched_setscheduler")
    assert realtime.ask()["scheduler"] == "no (not on this system)"


def test_both_ends_run_with_it_and_their_summaries_say_what_they_got(
    command: Callable[..., Any], tmp_path: Path
) -> None:
    scene = ["hard_wall", "--set", "duration=0.5", "--set", "link=none", "--realtime", "--json"]
    slave = command("slave", *scene, "--listen", "127.0.0.1:0", "--out", str(tmp_path / "s"))
    master = command("master", *scene, "--peer", f"127.0.0.1:{slave.port()}", "--out", str(tmp_path / "m"))
    for end, name, folder in ((master, "master", "m"), (slave, "slave", "s")):
        code, out, _ = end.end()
        assert code == 0, out
        told = summary(tmp_path / folder)
        assert told["status"] == "ok"
        assert set(told[name]["realtime"]) == {"scheduler", "memory", "garbage collection"}
        assert told[name]["realtime"]["garbage collection"] == "off"
        assert any("realtime:" in note for note in told["notes"])
        assert json.dumps(told)
