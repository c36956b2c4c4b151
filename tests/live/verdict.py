"""What the records of a run have to show whose processes were killed and stopped: force let go, in time and gently."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from teleop.errors import Refused
from teleop.live.records.reader import TruncatedRecord, read_record
from teleop.live.records.record import read_events
from tests.live.killing import DELAY, DT, F_MAX, RAMP, SLACK, SLEW, One, Site, Upset


class Rows(NamedTuple):
    """What one end recorded. `t`: when the tick was due, s, of this process's clock."""

    one: One
    k: Any
    t: Any
    seq: Any
    f: Any
    g: Any
    events: list[dict[str, Any]]


def rows_of(one: One) -> Rows | None:
    """None if it was killed before it had said or written anything; what it did last may not be on the disk."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", TruncatedRecord)
        try:
            header, record, _ = read_record(one.folder)
        except Refused:
            return None
    if not len(record.ticks) and not one.said:
        return None
    names = header["columns"][3:]
    rows: Any = record.rows
    table = rows.table(0, len(record.ticks))
    k, e = np.array(record.ticks, dtype=np.int64), header["end"]
    # a line comes a little after its tick; of one that said nothing no instant is known, and nothing compares
    zero = min((when - event["k"] * DT for when, event in one.said), default=float("nan"))
    return Rows(one, k, zero + k * DT, np.array(record.played, dtype=np.int64), table[:, names.index(f"f_{e}")],
                table[:, names.index(f"g_{e}")], read_events(one.folder))


@dataclass
class Figures:
    """What the judge has measured."""

    upsets: int = 0
    processes: int = 0
    most_step: float = 0.0  # of the slew limit
    force: list[float] = field(default_factory=list)  # N, the median of its amount where the gain was 1, by process
    safe: list[float] = field(default_factory=list)  # s, from a blow to the first tick on the way down
    back: list[float] = field(default_factory=list)  # s, from the end of a blow to the whole force
    slowest: str = ""  # the blow of the longest of these

    def __str__(self) -> str:
        spread = "; ".join(
            f"{name} {np.median(those):.3f} s, at most {max(those):.3f} s ({len(those)})"
            for name, those in (("on the way down after", self.safe), ("whole again after", self.back)) if those)
        spread += f", by {self.slowest!r}"
        return (f"{self.upsets} upsets, {self.processes} processes; {spread}; "
                f"force {np.median(self.force):.2f} N, largest force step {self.most_step:.3f} of the limit")


def judge(site: Site) -> Figures:
    """Every claim, for every process that recorded anything."""
    figures = Figures(len(site.upsets), len(site.every))
    all_rows = [rows for one in site.every if one.name != "channel" and (rows := rows_of(one)) is not None]
    for rows in all_rows:
        if not rows.k.size:
            continue
        where = rows.one.folder.name
        figures.most_step = max(figures.most_step, steps_are_slewed(rows, where))
        silence_is_heeded(rows, site.timeout, where)
        nothing_old_moves_it(rows, site.timeout, where)
        if np.any(rows.g == 1.0):
            figures.force.append(float(np.median(np.abs(rows.f[rows.g == 1.0]))))
        for stop in rows.one.stops:
            a_stop_ends_at_no_force(rows, stop, site.timeout, where)
    for i, upset in enumerate(site.upsets):
        until = site.upsets[i + 1].began if i + 1 < len(site.upsets) else float("inf")
        for rows in all_rows:
            figures.safe += survivor_is_safe(rows, upset, site.timeout)
        back = [whole_again(rows, upset, until) for rows in all_rows if alive(rows.one, upset.over, until)]
        assert len(back) == 2, (upset, "an end has no record")
        if max(back) > max(figures.back, default=0.0):
            figures.slowest = upset.what
        figures.back.append(max(back))
    return figures


def alive(one: One, since: float, until: float) -> bool:
    return one.began < since + 0.001 and one.ended > min(until, 1e12) - 0.001


def steps_are_slewed(rows: Rows, where: str) -> float:
    """No force step above the slew limit, from zero on; the largest, of the limit."""
    f, k = np.concatenate(([0.0], rows.f)), np.concatenate(([rows.k[0] - 1], rows.k))
    assert np.all(np.isfinite(f)), where
    assert np.max(np.abs(f)) <= F_MAX + 1e-9, where
    limit = SLEW * DT * np.diff(k)
    step = np.abs(np.diff(f))
    worst = int(np.argmax(step / limit))
    assert np.all(step <= limit + 1e-9), (where, int(k[worst + 1]), f[worst : worst + 2], limit[worst])
    return float(np.max(step / limit))


def silence_is_heeded(rows: Rows, timeout: float, where: str) -> None:
    """At the first tick past the timeout, and at each until something is played, the gain is on its way down."""
    joined = any(event["what"] == "joined" for event in rows.events)
    start = rows.k[0] - 1 if joined else -1
    heard = np.maximum.accumulate(np.where(rows.seq >= 0, rows.k, start))
    silent = (rows.k - heard) * DT > timeout + DT / 2
    before = np.concatenate(([1.0], rows.g[:-1]))
    down = (rows.g == 0.0) | (rows.g <= before - DT / RAMP + 1e-9)
    wrong = silent & ~down
    assert not wrong.any(), (where, rows.k[wrong][:3], rows.g[wrong][:3])


def nothing_old_moves_it(rows: Rows, timeout: float, where: str) -> None:
    """What waited at the socket of a stopped process, or in a stopped channel, is played at no force."""
    old = (rows.seq >= 0) & (rows.g > 0.0) & ((rows.k - rows.seq) * DT > timeout + DELAY + SLACK)
    assert not old.any(), (where, rows.k[old][:3], rows.seq[old][:3], rows.g[old][:3])


def a_stop_ends_at_no_force(rows: Rows, stop: tuple[float, float], timeout: float, where: str) -> None:
    """Stopped for longer than the timeout, an end holds nothing at its first tick afterwards."""
    since, until = stop
    after = np.flatnonzero(rows.t > since + SLACK)
    if until - since < timeout + SLACK or not after.size:
        return
    first = int(after[0])
    assert rows.t[first] > until - SLACK, (where, "it ticked while it was stopped")
    assert (rows.g[first], rows.f[first]) == (0.0, 0.0), (where, stop, rows.g[first], rows.f[first])


def survivor_is_safe(rows: Rows, upset: Upset, timeout: float) -> list[float]:
    """An end that was not struck, and heard nothing, lets go `timeout` after the last that was under way.

    How long (s) after the blow that was, if it was.
    """
    one = rows.one
    if one.name in upset.struck or not (one.began < upset.began and one.ended > upset.over):
        return []
    due = upset.began + DELAY + timeout + SLACK
    after = np.flatnonzero(rows.t > due)
    heard = (rows.seq >= 0) & (rows.t > upset.began + DELAY + SLACK) & (rows.t <= due)
    if not after.size or heard.any():  # what was struck was back in time, which no process that was killed is so soon
        assert not after.size or timeout > 1.0 or upset.what.startswith("stop"), (one.folder.name, upset)
        return []
    assert rows.g[after[0]] < 1.0, (one.folder.name, upset, rows.t[after[0]] - upset.began)
    down = np.flatnonzero((rows.t > upset.began) & (rows.g < 1.0))
    return [float(rows.t[down[0]] - upset.began)]


def whole_again(rows: Rows, upset: Upset, until: float) -> float:
    """How long after a blow was over the gain is 1 again, for good until the next one."""
    last = rows.t[-1] + DT if rows.t.size else 0.0  # what came behind that is known from its live lines alone
    later = [(at, event["gain"]) for at, event in rows.one.said if at > last]
    when, gain = np.append(rows.t, [at for at, _ in later]), np.append(rows.g, [g for _, g in later])
    here = np.flatnonzero((when > upset.over) & (when < until))
    assert here.size, (rows.one.folder.name, upset)
    assert gain[here[-1]] == 1.0, (rows.one.folder.name, upset)
    less = here[gain[here] < 1.0]
    return float(when[less[-1] + 1] - upset.over) if less.size else 0.0
