"""The live line of an end: what it shows four times a second while it runs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from teleop.live import fault
from teleop.protocol.endpoint import Axes, Endpoint, Reading

SAY_NS = 250_000_000  # between two live lines

Say = Callable[[dict[str, Any]], None]


class LiveLine:
    """Hands the newest tick's numbers of `endpoint` to `say`, at most every `SAY_NS`."""

    def __init__(self, endpoint: Endpoint, say: Say) -> None:
        self._endpoint, self._say = endpoint, say
        self._shown: tuple[int, Reading, Axes] | None = None  # tick, reading and force of the newest tick
        self._late_ns = 0  # the most since the last live line
        self._said_ns = 0

    def tick(self, k: int, late_ns: int, reading: Reading, force: Axes) -> None:
        """Take note of tick k, which ran `late_ns` late."""
        self._shown = k, reading, force
        self._late_ns = max(self._late_ns, late_ns)

    def announce(self, now: int) -> None:
        """Say the numbers if it is time. A reader who has left is no reason to let go of the robot."""
        if now - self._said_ns > SAY_NS and self._shown is not None:
            self._said_ns = now
            try:
                self._say(self.numbers(*self._shown))
            except (OSError, ValueError):
                self._said_ns = 1 << 63

    def numbers(self, k: int, reading: Reading, force: Axes) -> dict[str, Any]:
        """What the live line shows, SI units but `late_us`; the lateness is the most since this was asked last."""
        late, self._late_ns = self._late_ns, 0
        link, guard = self._endpoint.link, self._endpoint.guard
        return {
            "end": self._endpoint.e, "k": k, "x": reading.x[0], "f": force[0], "late_us": late / 1e3,
            "delay": link.way.recent / 1e9 if link.way.count else None, "gain": guard.gain, "cause": guard.cause,
            "rtt": link.rtt.recent / 1e9 if link.rtt.count else None, "jitter": link.jitter_ns / 1e9,
            "loss": link.loss(self._endpoint.session.peer_every),
        }


fault.named(LiveLine.announce, "the live line")
