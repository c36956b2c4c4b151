"""The bench of live timing: its parts run, here and in C, and what it calls a relay's error is that of the relay."""

from __future__ import annotations

import subprocess
import time
from itertools import pairwise
from pathlib import Path
from threading import Event, Thread

import pytest

from teleop.bench import timing
from teleop.bench.timing import CarriedLoad, Late, carried, compiled, datagrams, round_trips, ticks
from teleop.live.net.wire import Wire, bind_udp
from teleop.live.process.ticker import Alarm

pytestmark = pytest.mark.live


@pytest.fixture(scope="module")
def c(tmp_path_factory: pytest.TempPathFactory) -> str:
    program = compiled("timing", tmp_path_factory.mktemp("c"))
    if program is None:
        pytest.skip("there is no C compiler")
    return program


@pytest.mark.parametrize("spin_ns", [0, 150_000])
def test_an_alarm_is_timed(spin_ns: int) -> None:
    late = timing.tick(50, spin_ns)
    assert len(late) == 50
    assert min(late) >= 0


def test_ticks_that_a_stall_swallowed_are_late_each_by_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """One late call for all of them made a loop that stalls look better than one that is a little late each time."""
    wait, waits = Alarm.wait, [0]

    def stalls(alarm: Alarm) -> None:
        waits[0] += 1
        time.sleep(0.01 * (waits[0] == 20))
        wait(alarm)

    monkeypatch.setattr(Alarm, "wait", stalls)
    late = timing.tick(60, 0)
    assert len(late) == 60
    assert sum(each > 3_000_000 for each in late) >= 5
    assert any(one - after == timing.TICK_NS for one, after in pairwise(late))


def test_a_datagram_goes_there_and_back() -> None:
    over = Event()
    with bind_udp(("127.0.0.1", 0), "--listen") as here, bind_udp(("127.0.0.1", 0), "--listen") as there:
        echo = Thread(target=timing.echo, args=(Wire(there, None), over.is_set))
        echo.start()
        trips = timing.ping(Wire(here, there.getsockname()), 20)
        over.set()
        echo.join()
    assert len(trips) == 20
    assert min(trips) > 0


def test_ticks_and_round_trips_are_told_beside_c(c: str) -> None:
    rows = ticks(c, 1, 50) + round_trips(c, 1, 50)
    assert len(rows) == 10
    assert all(" us" in measured for _, measured, _ in rows)
    assert [asked.split("; ")[-1] for _, _, asked in rows if "times C" in asked and "asked" in asked] == [
        "asked: at most 1.5"] * 2 + ["asked: at most 2.2"] * 3


@pytest.mark.parametrize("ours", [True, False])
def test_a_relay_is_measured_by_what_comes_out(c: str, tmp_path: Path, ours: bool) -> None:
    datagrams(tmp_path, 100)
    got = carried(c, tmp_path, 1000, 100, ours=ours)
    assert isinstance(got, CarriedLoad)
    assert got.lost == 0
    assert 0.0 < got.error.median <= got.error.most


def test_an_error_of_the_delay_shows(c: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a relay that was told 35 ms where 20 are asked."""
    datagrams(tmp_path, 100)
    started = timing._started

    def off(*command: object, **streams: object) -> subprocess.Popen[str]:
        words = [35_000_000 if i and word == 20_000_000 and "relay" in command else word
                 for i, word in enumerate(command)]
        return started(*words, **streams)

    monkeypatch.setattr(timing, "_started", off)
    assert carried(c, tmp_path, 1000, 100, ours=False).error.median > 14_000.0


def test_ratios_are_taken_within_a_round() -> None:
    median, most = timing._beside("it", [Late(2.0, 9.0), Late(30.0, 1.0)], [Late(1.0, 3.0), Late(10.0, 1.0)])
    assert median == ("it, median", "16 us", "2.50 times C; asked: at most 1.5")
    assert most == ("  99 %", "5 us", "2.00 times C; asked: at most 1.5")


def test_without_a_compiler_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", "")
    assert timing.timing(1) == [("live timing beside C", "no C compiler here", "")]
