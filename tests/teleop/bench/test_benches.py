"""The benches of a tick's cost, of floods, of live runs, and of laws of plug-ins and files."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from teleop import Refused, find_law
from teleop.bench import __main__ as bench
from teleop.bench import flood, sweep
from teleop.bench.__main__ import BENCHES
from teleop.bench.cost import PARTS, place_of
from teleop.bench.live import Alone, Round, computing, rows
from teleop.bench.timing import compiled
from teleop.scene.library import ROOT
from tests.programs import COMPILERS, program


@pytest.mark.parametrize("name", [name for names in PARTS.values() for name in names])
def test_each_part_that_is_timed_is_a_function_of_the_stack(name: str) -> None:
    owner, last = place_of(name)
    assert callable(getattr(owner, last))


@pytest.mark.live
def test_two_ends_back_to_back_hear_each_other_and_have_all_the_parts() -> None:
    program = Path(place_of("bench.cost:main")[0].__file__)
    code = f"import runpy, sys; m = runpy.run_path({str(program)!r}); g = m['main'].__globals__; " \
           "g['TICKS'], g['WARM'] = 300, 50; m['main']()"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    found = json.loads(done.stdout)
    assert found.keys() == {"whole", *PARTS}
    assert all(us > 0.0 for us in found.values())


pytestmark = [
    pytest.mark.live,
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the forwarder is written for Linux"),
]


def test_a_flood_through_the_forwarder_is_seen_as_from_the_peer_and_leaves_the_run_whole(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A gentle one: 2000 a second at the slave, none at the master."""
    assert "flood" in BENCHES
    between = compiled("between", tmp_path)
    if between is None:
        pytest.skip("no C compiler here")
    monkeypatch.setattr(flood, "SCENE", ("hard_wall", "--link", "none", "--set", "duration=1"))
    run = flood.measured(flood.Flood(own_slave=2000), between, tmp_path)
    assert run.status == "ok"
    assert 0 < run.thrown < 2500
    assert all(0.0 < used <= 1.0 for used in run.used)
    assert run.gain <= 1.0
    told = {end: json.loads((tmp_path / end / "summary.json").read_text()) for end in ("master", "slave")}
    assert told["master"]["packets"]["bwd"]["rejected"] == {}
    found = told["slave"]["packets"]["fwd"]["rejected"]
    assert "checksum" in found, "what only looks like ours has to be opened"
    assert told["slave"]["slave"]["dropped_by_system"] > sum(found.values()), "the rest is dropped by the kernel"


def test_rows_say_what_was_asked_beside_what_was_measured() -> None:
    """The bound is of the calm run: twice it, or 0.2 ms more."""
    calm = flood.FloodRun(p99=(50.0, 300.0), used=(1.0, 1.0), gain=1.0, status="ok", thrown=0.0)
    under = flood.FloodRun(p99=(60.0, 700.0), used=(0.5, 0.25), gain=0.5, status="stopped", thrown=10.0)
    rows = flood._rows("in the open", {"calm": [calm], **{what: [under] for what in flood.FLOODS}})
    text = "\n".join("|".join(row) for row in rows)
    assert len(rows) == 2 * (1 + len(flood.FLOODS))
    assert text.count("asked: at most 250 / 600") == 2
    assert "50.00 / 25.00 %; 0.5|asked: at least 0 / 99 / 1; thrown were 10 a second" in text
    assert "watchdog, stopped" in text


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


def test_an_option_of_one_bench_is_refused_beside_others(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for option, typed in ((["--busy"], "live --busy"), (["--against", "tree"], "cost --against TREE"),
                          (["--model", "arm.xml"], "dynamics --model FILE.xml")):
        for benches in (["flood"], [typed.split()[0], "flood"], []):
            monkeypatch.setattr("sys.argv", ["bench", *benches, *option])
            assert bench.main() == 2
            assert capsys.readouterr().err.endswith(f"type python -m teleop.bench {typed}\n")


def test_it_sweeps_the_built_in_law_and_both_copies_and_takes_them_away(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sweep, "SHORT_ROWS", {"plain": 3})
    path = list(sys.path)
    told = sweep.own_laws(1)
    assert [what.split(",")[0] for what, _, _ in told] == [
        "plain", "  law of a plug-in", "  law of a file"]
    assert all(float(measured.split()[0]) > 0.0 for _, measured, _ in told)
    assert sys.path == path
    with pytest.raises(Refused):
        find_law("bench_waves")
