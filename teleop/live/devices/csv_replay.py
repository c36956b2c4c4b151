"""A recorded motion in place of a device or a robot: `--device csv:FILE`, `--robot csv:FILE`.

The file is what `teleop export RUN --csv FILE` writes, with the columns t, x_m and v_m of a master, or t, x_s and v_s
of a slave (of several axes x_m_x, x_m_y, ...), and f_h or f_env where a force was sensed; or what the scene
`recorded_reach` reads: t and one column for each axis, `t, x` or `t, x, y, z`. Times are s, positions m (rad of an axis
that turns). What is played ignores the force, and has no switches: `--set clutch=2,3` schedules a recorded clutch.
"""

from __future__ import annotations

import csv
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

from teleop.errors import Refused, enumerated, number_of
from teleop.protocol.endpoint import Axes, Reading
from teleop.protocol.guard import DEADLINE
from teleop.scene.scene import Scene
from teleop.storage.files import read_bytes
from teleop.storage.strict_json import parse

FORM = "`teleop export RUN --csv FILE` writes one, and `t, x` or `t, x, y, z` is one too"
FORCE = {"m": "f_h", "s": "f_env"}


@dataclass(frozen=True)
class RecordedMotion:
    """A motion at instants. `t` in s, growing; `x`, `v`, `f`: a tuple with a number per axis for each of them."""

    t: tuple[float, ...]
    x: tuple[Axes, ...]
    v: tuple[Axes, ...] | None  # m/s; None: none was recorded
    f: tuple[Axes, ...] | None  # N; None: none was sensed

    def at(self, t: float) -> Reading:
        """The left limit at time t (s): straight between rows, at rest before the first and after the last.

        A velocity that was not recorded is the slope of the line that ends at t, or that t is on.
        """
        i = bisect_left(self.t, t)  # the first row that is not before t
        if i == 0 or i == len(self.t):
            i = min(i, len(self.t) - 1)
            moves = self.v is not None and self.t[i] == t
            return Reading(self.x[i], self.v[i] if self.v is not None and moves else (0.0,) * len(self.x[i]),
                           None if self.f is None else self.f[i])
        part = (t - self.t[i - 1]) / (self.t[i] - self.t[i - 1])
        if self.v is None:
            span = self.t[i] - self.t[i - 1]
            v = tuple([(x1 - x0) / span for x0, x1 in zip(self.x[i - 1], self.x[i], strict=True)])
        else:
            v = _between(self.v, i, part)
        return Reading(_between(self.x, i, part), v, None if self.f is None else _between(self.f, i, part))


def _between(rows: Sequence[Axes], i: int, part: float) -> Axes:
    """The row `part` of the way from row i - 1 to row i; at its end that row, to the bit."""
    if part == 1.0:
        return rows[i]
    return tuple([x0 + (x1 - x0) * part for x0, x1 in zip(rows[i - 1], rows[i], strict=True)])


def read_motion(path: str, e: str, axes: Sequence[str], units: Sequence[str]) -> RecordedMotion:
    """Read the motion of the end `e`, "m" or "s", from a file; `axes`: their names, `units`: m or rad of each.

    The units of its columns are compared, if an export has written them beside it. Raises `Refused` with path and line.
    """
    try:
        lines = read_bytes(Path(path)).decode("utf-8-sig").splitlines()
    except OSError as error:
        raise Refused(f"cannot read the recorded motion {path!r}: {error.strerror or error}; name a CSV file: "
                      f"{FORM}") from None
    except ValueError:
        raise Refused(f"{path!r} is not text; a recorded motion is a CSV file: {FORM}") from None
    rows = [(at, cells) for at, cells in enumerate(csv.reader(line.split("#", 1)[0] for line in lines), start=1)
            if any(cell.strip() for cell in cells)]
    if not rows:
        raise Refused(f"{path} holds no motion; {FORM}")
    header = [cell.strip() for cell in rows[0][1]]
    if _is_number(header[0]):  # a recording without a line of names
        header = ["t", *axes]
        if len(rows[0][1]) != len(header):
            raise _other_axes(path, len(rows[0][1]) - 1, axes)
    else:
        rows = rows[1:]
    columns = {name: i for i, name in enumerate(header)}
    if "part" in columns:
        raise Refused(f"{path} has several parts of a run (its column part), and one motion is played; export the "
                      "folder of one part by itself")
    x, v, f = _columns(path, header, e, axes)
    _check_units(path, dict(zip(x, units, strict=True)))
    table = [[_cell(path, at, name, cells, columns[name]) for name in ("t", *x, *v, *f)] for at, cells in rows]
    if not table:
        raise Refused(f"{path} has names of columns and no row; {FORM}")
    for (at, _), row, before in zip(rows[1:], table[1:], table, strict=False):
        if row[0] <= before[0]:
            raise Refused(f"{path} line {at}: t = {row[0]:g} s does not come after {before[0]:g} s; sort the rows by "
                          "time and keep one for each instant")
    n = len(axes)
    return RecordedMotion(
        tuple([row[0] for row in table]), tuple([tuple(row[1:1 + n]) for row in table]),
        tuple([tuple(row[1 + n:1 + 2 * n]) for row in table]) if v else None,
        tuple([tuple(row[1 + n + len(v):]) for row in table]) if f else None,
    )


