"""`python -m slave`, `python -m channel` and `python -m master`, started by hand."""

from __future__ import annotations

import json
import os
import resource
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from teleop import load_result
from teleop.__main__ import main as report
from teleop.errors import Refused
from teleop.live.records.end_result import WAYS
from teleop.live.records.merge import merge, scene_of
from teleop.live.records.reader import FILE, read_noted, read_record
from teleop.live.records.record import EVERY
from teleop.scene.library import ROOT
from teleop.scene.loading import load_scene
from tests.live.conftest import share_received
from tests.waiting import PATIENCE, until

pytestmark = pytest.mark.live
Start = Callable[..., Any]

SCENE = ("hard_wall", "--set", "duration=0.6", "--set", "timeout=0.06")
LONG = ("hard_wall", "--set", "duration=600")  # nobody waits for its end
ANY = ("--listen", "127.0.0.1:0")
AT_THE_END = 30  # packets that a link of 10 ms may have lost behind the newest that came, and those of the farewell


def summary(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "summary.json").read_text())
    return found


def slave_and_master(command: Start, *scene: str, slave: tuple[str, ...] = (), master: tuple[str, ...] = ()) -> Any:
    one = command("slave", *scene, *ANY, "--json", *slave)
    other = command("master", *scene, "--peer", f"127.0.0.1:{one.port()}", "--json", *master)
    return one, other


def until_recorded(folder: Path) -> None:
    """Wait until the end whose folder this is has written rows."""
    record = folder / FILE
    until(lambda: record.is_file() and record.stat().st_size > 10_000)


def nothing_left(folder: Path) -> None:
    """But perhaps the folder of all runs, which either end may have made for the other."""
    assert [path for path in folder.rglob("*") if path.name != "runs"] == []


# Runs


def test_three_processes_make_a_run_and_both_ends_save_it(command: Start, tmp_path: Path) -> None:
    slave = command("slave", *SCENE, *ANY, "--json")
    channel = command("channel", *SCENE, *ANY, "--peer", f"127.0.0.1:{slave.port()}", "--json")
    master = command("master", *SCENE, "--peer", f"127.0.0.1:{channel.port()}", "--json")
    ended = {name: one.end() for name, one in (("master", master), ("slave", slave))}
    channel.signal(signal.SIGTERM)
    ended["channel"] = channel.end()
    assert {name: (code, err) for name, (code, _, err) in ended.items()} == dict.fromkeys(ended, (0, ""))
    for name in ("master", "slave"):
        events = [json.loads(line) for line in ended[name][1].splitlines()]
        assert [events[0]["event"], events[-1]["event"]] == ["listening", "done"]
        assert {event["event"] for event in events[1:-1]} == {"live"}
        left = summary(tmp_path / "runs" / f"hard_wall-{name}-1")
        assert events[-1]["summary"] == left
        own, (_, heard) = left[name], WAYS[name[0]]
        assert (left["status"], left["ticks"] + own["skipped"]) == ("ok", 600)
        assert own["delay"]["least"] >= 0.045
        assert own["rtt"]["least"] >= 0.095
        assert left["packets"][heard]["rejected"] == {}
        with np.load(tmp_path / "runs" / f"hard_wall-{name}-1" / "trace.npz") as trace:
            assert len(trace["t"]) == left["ticks"] == len(trace[f"late_{name[0]}"])
    counts = json.loads(ended["channel"][1].splitlines()[-1])["summary"]["counts"]
    assert counts["fwd"]["lost"] == counts["bwd"]["lost"] == 0
    assert counts["fwd"]["delivered"] == counts["fwd"]["received"] > 0


def test_of_ends_that_ran_by_hand_their_merge_counts_what_was_lost_on_the_way(command: Start, tmp_path: Path) -> None:
    """It said "0 lost" whatever the link had lost, and that all of it was under way at the end."""
    scene = (*SCENE, "--link", "delay(0.01) | bernoulli(0.2)")
    slave = command("slave", *scene, *ANY, "--out", "slave", "--json")
    channel = command("channel", *scene, *ANY, "--peer", f"127.0.0.1:{slave.port()}", "--json")
    master = command("master", *scene, "--peer", f"127.0.0.1:{channel.port()}", "--out", "master", "--json")
    assert [one.end()[0] for one in (master, slave)] == [0, 0]
    channel.signal(signal.SIGTERM)
    counted = json.loads(channel.end()[1].splitlines()[-1])["summary"]["counts"]
    whole = merge(scene_of(tmp_path / "master"), tmp_path / "master", tmp_path / "slave")
    for way, sender in (("fwd", "master"), ("bwd", "slave")):
        told, lost = whole.packets[way], counted[way]["lost"]
        skipped = summary(tmp_path / sender)[sender]["skipped"]
        assert told.sent == told.received + told.lost + told.in_flight
        assert lost - skipped - AT_THE_END <= told.lost <= lost + sum(told.rejected.values())


