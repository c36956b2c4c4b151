"""An end in C (`scenarios/examples/c`) beside an end of this package: sessions, loss, either one killed, the law."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
from collections.abc import Callable, Iterator
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgpack import unpackb

from teleop.__main__ import main
from teleop.protocol.packet import Echo, Kind, Packet, decode, encode
from tests.live.conftest import summary
from tests.programs import program
from tests.scenarios.examples.compiled import compiled

pytestmark = pytest.mark.live
Start = Callable[..., Any]

PP = ["hard_wall", "--set", "law=pp", "--set", "duration=600"]
WAVE = ["hard_wall", "--set", "duration=600"]
K, B, REJOIN, F_MAX, STEP = 400.0, 4.0, 2.0, 20.0, 2.0  # of PP: N/m, N s/m, 1/s; its cap, N; its slew limit, N a tick
LOG = ("met", "k", "x", "v", "f", "gain", "newest", "rx_0", "rx_1", "tx_0", "tx_1")


class InC:
    """Ends in C in `folder`: `start` gives a process, which logs into a file of its own."""

    def __init__(self, folder: Path, programs: Path) -> None:
        self.folder, self._programs, self.started = folder, programs, list[subprocess.Popen[str]]()

    def built(self, role: str, scene: list[str]) -> Path:
        """The program of an end, around what `teleop emit` prints for it."""
        folder = self._programs / sha256(repr([role, *scene]).encode()).hexdigest()[:12]
        folder.mkdir(exist_ok=True)
        built = folder / "end"
        return built if built.exists() else compiled("end", folder, end=(*scene, "--end", role[0]))

    def start(self, role: str, port: int, scene: list[str], log: str) -> subprocess.Popen[str]:
        words = [program(self.built(role, scene)), role, "127.0.0.1", str(port), "600", self.folder / log]
        self.started.append(subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True))
        return self.started[-1]

    def slave(self, scene: list[str], log: str) -> tuple[subprocess.Popen[str], int]:
        """Start a slave that listens; the port."""
        process = self.start("slave", 0, scene, log)
        assert process.stdout is not None
        return process, int(process.stdout.readline().split()[1])

    def rows(self, log: str) -> dict[str, Any]:
        """The columns of a log; the row in which its process was killed is left out."""
        lines = [line for line in (self.folder / log).read_text().splitlines()[:-1] if line.count(",") == len(LOG) - 1]
        table = np.array([line.split(",") for line in lines], dtype=float)
        return dict(zip(LOG, table.T, strict=True))


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("c")


@pytest.fixture
def in_c(programs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Iterator[InC]:
    ends = InC(tmp_path, programs)
    yield ends
    for one in ends.started:
        one.kill()
        one.communicate()
    capsys.readouterr()


def told(folder: Path) -> dict[str, Any]:
    """The columns of inputs.bin, all that an end of this package was told: see `teleop.live.records.inputs`."""
    head, _, rows = (folder / "inputs.bin").read_bytes().partition(b"\n")
    names = json.loads(head)["columns"]
    return dict(zip(names, np.frombuffer(rows).reshape(-1, len(names)).T, strict=True))


def ended(process: subprocess.Popen[str]) -> dict[str, Any]:
    """Ask an end in C to stop, and read what it has counted."""
    process.send_signal(signal.SIGTERM)
    out, err = process.communicate()
    assert process.returncode == 0, err  # a sanitizer would have said otherwise
    counts: dict[str, Any] = json.loads(out.splitlines()[-1])
    return counts


def hears_what_it_said(folder: Path, names: tuple[str, ...], *logs: dict[str, Any]) -> int:
    """How many messages of an end in C the other one played; each has, to the bit, the numbers that were sent."""
    heard, tx = told(folder), [f"tx_{i}" for i in range(len(names))]
    said = {k: row for log in logs for k, *row in zip(log["k"], *[log[each] for each in tx], strict=True)}
    fresh = [i for i, (got, k) in enumerate(zip(heard["fresh"], heard["newest"], strict=True)) if got and k in said]
    for i in fresh:
        assert [heard[f"rx.{name}"][i] for name in names] == said[heard["newest"][i]]
    return len(fresh)


def holds_what_the_law_says(log: dict[str, Any], sign: float) -> int:
    """At how many ticks of an end in C, with full gain and off the limits, the force was K (x - x') + B (v - v')."""
    f = np.zeros(len(log["k"]))
    met, slack, gain, k_before = 0.0, 0.0, 1.0, 0.0
    for i, k in enumerate(log["k"]):
        if log["met"][i] != met:
            met, slack, gain, k_before = log["met"][i], 0.0, 1.0, k - 1.0
        rx = (log["rx_0"][i], log["rx_1"][i]) if log["newest"][i] >= 0.0 else (0.0, 0.0)
        apart = sign * (log["x"][i] - rx[0])
        slack = (slack + (1.0 - gain) * (apart - slack)) * max(1.0 - REJOIN * (k - k_before) * 1e-3, 0.0)
        f[i] = K * (apart - slack) + B * sign * (log["v"][i] - rx[1])
        gain, k_before = log["gain"][i], k
    change = np.abs(np.diff(log["f"], prepend=log["f"][0]))
    plain = (log["gain"] == 1.0) & (log["newest"] >= 0.0) & (np.abs(f) < F_MAX) & (change < 0.99 * STEP)
    assert np.allclose(log["f"][plain], f[plain], rtol=0.0, atol=1e-9)
    return int(np.count_nonzero(plain))


def lets_go_first(log: dict[str, Any]) -> bool:
    """True if every session of it but the first began without force and the force came back within the slew limit."""
    later = np.flatnonzero(np.diff(log["met"], prepend=log["met"][0]))
    jumps = np.abs(np.diff(log["f"]))
    ticks = np.where(log["gain"][1:] > 0.0, 1.0, np.diff(log["k"]))  # let go after a stall it makes up for it
    return bool(np.all(log["f"][later] == 0.0) and np.all(jumps <= STEP * ticks + 1e-9))


def test_a_slave_in_c_serves_a_master_through_a_channel_that_loses_and_is_killed_and_started_again(
    command: Start, in_c: InC, tmp_path: Path
) -> None:
    scene = [*PP, "--link", "delay(0.005) | bernoulli(0.05)"]
    first, port = in_c.slave(scene, "first.csv")
    channel = command("channel", *scene, "--listen", "127.0.0.1:0", "--peer", f"127.0.0.1:{port}", "--json")
    master = command("master", *scene, "--peer", f"127.0.0.1:{channel.port()}", "--out", str(tmp_path / "m"), "--json")
    master.live(lambda numbers: numbers["k"] > 2000 and numbers["gain"] == 1.0)
    first.kill()
    first.wait()
    let_go = master.live(lambda numbers: numbers["gain"] == 0.0)["k"]
    second = in_c.start("slave", port, scene, "second.csv")
    again = master.live(lambda numbers: numbers["gain"] == 1.0 and numbers["k"] > let_go)["k"]
    master.live(lambda numbers: numbers["k"] > again + 1500)
    master.signal(signal.SIGTERM)
    assert master.end()[0] == 0
    counts = ended(second)
    left = summary(tmp_path / "m")
    assert left["master"]["sessions"] >= 2
    assert (left["packets"]["bwd"]["rejected"], counts["rejected"]) == ({}, 0)
    logs = [in_c.rows(name) for name in ("first.csv", "second.csv")]
    sent = sum(len(log["k"]) for log in logs)
    assert 0.5 * sent < left["packets"]["bwd"]["received"] < sent, "5 % are lost, and a machine may be slow"
    assert hears_what_it_said(tmp_path / "m", ("x", "v"), *logs) > 0.2 * sent
    assert min(holds_what_the_law_says(log, -1.0) for log in logs) > 200
    assert np.max(logs[0]["f"]) > 0.1
    assert logs[1]["k"][0] > let_go, "it takes up the grid of the master that went on"
    assert logs[1]["f"][0] == 0.0
    assert all(map(lets_go_first, logs))


@pytest.mark.full
def test_a_master_in_c_goes_on_with_a_slave_that_is_killed_and_started_again(
    command: Start, in_c: InC, tmp_path: Path
) -> None:
    slave = command("slave", *PP, "--listen", "127.0.0.1:0", "--out", str(tmp_path / "one"), "--json")
    port = slave.port()
    master = in_c.start("master", port, PP, "master.csv")
    slave.live(lambda numbers: numbers["k"] > 1000)
    slave.signal(signal.SIGKILL)
    slave.process.wait()
    slave = command("slave", *PP, "--listen", f"127.0.0.1:{port}", "--out", str(tmp_path / "two"), "--json")
    again = slave.live(lambda numbers: numbers["gain"] == 1.0)["k"]
    slave.live(lambda numbers: numbers["k"] > again + 1500)
    counts = ended(master)
    slave.end()
    left, log = summary(tmp_path / "two"), in_c.rows("master.csv")
    assert left["slave"]["sessions"] == 1
    assert set(left["packets"]["fwd"]["rejected"]) <= {"session"}, "what was still sent to the one that was killed"
    assert counts["met"] >= 2
    assert counts["rejected"] == 0
    assert hears_what_it_said(tmp_path / "two", ("x", "v"), log) > 0.2 * np.count_nonzero(log["met"] == 2.0)
    assert holds_what_the_law_says(log, 1.0) > 500
    assert np.max(log["f"]) > 0.5
    silent = (log["newest"] == log["newest"][log["met"] == 1.0][-1]) & (log["met"] == 1.0)
    assert log["f"][silent][-1] == 0.0, "a force without an answer goes to zero"
    assert lets_go_first(log)


@pytest.mark.parametrize("ours", [pytest.param("master", marks=pytest.mark.full), "slave"])
def test_waves_and_what_they_come_to_add_up_between_an_end_in_c_and_either_of_ours(
    ours: str, command: Start, in_c: InC, tmp_path: Path
) -> None:
    if ours == "master":
        theirs, port = in_c.slave(WAVE, "c.csv")
        at = ["--peer", f"127.0.0.1:{port}"]
    else:
        at = ["--listen", "127.0.0.1:0"]
    end = command(ours, *WAVE, *at, "--out", str(tmp_path / "ours"), "--json")
    if ours == "slave":
        theirs = in_c.start("master", end.port(), WAVE, "c.csv")
    end.live(lambda numbers: numbers["k"] > 1000)
    end.signal(signal.SIGTERM)
    assert end.end()[0] == 0
    counts = ended(theirs)
    left, log = summary(tmp_path / "ours"), in_c.rows("c.csv")
    way = "bwd" if ours == "master" else "fwd"
    assert (left["packets"][way]["rejected"], counts["rejected"], counts["met"]) == ({}, 0, 1)
    few = 0.5 * min(left["ticks"], len(log["k"]))  # either end leaves out what its machine is late for
    assert few > 50
    assert min(counts["received"], left["packets"][way]["received"]) > few
    assert hears_what_it_said(tmp_path / "ours", (), log) > few
    sent, heard = told(tmp_path / "ours"), {"master": "u", "slave": "w"}[ours]
    waves = dict(zip(sent["k"], sent[f"tx.{heard}"], strict=True))
    played = [(log["rx_0"][i], waves[k]) for i, k in enumerate(log["newest"]) if k in waves and log["met"][i] == 1.0]
    assert len(played) > few
    assert all(one == other for one, other in played)


@pytest.mark.full
def test_a_message_is_played_at_its_tick_by_a_fixed_playout_whichever_end_is_in_c(
    command: Start, in_c: InC, tmp_path: Path
) -> None:
    scene = [*PP, "--set", "playout=fixed:0.05", "--link", "delay(0.005) | uniform(0.02) | bernoulli(0.05)"]
    theirs, port = in_c.slave(scene, "c.csv")
    channel = command("channel", *scene, "--listen", "127.0.0.1:0", "--peer", f"127.0.0.1:{port}", "--json")
    end = command("master", *scene, "--peer", f"127.0.0.1:{channel.port()}", "--out", str(tmp_path / "ours"), "--json")
    end.live(lambda numbers: numbers["k"] > 2000 and numbers["gain"] == 1.0)
    end.signal(signal.SIGTERM)
    assert end.end()[0] == 0
    counts, log, heard = ended(theirs), in_c.rows("c.csv"), told(tmp_path / "ours")
    assert counts["rejected"] == 0
    fresh = np.diff(log["newest"], prepend=-1.0) > 0.0
    assert np.all(log["k"][fresh] - log["newest"][fresh] == 50.0)
    assert 50 < np.count_nonzero(fresh) < len(fresh) - 20, "some are lost"
    said = dict(zip(heard["k"], zip(heard["tx.x"], heard["tx.v"], strict=True), strict=True))
    played = [(rx, said[k]) for *rx, k in zip(log["rx_0"], log["rx_1"], log["newest"], strict=True) if k in said]
    assert len(played) > 50
    assert all(tuple(rx) == sent for rx, sent in played)
    assert hears_what_it_said(tmp_path / "ours", ("x", "v"), log) > 50
    assert holds_what_the_law_says(log, -1.0) > 20


def test_a_grid_that_begins_later_made_the_end_in_c_deaf_until_then(in_c: InC) -> None:
    """Tick 0 may be three minutes ahead: it slept until then, and took neither datagram nor SIGTERM."""
    slave, port = in_c.slave(PP, "c.csv")
    assert main(["manifest", *PP, "--write", str(in_c.folder / "manifest"), "--json"]) == 0
    entries = unpackb((in_c.folder / "manifest").read_bytes())
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as master:
        master.settimeout(30.0)
        master.connect(("127.0.0.1", port))

        def asked(packet: Packet) -> Packet:
            master.send(encode(packet, 1500))
            answer = decode(master.recv(8192), 2)
            assert isinstance(answer, Packet)
            return answer

        welcome = asked(Packet(Kind.HELLO, 7, 0, 1, None, entries, None))
        start = Packet(Kind.START, 7, 0, 2, Echo(welcome.sent_ns, 0), welcome.sent_ns + 150_000_000_000, None)
        assert asked(start).kind is Kind.START
        assert asked(start).kind is Kind.START, "it listens on"
    assert ended(slave)["met"] == 1


def test_ends_of_two_scenes_refuse_each_other_whichever_is_in_c_and_so_does_one_another_role(
    command: Start, in_c: InC
) -> None:
    other = [*PP, "--set", "k_e=2000"]
    slave, port = in_c.slave(PP, "c.csv")
    master = command("master", *other, "--peer", f"127.0.0.1:{port}")
    master.refused("the slave is set up for another run", "teleop manifest")
    assert ended(slave)["met"] == 0
    ours = command("slave", *other, "--listen", "127.0.0.1:0", "--json")
    theirs = in_c.start("master", ours.port(), PP, "c.csv")
    _, err = theirs.communicate()
    assert (theirs.returncode, "k_e is 20000.0 here and 2000.0 there" in err) == (2, True)
    ours.refused("the master asks for another run: k_e is 2000.0 here and 20000.0 there")
    words = [program(in_c.built("slave", PP)), "master", "127.0.0.1", "0", "1"]
    refused = subprocess.run(words, capture_output=True, text=True, check=False)
    assert (refused.returncode, refused.stderr) == (
        2, "type: end slave ADDRESS PORT SECONDS [LOG], the address as in 127.0.0.1\n")


@pytest.mark.full
def test_ends_of_two_axes_exchange_waves_and_what_they_come_to(command: Start, in_c: InC, tmp_path: Path) -> None:
    scene = ["bench_top", "--set", "axes=2", "--set", "duration=600"]
    theirs, port = in_c.slave(scene, "c.csv")
    end = command("master", *scene, "--peer", f"127.0.0.1:{port}", "--out", str(tmp_path / "ours"), "--json")
    end.live(lambda numbers: numbers["k"] > 1000 and numbers["gain"] == 1.0)
    end.signal(signal.SIGTERM)
    assert end.end()[0] == 0
    counts, left = ended(theirs), summary(tmp_path / "ours")
    assert (left["packets"]["bwd"]["rejected"], counts["rejected"], counts["met"]) == ({}, 0, 1)
    assert min(counts["received"], left["packets"]["bwd"]["received"]) > 0.5 * left["ticks"]