def _columns(path: str, header: list[str], e: str, axes: Sequence[str]) -> tuple[list[str], list[str], list[str]]:
    """The columns of position, velocity and sensed force; an empty list for a quantity that was not recorded."""
    if "t" not in header:
        raise Refused(f"{path} has no column t, the time in s; it has {', '.join(header)[:200]}, and {FORM}")
    plain = [name for name in header if name != "t"]
    if plain == list(axes) or (len(axes) == 1 and plain == ["x"]):
        return plain, [], []

    def of(what: str) -> list[str]:
        return [what] if len(axes) == 1 else [f"{what}_{axis}" for axis in axes]

    positions = [name for name in header if name == f"x_{e}" or name.startswith(f"x_{e}_")]
    if not positions:
        peer, word = ("s", "slave's") if e == "m" else ("m", "master's")
        if any(name.startswith(f"x_{peer}") for name in header):
            raise Refused(f"{path} has the {word} motion, x_{peer}, and none of this end, x_{e}; give it to the other "
                          "end, or export a run that has both")
        if {*plain} <= {"x", "y", "z"}:
            raise _other_axes(path, len(plain), axes)
        raise Refused(f"{path} has no column {of(f'x_{e}')[0]}, nor {axes[0]}; it has {', '.join(header)[:200]}, and "
                      f"{FORM}")
    if positions != of(f"x_{e}"):
        if len(positions) != len(axes):
            raise _other_axes(path, len(positions), axes)
        raise Refused(f"{path} has the axes {', '.join(positions)}, and the scene's are {', '.join(of(f'x_{e}'))}; "
                      "rename the columns, or take the scene that was recorded")
    parts = [of(f"x_{e}"), of(f"v_{e}"), of(FORCE[e])]
    for part in parts[1:]:
        missing = [name for name in part if name not in header]
        if missing and len(missing) < len(part):
            raise Refused(f"{path} has {enumerated([name for name in part if name in header])} and no "
                          f"{enumerated(missing)}; complete or remove these columns")
        if missing:
            part.clear()
    return parts[0], parts[1], parts[2]


def _check_units(path: str, units: dict[str, str]) -> None:
    """Refuse positions that were exported in m, where the scene's axis is in rad, or the other way round."""
    try:
        described = parse(read_bytes(Path(f"{path}-metadata.json")))
        exported = {each["name"]: each["schema:unitText"] for each in described["tableSchema"]["columns"]}
    except (OSError, ValueError, LookupError, TypeError):
        return  # a file of one's own has none beside it
    wrong = [name for name, unit in units.items() if exported.get(name) in ("m", "rad") and exported[name] != unit]
    if wrong:
        raise Refused(f"{path} has {wrong[0]} in {exported[wrong[0]]}, and that axis of the scene is in "
                      f"{units[wrong[0]]}; take the scene that was recorded, with its units")


def _other_axes(path: str, had: int, axes: Sequence[str]) -> Refused:
    return Refused(f"{path} holds a motion along {number_of(had, 'axis', 'axes')}, and the scene has {len(axes)} "
                   f"({', '.join(axes)}); take a scene of {had}, or another file")


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _cell(path: str, at: int, name: str, cells: list[str], i: int) -> float:
    """A cell as a finite number. Raises `Refused`."""
    if i >= len(cells) or not cells[i].strip():
        raise Refused(f"{path} line {at} has nothing in its column {name}; complete or remove the line")
    if not _is_number(cells[i]) or not isfinite(value := float(cells[i])):
        raise Refused(f"{path} line {at}: {name} is {cells[i].strip()!r} and no finite number; correct or remove the "
                      "line")
    return value


class Replay:
    """A recorded motion at one end. `senses`: true if the file has the force that was sensed."""

    deadline = DEADLINE  # of a force that it never holds
    simulated = True

    def __init__(self, motion: RecordedMotion, dt_ns: int) -> None:
        self.motion, self.senses, self._dt_ns = motion, motion.f is not None, dt_ns

    def read(self, k: int) -> Reading:
        """The recorded motion at tick k, and the force that was sensed then."""
        return self.motion.at(k * self._dt_ns / 1e9)

    def hold(self, force: Axes) -> None:
        """Ignore the force: a recording is moved by none."""


def replayed_device(scene: Scene, path: str) -> Replay:
    """A recorded motion of a master, csv:FILE, which no force moves."""
    return Replay(read_motion(path, "m", scene.axis_names, scene.axis_units), scene.dt_ns)


def replayed_robot(scene: Scene, path: str) -> Replay:
    """A recorded motion of a slave, csv:FILE, which no force moves."""
    return Replay(read_motion(path, "s", scene.axis_names, scene.axis_units), scene.dt_ns)
