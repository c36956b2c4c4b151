"""The rows of a chunk made ready: the scene of each is compared with one that was worked out before.

A scene's function may decide its structure by any knob, so it is called for every row. What follows from the scene it
returns (kernel, coefficients, path, schedules) is worked out once: of a row whose scene differs from an earlier one in
a few parts alone, only the numbers of these parts are worked out, and it takes the kernel of that earlier one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from itertools import compress
from math import copysign
from operator import attrgetter, is_not
from typing import Any, NamedTuple

from teleop.errors import Refused
from teleop.law import functions_of
from teleop.scene.library import OwnFile, own_file, scene_function
from teleop.scene.loading import SceneMaker
from teleop.scene.scene import Scene
from teleop.simulation.bodies import slave_plants
from teleop.simulation.felt import AT_REST, OF_SLAVE, Basis, frame_of
from teleop.simulation.prepared import Prepared, prepare
from teleop.simulation.rest import Still, least_swing, still
from teleop.simulation.structure import structure_of
from teleop.sweeps.engine import Measure, Stamps, kernel_of, needs_record
from teleop.sweeps.kernels.figures import SWINGS
from teleop.sweeps.kernels.kernel import (
    FLOATS,
    Kernel,
    Leaves,
    NotCompiled,
    Schedules,
    available,
    leaves,
    path_of,
    schedules_key,
    tree_of,
)

ATOMS = frozenset((float, int, bool, str, bytes, type(None)))
LIGHT = frozenset(("law", "hand", "environment", "link"))  # parts that a structure stays the same without
PARTS = tuple([each.name for each in fields(Scene) if each.name not in ("name", "knobs")])  # what decides a run


class Edited(Refused):
    """A file of the user's own was edited while its sweep ran: the rows from here on would be of another content."""


class Ready(NamedTuple):
    """A row that waits for others to be run with. It does not hold its scene: there are many of these at once."""

    row: dict[str, Any]
    tree: Any  # its numbers, for plain Python
    flat: Leaves | None  # the same for compiled code
    path: Any  # of its hand
    schedules: Schedules
    still: Still | None
    frame: Basis


class RowGroup:
    """Rows that one kernel may run side by side: of one structure, one number of ticks and the same whole numbers.

    Nothing moves them from the same tick on, if from any.
    """

    __slots__ = ("kernel", "rows", "ticks")

    def __init__(self, kernel: Kernel, ticks: int) -> None:
        self.kernel, self.ticks = kernel, ticks
        self.rows: list[Ready] = []


