"""What the page is shown of the two records: one message for all who look, at most sixty times a second."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from math import isfinite
from typing import NamedTuple

from teleop.live.page.following import Follower
from teleop.live.records.following import Row

PAST = 600  # messages that are kept: 10 s of them
_LAST = {"m": ("x_m", "f_m", "f_h"), "s": ("x_s", "f_s", "f_env")}
_SHOWN = {"x_m": "xm", "f_m": "fm", "f_h": "fh", "x_s": "xs", "f_s": "fs", "f_env": "fe"}
_SWINGS = ("x_m", "f_m", "x_s", "f_s")  # whose extremes are shown
_GAIN = {"m": "g_m", "s": "g_s"}


class Extremes(NamedTuple):
    """The least and the greatest of what came since the last message, per axis."""

    low: tuple[float, ...]
    high: tuple[float, ...]


class Shown(NamedTuple):
    """One message and what others ask of it: the extremes (N) of the forces, by the end's name, m or s."""

    text: str
    forces: dict[str, Extremes]


class Rows:
    """Makes the messages `rows` and `past`. `dt` in s; `gain`: of an end whose record has no column of it."""

    def __init__(self, dt: float) -> None:
        self.dt = dt
        self.past: deque[str] = deque(maxlen=PAST)
        self.gain: dict[str, float] = {"m": 1.0, "s": 1.0}

    def message(self, t: float, ends: dict[str, Follower], new: dict[str, list[Row]],
                hand: Sequence[float] | None) -> Shown | None:
        """What has come of the ends m and s since the last message, at time t (s); None while one has no row yet.

        `hand`: where the hand's reference is, m per axis; None: nobody says.
        """
        if not all(each.newest for each in ends.values()):
            return None
        parts, forces, gains = [f'"t":{t:.4f}', f'"hand":{_list(hand)}'], {}, []
        for e, follower in ends.items():
            row, places = follower.newest[-1], follower.places
            columns = list(zip(*(new[e] or [row]), strict=True))
            for name in _LAST[e]:
                at = places.get(name)
                parts.append(f'"{_SHOWN[name]}":{"null" if at is None else _list(row[at])}')
                if at is None or name not in _SWINGS:
                    continue
                extremes = Extremes(tuple(map(min, columns[at])), tuple(map(max, columns[at])))
                parts.append(f'"{_SHOWN[name]}_lo":{_list(extremes.low)},"{_SHOWN[name]}_hi":{_list(extremes.high)}')
                if name.startswith("f"):
                    forces[e] = extremes
            gains.append(_of(row, follower, _GAIN[e], self.gain[e]))
        energy = _energy(**ends) if all(gains) else None  # without force what an end sends is no session's
        parts += [f'"gain":{_list(gains)}', f'"E":{_number(energy)}', self._link(**ends)]
        text = f'{{"type":"rows",{",".join(parts)}}}'
        self.past.append(text)
        return Shown(text, forces)

    def past_message(self) -> str:
        """The messages of the last ten seconds as one."""
        return f'{{"type":"past","rows":[{",".join(self.past)}]}}'

    def _link(self, m: Follower, s: Follower) -> str:
        """The queues (s, of several axes the longest) and the ages (s) of what is played, forward at the slave and
        backward at the master.
        """
        queues, ages = [], []
        for follower, name in ((s, "queue_s"), (m, "queue_m")):
            row = follower.newest[-1]
            queues.append(max(row[follower.places[name]]) if name in follower.places else None)
            ages.append((row[0] - row[2]) * self.dt if row[2] >= 0.0 else None)
        return f'"queue":{"null" if None in queues else _list(queues)},"age":{_list(ages)}'


def _energy(m: Follower, s: Follower) -> float | None:
    """What is stored in the link (J), or else taken up at the two ports, at the newest tick that both ends have.

    None where the two do not have the same: no ledger, or one of them is turned already and the other is not.
    """
    common = min(m.newest[-1][0], s.newest[-1][0])
    ours, theirs = m.at(common), s.at(common)
    if ours is None or theirs is None:
        return None
    waves = "E_in_fwd" in m.places, "E_in_bwd" in s.places
    if all(waves):
        stored = _first(ours, m, "E_in_fwd") - _first(theirs, s, "E_out_fwd")
        return stored + (_first(theirs, s, "E_in_bwd") - _first(ours, m, "E_out_bwd"))
    if any(waves) or "E_port_m" not in m.places or "E_port_s" not in s.places:
        return None
    return _first(ours, m, "E_port_m") - _first(theirs, s, "E_port_s")


def _first(row: Row, follower: Follower, name: str) -> float:
    at: int = follower.places[name].start
    return row[at]


def _of(row: Row, follower: Follower, name: str, without: float | None) -> float | None:
    return _first(row, follower, name) if name in follower.places else without


def _list(values: Iterable[float | None] | None) -> str:
    return "null" if values is None else f"[{','.join(map(_number, values))}]"


def _number(value: float | None) -> str:
    """As JSON has it, with the digits that a picture has room for."""
    return f"{value:.5g}" if value is not None and isfinite(value) else "null"
