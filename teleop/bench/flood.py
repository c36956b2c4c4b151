"""The cost of bad datagrams to a live run: the lateness of its ticks, and the share of good packets still used.

Between the two ends stands a forwarder in C (`c/between.c`) which both take for their peer, so that what it throws
comes from the peer's own address, as it does from a host on the way; the other sender is a second socket of its own.
A quarter each of what it throws is random bytes, a good packet with one bit wrong, a good packet cut short, and
something like a DTLS record of the right length.

The ends ask to run before all others, as live ends do, the forwarder after them, and what throws last of these: what is
measured is what the datagrams cost, not what it costs to share a machine with those who send them. Where the system
refuses, they run as all do. Where less was thrown than asked, the row says how much.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from teleop.bench.timing import compiled, reason
from teleop.scene.library import ROOT

Row = tuple[str, str, str]
SECONDS = 3
SCENE = ("hard_wall", "--link", "none", "--set", f"duration={SECONDS}")
SLOW, FAST = 20_000, 200_000  # datagrams a second


class Flood(NamedTuple):
    """Bad datagrams a second: from the peer's own address to slave and master, and the same from another sender's."""

    own_slave: int = 0
    own_master: int = 0
    other_slave: int = 0
    other_master: int = 0


class FloodRun(NamedTuple):
    """The figures of a run under a flood; each pair is of the master and of the slave."""

    p99: tuple[float, float]  # of the ticks' lateness, us
    used: tuple[float, float]  # packets played, of those that the other end sent
    gain: float  # least of both watchdogs'
    status: str
    thrown: float  # bad datagrams a second, all together


CALM = Flood()
FLOODS = {
    "another sender": Flood(other_slave=SLOW, other_master=SLOW),
    "the peer's own address": Flood(own_slave=SLOW, own_master=SLOW),
    "another sender, at the slave": Flood(other_slave=FAST),
    "the peer's own address, at the slave": Flood(own_slave=FAST),
}


def flood(rounds: int) -> list[Row]:
    """Rows of (what, measured, asked): medians over `rounds`, each of them a calm run and one under each flood.

    Pairs are of the master and of the slave.
    """
    with TemporaryDirectory() as name:
        folder = Path(name)
        between = compiled("between", folder)
        if between is None:
            return [("bad datagrams", reason(), "")]
        links = {"in the open": (), **_sealed(folder)}
        rows: list[Row] = []
        for link, keys in links.items():
            runs: dict[str, list[FloodRun]] = {}
            for i in range(rounds):
                for what, rates in {"calm": CALM, **FLOODS}.items():
                    runs.setdefault(what, []).append(measured(rates, between, folder / f"{link}{what}{i}", keys))
            rows += _rows(link, runs)
    return rows


def _rows(link: str, runs: dict[str, list[FloodRun]]) -> list[Row]:
    calm = _p99(runs["calm"])
    rows: list[Row] = []
    for what, those in runs.items():
        rates = FLOODS.get(what, CALM)
        rate = max(rates)
        late, used = _p99(those), [median(run.used[i] for run in those) * 100 for i in (0, 1)]
        gain = min(run.gain for run in those)
        ended = {run.status for run in those} - {"ok"}
        thrown = median(run.thrown for run in those)
        bounds = [max(2 * p99, p99 + 200) for p99 in calm] if rate == SLOW else []
        rows.append((f"{link}, {f'{rate:,} a second from {what}' if rate else 'no flood'}: p99 late",
                     " / ".join(f"{p99:.0f}" for p99 in late) + " us",
                     f"asked: at most {bounds[0]:.0f} / {bounds[1]:.0f}" if bounds else ""))
        notes = ["asked: at least 0 / 99 / 1"] if rates.other_slave == FAST else []
        notes += [f"thrown were {thrown:,.0f} a second"] if thrown < 0.9 * sum(rates) else []
        rows.append((f"  good packets used; least gain of a watchdog{', '.join(['', *sorted(ended)])}",
                     " / ".join(f"{share:.2f}" for share in used) + f" %; {gain:g}", "; ".join(notes)))
    return rows


def _p99(runs: list[FloodRun]) -> tuple[float, float]:
    return median(run.p99[0] for run in runs), median(run.p99[1] for run in runs)


def measured(rates: Flood, between: str, folder: Path, keys: tuple[tuple[str, ...], ...] = ()) -> FloodRun:
    """A run of both ends, as processes of their own, under a flood. `keys`: the master's options and the slave's."""
    slave = _end("slave", folder, "--listen", "127.0.0.1:0", *(keys[1] if keys else ()))
    started = [slave]
    try:
        assert slave.stdout is not None
        port = json.loads(slave.stdout.readline())["port"]
        middle = subprocess.Popen([between, str(port), *map(str, rates)], stdout=subprocess.PIPE, text=True)
        started.append(middle)
        assert middle.stdout is not None
        near = middle.stdout.readline().strip()
        master = _end("master", folder, "--peer", f"127.0.0.1:{near}", *(keys[0] if keys else ()))
        started.append(master)
        for end in (master, slave):
            end.communicate(timeout=60)
        middle.terminate()
        *thrown, seconds = middle.communicate(timeout=60)[0].split()
    finally:
        for process in started:
            process.kill()
            process.communicate()
    ends = {end: json.loads((folder / end / "summary.json").read_text()) for end in ("master", "slave")}
    gains = [np.load(folder / end / "trace.npz")[f"g_{end[0]}"].min() for end in ends]
    return FloodRun(
        p99=(ends["master"]["master"]["late_us"]["p99"], ends["slave"]["slave"]["late_us"]["p99"]),
        used=(_used(ends["master"], ends["slave"], "bwd"), _used(ends["slave"], ends["master"], "fwd")),
        gain=float(min(gains)), status="/".join({end["status"] for end in ends.values()}),
        thrown=sum(map(int, thrown)) / max(1e-9, float(seconds)),
    )


def _used(end: dict[str, Any], peer: dict[str, Any], way: str) -> float:
    """The share played here of what was sent there."""
    heard = end["packets"][way]
    played = heard["received"] - heard["overtaken"] - heard["late"]
    return float(played / max(1, peer["packets"][way]["sent"]))


def _end(name: str, folder: Path, *options: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", name, *SCENE, *options, "--out", str(folder / name), "--json"], cwd=ROOT, text=True,
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
    )


def _sealed(folder: Path) -> dict[str, tuple[tuple[str, ...], ...]]:
    try:
        from teleop.protocol.secure.keys import keygen
    except ImportError:
        return {}
    made = {end: keygen(folder / end) for end in ("master", "slave")}
    return {"sealed": tuple(("--key", str(made[end][0]), "--peer-fingerprint", made[peer][1])
                            for end, peer in (("master", "slave"), ("slave", "master")))}
