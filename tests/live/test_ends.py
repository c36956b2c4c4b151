"""`python -m slave`, `channel` and `master`, by hand: in the open, with keys, and under floods of foreign datagrams."""

from __future__ import annotations

import json
import resource
import signal
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from channel.__main__ import main as channel_main
from master.__main__ import main as master_main
from slave.__main__ import main as slave_main
from teleop import Refused, load_result, load_scene
from teleop.__main__ import main as report
from teleop.live.records.end_result import WAYS
from teleop.live.records.merge import merge, scene_of
from teleop.live.records.reader import FILE, read_noted, read_record
from teleop.live.records.record import EVERY
from tests.live.conftest import pair_of_keys, share_received, summary
from tests.waiting import until

pytestmark = pytest.mark.live
Start = Callable[..., Any]

SCENE = ("hard_wall", "--set", "duration=0.6", "--set", "timeout=0.06")
LONG = ("hard_wall", "--set", "duration=600")  # nobody waits for its end
ANY = ("--listen", "127.0.0.1:0")
AT_THE_END = 80  # packets that a link of 50 ms may have lost behind the newest that came, and those of the farewell


def slave_and_master(command: Start, *scene: str, slave: tuple[str, ...] = (), master: tuple[str, ...] = ()) -> Any:
    one = command("slave", *scene, *ANY, "--json", *slave)
    other = command("master", *scene, "--peer", f"127.0.0.1:{one.port()}", "--json", *master)
    return one, other


def nothing_left(folder: Path) -> None:
    """But perhaps the folder of all runs, which either end may have made for the other."""
    assert [path for path in folder.rglob("*") if path.name != "runs"] == []


# Runs


def test_three_processes_make_a_run_and_what_they_saved_tells_what_was_lost_on_the_way(
    command: Start, tmp_path: Path
) -> None:
    """A merge of ends that ran by hand counted "0 lost" whatever the link had lost."""
    scene = (*SCENE, "--link", "delay(0.05) | bernoulli(0.2)")
    slave = command("slave", *scene, *ANY, "--json")
    channel = command("channel", *scene, *ANY, "--peer", f"127.0.0.1:{slave.port()}", "--json")
    master = command("master", *scene, "--peer", f"127.0.0.1:{channel.port()}", "--json")
    ended = {name: one.end() for name, one in (("master", master), ("slave", slave))}
    channel.signal(signal.SIGTERM)
    ended["channel"] = channel.end()
    assert {name: (code, err) for name, (code, _, err) in ended.items()} == dict.fromkeys(ended, (0, ""))
    folders = {name: tmp_path / "runs" / f"hard_wall-{name}-1" for name in ("master", "slave")}
    for name, folder in folders.items():
        events = [json.loads(line) for line in ended[name][1].splitlines()]
        assert [events[0]["event"], events[-1]["event"]] == ["listening", "done"]
        assert {event["event"] for event in events[1:-1]} <= {"live"}
        left = summary(folder)
        assert events[-1]["summary"] == left
        own, (_, heard) = left[name], WAYS[name[0]]
        assert (left["status"], left["ticks"] + own["skipped"]) == ("ok", 600)
        assert own["delay"]["least"] >= 0.045
        assert own["rtt"]["least"] >= 0.095
        assert left["packets"][heard]["rejected"] == {}
        with np.load(folder / "trace.npz") as trace:
            assert len(trace["t"]) == left["ticks"] == len(trace[f"late_{name[0]}"])
    counted = json.loads(ended["channel"][1].splitlines()[-1])["summary"]["counts"]
    whole = merge(scene_of(folders["master"]), folders["master"], folders["slave"])
    for way, sender in (("fwd", "master"), ("bwd", "slave")):
        told, lost = whole.packets[way], counted[way]["lost"]
        skipped = summary(folders[sender])[sender]["skipped"]
        assert counted[way]["delivered"] + lost == counted[way]["received"] > lost > 0
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


# Ends that do not match, or do not meet


@pytest.mark.parametrize(("at_slave", "at_master", "words"), [  # what else may differ: tests/teleop/protocol
    (("hard_wall", "--set", "k_e=1000"), ("hard_wall",), ["k_e is", "1000.0", "20000.0", "--set k_e="]),
    pytest.param(("canonical", "--lockstep", "--seed", "1"), ("canonical", "--lockstep", "--seed", "2"),
                 ["seed is", "1", "2"], marks=pytest.mark.full),
    (("hard_wall",), ("hard_wall", "--lockstep"), ["mode is", "live", "lockstep"]),
], ids=["knob", "seed", "mode"])
def test_ends_that_differ_stop_both_and_leave_nothing(
    at_slave: tuple[str, ...], at_master: tuple[str, ...], words: list[str], command: Start, tmp_path: Path
) -> None:
    slave = command("slave", *at_slave, *ANY, "--json")
    master = command("master", *at_master, "--peer", f"127.0.0.1:{slave.port()}", "--json")
    for one in (master, slave):
        one.refused(*words, "here", "there")
    nothing_left(tmp_path)


