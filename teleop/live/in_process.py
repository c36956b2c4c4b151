"""A run in virtual time with a device or robot of another kind: two endpoints stepped in one process, without a clock.

Each end is a live `Endpoint` that goes by packets; what one sends is handed to the other at once, and the schedule of
the link, drawn up front, says which message each tick plays. So with the simulated devices a run is that of
`teleop.simulation.virtual`, bit for bit, and with others it has the same record, figures and statuses.
"""

from __future__ import annotations

from argparse import Namespace
from array import array
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

from teleop.errors import Refused
from teleop.live.devices.guarded_device import GuardedDevice, LiveDevice
from teleop.live.devices.opening import open_device
from teleop.live.records.end_result import NAMES, UNSENSED
from teleop.protocol.endpoint import Endpoint, Reading, Stepped
from teleop.protocol.manifest import manifest_of
from teleop.protocol.session import Session
from teleop.scene.scene import Scene
from teleop.simulation.ending import Ending, divergence, ran_to_end, verdict
from teleop.simulation.plan import check_seed, link_plans
from teleop.simulation.prepared import Prepared, prepare
from teleop.simulation.result import Result
from teleop.simulation.virtual import Judge, result_of
from teleop.terminal.answer import Answer

Make = Callable[[Scene], LiveDevice]
MEETS_NS = 1_000_000_000  # of virtual time, within which the ends have met
NUMBER = 1  # of the session: nothing is drawn


def command(args: Namespace) -> Answer:
    """Run the scene in virtual time with a device or a robot by name, and leave its folder. Raises `Refused`."""
    from teleop.live.devices.opening import find_device
    from teleop.terminal.run import command as run_virtual

    if args.bodies is not None:
        raise Refused("--bodies moves the scene's own bodies, and a device or robot by name moves by itself; leave one "
                      "of them out")
    texts = {"m": args.device or "simulated", "s": args.robot or "simulated"}
    make = {e: find_device(e, text).open for e, text in texts.items()}
    reports = {word: texts[e] for word, e in (("device", "m"), ("robot", "s")) if texts[e] != "simulated"}

    def stepped(scene: Scene, *, seed: int, clock: Callable[[], int], **_bodies: None) -> Result:
        return run_stepped(scene, make, seed=seed, clock=clock, named=reports)

    return run_virtual(args, stepped)


def run_stepped(scene: Scene, make: Mapping[str, Make], *, seed: int = 0, clock: Callable[[], int] | None = None,
                named: Mapping[str, str] | None = None) -> Result:
    """Run `scene` in virtual time with the devices that `make` gives for the ends m and s.

    `seed` keys the link's random draws, and `clock` (ns) times the loop, as `teleop.run` has them. `named`: what the
    summary calls the devices, by "device" and "robot". A robot that is not the scene's own body is touched by nothing
    of the scene's environment: what it touches is its own, and f_env is what it senses. Raises `Refused`.
    """
    seed = check_seed(seed)
    _check(scene)
    with ExitStack() as stack:
        devices = {}
        for e in "ms":
            devices[e] = open_device(make[e], scene)
            stack.callback(getattr(devices[e], "close", lambda: None))
        return _run(scene, devices, seed, clock, dict(named or {}))


def _check(scene: Scene) -> None:
    """Refuse a scene whose two ends cannot be stepped by a schedule of packets."""
    if scene.slave is None:
        raise Refused(f"scene {scene.name} has no slave, so there are no two ends with a device each; leave --device "
                      "and --robot out")
    if scene.deadband is not None:
        raise Refused("with --device or --robot each end plays the packets of a schedule that is drawn up front, and a "
                      "deadband leaves packets out as the run goes; leave one of them out")
    if scene.leaves_out("m") is not None or scene.leaves_out("s") is not None:
        raise Refused("ticks are left out by order where both devices are simulated; leave --device and --robot out, "
                      "or left_out (of a recorded link write left_out=False)")


def _run(scene: Scene, devices: Mapping[str, LiveDevice], seed: int, clock: Callable[[], int] | None,
         named: dict[str, str]) -> Result:
    plans = link_plans(scene, seed)
    plan_of = dict(zip("sm", plans, strict=True))
    ends, start_ns = _begin_session(scene, {e: Stepped(plan_of[e]) for e in "ms"})
    guarded = {e: GuardedDevice(device, scene.axes, trusted=True) for e, device in devices.items()}
    rows = {e: array("d") for e in "ms"}
    began = clock() if clock else 0
    ran, end, why = _step(scene, ends, guarded, rows, start_ns)
    took = clock() - began if clock else None
    forces = {e: device.force_source for e, device in guarded.items()}
    notes = [f"{NAMES[e]}: {UNSENSED[e]}" for e, source in forces.items() if source == "unknown"]
    notes += [note for device in devices.values() for note in getattr(device, "notes", ())]
    return result_of(prepare(_analysable(scene, devices)), plans, rows, ran, end, seed=seed, took=took, forces=forces,
                     notes=notes, reports=named, judge=_judge_of(why, devices))


