"""The cost of handing a run to other tools: files of a demo's 10 s, and the rows of it that go to PlotJuggler.

Processor time of this process alone.
"""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from io import BytesIO
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

from teleop.export.files import write_csv, write_mcap
from teleop.export.stored import read_parts
from teleop.export.stream import ROWS, GrowingEnd, GrowingRun, RowEncoder
from teleop.scene.library import ROOT

Row = tuple[str, str, str]
DEMOS = {"one axis": ["canonical"], "three axes": ["recorded_reach", "--set", "duration=10"]}


def export(rounds: int) -> list[Row]:
    """Rows of (what, measured, asked)."""
    rows: list[Row] = []
    with TemporaryDirectory() as at:
        for axes, words in DEMOS.items():
            folder = Path(at) / words[0]
            command = ["-m", "scenarios", "demo", *words, "--lockstep", "--out", str(folder), "--json"]
            subprocess.run([sys.executable, *command], check=True, stdout=subprocess.DEVNULL, cwd=ROOT)
            took: dict[str, list[float]] = {"CSV": [], "MCAP": []}
            sizes: dict[str, int] = {}
            streamed = []
            for _ in range(rounds):
                for kind, times in took.items():
                    file, began = BytesIO(), time.process_time()
                    parts = read_parts(folder, trust=False)
                    if kind == "CSV":
                        write_csv(file, parts)
                    else:
                        write_mcap(file, parts, "bench")
                    times.append(time.process_time() - began)
                    sizes[kind] = len(file.getvalue())
                streamed.append(_row(folder))
            rows += [(f"{axes}, 10 s as {kind}", f"{sizes[kind] / 1e6:.1f} MB, {median(took[kind]):.2f} s", "")
                     for kind in took]
            rows.append((f"{axes}, a row read, encoded and sent, {ROWS} a datagram", f"{median(streamed):.1f} us",
                         "asked: at most 2"))
    return rows


def _row(folder: Path) -> float:
    """Time for a row of the demo, us, without the pauses between datagrams."""
    run, encoders, rows, spent = GrowingRun(folder), dict[GrowingEnd, RowEncoder](), 0, 0.0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver, \
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        receiver.bind(("127.0.0.1", 0))
        sock.connect(receiver.getsockname())
        while not run.over:
            began = time.process_time()
            for some in run.take(ROWS):
                encoder = encoders.get(some.end) or encoders.setdefault(some.end, RowEncoder(some.end))
                for data in encoder.datagrams(some):
                    sock.send(data)
                rows += len(some.rows)
            spent += time.process_time() - began
    return spent / rows * 1e6
