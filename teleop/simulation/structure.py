"""The structure of a scene: all that decides which lines of the tick it has, and none of its numbers."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

from teleop.errors import Refused
from teleop.kind import wave
from teleop.law import functions_of, messages, reads, start_at
from teleop.law.offers import stores
from teleop.scene.playout import integrates, repeats
from teleop.scene.scene import Scene
from teleop.simulation.bodies import has_inner, master_has_inner
from teleop.stages.end import Column, End, EndHas, Recorder, Run, RunHas, Shown, Stage, per_axis
from teleop.stages.order import STAGES, Asked

NAMES = {"m": "master", "s": "slave"}
SENSED = {"m": "f_h", "s": "f_env"}  # the external force at each end


class EndStructure(NamedTuple):
    """Structure of one end: its stages in order, the fields that its law sums over the axes, and its messages."""

    has: EndHas
    stages: tuple[type[Stage], ...]
    of_stages: tuple[Any, ...]  # what decides the lines of each beside its being there
    fields: tuple[str, ...] = ()
    tx_wave: str = ""
    rx_wave: str = ""
    rx_fields: tuple[str, ...] = ()
    shows: tuple[str, ...] = ()  # fields of its law's state that are recorded

    def has_stage(self, name: str) -> bool:
        """True if the end has the stage of this name."""
        return any(stage.name == name for stage in self.stages)


class Structure(NamedTuple):
    """Structure of a scene. Those of one structure differ in numbers, and in functions of laws and bodies."""

    axes: int
    has: RunHas
    m: EndStructure
    s: EndStructure


def structure_of(scene: Scene) -> Structure:
    """The structure of a scene; kept with the scene, which does not change."""
    structure: Structure | None = vars(scene).get("_structure")
    if structure is None:
        late = scene.leaves_out("m") is not None or scene.leaves_out("s") is not None
        has = RunHas(
            slave=scene.slave is not None, hand=scene.reference is not None,
            link=scene.slave is not None and (scene.link is not None or late or scene.deadband is not None),
            repeats=repeats(scene.played_as), integral=scene.has_waves and integrates(scene.played_as),
            own_laws=isinstance(scene.law, tuple), deadband=scene.deadband is not None,
            energy=scene.energy, waves=scene.energy and scene.has_waves,
            stored=scene.energy and scene.slave is not None and stores(scene.laws[0]))
        slave = _end(scene, "s", has) if has.slave else EndStructure(EndHas(), (), ())
        structure = vars(scene)["_structure"] = Structure(scene.axes, has, _end(scene, "m", has), slave)
    return structure


def _end(scene: Scene, e: str, run: RunHas) -> EndStructure:
    law = functions_of(scene.laws[0])
    sums = getattr(law, f"{NAMES[e]}_sums", None)
    reading = reads(getattr(law, NAMES[e]) if run.slave else law.force) | (reads(sums) if sums else frozenset())
    dt = scene.dt_ns / 1e9
    tx: Any
    rx: Any
    tx, rx = messages(scene.laws[0], dt)[::1 if e == "m" else -1] if run.slave else (None, None)
    state = type(start_of(scene.laws[0], e, dt)[0]) if run.slave else None
    end = Asked(scene, e, scene.per_axis(f"device_{e}")[0], scene.per_axis(NAMES[e])[0], reading, tx, rx, state)
    places = [place for place in STAGES if place.wanted(end)]
    stages, names = tuple([place.stage() for place in places]), {place.name for place in places}
    of_stages = tuple([stage.structure(end) for stage in stages])
    touch, observed = "f" in reading, "observer" in names
    inner = master_has_inner(scene) if e == "m" else (
        scene.slave is not None and (any(has_inner(body) for body in scene.per_axis("slave")) or any(
            getattr(one, "inner", False) for one in scene.environments)))
    age, aged = "age" in reading and run.slave, getattr(scene.watchdog, "age", None) is not None
    has = EndHas(
        inner=inner, touch=touch, sensed=touch and not observed,
        # A body with an inner state cannot tell its external force afterwards, so it is recorded.
        felt=(touch and not observed) or inner,
        age=age, newest=age or aged or run.deadband, sums=sums is not None,
        dx="dx" in reading or (run.energy and "encoder" not in names) or any(stage.wants_dx for stage in stages),
        leaves_out=scene.leaves_out(e) is not None, span="span" in reading, gain="gain" in reading)
    fields = sums_type(scene.laws[0], e, dt)._fields if sums else ()
    if not run.slave:
        return EndStructure(has, stages, of_stages, fields)
    shows = tuple([field for field in getattr(scene.laws[0], "shows", ()) if field in getattr(state, "_fields", ())])
    return EndStructure(has, stages, of_stages, fields, wave(tx) or "", wave(rx) or "", rx._fields, shows)


def end_scene(scene: Scene, e: str) -> Scene:
    """The scene as the live end `e` runs it: what a policy does is sent to its ticks, and is none of its numbers."""
    if e != "m" or getattr(scene.handover, "policy", None) is None:
        return scene
    return replace(scene, handover=scene.handover.without_policy)  # type: ignore[union-attr]  # it has one


def start_of(law: Any, e: str, dt: float) -> Any:
    """The state of an end of a law, and the message that it begins with, at rest at 0."""
    return getattr(law, f"{NAMES[e]}_start")(start_at(0.0, 0.0, 0.0, dt))


def sums_type(law: Any, e: str, dt: float) -> Any:
    """The NamedTuple that an end of a law sums over the axes, as a call at rest shows it."""
    still = start_at(0.0, 0.0, 0.0, dt)
    state, rx = getattr(law, f"{NAMES[e]}_start")(still)
    return type(getattr(law, f"{NAMES[e]}_sums")(state, still, rx))


def live_structure(structure: Structure, e: str, sensor: bool | None = None) -> Structure:
    """Structure of a live end, whose force is multiplied by its guard's gain whether there is a watchdog or not.

    `sensor`: does its device sense the external force; None: it does where a run in virtual time works it out.
    """
    shape: EndStructure = getattr(structure, e)
    of_stage = {stage.name: structure for stage, structure in zip(shape.stages, shape.of_stages, strict=True)}
    places = [place for place in STAGES if place.name in {"watchdog", *of_stage}]
    felt = shape.has.felt if sensor is None else sensor
    alone = shape._replace(has=shape.has._replace(live=True, leaves_out=True, felt=felt),
                         stages=tuple([place.stage() for place in places]),
                         of_stages=tuple([of_stage.get(place.name) for place in places]))
    return structure._replace(m=alone) if e == "m" else structure._replace(s=alone)


def run_of(structure: Structure, recorder: Recorder) -> Run:
    """The records that the tick of this structure is written over."""
    run = Run()
    run.has, run.recorder = structure.has, recorder
    run.m, run.s = _end_of("m", structure), _end_of("s", structure)
    run.ends = (run.m, run.s) if run.has.slave else (run.m,)
    return run


def _end_of(name: str, structure: Structure) -> End:
    shape: EndStructure = getattr(structure, name)
    e = End(name, structure.axes, shape.has)
    e.stages = tuple([stage(e, structure) for stage, structure in zip(shape.stages, shape.of_stages, strict=True)])
    e.stage = stages_by_name()(**{stage.name: stage for stage in e.stages})
    e.fields, e.tx_wave, e.rx_wave, e.rx_fields = shape.fields, shape.tx_wave, shape.rx_wave, shape.rx_fields
    e.shown = tuple([Shown(f"{a.suffix}_{field}", a, field) for field in shape.shows for a in e.axes])
    e.cells = tuple([cell for column in end_columns(e) for cell in column.cells])
    e.memory = (
        *[(a, field) for a in e.axes for field in ("x", "v", "f")], *[(a, "z") for a in e.axes if shape.has.inner],
        *[(a, "x_before") for a in e.axes if shape.has.dx], *[cell for stage in e.stages for cell in stage.memory(e)],
        *[(a, "s") for a in e.axes])
    return e


@lru_cache
def stages_by_name() -> Any:
    """A NamedTuple of all stages, of which an end has some."""
    return namedtuple("stages_by_name", [place.name for place in STAGES], defaults=[None] * len(STAGES))


def end_columns(e: End) -> list[Column]:
    """The columns of an end's record, in order: motion, readings, forces, and what the stages keep."""
    before = [column for stage in e.stages if stage.reading for column in stage.columns(e)]
    after = [column for stage in e.stages if not stage.reading for column in stage.columns(e)]
    felt = [per_axis(SENSED[e.name], e.axes, "f_ext")] * e.has.felt
    x, v, f = [per_axis(f"{field}_{e.name}", e.axes, field) for field in ("x", "v", "f")]
    fields = dict.fromkeys([one.field for one in e.shown])
    shown = [per_axis(f"{field}_{e.name}", tuple([one for one in e.shown if one.field == field]), "value")
             for field in fields]
    all_columns = [x, v, *before, *felt, f, *after, *shown]
    names = [column.name.removesuffix("@") for column in all_columns]
    if double := next((name for name in names if names.count(name) > 1), None):
        raise Refused(f"the law shows {double.rpartition('_')[0]}, and {double} is a column of every record; give that "
                      "field of its state another name")
    return all_columns