def _analysable(scene: Scene, devices: Mapping[str, LiveDevice]) -> Scene:
    """The scene without the hand and the environment of the bodies that other devices stand for."""
    master, slave = (getattr(devices[e], "scene_body", False) for e in "ms")
    return replace(scene, hand=scene.hand if master else None, environment=scene.environment if slave else None)


def _begin_session(scene: Scene, inboxes: Mapping[str, Stepped]) -> tuple[dict[str, Endpoint], int]:
    """Both ends with their session begun, and the time of tick 0 (ns)."""
    sessions = {e: Session(master=e == "m", manifest=manifest_of(scene), number=NUMBER if e == "m" else None,
                           heals=False) for e in "ms"}
    ends = {e: Endpoint(scene, e, sessions[e], inboxes[e]) for e in "ms"}
    for now in range(0, MEETS_NS, 1_000_000):
        waiting = [("s", data) for data in sessions["m"].due(now)] + [("m", data) for data in sessions["s"].due(now)]
        while waiting:
            to, data = waiting.pop(0)
            waiting += [("s" if to == "m" else "m", reply) for reply in ends[to].receive(data, now)]
        start_ns = sessions["m"].start_ns
        if all(each.met and each.carries_data and not each.meeting for each in sessions.values()):
            assert start_ns is not None
            return ends, start_ns
    why = sessions["m"].failure or sessions["s"].failure
    raise Refused(f"the two ends of scene {scene.name} do not meet: {why or 'neither says why'}; leave --device and "
                  "--robot out")


def _step(scene: Scene, ends: Mapping[str, Endpoint], devices: Mapping[str, GuardedDevice],
          rows: Mapping[str, array[float]], start_ns: int) -> tuple[int, Any, Ending | None]:
    """Step both ends through the run: how many ticks ran, the places beyond the scene's bounds, and what ended it.

    The last is None where the record itself shows how it ended.
    """
    count, dt_ns, limit = scene.ticks, scene.dt_ns, scene.x_limit
    (m, s), (master, slave) = (ends[e] for e in "ms"), (devices[e] for e in "ms")
    rows_m, rows_s = rows["m"], rows["s"]
    reading_m, reading_s = _first(master, "m"), _first(slave, "s")
    for k in range(count):
        now = start_ns + k * dt_ns
        tick_m = m.tick(k, now, reading_m)
        tick_s = s.tick(k, now, reading_s)
        rows_m.extend(tick_m.row)
        rows_s.extend(tick_s.row)
        failed = m.force_failed or s.force_failed
        if failed is not None:
            return k + 1, None, Ending("diverged", "")  # the record has the force, and names it
        if tick_m.datagram is None or tick_s.datagram is None:
            return k + 1, None, Ending("diverged", divergence(scene, k, "the message is not finite"))
        s.receive(tick_m.datagram, now)
        m.receive(tick_s.datagram, now)
        for e, device, force in (("m", master, tick_m.force), ("s", slave, tick_s.force)):
            if not device.hold(force):
                return k + 1, None, _stop_at(scene, k, e, device)
        readings = master.read(k + 1, now + dt_ns), slave.read(k + 1, now + dt_ns)
        for e, device, reading in zip("ms", (master, slave), readings, strict=True):
            if reading is None:
                return k + 1, None, _stop_at(scene, k, e, device)
        reading_m, reading_s = readings  # type: ignore[assignment]  # None has just been ruled out
        for x in reading_m.x + reading_s.x:
            if not -limit < x < limit:
                return k + 1, (reading_m.x, reading_s.x), None
    return count, None, None


def _first(device: GuardedDevice, e: str) -> Reading:
    """Read the device before the run. Raises `Refused` if it cannot be read."""
    reading = device.read(0, 0)
    if reading is None:
        raise Refused(f"the {NAMES[e]}'s device cannot be read: {device.trouble}; mend that, or leave "
                      f"{'--device' if e == 'm' else '--robot'} out for the simulated one")
    return reading


def _stop_at(scene: Scene, k: int, e: str, device: GuardedDevice) -> Ending:
    return Ending("stopped", f"stopped at t = {(k + 1) * scene.dt_ns / 1e9:.3f} s: the {NAMES[e]}'s device fails: "
                             f"{device.trouble}")


def _judge_of(why: Ending | None, devices: Mapping[str, LiveDevice]) -> Judge:
    """Judge of how the run ended.

    Whether it comes to rest is judged where nothing but the scene's hand moves it. A person or a recording may move
    a device otherwise, of which the scene knows nothing: such a run that reached its end is ok.
    """
    all_simulated = all(getattr(device, "scene_body", False) for device in devices.values())
    known = all(getattr(device, "scene_body", False) or getattr(device, "passive", False)
                for device in devices.values())

    def judge(prepared: Prepared, trace: Mapping[str, Any], ran: int, end: Any, trip: int) -> Ending:
        if why is not None and why.sentence:
            return why
        ending = verdict(prepared, trace, ran, end, trip, advises=all_simulated)
        return ending if known or ending.status == "diverged" else Ending("ok", ran_to_end(prepared.scene, ran))

    return judge
