"""The live line: what an end shows four times a second while it runs, and `teleop demo` of both ends."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from teleop.live.records.end_result import NAMES
from teleop.protocol.endpoint import Axes, Endpoint, Reading
from teleop.scene.axes import FORCE_UNIT

SAY_NS = 250_000_000  # between two live lines
CAUSE = 17  # characters of why an end is in its safe state
NAME = 8  # characters of the name of an axis

Say = Callable[[dict[str, Any]], None]


class LiveLine:
    """Hands the newest tick's numbers of `endpoint` to `say`, at most every `SAY_NS`."""

    def __init__(self, endpoint: Endpoint, say: Say) -> None:
        self._endpoint, self._say = endpoint, say
        # Of the newest tick: its number, reading, force and row.
        self._shown: tuple[int, Reading, Axes, tuple[float, ...]] | None = None
        self._late_ns = 0  # the most since the last live line
        self._said_ns = 0

    def go_on(self, endpoint: Endpoint) -> None:
        """Show another endpoint from now on."""
        self._endpoint, self._shown = endpoint, None

    def tick(self, k: int, late_ns: int, reading: Reading, force: Axes, row: tuple[float, ...]) -> None:
        """Take note of tick k, which ran `late_ns` late; `row` is its row of the record."""
        self._shown = k, reading, force, row
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

    def numbers(self, k: int, reading: Reading, force: Axes, row: tuple[float, ...]) -> dict[str, Any]:
        """Numbers of the live line, SI units but `late_us`; the lateness is the most since this was called last.

        `x` and `f` are of the first axis. Of several axes, or of one that turns, `axes` has name and unit, position,
        force and force cap (None: none) of each. `queue` is that of the waves heard here, of several axes the longest;
        None where nothing has one. `loss` is None where the other end has a deadband: what that did not send would
        count as lost.
        """
        late, self._late_ns = self._late_ns, 0
        endpoint, link, guard = self._endpoint, self._endpoint.link, self._endpoint.guard
        scene = endpoint.scene
        queue = [row[i] for i in endpoint.places.queues]
        return {
            "end": endpoint.e, "k": k, "x": reading.x[0], "f": force[0], "late_us": late / 1e3,
            "delay": link.way.recent / 1e9 if link.way.count else None, "gain": guard.gain, "cause": guard.cause,
            "rtt": link.rtt.recent / 1e9 if link.rtt.count else None, "jitter": link.jitter_ns / 1e9,
            "loss": None if scene.deadband is not None else link.loss(endpoint.session.peer_every),
            "queue": max(queue) if queue else None,
        } | ({} if scene.axes == 1 and not scene.units else {"axes": [*zip(
            scene.axis_names, scene.axis_units, reading.x, force,
            [getattr(cap, "f_max", None) for cap in scene.per_axis("cap")], strict=True)]})