class RowMaker:
    """Makes the rows of a chunk ready, and gathers them in `groups`."""

    def __init__(self, scene: str, fixed: Mapping[str, object], measures: tuple[Measure, ...], engine: str,
                 files: Sequence[OwnFile] = ()) -> None:
        """`files`: those of the user's own with the scene and its laws, as the sweep began. Raises `Edited`."""
        self._measures, self._engine = measures, engine
        self._files = {file.path: file.digest for file in files}
        self._as_begun: set[type] = set()  # classes of laws that are so
        function = scene_function(scene)
        self._check(function)
        self._maker = SceneMaker(function, scene, fixed)
        self._stamps = Stamps(engine)
        self._known: dict[Any, KnownScene] = {}  # by the law's class, the last one that was worked out in full
        self._knobs: dict[str, object] | None = None  # those of the row before, and what came of them
        self._before: tuple[Scene, Made | None]
        self._schedules: dict[Any, Schedules] = {}
        self._groups: dict[Any, RowGroup] = {}

    @property
    def groups(self) -> list[RowGroup]:
        """The rows so far."""
        return [*self._groups.values()]

    def add(self, row: dict[str, Any], knobs: dict[str, object], seed: int) -> Scene | None:
        """Make a row ready; the scene of a row whose metrics need its whole record, which no kernel gives.

        Raises `Refused` where the scene, a body or the path of the hand does, and `Edited`.
        """
        if self._knobs is None or not _same_knobs(self._knobs, knobs):
            self._knobs = None
            scene = self._maker.scene(knobs)
            if type(scene.laws[0]) not in self._as_begun:  # an edited file has another class
                self._check(type(scene.laws[0]))
                self._as_begun.add(type(scene.laws[0]))
            self._before = scene, None if needs_record(self._measures, scene) else self._make(scene)
            self._knobs = knobs
        scene, made = self._before
        if made is None:
            return scene
        schedules = made.drawn.get(seed)
        if schedules is None:
            key = schedules_key(scene, seed)
            schedules = made.drawn[seed] = self._schedules.get(key) or self._schedules.setdefault(
                key, Schedules(key, scene, seed))
        made.group.rows.append(Ready(row, made.tree, made.flat, made.path, schedules, made.still, made.frame))
        return None

    def _check(self, thing: type | Callable[..., Any]) -> None:
        file = own_file(thing)
        if file is not None and self._files.get(file.path, file.digest) != file.digest:
            raise Edited(f"{file.path} was edited while the sweep ran; the rows until then are of the file as it was, "
                         "so run the sweep again, one with --out into another folder")

    def _make(self, scene: Scene) -> Made:
        kind = type(scene.laws[0])
        known = self._known.get(kind)
        changed = None if known is None else known.changed(scene)
        if known is not None and changed is not None and (made := self._varied(known, scene, changed)) is not None:
            return made
        known = self._known[kind] = self._worked_out(scene)
        return known.made

    def _worked_out(self, scene: Scene) -> KnownScene:
        """A scene worked out in full."""
        prepared = prepare(scene)
        bodies, offered = prepared.bodies, available(scene)
        wanted = tuple([one for one in self._measures if isinstance(one, str) and one in offered])
        rest, frame = still(scene, path_of(scene, compiled=self._engine != "plain")), frame_of(scene)
        if rest:
            wanted = (*wanted, *[str(one) for one in self._measures if one in AT_REST and (
                scene.slave is not None or one not in OF_SLAVE)], *SWINGS)
        kernel, flat = kernel_of(prepared, wanted, self._engine, self._stamps.of(prepared))
        tree = None if flat else tree_of(scene, bodies, compiled=False)
        path = path_of(scene, compiled=flat is not None)
        group = self._group(kernel, scene.ticks, flat, rest, frame)
        return KnownScene(prepared, Made(group, tree, flat, path, {}, rest, frame))

    def _group(self, kernel: Kernel, ticks: int, flat: Leaves | None, rest: Still | None, frame: Basis) -> RowGroup:
        key = id(kernel), ticks, tuple(flat.wholes) if flat else (), rest and (rest.since, rest.window), frame.last
        group = self._groups.get(key)
        if group is None:
            group = self._groups[key] = RowGroup(kernel, ticks)
        return group

    def _varied(self, known: KnownScene, scene: Scene, changed: frozenset[str]) -> Made | None:
        """A scene that differs from a known one in these parts; None if it is of another structure."""
        # A link may decide how waves are played.
        if not changed <= LIGHT or ("link" in changed and structure_of(scene) != known.prepared.structure):
            return None
        made = _with_link_of(scene, known.made) if "link" in changed else known.made
        bodies = known.prepared.bodies
        if "environment" in changed:
            made = made._replace(frame=frame_of(scene))
            slaves = slave_plants(scene)
            if not known.has_functions_of(scene, slaves):
                return None
            if changed <= {"environment", "link"} and (flat := known.with_slaves(slaves)) is not None:
                return made._replace(flat=flat)
            bodies = bodies._replace(slaves=slaves)
        if changed <= {"link"}:
            return made
        prepared = prepare(scene, bodies if "hand" not in changed else None)
        if "law" in changed and not known.has_law_like(scene):
            return None
        if "hand" in changed and (prepared.bodies.instead != bodies.instead or
                                  not known.has_functions_of(scene, prepared.bodies.slaves)):
            return None
        path = path_of(scene, compiled=made.flat is not None) if "hand" in changed else made.path
        rest = still(scene, path) if "hand" in changed else made.still
        if (rest is None) != (made.still is None):  # the kernel looks at the end, or it does not
            return None
        if made.flat is None:
            if self._engine != "plain" and "law" in changed:  # it may be this law's numbers that are not compiled
                return None
            group = self._group(made.group.kernel, made.group.ticks, None, rest, made.frame)
            tree = tree_of(scene, prepared.bodies, compiled=False)
            return made._replace(group=group, tree=tree, path=path, still=rest)
        try:
            flat = leaves(tree_of(scene, prepared.bodies))
        except NotCompiled:
            return None
        if flat.shape != made.flat.shape:
            return None
        group = self._group(made.group.kernel, made.group.ticks, flat, rest, made.frame)
        return made._replace(group=group, flat=flat, path=path, still=rest)


def _with_link_of(scene: Scene, made: Made) -> Made:
    """The same with another link: it has its own schedules, and may disturb what is at rest."""
    rest = made.still and made.still._replace(least_swing=least_swing(scene))
    return made._replace(drawn={}, still=rest)


class Made(NamedTuple):
    """Parts of a row that follow from its scene, whatever its seed."""

    group: RowGroup
    tree: Any
    flat: Leaves | None
    path: Any
    drawn: dict[int, Schedules]  # of its link, by the seed
    still: Still | None  # how its end is looked at
    frame: Basis


