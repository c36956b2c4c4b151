"""Columns of a trace: unit, meaning, topic, and the names that their numbers have in other tools.

Foxglove draws an array as one curve and has no names for its entries, so what has axes is an object with a field for
each, by its name, in one axis too: a layout made for one run fits the others. A CSV has a column for each.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from math import isfinite
from typing import TYPE_CHECKING, Any, NamedTuple

from teleop.scene.axes import AxisLabels, unit_on

if TYPE_CHECKING:
    from numpy.typing import NDArray

Keys = tuple[str, ...]  # of a number in an object: the names on the way to it
TOPICS = {
    "master": "the master's end: the device in the hand",
    "slave": "the slave's end: the robot, and what it touches",
    "link": "what the link does: packets played, and queues of waves",
    "energy": "ledgers of energy, each from the begin of a session",
}


class Quantity(NamedTuple):
    """Unit, meaning and topic of a column. `unit`: in SI, 1 of a number without one, empty where a law names none."""

    unit: str
    meaning: str
    topic: str  # one of `TOPICS`; empty: none, as of the time
    axes: bool = False  # does it have a number for each axis


def _of_end(e: str) -> dict[str, Quantity]:
    """The columns of one end, m or s."""
    end, out, back = ("master", "forward", "backward") if e == "m" else ("slave", "backward", "forward")
    ways = ("fwd", "bwd") if e == "m" else ("bwd", "fwd")
    return {
        f"x_{e}": Quantity("m", f"position of the {end}", end, True),
        f"v_{e}": Quantity("m/s", f"velocity of the {end}", end, True),
        f"q_{e}": Quantity("m", f"position of the {end} as its encoder reads it", end, True),
        f"v_hat_{e}": Quantity("m/s", f"velocity of the {end} as it is estimated from its readings", end, True),
        f"shaft_{e}": Quantity("m", f"true position of the {end}'s shaft, a position servo's", end, True),
        f"touch_{e}": Quantity("N", "true force of the hand on that shaft" if e == "m" else
                               "true force of that shaft on what it touches", end, True),
        f"g_{e}": Quantity("1", f"gain of the {end}'s watchdog: 1 lets the law's force through, 0 none of it", end),
        f"late_{e}": Quantity("s", f"how late the {end}'s tick ran", end),
        f"E_left_{e}": Quantity("J", f"what is left of the {end}'s energy budget", end),
        f"seq_{e}": Quantity("1", f"number of the {back} message that the {end} played, which is the tick that sent "
                             "it; -1 where it had no fresh one", "link"),
        f"sent_{e}": Quantity("1", f"1 where the {end}'s deadband let a {out} message be sent, 0 where not", "link"),
        f"queue_{e}": Quantity("s", f"queue of {back} waves at the {end}: the time that is still to be played, below 0 "
                               "where a gap is bridged by what has not come yet", "link", True),
        f"E_in_{ways[0]}": Quantity("J", f"energy that the {end}'s waves have brought into the link, {out}", "energy"),
        f"E_out_{ways[1]}": Quantity("J", f"energy that the waves played at the {end} have taken out of the link, "
                                     f"{back}", "energy"),
        f"E_port_{e}": Quantity("J", f"work of the stack's force over the motion of the {end}", "energy"),
        f"E_law_{e}": Quantity("J", f"energy that the law says it keeps at the {end}", "energy"),
        **{f"q{part}_{e}": Quantity("1", f"{part} of the unit quaternion of the {end}'s first rotation", end)
           for part in "wxyz"},
    }


KNOWN: Mapping[str, Quantity] = {
    "t": Quantity("s", "time since tick 0", ""),
    **_of_end("m"),
    **_of_end("s"),
    "f_m": Quantity("N", "force of the stack against the hand", "master", True),
    "clutch_m": Quantity("1", "open clutch: 1 of all axes, 2 of the translation, 3 of the rotation, else 0", "master"),
    "present_m": Quantity("1", "1 while the operator is there, else 0", "master"),
    "g_clutch_m": Quantity("1", "modulus between the master and its law: 1 closed, 0 open or nobody there", "master"),
    "apart_m": Quantity("m", "how far the ends of the law are apart, by which the clutch closes", "master", True),
    "g_turn_m": Quantity("1", "the same modulus of the axes that turn", "master"),
    "scale_m": Quantity("1", "motion of the master as its law was told it, for one of the device", "master"),
    "way_m": Quantity("m", "way that an alignment has to go", "master", True),
    "E_align_m": Quantity("J", "energy that alignments have put into the law's port", "energy"),
    "offset_m": Quantity("m", "how far the master has moved beyond what its law was told", "master", True),
    "policy_m": Quantity("1", "who has authority: 0 the operator, 1 the policy; 2 the operator, by force; 3 the "
                         "operator, for the policy is late; 4 the same, for link or clutch is open", "master"),
    "authority_m": Quantity("1", "the policy's share of its force: 0 the operator alone, 1 all of it", "master"),
    "f_policy_m": Quantity("N", "force of the policy on the master, along its motion", "master", True),
    "E_tank_m": Quantity("J", "energy that the policy has left", "master"),
    "E_policy_m": Quantity("J", "work that the policy has done on the master", "energy"),
    "offset_policy_m": Quantity("m", "how far the master is from where its law was told that it is", "master", True),
    "refused_m": Quantity("1", "actions of the policy that were refused: no numbers, or leaps", "master"),
    "f_h": Quantity("N", "force of the hand on the master", "master", True),
    "f_h_hat": Quantity("N", "force of the hand as the observer estimates it", "master", True),
    "E_po": Quantity("J", "energy that the passivity observer has counted at the master's port", "energy", True),
    "f_s": Quantity("N", "force of the stack on the slave", "slave", True),
    "f_env": Quantity("N", "force of the slave on its environment", "slave", True),
    "E_link": Quantity("J", "energy stored in the link", "energy"),
    "E_port": Quantity("J", "energy that law and link have taken up at the ports", "energy"),
    "E_law": Quantity("J", "energy that the law keeps, both ends together", "energy"),
}


def quantity(name: str) -> Quantity:
    """Look up the column `name` of a trace. One that is not `KNOWN` is a field of its law's state, which a law shows.

    >>> quantity("f_env").unit, quantity("H_s").meaning
    ('N', "H of the state of the slave's law, in its own unit")
    """
    known = KNOWN.get(name)
    if known is not None:
        return known
    field, _, e = name.rpartition("_")
    end = "slave" if e == "s" else "master"
    return Quantity("", f"{field or name} of the state of the {end}'s law, in its own unit", end, True)


class Field(NamedTuple):
    """A column with so many numbers in each row: `axes`, 1 of a scalar. `labels`: of the axes of its record."""

    name: str
    quantity: Quantity
    axes: int
    labels: AxisLabels = AxisLabels()

    @property
    def names(self) -> tuple[str, ...]:
        """The names of its axes."""
        return self.labels.names_for(self.axes)

    @property
    def units(self) -> tuple[str, ...]:
        """The unit of each of its numbers."""
        if not self.quantity.axes:
            return (self.quantity.unit,) * self.axes
        return tuple([unit_on(self.quantity.unit, each) for each in self.labels.units_for(self.axes)])

    @property
    def flat(self) -> tuple[str, ...]:
        """The name of each number where there are no objects, as in a CSV: of several axes one for each."""
        return (self.name,) if self.axes == 1 else tuple([f"{self.name}_{axis}" for axis in self.names])

    def described(self, axis: int = 0) -> str:
        """Meaning and unit, on the axis with that index."""
        unit = self.units[axis]
        return f"{self.quantity.meaning}{f' ({unit})' if unit else ''}"

    def described_whole(self) -> str:
        """Meaning and unit of all axes; without a unit where they have different ones."""
        return self.described() if len({*self.units}) == 1 else self.quantity.meaning


def field(name: str, axes: int, labels: AxisLabels = AxisLabels()) -> Field:  # noqa: B008 - it cannot be changed
    """The column `name` with so many numbers in each row."""
    return Field(name, quantity(name), axes, labels)


def paths_of(one: Field, *, topic: bool = True) -> list[tuple[str, ...]]:
    """Paths of a column's numbers in an object, with its `topic` or beneath it.

    >>> paths_of(field("f_env", 1)), paths_of(field("E_link", 1), topic=False)
    ([('slave', 'f_env', 'x')], [('E_link',)])
    """
    base = (one.quantity.topic, one.name) if topic else (one.name,)
    return [(*base, axis) for axis in one.names] if one.quantity.axes or one.axes > 1 else [base]


def numbers(columns: Iterable[NDArray[Any]]) -> list[list[float]]:
    """Columns of shape (rows,) or (rows, axes) as lists of Python's numbers, one list for each axis of each."""
    cells: list[list[float]] = []
    for column in columns:
        plain = column.astype(int) if column.dtype.kind == "b" else column
        cells += [plain.tolist()] if plain.ndim == 1 else plain.T.tolist()
    return cells