def live_text(*ends: Mapping[str, Any]) -> tuple[str, str]:
    """The live numbers of one end or of both, master/slave, what matters most first; and what matters less.

    Both are parts two spaces apart, of which a narrow terminal leaves out the last ones. The safe state, the forces
    (below 10 kN) and the queue (below 10 s) always fit 80 columns behind what `Progress` needs. Of both ends, loss,
    round trip and jitter are the greater ones. Of several axes the one is shown whose forces are the greatest share of
    their caps, with its name; without caps the one with the greatest forces.

    >>> link = {"delay": 0.051, "rtt": 0.1, "jitter": 0.002, "loss": 0.0, "cause": None, "queue": 0.0007}
    >>> live_text({"end": "m", "x": 0.0573, "f": 0.41, **link}, {"end": "s", "x": 0.03, "f": 0.38, **link})
    ('f 0.4/0.4 N  queue 0.7/0.7 ms  x 57.3/30.0 mm  delay 51/51 ms', 'rtt 100 ms  jitter 2.0 ms')
    """
    name, unit, shown = _hardest(ends)
    parts = [*_safe(ends), name + _quantity("f", shown, lambda one: _newtons(one["f"]), FORCE_UNIT[unit])]
    if any(one["queue"] is not None for one in ends):
        parts.append(_quantity("queue", ends, lambda one: _ms(one["queue"]), "ms"))
    parts.append(_quantity("x", shown, lambda one: f"{one['x'] * 1e3:z.1f}", f"m{unit}"))
    heard = [one for one in ends if one["delay"] is not None]
    if not heard:
        return "  ".join([*parts, "nothing heard"]), ""
    loss = max((one["loss"] for one in heard if one["loss"] is not None), default=0.0)
    if loss >= 0.0005:
        parts.append(f"loss {loss:.1%}" if loss < 0.01 else f"loss {loss:.0%}")
    parts.append(_quantity("delay", ends, lambda one: _ms(one["delay"]), "ms"))
    rtt = max((one["rtt"] for one in heard if one["rtt"] is not None), default=None)
    less = [f"rtt {_ms(rtt)} ms"] * (rtt is not None) + [f"jitter {_ms(max(one['jitter'] for one in heard))} ms"]
    return "  ".join(parts), "  ".join(less)


def _hardest(ends: Sequence[Mapping[str, Any]]) -> tuple[str, str, Sequence[Mapping[str, Any]]]:
    """Name (with a space) and unit of the axis that is shown, and the ends with its position and force."""
    every = [end.get("axes") for end in ends]
    if not every or not all(every) or len({len(axes) for axes in every if axes}) > 1:
        return "", "m", ends
    load = [sum(abs(f) / (cap or 1.0) for _, _, _, f, cap in same) for same in zip(*every, strict=True)]
    i = max(range(len(load)), key=load.__getitem__)
    name, unit, *_ = every[0][i]  # type: ignore[index]  # none is None, see above
    shown = [{**end, "x": axes[i][2], "f": axes[i][3]}  # type: ignore[index]  # as above
             for end, axes in zip(ends, every, strict=True)]
    return f"{name[:NAME]} " * (len(load) > 1), unit, shown


def _safe(ends: Sequence[Mapping[str, Any]]) -> list[str]:
    """Note on the ends in the safe state, with their gains and why; empty if none is."""
    safe = [one for one in ends if one["cause"] is not None]
    if not safe:
        return []
    kinds = dict.fromkeys(one["cause"].split(":")[0].removeprefix("the ").removeprefix("a ") for one in safe)
    room = CAUSE if len(kinds) == 1 else CAUSE // 2 + 1
    whose = f"{NAMES[safe[0]['end']]} " if len(safe) < len(ends) else ""
    gains = "/".join(f"{one['gain']:.0%}" for one in safe)
    return [f"{whose}SAFE {gains}, {'/'.join(kind[:room] for kind in kinds)}"]


def _quantity(name: str, ends: Sequence[Mapping[str, Any]], text: Callable[[Mapping[str, Any]], str], unit: str) -> str:
    """Text of one quantity of each end."""
    return f"{name} {'/'.join(map(text, ends))} {unit}"


def _newtons(force: float) -> str:
    """A force, in as many characters as a narrow line has for it.

    >>> _newtons(-0.04), _newtons(-19.87), _newtons(123.4), _newtons(2e7)
    ('0.0', '-19.9', '123', '2e+07')
    """
    return f"{force:z.1f}" if abs(force) < 99.95 else f"{force:.0f}" if abs(force) < 9999.5 else f"{force:.0e}"


def _ms(seconds: float | None) -> str:
    """In ms, as many digits as say something; - where there is none.

    >>> _ms(0.00012), _ms(0.0501), _ms(0.1004), _ms(None)
    ('0.1', '50', '100', '-')
    """
    return "-" if seconds is None else f"{seconds * 1e3:.1f}" if seconds < 0.01 else f"{seconds * 1e3:.0f}"
