"""The loop of one scene: what `specialise` makes of the tick for its structure, with the scene's own functions in it.

Scenes of one structure share the lines, which are made once and kept; what differs is the functions of their laws and
bodies, which the lines find by name.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from inspect import getattr_static
from types import CodeType, FunctionType
from typing import Any, NamedTuple

from teleop.law import messages
from teleop.physics.plant import grip_force, move_free, move_gripped
from teleop.scene.scene import Scene
from teleop.simulation.bodies import Bodies
from teleop.simulation.specialise import Specialised, specialise
from teleop.simulation.structure import NAMES, Structure, live_structure, run_of, start_of, structure_of, sums_type
from teleop.simulation.tick import live, loop, row
from teleop.stages.end import End, Record, Recorder, Run, function_fields


class Lines(NamedTuple):
    """The lines of one structure, and what they find by name: functions of the stack, and those of a scene (None)."""

    made: Specialised
    code: CodeType

    def text(self) -> str:
        """Text of these lines."""
        return ast.unparse(self.made.tree)

    def names(self, functions: Mapping[str, Any]) -> dict[str, Any]:
        """Names that these lines need, with a scene's own functions."""
        return {word: functions[word] if thing is missing else thing for word, thing in self.made.names.items()}

    def function(self, functions: Mapping[str, Any]) -> Callable[..., Any]:
        """The function of these lines with a scene's own functions."""
        names = self.names(functions)
        exec(self.code, names)
        made: Callable[..., Any] = names[self.made.tree.name]
        return made


def loop_of(scene: Scene, bodies: Bodies) -> Callable[..., Any]:
    """The loop of a run in virtual time."""
    return lines(structure_of(scene), loop, RowRecorder).function({**functions(scene), **bodies.functions()})


def live_of(scene: Scene, e: str, sensor: bool | None = None) -> Callable[..., Any]:
    """The generator of a live end, m or s. `sensor`: does its device sense the external force, see `live_structure`."""
    return lines(live_structure(structure_of(scene), e, sensor), live, ends=(e,)).function(functions(scene))


@lru_cache(maxsize=64)
def lines(structure: Structure, entry: Callable[..., Any], recorder: Callable[..., Recorder] = Recorder,
          request: tuple[Any, ...] = (), ends: tuple[str, ...] = (), engine: str = "plain") -> Lines:
    """The lines that `entry` comes to for a structure.

    `recorder` makes the run's recorder of what is `asked`. `ends`: the ends that `entry` is handed beside the run.
    `engine`: plain, c or vector; see `teleop.simulation.specialise`.
    """
    run = run_of(structure, recorder(*request))
    bind(run, None)
    made = specialise(entry, run, *[getattr(run, e) for e in ends], engine=engine)
    return Lines(made, compile(ast.Module([made.tree], []), made.file, "exec"))


def missing(*_: Any) -> Any:
    """A function that a scene brings, where lines are made for all scenes of a structure."""
    raise NotImplementedError


def bind(run: Run, functions: Mapping[str, Any] | None) -> None:
    """Let the records of a run have the functions of a scene by their names, or `missing` in place of each."""
    for record in _records(run):
        for field in function_fields(type(record)):
            if functions is None:
                setattr(record, field, missing)
            elif record.word(field) in functions:
                setattr(record, field, functions[record.word(field)])


def _records(run: Run) -> Iterator[Record]:
    yield run
    yield run.recorder
    for e in run.ends:
        yield e
        yield from e.axes
        yield from e.stages


def functions(scene: Scene) -> dict[str, Any]:
    """Functions that the lines of a scene find by name: its law's, its devices' and its master's."""
    table: dict[str, Any] = {"grip_force": grip_force, "move_free": move_free, "move_gripped": move_gripped}
    structure, law = structure_of(scene), scene.laws[0]
    if scene.slave is None:
        words = {"begin_m": "start", "law_m": "force"}
    else:
        words = {"begin_m": "master_start", "law_m": "master", "begin_s": "slave_start", "law_s": "slave"}
    for e, end in (("m", structure.m), ("s", structure.s)):
        device = scene.per_axis(f"device_{e}")[0]
        if end.has.sums:
            words[f"total_{e}"] = f"{NAMES[e]}_sums"
            table[f"Sums_{e}"] = sums_type(law, e, scene.dt_ns / 1e9)
        if end.rx_wave or scene.rotations:
            table[f"Message_{e}"] = messages(law, scene.dt_ns / 1e9)[e == "m"]
        if scene.rotations:
            table[f"Sent_{e}"] = messages(law, scene.dt_ns / 1e9)[e == "s"]
            table[f"State_{e}"] = type(start_of(law, e, scene.dt_ns / 1e9)[0])
        if structure.has.stored:
            words[f"stored_{e}"] = f"{NAMES[e]}_stored"
        if device is not None and device.velocity is not None:
            table[f"estimate_{e}"] = device.velocity.step
    return table | {word: _end_of(law, name) for word, name in words.items()}


def _end_of(law: Any, name: str) -> Callable[..., Any]:
    """An end of a law as a function of the law and the rest; of a law that wraps another, whatever it answers with."""
    function = getattr_static(type(law), name, None)
    if isinstance(function, FunctionType):
        return function
    method: Callable[..., Any] = getattr(law, name)
    return lambda _, *rest: method(*rest)


def rendered(scene: Scene, e: str | None = None) -> str:
    """The lines of a scene's loop as text, or with `e` (m or s) those of its live end."""
    structure = structure_of(scene)
    made = lines(structure, loop, RowRecorder) if e is None else lines(live_structure(structure, e), live, ends=(e,))
    return made.text() + "\n"


class RowRecorder(Recorder):
    """A row of each end at every tick, handed to the two functions that the run is asked with."""

    rows_m: Any
    rows_s: Any

    def begin(self, run: Run, request: Any, size: int) -> None:
        self.rows_m = request[0]
        if run.has.slave:
            self.rows_s = request[1]

    def step(self, run: Run, k: int) -> None:
        self.rows_m(row(run.m))
        if run.has.slave:
            self.rows_s(row(run.s))

    def outcome(self, run: Run, ticks: int, complete: bool) -> Any:
        """Ticks that ran, ticks with too many contact events, where it left its bounds, and the inner states."""
        ends = None if complete else tuple([places(e) for e in run.ends])
        return ticks, run.capped if run.has.slave else 0, ends, (inner(run.m), inner(run.s))


def places(e: End) -> tuple[float, ...]:
    """Positions of an end."""
    return tuple([a.x for a in e.axes])


def inner(e: End) -> tuple[Any, ...]:
    """The inner states of an end's bodies."""
    return tuple([a.z for a in e.axes]) if e.has.inner else ()
