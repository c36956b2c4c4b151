"""Rows of the two records as they grow: the messages that show them, and the shaking that they tell of."""

from __future__ import annotations

import json
import os
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from math import isfinite
from pathlib import Path
from struct import Struct
from struct import error as StructError
from typing import BinaryIO, NamedTuple

from teleop.live.page.side_view import SideView
from teleop.live.records.reader import FILE, GrowingRecord, Row
from teleop.storage.files import open_regular
from teleop.storage.strict_json import parse

KEPT = 512  # rows, the newest ones
HAND = "hand.bin"
LONGEST_LINE = 1 << 10  # bytes of its header


class HandReference:
    """Reference of the hand, m per axis: the last whole row of the master's `hand.bin`, see its package."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / HAND
        self._file: BinaryIO | None = None
        self._offset = 0
        self._row = Struct("")

    def newest(self) -> Row | None:
        """Read the newest position; None where the master records none, or has not begun to."""
        try:
            if self._file is None and not self._begin():
                return None
            assert self._file is not None
            count = (os.fstat(self._file.fileno()).st_size - self._offset) // self._row.size
            if count < 1:
                return None
            data = os.pread(self._file.fileno(), self._row.size, self._offset + (count - 1) * self._row.size)
            row: Row = self._row.unpack(data)
        except (OSError, StructError, ValueError, KeyError, TypeError):  # it is a help to the eye, and may be missing
            return None
        return row[1:]

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
        self._file = None

    def _begin(self) -> bool:
        file = open_regular(self._path, links=False)
        line = file.readline(LONGEST_LINE)
        if not line.endswith(b"\n"):
            file.close()
            return False
        self._offset, self._file = len(line), file
        self._row = Struct(f"<{1 + int(parse(line)['axes'])}d")
        return True


class RecordTail(GrowingRecord):
    """Record in `folder` as it grows, with its newest rows, and the slice of each column in a row."""

    def __init__(self, folder: Path, name: str = FILE) -> None:
        super().__init__(folder, name)
        self.part = folder.parent.name
        self.slices: dict[str, slice] = {}  # of each column in a row, once there is a header
        self.axes = 0
        self.newest: deque[Row] = deque(maxlen=KEPT)  # oldest first; of one tick each

    def read(self) -> list[Row]:
        """Read the new rows, oldest first. Raises `OSError`, or `Misshapen` for a file that is no record of a run."""
        rows = super().read()
        if self.header is not None and not self.slices:
            columns, self.axes = self.header["columns"], self.header["axes"]
            self.slices = {name: slice(columns.index(name), columns.index(name) + columns.count(name))
                           for name in columns}
        self.newest.extend(rows)
        return rows

    def at(self, k: float) -> Row | None:
        """The newest row of a tick up to k, if it is still known."""
        return next((row for row in reversed(self.newest) if row[0] <= k), None)


PAST = 600  # messages that are kept: 10 s of them
ARM_EVERY = 3  # messages, one of which has the poses of the robot's outlines: 20 a second
_LAST = {"m": ("x_m", "f_m", "f_h"), "s": ("x_s", "f_s", "f_env")}
_SHOWN = {"x_m": "xm", "f_m": "fm", "f_h": "fh", "x_s": "xs", "f_s": "fs", "f_env": "fe"}
_SWINGS = ("x_m", "f_m", "x_s", "f_s")  # whose extremes are shown
_GAIN = {"m": "g_m", "s": "g_s"}


class Extremes(NamedTuple):
    """Least and greatest value since the last message, per axis."""

    low: tuple[float, ...]
    high: tuple[float, ...]


class RowsMessage(NamedTuple):
    """Message with new rows, and the extremes (N) of its forces, by the end's name, m or s."""

    text: str
    forces: dict[str, Extremes]


