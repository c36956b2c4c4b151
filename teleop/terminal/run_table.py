"""What a person reads in a terminal: the table of a run, and the line that shows how far one has come."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, TextIO

from teleop.terminal.printable import printable

if TYPE_CHECKING:
    from teleop.simulation.result import Packets, Result

PREFIX = {-3: "n", -2: "u", -1: "m", 0: "", 1: "k", 2: "M", 3: "G"}  # u: a terminal may know ASCII only
RATE_AFTER = 0.5  # s of rows before their rate is told: the first few come in a bunch
RATE_OVER = 10.0  # s that it is taken over, or as long as a few rows last
BAR_FROM = 60  # columns; a bar in fewer would come and go with what stands behind it
_DIRECTIONS = ("fwd", "bwd")
_LATE = (("half under", "p50"), ("99 % under", "p99"), ("at most", "p100"))
_MODE = {"virtual": "virtual time", "lockstep": "live in lockstep", "live": "live"}
_COUNTS = (("lost", "lost"), ("late", "late"), ("overtaken", "overtaken"), ("duplicates", "doubled"),
           ("in_flight", "under way at the end"))


def si(value: float, unit: str) -> str:
    """`value` to three digits with an SI prefix.

    >>> si(0.03181, "m"), si(-1.1e-2, "J"), si(999.96, "N"), si(0.0, "J")
    ('31.8 mm', '-11.0 mJ', '1.00 kN', '0 J')
    """
    if value == 0.0:
        return f"0 {unit}"
    digits, _, power = f"{value:.2e}".partition("e")
    if power == "":  # not finite
        return f"{value} {unit}"
    thousands, rest = divmod(int(power), 3)
    if thousands not in PREFIX:
        return f"{value:.2e} {unit}"
    return f"{float(digits) * 10**rest:.{2 - rest}f} {PREFIX[thousands]}{unit}"


def table(result: Result) -> str:
    """The run in a few lines: what it was, how it ended, and the figures that its scene has."""
    rows = [
        ("run", f"{heading(result)}, {_MODE.get(result.mode, result.mode)}, seed {result.seed}"),
        ("status", verdict(result)),
        *((label, text) for label, tell in _ROWS for text in tell(result)),
        *(("note", note) for note in result.notes),
    ]
    width = max(len(label) for label, _ in rows)
    return "\n".join(f"{label:<{width}}   {printable(text)}" for label, text in rows)


def heading(result: Result) -> str:
    """Scene and law."""
    law = result.parameters.get("law")
    return f"{result.scene}, law {law['name'] if isinstance(law, Mapping) else law}"


def verdict(result: Result) -> str:
    """The status and its sentence, which may begin with the status itself."""
    return result.sentence if result.sentence.startswith(result.status) else f"{result.status}: {result.sentence}"


def _error(key: str, unit: str) -> Callable[[Result], Iterator[str]]:
    def tell(result: Result) -> Iterator[str]:
        got = result.metrics
        if {f"{key}_rms", f"{key}_max"} <= got.keys():
            yield f"{si(got[f'{key}_rms'], unit)} rms, {si(got[f'{key}_max'], unit)} max"

    return tell


def _energy(key: str) -> Callable[[Result], Iterator[str]]:
    def tell(result: Result) -> Iterator[str]:
        # A run that diverges may end with a sum that is not finite, and then has no figure for its end.
        said = [f"{si(result.metrics[name], 'J')} {word}"
                for name, word in ((f"{key}_min", "smallest"), (f"{key}_end", "at the end")) if name in result.metrics]
        if said:
            yield ", ".join(said)

    return tell


def _delay(result: Result) -> Iterator[str]:
    got = result.metrics
    heard = [way for way in _DIRECTIONS if f"fresh_{way}" in got]  # of one end alone, one way
    if heard:
        yield ", ".join(f"{_seen(got, way)} {way}" for way in heard)


def _seen(got: Mapping[str, float], way: str) -> str:
    if not {f"T_{way}_mean", f"T_{way}_max"} <= got.keys():
        return "nothing came"
    mean, most = got[f"T_{way}_mean"], got[f"T_{way}_max"]
    return si(mean, "s") if most - mean < 1e-9 else f"{si(mean, 's')} (up to {si(most, 's')})"


def _packets(result: Result) -> Iterator[str]:
    for way in _DIRECTIONS:
        if f"fresh_{way}" in result.metrics and way in result.packets:
            yield f"{way}: {_counts(result.packets[way])}"


def _counts(packets: Packets) -> str:
    said = [f"{packets.sent} sent"] * (packets.sent > 0) + [f"{packets.received} received"]
    for key, word in _COUNTS:
        count = getattr(packets, key)
        said += [f"{count} {word}"] * (count > 0 or key in ("lost", "late"))
    said += [f"{count} rejected ({cause})" for cause, count in packets.rejected.items() if count]
    return ", ".join(said)


def _watchdog(result: Result) -> Iterator[str]:
    fell = [(end, result.metrics[f"g_{e}_min"]) for end, e in (("master", "m"), ("slave", "s"))
            if f"g_{e}_min" in result.metrics]
    if any(gain < 1.0 for _, gain in fell):
        yield "let go: smallest gain " + ", ".join(f"{gain:.0%} at the {end}" for end, gain in fell)


def _link(result: Result) -> Iterator[str]:
    for end, own in _live_ends(result):
        rtt, clock = own.get("rtt"), own.get("peer_clock") or {}
        if not rtt:
            continue
        text = f"{end}: round trip {si(rtt['mean'], 's')}, jitter {si(own['jitter'], 's')}, {own['lost']} missing, "
        text += f"{own['reordered']} out of order"
        drift = clock.get("drift")
        yield text + ("" if drift is None else f"; the peer's clock goes {drift * 1e6:+.0f} ppm")


def _safe(result: Result) -> Iterator[str]:
    for end, own in _live_ends(result):
        told = [event for event in own.get("events") or () if event.get("what") in ("safe", "joined")]
        for event in told[:_MOST_EVENTS]:
            yield f"{end}: {event['what']} at t = {event['k'] * result.dt:.3f} s, {event['why']}"
        if len(told) > _MOST_EVENTS:
            yield f"{end}: and {len(told) - _MOST_EVENTS} times more, see its events.jsonl"


def _late_ticks(result: Result) -> Iterator[str]:
    for end, own in _live_ends(result):
        late = own.get("late_us") or {}
        text = f"{end}: {own.get('skipped', 0)} skipped"
        yield text + "".join(f", {word} {si(late[q] * 1e-6, 's')} late" for word, q in _LATE if q in late)


def _integration(result: Result) -> Iterator[str]:
    for end, own in dict(result.extra.get("integration") or {}).items():  # type: ignore[call-overload]  # a mapping
        text = f"{end}: error estimated at {si(float(own['error_estimate_max']), 'm')} a tick"
        text += f" ({si(float(own['error_estimate_sum']), 'm')} in all), up to {own['substeps_max']} sub-steps"
        over = own["ticks_over_tolerance"]
        yield text + (f"; {over} ticks above {si(own['tolerance'], 'm')}" if over else "")


def _per_tick(result: Result) -> Iterator[str]:
    ends = [f"{si(own['cpu'] * result.dt, 's')} {end}" for end, own in _live_ends(result) if own.get("cpu")]
    if ends:
        yield ", ".join(ends) + " of processor time"
    elif result.run_time and result.ticks and (each := result.run_time / result.ticks) > 0.0:
        yield f"{si(each, 's')}, {result.dt / each:.3g} times real time"


def _live_ends(result: Result) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """What each end of a live run said of its own ticks; in lockstep there is nothing to be late for."""
    for end in ("master", "slave"):
        own = result.extra.get(end)
        if result.mode == "live" and isinstance(own, Mapping):
            yield end, own


_MOST_EVENTS = 5  # shown of each end

_ROWS: tuple[tuple[str, Callable[[Result], Iterator[str]]], ...] = (
    ("tracking error", _error("x_err", "m")),
    ("force error", _error("f_err", "N")),
    ("delay seen", _delay),
    ("packets", _packets),
    ("link seen", _link),
    ("safe state", _safe),
    ("watchdog", _watchdog),
    ("late ticks", _late_ticks),
    ("link energy", _energy("E_link")),
    ("port energy", _energy("E_port")),
    ("integration", _integration),
    ("time per tick", _per_tick),
)


class Progress:
    """One line on `stream` that says how far something of size `total` has come.

    On a terminal the line is written over itself; elsewhere there is a plain line now and then, and none for
    what takes no longer. There is no colour anywhere, so NO_COLOR has nothing to switch off.
    """

    __slots__ = ("_first", "_line", "_total")

    def __init__(self, stream: TextIO, total: float) -> None:
        self._line, self._total = _Line(stream), total
        self._first: tuple[float, float] | None = None  # what was done at the first call, and when

    def show(self, done: float, now_s: float, text: str = "") -> None:
        """`done` of the total is done at `now_s` (s, of any clock that does not go back); `text` follows."""
        first, began = self._first = self._first or (done, now_s)
        if not self._line.is_due(now_s, done >= self._total):
            return
        part = min(max(done / self._total, 0.0), 1.0) if self._total > 0.0 else 1.0
        left = "" if done <= first else f"{(now_s - began) * max(0.0, self._total - done) / (done - first):.1f} s left"
        self._line.write(part, "  ".join(word for word in (f"{part:4.0%}", left, text) if word))

    def end(self) -> None:
        """Leave the line as it stands and go on below it."""
        self._line.end()


class RowsProgress:
    """One line on `stream` that says how many of many rows are there, as `Progress` shows it.

    Rows that were there at the first call took no time now. The rate and the time left are those of the rows after the
    first that come: before these come what is compiled, processes that start and files that are read.
    """

    __slots__ = ("_before", "_came", "_line")

    def __init__(self, stream: TextIO) -> None:
        self._line = _Line(stream)
        self._before: int | None = None  # rows that were there at the first call
        self._came: deque[tuple[int, float]] = deque()  # how many were there when, of the last seconds

    def show(self, done: int, total: int, now_s: float) -> None:
        """`done` of `total` rows are there at `now_s` (s, of any clock that does not go back)."""
        if self._before is None:
            self._before = done
        came = self._came
        if done > self._before:
            came.append((done, now_s))
        while len(came) > 2 and came[1][1] <= now_s - RATE_OVER:
            came.popleft()
        if not self._line.is_due(now_s, done >= total):
            return
        count, rate, left = f"{whole(done)} of {whole(total)}", "", ""
        if done == self._before:
            rate = "starting" if done < total else ""
        elif done > came[0][0] and now_s - came[0][1] >= RATE_AFTER:
            a_second = (done - came[0][0]) / (now_s - came[0][1])
            rate = f"{_two_digits(a_second)} rows/s"
            left = f"{duration((total - done) / a_second)} left" if done < total else ""
        texts = [[f"{count} rows", rate, left], [f"{count} rows", left or rate], [count, left or rate], [count]]
        self._line.write(done / total if total else 1.0, *("  ".join(filter(None, words)) for words in texts))

    def end(self) -> None:
        """Leave the line as it stands and go on below it."""
        self._line.end()


def duration(seconds: float) -> str:
    """A time in whole seconds, or in min or h to two digits.

    >>> duration(0.2), duration(41.3), duration(750.0), duration(4e4), duration(3.6e6)
    ('1 s', '41 s', '12 min', '11 h', '1000 h')
    """
    if seconds < 99.5:
        return f"{max(seconds, 1.0):.0f} s"
    return f"{_two_digits(seconds / 60.0)} min" if seconds < 99.5 * 60.0 else f"{_two_digits(seconds / 3600.0)} h"


def whole(count: int) -> str:
    """A count with its thousands apart: it is counted at a glance, where 1e+10 has to be read.

    >>> whole(4800), whole(10_000_000_000)
    ('4800', '10 000 000 000')
    """
    return f"{count:,}".replace(",", " ") if count >= 10_000 else str(count)


def _two_digits(value: float) -> str:
    """To two digits, or to a whole number, without an exponent."""
    return f"{value:.0f}" if value >= 10.0 else f"{value:.2g}" if value >= 1e-3 else f"{value:.1e}"


class _Line:
    """A line that is written over itself on a terminal, and anew now and then elsewhere."""

    __slots__ = ("_due", "_stream", "_terminal", "_width")

    def __init__(self, stream: TextIO) -> None:
        self._stream, self._terminal = stream, stream.isatty()
        self._due: float | None = None  # the time before which nothing is written
        self._width = 0  # of what stands on the terminal's line

    def is_due(self, now_s: float, last: bool) -> bool:
        """Is it time to write: on a terminal at once, ten times a second and at the `last`, elsewhere every 5 s."""
        if self._due is None:
            self._due = now_s if self._terminal else now_s + 5.0
        if now_s < self._due and not (self._terminal and last):
            return False
        self._due = now_s + (0.1 if self._terminal else 5.0)
        return True

    def write(self, part: float, *texts: str) -> None:
        """The first of `texts` that fits, behind a bar if there is room for that too; cut if none does."""
        if not self._terminal:
            self._stream.write(texts[0].strip() + "\n")
        else:
            filled = round(20 * part)
            bar = "[" + "#" * filled + "." * (20 - filled) + "]  "
            room = _columns(self._stream) - 1
            fitting = [text for text in (*[bar + texts[0]] * (room >= BAR_FROM), *texts) if len(text) <= room]
            line = (fitting or [texts[-1][:room]])[0]
            self._stream.write("\r" + line.ljust(self._width))
            self._width = len(line)
        self._stream.flush()

    def end(self) -> None:
        """Go on below the line, if there is one."""
        if self._width:
            self._stream.write("\n")
            self._stream.flush()
            self._width = 0


def _columns(stream: TextIO) -> int:
    """The terminal's width; 80 where it cannot be told."""
    try:
        return os.get_terminal_size(stream.fileno()).columns or 80
    except (OSError, ValueError):
        return 80
