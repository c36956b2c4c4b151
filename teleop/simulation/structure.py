"""The structure of a scene: all that decides which lines of the tick it has, and none of its numbers."""

from __future__ import annotations

from typing import Any, NamedTuple

from teleop.errors import Refused
from teleop.kind import kinds, positions, wave
from teleop.law import functions_of, messages, reads, start_at
from teleop.law.offers import stores
from teleop.scene.playout import integrates, repeats
from teleop.scene.scene import Scene
from teleop.simulation.bodies import master_has_inner
from teleop.stages.end import Column, End, EndHas, Recorder, Run, RunHas, Shown, Stage, Told, Turn, per_axis
from teleop.stages.order import STAGES, Asked

NAMES = {"m": "master", "s": "slave"}
SENSED = {"m": "f_h", "s": "f_env"}  # the external force at each end


class Turns(NamedTuple):
    """The rotations of an end: the first axis of each, the fields of its messages and its state, and the positions."""

    first: tuple[int, ...]
    tx_fields: tuple[str, ...]
    state_fields: tuple[str, ...]
    rx_positions: tuple[str, ...]
    tx_positions: tuple[str, ...]
    state_positions: tuple[str, ...]


class EndStructure(NamedTuple):
    """That of one end: what it has, its stages in order, what its law sums over the axes, and its messages."""

    has: EndHas
    stages: tuple[type[Stage], ...]
    fields: tuple[str, ...] = ()
    tx_wave: str = ""
    rx_wave: str = ""
    rx_fields: tuple[str, ...] = ()
    shows: tuple[str, ...] = ()  # fields of its law's state that are recorded
    tells: tuple[str, ...] = ()  # fields of its messages that decide whether they are sent
    turns: Turns | None = None
    rx_place: str = ""  # the position that it receives, where that decides whether a clutch closes


class Structure(NamedTuple):
    """That of a scene. Scenes of one structure differ in numbers, and in the functions of their laws and bodies."""

    axes: int
    has: RunHas
    m: EndStructure
    s: EndStructure


def structure_of(scene: Scene) -> Structure:
    """The structure of a scene; kept with the scene, which does not change."""
    kept: Structure | None = vars(scene).get("_structure")
    if kept is None:
        late = scene.leaves_out("m") is not None or scene.leaves_out("s") is not None
        has = RunHas(
            slave=scene.slave is not None, hand=scene.reference is not None,
            link=scene.slave is not None and (scene.link is not None or late or scene.deadband is not None),
            repeats=repeats(scene.played_as), integral=scene.has_waves and integrates(scene.played_as),
            own_laws=isinstance(scene.law, tuple), deadband=scene.deadband is not None,
            energy=scene.energy, waves=scene.energy and scene.has_waves,
            stored=scene.energy and scene.slave is not None and stores(scene.laws[0]))
        slave = _end(scene, "s", has) if has.slave else EndStructure(EndHas(), ())
        kept = vars(scene)["_structure"] = Structure(scene.axes, has, _end(scene, "m", has), slave)
    return kept


def _end(scene: Scene, e: str, run: RunHas) -> EndStructure:
    law = functions_of(scene.laws[0])
    sums = getattr(law, f"{NAMES[e]}_sums", None)
    reading = reads(getattr(law, NAMES[e]) if run.slave else law.force) | (reads(sums) if sums else frozenset())
    asked = Asked(scene, e, scene.per_axis(f"device_{e}")[0], reading)
    places = [place for place in STAGES if place.wanted(asked)]
    stages, names = tuple([place.stage() for place in places]), {place.name for place in places}
    touch, observed = "f" in reading, "observer" in names
    inner = master_has_inner(scene) if e == "m" else (
        scene.slave is not None and (any(body.friction > 0.0 for body in scene.per_axis("slave")) or any(
            getattr(one, "inner", False) for one in scene.environments)))
    age, aged = "age" in reading and run.slave, getattr(scene.watchdog, "age", None) is not None
    has = EndHas(
        inner=inner, touch=touch, observed=observed, sensed=touch and not observed,
        # A body with an inner state cannot tell its external force afterwards, so it is recorded.
        felt=(touch and not observed) or inner,
        age=age, aged=aged, newest=age or aged or run.deadband, sums=sums is not None,
        dx="dx" in reading or (run.energy and "encoder" not in names) or any(stage.wants_dx for stage in stages),
        leaves_out=scene.leaves_out(e) is not None, encoder="encoder" in names,
        velocity="velocity" in names, scaled="scaling" in names, operated="operator" in names,
        watchdog="watchdog" in names, span="span" in reading, gain="gain" in reading,
        slewed=not names.isdisjoint(("watchdog", "operator")) and any(
            cap is not None and cap.slew is not None for cap in scene.per_axis("cap")))
    fields = sums_type(scene.laws[0], e, scene.dt_ns / 1e9)._fields if sums else ()
    if not run.slave:
        return EndStructure(has, stages, fields)
    forth, back = messages(scene.laws[0], scene.dt_ns / 1e9)
    tx, rx = (forth, back) if e == "m" else (back, forth)
    return EndStructure(has, stages, fields, wave(tx) or "", wave(rx) or "", rx._fields, _shows(scene, e),
                        _tells(tx) if run.deadband else (), _turns(scene, e, tx, rx) if scene.rotations else None,
                        _place(scene, rx) if "operator" in names else "")


def _place(scene: Scene, rx: Any) -> str:
    """The position that a master receives, where an operator's clutch closes by it."""
    return positions(rx)[0] if scene.operator is not None and scene.operator.closes_within is not None else ""