def test_a_port_in_use_and_a_peer_that_does_not_come_are_one_sentence_and_leave_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        at = f"127.0.0.1:{taken.getsockname()[1]}"
        for main, arguments, words in (
            (slave_main, ["--listen", at], [at, "in use", "--listen"]),
            (channel_main, ["--listen", at, "--peer", "127.0.0.1:9"], [at, "in use", "--listen"]),
            (master_main, ["--peer", at, "--wait", "0.3"], [f"no answer from {at} in 0.3 s", "start the other end"]),
            (slave_main, [*ANY, "--wait", "0.3"], ["no master came in 0.3 s"]),
        ):
            assert main([*SCENE, *arguments]) == 2
            err = capsys.readouterr().err
            assert err.startswith("teleop: ")
            assert err.count("\n") == 1
            assert all(word in err for word in words), err
    nothing_left(tmp_path)


@pytest.mark.full
def test_whoever_waits_is_told_what_may_be_wrong_while_it_waits(command: Start) -> None:
    """A wrong port, keys at one end alone, or an older release was silence for ever at both."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        cases = [
            ("master", b"", "master: no answer from 127.0.0.1:", " yet; start the other end first"),
            ("slave", bytes((22, 254, 253)) + bytes(100),  # as an end with keys begins
             "slave: no master came yet", "has one of the two keys, and the other none?"),
            ("slave", b"BT\x03" + bytes(100), "slave: no master came yet", "of another wire version than 4: install"),
        ]
        ends = [command(name, *SCENE, *(("--peer", f"127.0.0.1:{other.getsockname()[1]}") if name == "master" else ANY))
                for name, *_ in cases]
        for end, (name, sent, *_) in zip(ends, cases, strict=True):
            said = end.process.stdout.readline()
            if name == "slave":
                other.sendto(sent, ("127.0.0.1", int(said.split(";")[0].rpartition(":")[2])))
        for end, (_, _, begins, has) in zip(ends, cases, strict=True):
            hint = end.process.stderr.readline()
            assert hint.startswith(begins)
            assert has in hint


def test_a_slave_that_is_stopped_while_it_waits_leaves_nothing(command: Start, tmp_path: Path) -> None:
    slave = command("slave", *SCENE, *ANY, "--json")
    slave.port()
    slave.signal(signal.SIGTERM)
    code, out, err = slave.end()
    assert (code, len(out.splitlines()), len(err.splitlines())) == (130, 1, 1)
    nothing_left(tmp_path)


def test_an_end_that_is_killed_leaves_a_record_that_can_be_opened_and_the_other_lets_go(
    command: Start, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its arrays are made at the next opening."""
    slave, master = slave_and_master(command, "hard_wall", "--set", "duration=1.5", "--set", "timeout=0.1")
    folders = [tmp_path / "runs" / f"hard_wall-{name}-1" for name in ("master", "slave")]
    record = folders[1] / FILE
    until(lambda: record.is_file() and record.stat().st_size > 10_000, "it wrote no rows")
    slave.signal(signal.SIGSTOP)  # a process that stands still lives
    assert report(["report", str(folders[1])]) == 0
    assert "still running" in capsys.readouterr().out
    assert [*folders[1].glob("*.json"), *folders[1].glob("*.npz")] == [], "nothing is written while it runs"
    slave.signal(signal.SIGKILL)
    code, out, _ = master.end()
    assert code == 0
    left = summary(folders[0])
    assert (left["status"], left["ticks"] + left["master"]["skipped"]) == ("ok", 1500)
    with np.load(folders[0] / "trace.npz") as trace:
        assert (trace["g_m"].max(), trace["g_m"][-1], trace["f_m"][-1]) == (1.0, 0.0, 0.0)
    gains = [event["gain"] for event in map(json.loads, out.splitlines()) if event["event"] == "live"]
    assert gains[-1] == 0.0
    assert len(read_record(folders[1])[1].ticks) >= EVERY, "what was handed to the system outlives the process"
    opened = load_result(folders[1])
    assert opened.status == "stopped"
    assert "ended without a word after tick" in opened.sentence
    assert {"x_s", "f_s", "f_env", "seq_s"} <= opened.trace.keys()
    assert len(opened.trace["t"]) == opened.ticks > 0
    whole = merge(scene_of(folders[0]), *folders)
    assert whole.status == "stopped"
    assert 0 < whole.ticks <= opened.ticks
    assert "x_err_rms" in whole.metrics
    with pytest.raises(Refused, match="the master's folder first"):
        merge(scene_of(folders[0]), *reversed(folders))


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


# The state of the machine


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
    slave.live(lambda numbers: numbers["k"] > rows.ticks[-1] + 300)
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


FLOOD = """
import socket, time
out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
words = [b"", b"GET / HTTP/1.1", b"BT\\x01\\x00" + bytes(96), bytes(1200)]
port, seconds = map(float, input().split())  # it is up before the run is
sent, end = 0, time.monotonic() + seconds
while time.monotonic() < end:
    for word in words * 8:
        out.sendto(word, ("127.0.0.1", int(port)))
    sent += 32
print(sent)
"""