def test_two_ends_do_without_a_channel_and_talk_plainly_to_people(command: Start, tmp_path: Path) -> None:
    slave = command("slave", *SCENE, *ANY, "--out", "one/slave")
    said = slave.process.stdout.readline()
    assert said.startswith("slave: listening on 127.0.0.1:")
    at = said.split(";")[0].rpartition(" ")[2]
    master = command("master", *SCENE, "--peer", at, "--out", "one/master")
    for one in (slave, master):
        code, out, err = one.end()
        assert (code, err) == (0, "")
        assert "ok: ran to its end, 600 ticks" in out
        assert "\x1b" not in out
        assert "\r" not in out
        assert "written to one/" in out
    assert summary(tmp_path / "one" / "slave")["slave"]["delay"]["least"] < 0.03
    scene = load_scene("hard_wall", duration=0.6, timeout=0.06, playout="integral")
    whole = merge(scene, tmp_path / "one" / "master", tmp_path / "one" / "slave")
    assert whole.status == "ok"
    assert whole.ticks > 0
    assert whole.metrics["x_err_max"] < 0.05


def test_stepped_ends_by_hand_agree_on_seed_and_mode(command: Start) -> None:
    slave = command("slave", "canonical", "--lockstep", "--seed", "1", *ANY, "--json")
    master = command("master", "canonical", "--lockstep", "--seed", "2", "--peer", f"127.0.0.1:{slave.port()}")
    assert "seed is 2 here and 1 there" in master.refused()
    assert "seed is 1 here and 2 there" in slave.refused()


# Ends that do not match, or do not meet


@pytest.mark.parametrize(("at_slave", "at_master", "words"), [
    (("hard_wall",), ("hard_wall", "--set", "law=pfra"), ["law is", "pfra", "wave"]),
    (("hard_wall",), ("hard_wall", "--set", "law.b=3"), ["law.b is", "3.0", "20.0", "--set law.b="]),
    (("hard_wall", "--set", "k_e=1000"), ("hard_wall",), ["k_e is", "1000.0", "20000.0", "--set k_e="]),
    (("hard_wall", "--set", "dt=0.002"), ("hard_wall",), ["dt is", "0.002", "--set dt="]),
    (("hard_wall",), ("soft_tissue",), ["scene is", "hard_wall", "soft_tissue"]),
    (("hard_wall",), ("hard_wall", "--lockstep"), ["mode is", "live", "lockstep"]),
], ids=["law", "law's knob", "knob", "dt", "scene", "mode"])
def test_ends_that_differ_stop_both_and_leave_nothing(
    at_slave: tuple[str, ...], at_master: tuple[str, ...], words: list[str], command: Start, tmp_path: Path
) -> None:
    slave = command("slave", *at_slave, *ANY, "--json")
    master = command("master", *at_master, "--peer", f"127.0.0.1:{slave.port()}", "--json")
    for one in (master, slave):
        one.refused(*words, "here", "there")
    nothing_left(tmp_path)


