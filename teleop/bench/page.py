"""The cost of the live page: lateness of the ends with a page that is looked at, beside a demo without one.

Rounds of both, one after the other. The page is looked at by a client that drags the hand, as a browser's tab does: its
rows and its orders, without the drawing.
"""

from __future__ import annotations

import json
import math
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from teleop.live.page.command import page_bytes
from teleop.live.records.end_result import lateness, spread_us
from teleop.live.records.reader import read_record
from teleop.scene.library import ROOT

Row = tuple[str, str, str]
SECONDS = 10
ENDS = ("master", "slave")


class Looked(NamedTuple):
    """Run with a page: lateness (us) by end, the server's share of a core, s to the first rows, rows a second."""

    late: dict[str, dict[str, float]]
    cpu: float
    first: float
    rows: float


def page(rounds: int) -> list[Row]:
    """Rows of (what, measured, asked): medians over `rounds` pairs of 10 s."""
    without: list[dict[str, dict[str, float]]] = []
    looked: list[Looked] = []
    with TemporaryDirectory() as name:
        for i in range(rounds):
            without.append(_without(Path(name) / f"{i}-demo"))
            looked.append(_looked_at(Path(name) / f"{i}-page"))
    lines = []
    for end in ENDS:
        for quantile, what in (("p50", "median"), ("p99", "99 %")):
            ours, theirs = (median(each[end][quantile] for each in runs) for runs in (
                [run.late for run in looked], without))
            bound = "; asked: at most 1.2" if quantile == "p99" else ""
            lines.append((f"{end}: tick late by, {what}: with the page; without", f"{ours:.0f}; {theirs:.0f} us",
                         f"{ours / theirs:.2f} times{bound}"))
    return [*lines,
            ("the page's process: share of a core", f"{100.0 * median(run.cpu for run in looked):.1f} %",
             "asked: at most 5"),
            ("from the open socket to the first rows", f"{1e3 * median(run.first for run in looked):.0f} ms",
             "asked: at most 300"),
            ("rows a second", f"{median(run.rows for run in looked):.0f}", ""),
            ("the page, with its style and scripts", f"{len(page_bytes()) / 1e3:.1f} kB", "asked: at most 60")]


def _without(out: Path) -> dict[str, dict[str, float]]:
    done = subprocess.run(
        [sys.executable, "-m", "scenarios", "demo", "hard_wall", "--set", f"duration={SECONDS}", "--out", str(out),
         "--json"], check=True, capture_output=True, cwd=ROOT)
    summary = json.loads(done.stdout)
    return {end: summary[end]["late_us"] for end in ENDS}


def _looked_at(out: Path) -> Looked:
    process = subprocess.Popen(
        [sys.executable, "-m", "scenarios", "demo", "hard_wall", "--page", "--out", str(out)],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, cwd=ROOT, text=True)
    try:
        assert process.stderr is not None
        port, token = _address(iter(process.stderr.readline, ""))
        used, began = _processor_time(process.pid), time.monotonic()
        first, rows = _drag(port, token)
        cpu = (_processor_time(process.pid) - used) / (time.monotonic() - began)
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=60.0)
    late = {}
    for end in ENDS:
        header, record, by = read_record(out / "01" / end)
        late[end] = spread_us(lateness(record.ticks, by, header["dt_ns"]))
    return Looked(late, cpu, first, rows)


def _address(lines: Any) -> tuple[str, str]:
    for line in lines:
        if (address := re.search(r"http://(\S+)/\?token=(\S+)", line)) is not None:
            return address[1], address[2]
    raise RuntimeError("the page did not start; type teleop demo --page for the reason")


def _drag(host: str, token: str) -> tuple[float, float]:
    """Drag the hand to and fro for `SECONDS`: s to the first rows after the run had begun, and rows a second."""
    from websockets.sync.client import connect
    from websockets.typing import Origin

    def look() -> Any:
        return connect(f"ws://{host}/ws?token={token}", origin=Origin(f"http://{host}"), max_size=None)

    with look() as socket:  # until the three have come up
        while json.loads(socket.recv())["type"] != "rows":
            pass
    opened = time.monotonic()
    with look() as socket:
        while '"rows"' not in socket.recv():
            pass
        first = began = time.monotonic()
        count, due = 0, began
        while (now := time.monotonic()) < began + SECONDS:
            try:
                count += '"type":"rows"' in socket.recv(timeout=max(0.0, due - now))
            except TimeoutError:
                due += 1.0 / 60.0
                to = 0.03 + 0.03 * math.sin(2.0 * math.pi * 0.5 * (now - began))
                socket.send(json.dumps({"type": "hand", "to": [to]}))
        return first - opened, count / SECONDS


def _processor_time(pid: int) -> float:
    """Processor time that a process has used so far, s; on Linux alone."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
