"""A process that speaks to its parent as slave, channel and master do, with no endpoint in it: `fake.py NAME ...`.

It writes a record of the scene's columns, one row a tick of 1 ms, and answers orders; what it was told stands in
`orders-NAME.jsonl` beside its part. With `FAKE_NAME` in the environment it behaves otherwise: `refuses` each turn,
`deaf`: answers none, `crashes` when it is turned, `fails`: never comes up, `lingers` until a second signal.
"""

from __future__ import annotations

import json
import os
import select
import signal
import struct
import sys
import time
from argparse import ArgumentParser
from pathlib import Path
from typing import Any, TextIO

OF_ALL = ["k", "late_ns", "seq"]
COLUMNS = {
    "master": [*OF_ALL, "x_m", "v_m", "f_h", "f_m", "queue_m", "g_m", "E_in_fwd", "E_out_bwd", "E_port_m"],
    "slave": [*OF_ALL, "x_s", "v_s", "f_env", "f_s", "queue_s", "g_s", "E_in_bwd", "E_out_fwd", "E_port_s"],
}
FLUSH = 16
MEETS = 0.3  # s after a turn, until the next session begins


def tell(event: str, **fields: Any) -> None:
    print(json.dumps({"event": event, **fields}), flush=True)


class Fake:
    """One of the three; of an end the record, whose numbers are functions of the tick and of where the hand is."""

    def __init__(self, name: str, manner: str, out: str | None, knobs: dict[str, str]) -> None:
        self.name, self.manner, self.knobs = name, manner, knobs
        self.k = int(time.monotonic() * 1e3)  # both ends count by one clock
        self.at, self.said, self.rest = 0.0, 0.0, b""
        self.meets: float | None = None
        self.told: TextIO | None = None
        if out is not None:
            self.begin(out)
            self.told = (Path(out).parent.parent / f"orders-{name}.jsonl").open("a")
            tell("event", end=name[0], k=self.k, what="met", why="session 0")

    def begin(self, out: str) -> None:
        folder = Path(out)
        folder.mkdir(parents=True)
        self.file = (folder / "record.bin").open("wb")
        header = {"end": self.name[0], "dt_ns": 1_000_000, "axes": 1, "scene": "hard_wall", "knobs": self.knobs,
                  "seed": 0, "mode": "live", "force": "sensor", "columns": COLUMNS[self.name]}
        self.header = json.dumps(header).encode() + b"\n"
        self.file.write(self.header)
        self.file.flush()

    def idle(self) -> None:
        """The record ends; the newest rows go to another file."""
        self.file.close()
        folder = Path(self.file.name).parent
        self.file = (folder / "idle.bin").open("wb")
        self.file.write(self.header)

    def tick(self) -> None:
        """Write the rows that are due, and say how it goes four times a second."""
        now = time.monotonic()
        while self.k + FLUSH <= now * 1e3:
            for _ in range(FLUSH):
                self.file.write(struct.pack("<12d", self.k, 0.0, max(-1, self.k - 50), self.at, 0.0, 0.5, 1.5, 0.002,
                                            1.0, 3.0, 1.0, 0.0))
                self.k += 1
            self.file.flush()
        if self.meets is not None and now > self.meets:
            self.meets = None
            tell("event", end=self.name[0], k=self.k, what="met", why="the next session")
        if now - self.said > 0.25:
            self.said = now
            tell("live", end=self.name[0], k=self.k, x=self.at, f=1.5, late_us=10.0, delay=0.05, gain=1.0, cause=None,
                 rtt=0.1, jitter=0.001, loss=0.0)

    def hear(self) -> bool:
        """Take the orders that have come; False at the end of them."""
        data = os.read(0, 1 << 16)
        *lines, self.rest = (self.rest + data).split(b"\n")
        for line in lines:
            order = json.loads(line)
            if self.told is not None:
                self.told.write(json.dumps(order) + "\n")
                self.told.flush()
            if order["order"] == "hand" and order["to"] is not None:
                self.at = order["to"][0]
            if order["order"] == "idle" and not self.file.name.endswith("idle.bin"):
                self.idle()
            if order["order"] == "turn":
                self.turn(order)
        return bool(data)

    def turn(self, order: dict[str, Any]) -> None:
        if self.manner == "crashes":
            sys.exit("teleop: the fake crashed")
        if self.manner == "refuses":
            tell("refused", sentence="the fake does not like it")
        elif self.name not in COLUMNS:
            tell("turned")
        elif self.manner != "deaf":
            self.file.close()
            self.knobs = order["knobs"]
            self.begin(order["out"])
            tell("turned", k=self.k, out=order["out"])
            self.meets = time.monotonic() + MEETS


def main() -> None:
    name, parser = sys.argv[1], ArgumentParser()
    parser.add_argument("scene")
    for option in ("--seed", "--link", "--listen", "--peer", "--out", "--flush"):
        parser.add_argument(option)
    for option in ("--json", "--orders", "--no-realtime"):
        parser.add_argument(option, action="store_true")
    parser.add_argument("--set", action="append", default=[])
    args = parser.parse_args(sys.argv[2:])
    manner = os.environ.get(f"FAKE_{name.upper()}", "")
    if manner == "fails":
        sys.exit("teleop: the fake never comes up")
    over: list[int] = []
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda number, _: over.append(number))
    fake = Fake(name, manner, args.out, dict(each.split("=", 1) for each in args.set))
    tell("listening", address="127.0.0.1:1", port=4321, realtime=None)
    while len(over) < (2 if manner == "lingers" else 1):
        if select.select([0], [], [], 0.005)[0] and not fake.hear():
            break
        if name in COLUMNS:
            fake.tick()
    tell("done", path=args.out, summary={"sentence": "the fake was stopped"})


if __name__ == "__main__":
    main()