class KnownScene:
    """A scene that was worked out in full, for those that differ from it in a few parts."""

    def __init__(self, prepared: Prepared, made: Made) -> None:
        self.prepared, self.made = prepared, made
        self._scene = prepared.scene
        values = vars(self._scene)
        self._always = [name for name in PARTS if not same(values[name], values[name])]  # they may change unseen
        leaves_of = [(name, path) for name in PARTS if name not in self._always for path in _paths(name, values[name])]
        self._owners, paths = zip(*leaves_of, strict=True)
        self._get: Callable[[Scene], tuple[Any, ...]] = attrgetter(*paths)
        self._values = self._get(self._scene)
        slaves = prepared.bodies.slaves
        self._functions = [(plant.move, plant.force) for plant in slaves]
        self._inner = _inner(self._scene)
        self._lengths: list[int] | None = None  # of the slaves' coefficients, where they are plain floats
        if made.flat is not None and all(_is_plain(plant.c) and plant.start is None for plant in slaves):
            self._lengths = [len(plant.c) for plant in slaves]
            self._before = made.flat.reals[:len(made.flat.reals) - sum(self._lengths)]

    def changed(self, scene: Scene) -> frozenset[str] | None:
        """The parts of a scene that have not the very bits of this one's; None if it cannot be varied."""
        if type(scene) is not Scene:
            return None
        try:
            values = self._get(scene)
        except AttributeError:  # a part of another class, with other fields
            before, now = vars(self._scene), vars(scene)
            return frozenset([name for name in PARTS if not same(before[name], now[name])])
        others = compress(zip(self._owners, self._values, values, strict=True), map(is_not, self._values, values))
        return frozenset([*self._always, *[name for name, before, now in others if not same(before, now)]])

    def has_functions_of(self, scene: Scene, slaves: list[Any]) -> bool:
        """True if these plants move by the functions of this scene's."""
        return _inner(scene) == self._inner and [(plant.move, plant.force) for plant in slaves] == self._functions

    def has_law_like(self, scene: Scene) -> bool:
        """True if the law of a scene differs from this one's in its numbers alone."""
        kind = type(self._scene.laws[0])
        return functions_of(scene.laws[0]) is kind and structure_of(scene) == self.prepared.structure

    def with_slaves(self, slaves: list[Any]) -> Leaves | None:
        """The numbers of this scene with other coefficients of its slaves, which stand at their end; None if unlike."""
        flat = self.made.flat
        if flat is None or self._lengths is None:
            return None
        reals = self._before[:]
        for plant, length in zip(slaves, self._lengths, strict=True):
            if plant.start is not None or not _is_plain(plant.c) or len(plant.c) != length:
                return None
            reals.extend(plant.c)
        return Leaves(flat.shape, reals, flat.wholes, flat.arrays)


def _inner(scene: Scene) -> list[bool]:
    return [getattr(one, "inner", False) for one in scene.environments]


def _is_plain(coefficients: Any) -> bool:
    return type(coefficients) is tuple and set(map(type, coefficients)) == FLOATS


def same(a: Any, b: Any) -> bool:
    """True if two parts of scenes have the same bits, so that the same follows from both: -0.0 is not 0.0, 1 not True.

    Of a part that is no number, text, tuple or frozen dataclass nothing is known, and the answer is no.
    """
    kind = type(a)
    if kind is not type(b):
        return False
    if kind is float:
        return bool(a == b) and (a != 0.0 or copysign(1.0, a) == copysign(1.0, b))
    if kind in ATOMS:
        return bool(a == b)
    if kind is tuple:
        return len(a) == len(b) and all(map(same, a, b))
    values = _values_of(kind)
    if values is None:
        return False
    for x, y in zip(values(a), values(b), strict=True):  # noqa: SIM110 - a loop takes a third of the time
        if not ((x is y and type(x) in ATOMS) or same(x, y)):
            return False
    return True


def _paths(path: str, part: Any) -> list[str]:
    """Paths of the values and classes that a part consists of: a part with the same ones is the same."""
    if type(part) in ATOMS or type(part) is tuple:
        return [path]
    return [f"{path}.__class__", *[each for field in fields(part)
                                   for each in _paths(f"{path}.{field.name}", getattr(part, field.name))]]


_VALUES: dict[type, Callable[[Any], tuple[Any, ...]] | None] = {}


def _values_of(kind: type) -> Callable[[Any], tuple[Any, ...]] | None:
    """A function that gives the fields of a frozen dataclass; None for another class."""
    if kind not in _VALUES:
        _VALUES[kind] = None
        if is_dataclass(kind) and kind.__dataclass_params__.frozen:  # type: ignore[attr-defined]  # typeshed lacks it
            names = [each.name for each in fields(kind)]
            get: Any = attrgetter(*names) if names else None
            _VALUES[kind] = (lambda _: ()) if not names else (lambda part: (get(part),)) if len(names) == 1 else get
    return _VALUES[kind]


def _same_knobs(knobs: dict[str, object], others: dict[str, object]) -> bool:
    """True if these are the same knobs, to the bit."""
    return all(a is b or (type(a) is type(b) is float and a == b != 0.0)
               for a, b in zip(knobs.values(), others.values(), strict=True))