def test_a_port_in_use_is_refused_in_one_sentence(command: Start, tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        at = f"127.0.0.1:{taken.getsockname()[1]}"
        slave = command("slave", *SCENE, "--listen", at)
        channel = command("channel", *SCENE, "--listen", at, "--peer", "127.0.0.1:9")
        for one in (slave, channel):
            one.refused(at, "in use", "--listen")
    nothing_left(tmp_path)


@pytest.mark.parametrize(("name", "arguments", "words"), [
    ("master", ("--peer", "127.0.0.1:9", "--wait", "0.3"), ["no answer from 127.0.0.1:9 in 0.3 s", "start the other"]),
    ("slave", (*ANY, "--wait", "0.3"), ["no master came in 0.3 s"]),
    ("master", ("--peer", "127.0.0.1"), ["--peer takes HOST:PORT", "write for example"]),
    ("master", ("--peer", "127.0.0.1:0"), ["--peer needs the port"]),
    ("master", ("--peer", "no..such..host:1"), ["--peer names the host 'no..such..host'"]),
    ("slave", ("--listen", "127.0.0.1:99999"), ["--listen takes HOST:PORT"]),
    ("slave", ("--listen", "203.0.113.1:9001"), ["203.0.113.1:9001 reaches beyond this machine", "--insecure"]),
    ("slave", (*ANY, "--wait", "nan"), ["--wait", "finite"]),
    ("slave", (*ANY, "--wait", "0"), ["--wait", "above 0"]),
    ("slave", (*ANY, "--out", "/dev/null/x"), ["cannot write to /dev/null/x", "--out"]),
    ("master", (), ["--peer", "--help"]),
], ids=lambda value: "" if isinstance(value, list) else " ".join(value) if isinstance(value, tuple) else value)
def test_a_request_that_comes_to_nothing_is_one_sentence(
    name: str, arguments: tuple[str, ...], words: list[str], command: Start, tmp_path: Path
) -> None:
    command(name, *SCENE, *arguments).refused(*words)
    nothing_left(tmp_path)


@pytest.mark.parametrize(("name", "came", "words"), [
    ("master", b"", ["master: no answer from 127.0.0.1:", " yet; start the other end first"]),
    ("slave", bytes((22, 254, 253)) + bytes(100),  # as an end with keys begins
     ["slave: no master came yet", "has one of the two keys, and the other none?"]),
    ("slave", b"BT\x03" + bytes(100), ["slave: no master came yet", "of another wire version than 4: install"]),
], ids=["silence", "keys", "wire version"])
def test_whoever_waits_is_told_what_may_be_wrong_while_it_waits(
    name: str, came: bytes, words: list[str], command: Start
) -> None:
    """A wrong port, keys at one end alone, or an older release was silence for ever at both."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        at = ("--peer", f"127.0.0.1:{other.getsockname()[1]}") if name == "master" else ANY
        end = command(name, *SCENE, *at)
        assert end.process.stdout is not None
        said = end.process.stdout.readline()
        if name == "slave":
            port = int(said.split(";")[0].rpartition(":")[2])
            other.sendto(came, ("127.0.0.1", port))
        assert end.process.stderr is not None
        hint = end.process.stderr.readline()
    assert hint.startswith(words[0])
    assert words[1] in hint


@pytest.mark.parametrize("closed", ["1", "2", "1 2"])
@pytest.mark.parametrize("form", [("--json",), ()])
def test_an_end_whose_streams_are_closed_runs_to_its_end(
    closed: str, form: tuple[str, ...], command: Start, tmp_path: Path
) -> None:
    """As under a service manager. What cannot be said ended the run, at both ends."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        at = f"127.0.0.1:{free.getsockname()[1]}"
    code = "import os, sys; [os.close(int(n)) for n in sys.argv[1].split()]; os.execv(sys.executable, sys.argv[2:])"
    words = [sys.executable, "-m", "slave", *SCENE, "--listen", at, "--out", "quiet", *form]
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen([sys.executable, "-c", code, closed, *words], cwd=tmp_path, env=env) as slave:
        code, _, err = command("master", *SCENE, "--peer", at, "--json").end()
        assert (code, err) == (0, "")
        assert slave.wait(PATIENCE) == 0
    assert summary(tmp_path / "quiet")["status"] == "ok"


# Stopping


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("who", ["slave", "master"])
def test_a_signal_stops_both_ends_and_both_keep_what_they_have(
    who: str, number: signal.Signals, command: Start, tmp_path: Path
) -> None:
    slave, master = slave_and_master(command, *LONG)
    first, other = (slave, master) if who == "slave" else (master, slave)
    first.event("live")
    first.event("live")
    first.signal(number)
    first.signal(number)  # an impatient finger
    assert first.end()[0] == other.end()[0] == 0
    name, its = (who, "master" if who == "slave" else "slave")
    left = {end: summary(tmp_path / "runs" / f"hard_wall-{end}-1") for end in ("master", "slave")}
    assert left[name]["status"] == left[its]["status"] == "stopped"
    assert left[name]["sentence"].endswith(f"it was asked to stop ({number.name})")
    assert "the other end left: stopped at t = " in left[its]["sentence"]
    for end in left:
        header, record, _ = read_record(tmp_path / "runs" / f"hard_wall-{end}-1")
        assert len(record.ticks) == left[end]["ticks"] > 0
        assert header["end"] == end[0]


def test_a_slave_that_is_stopped_while_it_waits_leaves_nothing(command: Start, tmp_path: Path) -> None:
    slave = command("slave", *SCENE, *ANY, "--json")
    slave.port()
    slave.signal(signal.SIGTERM)
    code, out, err = slave.end()
    assert (code, len(out.splitlines()), len(err.splitlines())) == (130, 1, 1)
    nothing_left(tmp_path)


def test_an_end_that_is_killed_leaves_a_record_and_the_other_lets_go(command: Start, tmp_path: Path) -> None:
    slave, master = slave_and_master(command, "hard_wall", "--set", "duration=2", "--set", "timeout=0.1")
    until_recorded(tmp_path / "runs" / "hard_wall-slave-1")
    slave.signal(signal.SIGKILL)
    code, out, _ = master.end()
    assert code == 0
    left = summary(tmp_path / "runs" / "hard_wall-master-1")
    assert (left["status"], left["ticks"] + left["master"]["skipped"]) == ("ok", 2000)
    with np.load(tmp_path / "runs" / "hard_wall-master-1" / "trace.npz") as trace:
        assert (trace["g_m"].max(), trace["g_m"][-1], trace["f_m"][-1]) == (1.0, 0.0, 0.0)
    gains = [event["gain"] for event in map(json.loads, out.splitlines()) if event["event"] == "live"]
    assert gains[-1] == 0.0
    rows = read_record(tmp_path / "runs" / "hard_wall-slave-1")[1].ticks
    assert len(rows) >= EVERY, "what was handed to the system outlives the process"


def test_a_run_that_diverges_is_saved_and_its_status_says_so(command: Start, tmp_path: Path) -> None:
    mine = tmp_path / "mine.py"
    mine.write_text("from dataclasses import replace\nfrom scenarios import canonical\n\n"
                    "def scene(*, x_limit: float = 0.01):\n    return replace(canonical.scene(), x_limit=x_limit)\n")
    for one in slave_and_master(command, "mine.py"):
        code, _, err = one.end()
        assert (code, err) == (0, "")
    left = [summary(tmp_path / "runs" / f"mine-{end}-1") for end in ("master", "slave")]
    assert "diverged" in {end["status"] for end in left}
    assert all("passed 0.01 m" in end["sentence"] for end in left)


# Other senders, and the state of the machine


def test_garbage_at_a_slaves_port_is_counted_and_the_run_goes_on(command: Start, tmp_path: Path) -> None:
    slave = command("slave", *SCENE, *ANY, "--json")
    at = ("127.0.0.1", slave.port())
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        for data in (b"", b"GET / HTTP/1.1", bytes(60000)):
            stranger.sendto(data, at)
        master = command("master", *SCENE, "--peer", f"127.0.0.1:{at[1]}", "--json")
        master.event("live")
        slave.event("live")
        for i in range(300):
            stranger.sendto(bytes([i % 256]) * (i + 1), at)
            time.sleep(0.0005)
        assert master.end()[0] == slave.end()[0] == 0
    left = summary(tmp_path / "runs" / "hard_wall-slave-1")
    assert left["status"] == "ok"
    # What came before the two had met; from then on the system keeps strangers out.
    assert left["packets"]["fwd"]["rejected"] == {"truncated": 1, "magic": 1, "oversize": 1}
    assert share_received(tmp_path / "runs" / "hard_wall-master-1", tmp_path / "runs" / "hard_wall-slave-1") > 0.5


def test_a_disk_that_fills_up_stops_the_record_and_not_the_loop(command: Start, tmp_path: Path) -> None:
    """A limit on the size of a file stands for the disk. The arrays of what was recorded do not fit below it either."""
    full = 40_000

    def small() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (full, full))

    slave = command("slave", *LONG, *ANY, "--json", preexec_fn=small)
    master = command("master", *LONG, "--peer", f"127.0.0.1:{slave.port()}", "--json")
    folder = tmp_path / "runs" / "hard_wall-slave-1"
    until(lambda: (folder / FILE).is_file() and (folder / FILE).stat().st_size == full)
    rows = read_noted(folder)[1]
    slave.live(lambda numbers: numbers["k"] > rows.ticks[-1] + 1000)
    slave.signal(signal.SIGTERM)
    assert master.end()[0] == 0
    code, _, err = slave.end()
    assert code == 2
    assert err.startswith("teleop: stopped at t = ")
    assert str(Path("runs") / "hard_wall-slave-1" / FILE) in err
    assert not (folder / "summary.json").exists()
    assert read_noted(folder)[1].ticks.tolist() == rows.ticks.tolist()
    left = summary(tmp_path / "runs" / "hard_wall-master-1")
    assert left["packets"]["bwd"]["received"] > len(rows.ticks), "the loop went on"


