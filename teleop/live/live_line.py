"""The live line: what an end shows four times a second while it runs, and `teleop demo` of both ends."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from teleop.live import fault
from teleop.live.records.end_result import NAMES
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
        if late_ns > self._late_ns:  # noqa: PLR1730 - at every tick, and `max` takes three times as long
            self._late_ns = late_ns

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


def live_text(*ends: Mapping[str, Any]) -> str:
    """The live numbers of one end or of both, master/slave, what matters most first: a terminal may cut the rest.

    Of both, loss, round trip and jitter are the greater ones.

    >>> link = {"delay": 0.051, "rtt": 0.1, "jitter": 0.002, "loss": 0.0, "cause": None}
    >>> live_text({"end": "m", "x": 0.0573, "f": 0.41, **link}, {"end": "s", "x": 0.03, "f": 0.38, **link})
    'x 57.3/30.0 mm  f 0.4/0.4 N  delay 51/51 rtt 100 jitter 2.0 ms'
    """
    parts = []
    for one in ends:
        if one["cause"] is not None:
            whose = f"{NAMES[one['end']]} " if len(ends) > 1 else ""
            parts.append(f"{whose}SAFE {one['gain']:.0%}, {one['cause'].split(':')[0]}")
    parts += ["x " + "/".join(f"{one['x'] * 1e3:z.1f}" for one in ends) + " mm",
              "f " + "/".join(f"{one['f']:z.1f}" for one in ends) + " N"]
    heard = [one for one in ends if one["delay"] is not None]
    if not heard:
        return "  ".join([*parts, "nothing heard"])
    if (loss := max(one["loss"] for one in heard)) >= 0.0005:
        parts.append(f"loss {loss:.1%}" if loss < 0.01 else f"loss {loss:.0%}")
    delay = "/".join("-" if one["delay"] is None else _ms(one["delay"]) for one in ends)
    rtt = max((one["rtt"] for one in heard if one["rtt"] is not None), default=None)
    jitter = max(one["jitter"] for one in heard)
    return "  ".join([*parts, f"delay {delay}{'' if rtt is None else f' rtt {_ms(rtt)}'} jitter {_ms(jitter)} ms"])


def _ms(seconds: float) -> str:
    """In ms, as many digits as say something.

    >>> _ms(0.00012), _ms(0.0501), _ms(0.1004)
    ('0.1', '50', '100')
    """
    return f"{seconds * 1e3:.1f}" if seconds < 0.01 else f"{seconds * 1e3:.0f}"