def columns(scene: Scene, e: str, sensor: bool | None = None) -> tuple[str, ...]:
    """Names of the columns of one end's record, in order; one with @ stands once for each axis.

    `sensor`: True if the device of a live end senses the external force; None: as in virtual time.
    """
    structure = structure_of(scene)
    return _columns_of(structure if sensor is None else live_structure(structure, e, sensor), e)


@lru_cache(maxsize=64)
def _columns_of(structure: Structure, e: str) -> tuple[str, ...]:
    return tuple([column.name for column in end_columns(getattr(run_of(structure, Recorder()), e))])


def numbers_of(scene: Scene, starts: Mapping[str, Sequence[float]]) -> Any:
    """A NamedTuple of an entry for each of these ends, a NamedTuple of what each of its stages is given.

    `starts`: where each end starts, m, per axis.
    """
    dt = scene.dt_ns / 1e9
    ends = {}
    for e, start in starts.items():
        shape: EndStructure = getattr(structure_of(scene), e)
        places = list(start)
        numbers = {stage.name: stage.numbers(scene, e, dt, places) for stage in shape.stages}
        ends[e] = record("GivenEnd", tuple(numbers))(*numbers.values())
    return record("Given", tuple(ends))(*ends.values())


@lru_cache
def record(name: str, names: tuple[str, ...]) -> Any:
    """A NamedTuple of these fields: one and the same class whenever it is asked for."""
    return namedtuple(name, names)