def _turns(scene: Scene, e: str, tx: Any, rx: Any) -> Turns:
    """The rotations of an end, whose messages are of these types."""
    state = type(start_of(scene.laws[0], e, scene.dt_ns / 1e9)[0])
    named = hasattr(state, "_fields")
    return Turns(scene.rotations, tx._fields, state._fields if named else (), positions(rx), positions(tx),
                 positions(state) if named else ())


def _tells(message: Any) -> tuple[str, ...]:
    """The fields of a message that ask for it to be sent: all but totals, which tell of energy."""
    return tuple([name for name, of_kind in kinds(message).items() if of_kind != "total"])


def _shows(scene: Scene, e: str) -> tuple[str, ...]:
    """The fields of the law's state at one end that it asks to be recorded."""
    asked = getattr(scene.laws[0], "shows", ())
    if not asked:
        return ()
    state, _ = start_of(scene.laws[0], e, scene.dt_ns / 1e9)
    return tuple([field for field in asked if field in getattr(state, "_fields", ())])


def start_of(law: Any, e: str, dt: float) -> Any:
    """The state of an end of a law, and the message that it begins with, at rest at 0."""
    return getattr(law, f"{NAMES[e]}_start")(start_at(0.0, 0.0, 0.0, dt))


def sums_type(law: Any, e: str, dt: float) -> Any:
    """The NamedTuple that an end of a law sums over the axes, as a call at rest shows it."""
    still = start_at(0.0, 0.0, 0.0, dt)
    state, rx = getattr(law, f"{NAMES[e]}_start")(still)
    return type(getattr(law, f"{NAMES[e]}_sums")(state, still, rx))


def live_structure(structure: Structure, e: str, sensor: bool | None = None) -> Structure:
    """That of a live end, whose force is multiplied by its guard's gain whether there is a watchdog or not.

    `sensor`: does its device sense the external force; None: it does where a run in virtual time works it out.
    """
    own: EndStructure = getattr(structure, e)
    names = {"watchdog", *[stage.name for stage in own.stages]}
    stages = tuple([place.stage() for place in STAGES if place.name in names])
    felt = own.has.felt if sensor is None else sensor
    alone = own._replace(has=own.has._replace(live=True, leaves_out=True, felt=felt), stages=stages)
    return structure._replace(m=alone) if e == "m" else structure._replace(s=alone)


def run_of(structure: Structure, recorder: Recorder) -> Run:
    """The records that the tick of this structure is written over."""
    run = Run()
    run.has, run.recorder = structure.has, recorder
    run.m, run.s = _end_of("m", structure), _end_of("s", structure)
    run.ends = (run.m, run.s) if run.has.slave else (run.m,)
    return run


def _end_of(name: str, structure: Structure) -> End:
    own: EndStructure = getattr(structure, name)
    e = End(name, structure.axes, own.has)
    e.stages = tuple([stage(name, structure.axes) for stage in own.stages])
    e.fields, e.tx_wave, e.rx_wave, e.rx_fields = own.fields, own.tx_wave, own.rx_wave, own.rx_fields
    e.rx_place = own.rx_place
    e.shown = tuple([Shown(f"{a.suffix}_{field}", a, field) for field in own.shows for a in e.axes])
    e.told = tuple([Told(f"{a.suffix}_{field}", a, field) for field in own.tells for a in e.axes])
    own_turns = own.turns or Turns((), (), (), (), (), ())
    e.tx_fields, e.state_fields, e.state_positions = (
        own_turns.tx_fields, own_turns.state_fields, own_turns.state_positions)
    e.turns = tuple([Turn(f"{name}_turn{i}", e.axes[i:i + 3], own_turns.rx_positions, own_turns.tx_positions)
                     for i in own_turns.first])
    e.cells = tuple([cell for column in end_columns(e) for cell in column.cells])
    e.memory = (
        *[(a, field) for a in e.axes for field in ("x", "v", "f")], *[(a, "z") for a in e.axes if own.has.inner],
        *[(a, "x_before") for a in e.axes if own.has.dx], *[cell for stage in e.stages for cell in stage.memory(e)],
        *[(a, "s") for a in e.axes])
    return e


def end_columns(e: End) -> list[Column]:
    """The columns of an end's record, in order: motion, readings, forces, and what the stages keep."""
    before = [column for stage in e.stages if stage.reading for column in stage.columns(e)]
    after = [column for stage in e.stages if not stage.reading for column in stage.columns(e)]
    felt = [per_axis(SENSED[e.name], e.axes, "f_ext")] * e.has.felt
    x, v, f = [per_axis(f"{field}_{e.name}", e.axes, field) for field in ("x", "v", "f")]
    fields = dict.fromkeys([one.field for one in e.shown])
    shown = [per_axis(f"{field}_{e.name}", tuple([one for one in e.shown if one.field == field]), "value")
             for field in fields]
    found = [x, v, *before, *felt, f, *after, *shown]
    names = [column.name.removesuffix("@") for column in found]
    if double := next((name for name in names if names.count(name) > 1), None):
        raise Refused(f"the law shows {double.rpartition('_')[0]}, and {double} is a column of every record; give that "
                      "field of its state another name")
    return found


def columns(scene: Scene, e: str, sensor: bool | None = None) -> list[str]:
    """The names of one end's record, in order; one with @ stands once for each axis.

    `sensor`: does the device of a live end sense the external force; None: as in virtual time.
    """
    structure = structure_of(scene) if sensor is None else live_structure(structure_of(scene), e, sensor)
    return [column.name for column in end_columns(getattr(run_of(structure, Recorder()), e))]