class Objects:
    """Writes rows as objects, the numbers of a row at `paths`. A number that another path leads through is none.

    The text is the same for every reader: shortest digits that give the same bits again. JSON has neither NaN nor
    infinity, and a reader of JSON Schema such as Foxglove takes no field that may be a number or null: so a number that
    is not finite is left out of its object, and what it leaves empty too.
    """

    def __init__(self, paths: Sequence[Keys]) -> None:
        self._paths = list(paths)
        tree: dict[str, Any] = {}
        for i, path in enumerate(self._paths):
            _set_at(tree, path, i)
        self._order: list[int] = []
        self._template = self._of(tree)

    def _of(self, tree: dict[str, Any]) -> str:
        parts = []
        for name, inner in tree.items():
            if isinstance(inner, dict):
                text = self._of(inner)
            else:
                self._order.append(inner)
                text = "%s"
            parts.append(f"{json.dumps(name).replace('%', '%%')}:{text}")
        return "{" + ",".join(parts) + "}"

    def texts(self, cells: Sequence[Sequence[float]]) -> list[str]:
        """The object of each row; `cells` has for each path the numbers of all rows."""
        texts = [self._template % row for row in zip(*[cells[i] for i in self._order], strict=True)]
        doubtful = [column for column in cells if not isfinite(sum(column))]  # the sum of sound ones may overflow too
        for i in {i for column in doubtful for i, value in enumerate(column) if not isfinite(value)}:
            texts[i] = self._sparse([column[i] for column in cells])
        return texts

    def _sparse(self, row: Sequence[float]) -> str:
        tree: dict[str, Any] = {}
        for path, value in zip(self._paths, row, strict=True):
            if isfinite(value):
                _set_at(tree, path, value)
        return json.dumps(tree, separators=(",", ":"), allow_nan=False)


def _set_at(tree: dict[str, Any], path: Keys, value: Any) -> None:
    for name in path[:-1]:
        tree = tree.setdefault(name, {})
    tree[path[-1]] = value
