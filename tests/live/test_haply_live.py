"""A master with a Haply Inverse3 by name, against a stand-in of its service in a process of its own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("websockets", reason="the extra `haply` is not installed")

from teleop import load_result
from teleop.live.records.record import read_events
from teleop.scene.library import ROOT
from tests.live.conftest import Command, summary

pytestmark = pytest.mark.live
Service = tuple[subprocess.Popen[str], str]
SERVICE = ROOT / "tests" / "master" / "inverse_stand_in.py"


@pytest.fixture
def service() -> Iterator[Callable[..., Service]]:
    """`service("vector")`: the stand-in's process, and its address."""
    started: list[subprocess.Popen[str]] = []

    def start(word: str, port: str = "0") -> Service:
        process = subprocess.Popen([sys.executable, SERVICE, word, port], cwd=ROOT,
                                   env={**os.environ, "PYTHONPATH": str(ROOT)}, stdout=subprocess.PIPE, text=True)
        started.append(process)
        assert process.stdout is not None
        return process, process.stdout.readline().strip()

    yield start
    for one in started:
        one.kill()
        one.communicate()


def ends(command: Callable[..., Command], url: str, duration: float) -> tuple[Command, Command]:
    """A slave, and a master that drives the Inverse3 at `url`."""
    knobs = "--set", f"duration={duration:g}", "--rate", "250", "--json"
    slave = command("slave", "hard_wall", *knobs, "--listen", "127.0.0.1:0", "--out", "slave")
    master = command("master", "hard_wall", *knobs, "--peer", f"127.0.0.1:{slave.port()}", "--out", "master",
                     "--device", f"haply:{url}?axes=y&origin=0,-0.12,0.15")
    return slave, master


def pushes(service: subprocess.Popen[str], shows: Callable[[float], bool]) -> None:
    """Read on until the stand-in says of its motors' force (N) what `shows`."""
    assert service.stdout is not None
    while not shows(float(service.stdout.readline().split()[1])):
        pass


def test_a_run_with_an_inverse3_by_name(
    service: Callable[..., Service], command: Callable[..., Command], tmp_path: Path
) -> None:
    there, url = service("values")
    slave, master = ends(command, url, 1.5)
    pushes(there, lambda force: force >= 0.1)  # the hand feels the slave
    for end in (master, slave):
        code, _, err = end.end()
        assert code == 0, err
        assert "holds its last force" not in err  # it has a watchdog
    pushes(there, lambda force: force == 0.0)
    result = load_result(tmp_path / "master")
    assert np.ptp(result.trace["x_m"]) > 0.01  # m: the hand moved, and was read
    assert summary(tmp_path / "master")["status"] == "ok"


def test_a_service_that_is_started_again_in_a_run_is_found_again_and_let_go_of_by_a_master_that_is_killed(
    service: Callable[..., Service], command: Callable[..., Command], tmp_path: Path
) -> None:
    there, url = service("vector")
    _, master = ends(command, url, 600.0)
    pushes(there, lambda force: force >= 0.1)
    there.kill()
    there.wait()
    there, _ = service("vector", url.rpartition(":")[2])
    pushes(there, lambda force: force >= 0.1)  # by the ramp
    master.signal(signal.SIGKILL)
    pushes(there, lambda force: force == 0.0)
    events = [event for event in read_events(tmp_path / "master") if event["what"] in ("safe", "released")]
    lost = next(i for i, event in enumerate(events) if event["what"] == "safe" and "Inverse service" in event["why"])
    # On a busy machine the link may fall silent in between, too.
    assert "released" in [event["what"] for event in events[:lost]]
    assert "released" in [event["what"] for event in events[lost:]]
