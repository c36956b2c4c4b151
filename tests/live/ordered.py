"""The three processes of a live run that takes orders, as `teleop demo --page` starts them, and their events."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from threading import Thread
from typing import Any

from tests.live.conftest import OWN
from tests.waiting import until

SHORT = {"m": "master", "s": "slave", "c": "channel"}


class Ordered:
    """Slave, channel and master of `scene` below `out`, each with --orders; close it when the test is over."""

    def __init__(self, scene: str, out: Path, knobs: dict[str, str]) -> None:
        self.scene, self.out, self.knobs = scene, out, knobs
        self.events: dict[str, list[dict[str, Any]]] = {}
        self.processes: dict[str, subprocess.Popen[str]] = {}
        self.part = 1
        slave = self.start("s", "--listen", "127.0.0.1:0", "--flush", "16", "--out", str(out / "01" / "slave"))
        channel = self.start("c", "--listen", "127.0.0.1:0", "--peer", f"127.0.0.1:{slave}")
        self.start("m", "--peer", f"127.0.0.1:{channel}", "--flush", "16", "--out", str(out / "01" / "master"))

    def start(self, who: str, *arguments: str) -> int:
        """Start one of them; the port that it listens on."""
        words = [part for name, value in self.knobs.items() for part in ("--set", f"{name}={value}")]
        process = subprocess.Popen(
            [sys.executable, "-m", SHORT[who], self.scene, *words, "--json", "--orders", *arguments], cwd=self.out,
            env=OWN, text=True, bufsize=1, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        )
        self.processes[who], heard = process, self.events.setdefault(who, [])

        def read() -> None:
            assert process.stdout is not None
            for line in process.stdout:
                heard.append(json.loads(line))

        Thread(target=read, daemon=True).start()
        return int(self.event(who, lambda event: event["event"] == "listening")["port"])

    def order(self, who: str, line: str | None = None, **order: Any) -> None:
        """Give an order to each of `who`."""
        for each in who:
            pipe = self.processes[each].stdin
            assert pipe is not None
            pipe.write((json.dumps(order) if line is None else line) + "\n")
            pipe.flush()

    def turn(self, who: str = "csm", align: float | None = None, *, again: bool = False, **knobs: str) -> Path:
        """Order a turn; the folder of the part that begins with it. `align`: where the master is brought, m."""
        if "m" in who:
            self.part += 1
        part = self.out / f"{self.part:02}"
        for each in who:
            more: dict[str, Any] = {} if each == "c" else {"out": str(part / SHORT[each]), "again": again}
            more |= {} if each != "m" or align is None else {"align": [align]}
            self.order(each, order="turn", knobs={**self.knobs, **knobs}, **more)
        return part

    def event(self, who: str, wanted: Callable[[dict[str, Any]], bool], since: int = 0) -> dict[str, Any]:
        """Wait for an event, among those after the first `since`."""
        found: list[dict[str, Any]] = []

        def came() -> bool:
            found.extend(each for each in self.events[who][since:] if wanted(each))
            return bool(found)

        until(came, f"no such event came from the {SHORT[who]}")
        return found[0]

    def happens(self, who: str, what: str, since: dict[str, int] | None = None) -> None:
        """Wait until each of `who` tells of an event `what` (met, safe, released, ...)."""
        for each in who:
            self.event(each, lambda event: what in (event["event"], event.get("what")), (since or {}).get(each, 0))

    def live(self, who: str, wanted: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """Wait for live numbers from now on that show this."""
        return self.event(who, lambda event: event["event"] == "live" and wanted(event), len(self.events[who]))

    def now(self) -> dict[str, int]:
        """How many events each has told of so far."""
        return {who: len(events) for who, events in self.events.items()}

    def close(self) -> None:
        """End their orders, which ends them; then whatever is left."""
        for process in self.processes.values():
            assert process.stdin is not None
            process.stdin.close()
        for process in self.processes.values():
            try:
                process.wait(20.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