def test_what_a_killed_end_left_can_be_opened(command: Start, tmp_path: Path) -> None:
    """The arrays are made at the end, or at the next opening."""
    slave, master = slave_and_master(command, "hard_wall", "--set", "duration=2")
    until_recorded(tmp_path / "runs" / "hard_wall-slave-1")
    slave.signal(signal.SIGKILL)
    assert master.end()[0] == 0
    folders = [tmp_path / "runs" / f"hard_wall-{name}-1" for name in ("master", "slave")]
    left = load_result(folders[1])
    assert left.status == "stopped"
    assert "ended without a word after tick" in left.sentence
    assert {"x_s", "f_s", "f_env", "seq_s"} <= left.trace.keys()
    assert len(left.trace["t"]) == left.ticks > 0
    whole = merge(scene_of(folders[0]), *folders)
    assert whole.status == "stopped"
    assert 0 < whole.ticks <= left.ticks
    assert "x_err_rms" in whole.metrics


def test_two_ends_that_are_reported_while_they_run_and_then_killed_lose_no_tick_for_it(
    command: Start, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """They stayed at the tick of the report for good, and were said to have ended."""
    slave, master = slave_and_master(command, "hard_wall", "--set", "duration=60")
    folders = [tmp_path / "runs" / f"hard_wall-{name}-1" for name in ("master", "slave")]
    for folder in folders:
        until_recorded(folder)
    for typed in ([folders[0]], [folders[1]], folders):
        assert report(["report", *map(str, typed)]) == 0
        assert "still running" in capsys.readouterr().out
    assert [list(folder.glob("*.json")) + list(folder.glob("*.npz")) for folder in folders] == [[], []]
    then = len(read_record(folders[0])[1].ticks)
    until(lambda: len(read_record(folders[0])[1].ticks) > then + 250)
    for end in (master, slave):
        end.signal(signal.SIGKILL)
        end.process.wait()
    for folder in folders:
        left = load_result(folder)
        assert left.sentence.startswith("the process ended without a word")
        assert left.ticks == len(read_record(folder)[1].ticks) > then


def test_ends_of_two_runs_are_not_put_together(command: Start, tmp_path: Path) -> None:
    for delay in ("0.01", "0.02"):
        slave, master = slave_and_master(command, "hard_wall", "--set", "duration=0.2", "--set", f"delay={delay}")
        assert master.end()[0] == slave.end()[0] == 0
    runs = tmp_path / "runs"
    with pytest.raises(Refused, match="not the two ends of one run"):
        merge(scene_of(runs / "hard_wall-master-1"), runs / "hard_wall-master-1", runs / "hard_wall-slave-2")
    with pytest.raises(Refused, match="the master's folder first"):
        merge(scene_of(runs / "hard_wall-master-1"), runs / "hard_wall-slave-1", runs / "hard_wall-master-1")


def test_a_channel_of_another_scene_says_so(command: Start) -> None:
    slave = command("slave", *SCENE, *ANY, "--json")
    peer = f"127.0.0.1:{slave.port()}"
    channel = command("channel", *SCENE, "--set", "dt=0.002", *ANY, "--peer", peer, "--json")
    master = command("master", *SCENE, "--peer", f"127.0.0.1:{channel.port()}", "--json")
    assert master.end()[0] == slave.end()[0] == 0
    channel.signal(signal.SIGTERM)
    code, _, err = channel.end()
    assert code == 0
    assert "another scene than this channel: " in err
    assert "dt is" in err