class RowMessages:
    """Maker of the messages `rows` and `past`, for all pages, at most sixty times a second.

    `dt` in s; `view`: of the robot's model, if it has one; `gain`: the gain of an end whose record has no column of it.
    """

    def __init__(self, dt: float, view: SideView | None = None) -> None:
        self.dt, self.view = dt, view
        self._count = 0
        self.past: deque[str] = deque(maxlen=PAST)
        self.gain: dict[str, float] = {"m": 1.0, "s": 1.0}

    def message(self, t: float, ends: dict[str, RecordTail], new: dict[str, list[Row]],
                hand: Sequence[float] | None) -> RowsMessage | None:
        """Write the rows of the ends m and s since the last message, at time t (s); None while one has no row yet.

        `hand`: the reference of the hand, m per axis; None: not known.
        """
        if not all(each.newest for each in ends.values()):
            return None
        parts, forces, gains = [f'"t":{t:.4f}', f'"part":"{ends["m"].part}"', f'"hand":{_list(hand)}'], {}, []
        for e, tail in ends.items():
            row, slices = tail.newest[-1], tail.slices
            columns = list(zip(*(new[e] or [row]), strict=True))
            for name in _LAST[e]:
                at = slices.get(name)
                parts.append(f'"{_SHOWN[name]}":{"null" if at is None else _list(row[at])}')
                if at is None or name not in _SWINGS:
                    continue
                extremes = Extremes(tuple(map(min, columns[at])), tuple(map(max, columns[at])))
                parts.append(f'"{_SHOWN[name]}_lo":{_list(extremes.low)},"{_SHOWN[name]}_hi":{_list(extremes.high)}')
                if name.startswith("f"):
                    forces[e] = extremes
            gains.append(_first_or(row, tail, _GAIN[e], self.gain[e]))
        kind, energy = _energy(**ends) if all(gains) else (None, None)  # without force it is of no session
        parts += [f'"gain":{_list(gains)}', '"kind":null' if kind is None else f'"kind":"{kind}"',
                  f'"E":{_number(energy)}', self._link(**ends)]
        self._count += 1
        if self.view is not None and self._count % ARM_EVERY == 0:
            parts.append(f'"arm":{json.dumps(self.view.poses(**positions_of(ends)))}')
        text = f'{{"type":"rows",{",".join(parts)}}}'
        self.past.append(text)
        return RowsMessage(text, forces)

    def past_message(self) -> str:
        """Write the messages of the last ten seconds as one."""
        return f'{{"type":"past","rows":[{",".join(self.past)}]}}'

    def _link(self, m: RecordTail, s: RecordTail) -> str:
        """Write queues and ages of the played messages (s), forward at the slave and backward at the master.

        Of several axes the longest queue counts.
        """
        queues, ages = [], []
        for tail, name in ((s, "queue_s"), (m, "queue_m")):
            row = tail.newest[-1]
            queues.append(max(row[tail.slices[name]]) if name in tail.slices else None)
            ages.append((row[0] - row[2]) * self.dt if row[2] >= 0.0 else None)
        return f'"queue":{"null" if None in queues else _list(queues)},"age":{_list(ages)}'


def positions_of(ends: Mapping[str, RecordTail]) -> dict[str, Row]:
    """The newest positions of the ends m and s, m or rad per axis."""
    return {e: tail.newest[-1][tail.slices[f"x_{e}"]] for e, tail in ends.items()}


def _energy(m: RecordTail, s: RecordTail) -> tuple[str | None, float | None]:
    """Energy stored in the link (J), or else absorbed at the two ports, at the newest tick that both ends have.

    Before it its kind, `link` or `ports`. None where the two do not have the same columns: without a ledger, or while
    one end alone has switched.
    """
    common = min(m.newest[-1][0], s.newest[-1][0])
    row_m, row_s = m.at(common), s.at(common)
    if row_m is None or row_s is None:
        return None, None
    waves = "E_in_fwd" in m.slices, "E_in_bwd" in s.slices
    if all(waves):
        stored = _first(row_m, m, "E_in_fwd") - _first(row_s, s, "E_out_fwd")
        return "link", stored + (_first(row_s, s, "E_in_bwd") - _first(row_m, m, "E_out_bwd"))
    if any(waves) or "E_port_m" not in m.slices or "E_port_s" not in s.slices:
        return None, None
    return "ports", _first(row_m, m, "E_port_m") - _first(row_s, s, "E_port_s")


def _first(row: Row, tail: RecordTail, name: str) -> float:
    at: int = tail.slices[name].start
    return row[at]


def _first_or(row: Row, tail: RecordTail, name: str, default: float | None) -> float | None:
    return _first(row, tail, name) if name in tail.slices else default


def _list(values: Iterable[float | None] | None) -> str:
    return "null" if values is None else f"[{','.join(map(_number, values))}]"


def _number(value: float | None) -> str:
    """Write a number for JSON, with the digits that a picture has room for."""
    return f"{value:.5g}" if value is not None and isfinite(value) else "null"