@pytest.mark.parametrize("sealed", [
    False, pytest.param(True, marks=pytest.mark.full)], ids=["in the open", "sealed"])
def test_a_flood_from_a_wrong_address_costs_no_good_packet(
    sealed: bool, command: Callable[..., Any], tmp_path: Path
) -> None:
    """Tens of thousands a second. Datagrams of other senders are dropped by the system once the two have met."""
    scene = ["hard_wall", "--set", "duration=1.5", "--set", "link=none"]
    keys = pair_of_keys(tmp_path) if sealed else {"master": [], "slave": []}
    flood = subprocess.Popen([sys.executable, "-c", FLOOD], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    slave = command("slave", *scene, *keys["slave"], "--listen", "127.0.0.1:0", "--json",
                    "--out", str(tmp_path / "s"))
    port = slave.port()
    master = command("master", *scene, *keys["master"], "--peer", f"127.0.0.1:{port}", "--json",
                     "--out", str(tmp_path / "m"))
    slave.event("live")
    thrown = int(flood.communicate(f"{port} 0.8\n")[0])
    assert master.end()[0] == slave.end()[0] == 0
    told = summary(tmp_path / "s")
    assert told["status"] == "ok"
    assert thrown > 1000, "of tens of thousands on a machine that has nothing else to do"
    assert share_received(tmp_path / "m", tmp_path / "s") > 0.95
    assert sum(told["packets"]["fwd"]["rejected"].values()) < 0.01 * thrown


HALF = ["hard_wall", "--set", "duration=0.5", "--json"]


@pytest.mark.parametrize(("called", "channels"), [
    ("127.0.0.2", 1), ("127.0.0.2", 0), pytest.param("0.0.0.0", 0, marks=pytest.mark.full)])
def test_two_ends_with_keys_run_sealed_also_if_the_slave_answers_from_another_address_of_its_host(
    called: str, channels: int, command: Callable[..., Any], tmp_path: Path
) -> None:
    """A slave on 0.0.0.0 does, if it is called by another address than the system would choose for an answer."""
    keys, scene = pair_of_keys(tmp_path), [*HALF, "--link", "none"]
    slave = command("slave", *scene, "--listen", "0.0.0.0:0", *keys["slave"], "--out", str(tmp_path / "s"))
    to = f"{called}:{slave.port()}"
    for _ in range(channels):
        to = f"127.0.0.1:{command('channel', *scene, '--listen', '127.0.0.1:0', '--peer', to).port()}"
    master = command("master", *scene, "--peer", to, *keys["master"], "--out", str(tmp_path / "m"))
    for end in (master, slave):
        code, out, err = end.end()
        assert code == 0, (out, err)
    for name, folder in (("master", "m"), ("slave", "s")):
        told = summary(tmp_path / folder)
        assert told["status"] == "ok"
        assert told[name]["sealed"] is True
        assert told[name]["associations"] == 1
        assert not told["packets"]["bwd" if name == "master" else "fwd"]["rejected"]
        assert keys[name][1] in " ".join(told["command"])  # the file's name, and nothing of what is in it
        assert "PRIVATE" not in (tmp_path / folder / "summary.json").read_text()
    assert share_received(tmp_path / "m", tmp_path / "s") > 0.8
    assert share_received(tmp_path / "s", tmp_path / "m") > 0.8


@pytest.mark.parametrize("wrong", ["master", pytest.param("slave", marks=pytest.mark.full)])
def test_an_end_with_another_key_is_not_let_in(wrong: str, command: Callable[..., Any], tmp_path: Path) -> None:
    """The stranger knows the fingerprint that it should have, and has not the key to it."""
    keys = pair_of_keys(tmp_path)
    (tmp_path / "stranger").mkdir()
    keys[wrong][:2] = pair_of_keys(tmp_path / "stranger")[wrong][:2]
    slave = command("slave", *HALF, "--listen", "127.0.0.1:0", *keys["slave"], "--wait", "2", "--out",
                    str(tmp_path / "s"))
    master = command("master", *HALF, "--peer", f"127.0.0.1:{slave.port()}", *keys["master"], "--wait", "2", "--out",
                     str(tmp_path / "m"))
    for end in (master, slave):
        end.refused("in 2 s")
    assert not (tmp_path / "s").exists()
    assert not (tmp_path / "m").exists()


def test_what_goes_in_the_open_all_the_same_says_so_loudly(command: Callable[..., Any], tmp_path: Path) -> None:
    slave = command("slave", *HALF, "--link", "none", "--listen", "0.0.0.0:0", "--insecure",
                    "--out", str(tmp_path / "s"))
    master = command("master", *HALF, "--link", "none", "--peer", f"127.0.0.1:{slave.port()}",
                     "--out", str(tmp_path / "m"))
    assert master.end()[0] == 0
    code, _, err = slave.end()
    assert code == 0
    assert "INSECURE" in err
    assert any("--insecure" in note for note in summary(tmp_path / "s")["notes"])
    assert not any("--insecure" in note for note in summary(tmp_path / "m")["notes"])