AT_CAP, OF_CAP = 0.98, 0.5  # of the cap: what counts as being there; the swing
LEAST = 1.0  # N of swing
GROWS = 1.1  # from one second to the next
SECONDS = 4  # that are compared
SPANS = (1, 2, 4)  # s: two of each are compared
CALM = 2  # s

Swings = dict[tuple[str, int], tuple[float, float]]  # by end and axis: the least and the greatest force, N


class Shaking:
    """Judgement whether a loop shakes, by a rule on its forces alone, second by second. Times are in s.

    It is judged only where nobody has moved the hand for those seconds. It shakes when the force of an end came to its
    cap in each of two spans of 1, 2 or 4 s, one after the other, and in each swung by half of the cap and more: a loop
    over half a second each way takes some seconds for one swing. Or when its swing was greater in each of four seconds
    than in the one before, by a tenth and more, and is above `LEAST` by then. It is over when the swing of such a span
    was below half of its first value for two seconds, whoever moves the hand. `f_max`: the cap of each axis, N (N m of
    one that turns); None: there is none.
    """

    def __init__(self, f_max: Sequence[float | None]) -> None:
        self.shakes = False
        self._f_max = [*f_max]
        self._seconds: deque[Swings] = deque(maxlen=2 * SPANS[-1])
        self._span = 1  # s of the span in which it was seen to shake
        self._now: Swings = {}  # of the second that goes on
        self._since: float | None = None  # when it began
        self._still = 0  # whole seconds in which nobody moved the hand
        self._moved = False  # somebody did in this one
        self._first_swing = 0.0  # N, when it began to shake
        self._calm = 0  # s

    def note_motion(self) -> None:
        """Note that somebody moves the hand now, or that the law begins anew."""
        self._moved = True

    def sentence(self, now: float, forces: dict[str, Extremes]) -> str | None:
        """Take the extremes (N) of both ends' forces; return the sentence to report, if there is one."""
        if self._since is None:
            self._since = now
        sentence = None
        if now - self._since >= 1.0:
            sentence = self._judge_second()
            self._since, self._now, self._moved = now, {}, False
        for e, (lows, highs) in forces.items():
            for axis, (low, high) in enumerate(zip(lows, highs, strict=True)):
                least, most = self._now.get((e, axis), (low, high))
                self._now[e, axis] = min(least, low), max(most, high)
        return sentence

    def _judge_second(self) -> str | None:
        """Judge the seconds that are over; return the sentence to report, if there is one."""
        self._seconds.append(self._now)
        self._still = 0 if self._moved else self._still + 1
        if self.shakes:
            swing = max((high - low for low, high in (self._range(which, self._span) for which in self._now)),
                        default=0.0)
            self._calm = self._calm + 1 if swing < self._first_swing / 2.0 else 0
            self.shakes = self._calm < CALM
            if self.shakes:
                return None
            self._seconds.clear()
            self._still = 0
            return "stable again"
        for which in self._now:
            capped = next((span for span in SPANS if self._still >= 2 * span and all(
                self._comes_to_cap(which[1], self._range(which, span, before)) for before in (0, span))), None)
            swings = [high - low for low, high in (self._range(which, 1, before) for before in range(SECONDS))][::-1]
            if capped is not None or (self._still >= SECONDS and _grow(swings)):
                self.shakes, self._calm, self._span = True, 0, capped or 1
                low, high = self._range(which, self._span)
                self._first_swing = high - low
                how = ("comes to its cap again and again, and the cap holds it" if capped
                       else f"swings by {self._first_swing:.1f} N, more each second")
                return (f"unstable: while nobody moves the hand the force {how}; another law, less delay or a "
                        "softer environment ends it")
        return None

    def _range(self, which: tuple[str, int], span: int, before: int = 0) -> tuple[float, float]:
        """Least and greatest force (N) of `span` seconds that ended `before` seconds ago; 0 without any."""
        ends = len(self._seconds) - before
        seconds = [self._seconds[i][which] for i in range(max(0, ends - span), ends) if which in self._seconds[i]]
        return min((low for low, _ in seconds), default=0.0), max((high for _, high in seconds), default=0.0)

    def _comes_to_cap(self, axis: int, second: tuple[float, float]) -> bool:
        low, high = second
        cap = self._f_max[axis] if axis < len(self._f_max) else None
        return cap is not None and max(high, -low) >= AT_CAP * cap and high - low >= OF_CAP * cap


def _grow(swings: list[float]) -> bool:
    return len(swings) == SECONDS and swings[-1] > LEAST and all(
        after > GROWS * before for before, after in pairwise(swings))
