"""Commands `teleop check device NAME` and `teleop check robot NAME`."""

from __future__ import annotations

import signal
from argparse import Namespace
from typing import Any

from teleop.errors import number_of
from teleop.live.devices.checking import DeviceCheck, check_device
from teleop.live.devices.judging import DeviceFault, Mistake
from teleop.naming import DEVICE_KINDS
from teleop.scene.axes import FORCE_UNIT
from teleop.scene.loading import load_scene
from teleop.terminal.answer import Answer
from teleop.terminal.options import FAULT, FORCED, knobs_from


def command(args: Namespace) -> Answer:
    """Check a device as `check_device` does; a device with a mistake ends with exit code 1. Raises `Refused`."""
    scene = load_scene(args.scene, **knobs_from(args))
    e = "m" if args.what == "device" else "s"
    # A device that is pushed lets go of these too, as of Ctrl-C.
    before = {each: signal.signal(each, _interrupted) for each in (signal.SIGTERM, signal.SIGHUP)}
    try:
        result = check_device(args.name, scene, e=e, push=True if args.push else None, force=args.force,
                              ticks=args.ticks)
    except DeviceFault as fault:
        sentence, mistake = str(fault), fault.mistake
        return Answer(f"{args.what} {args.name}: {mistake.value}\n  {sentence}",
                      {"device": args.name, "mistake": mistake.name.lower(), "sentence": sentence},
                      FORCED if mistake is Mistake.UNRELEASED else FAULT)
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)
    return Answer(_report(result, e), result.document())


def _interrupted(*_: Any) -> None:
    raise KeyboardInterrupt


def _report(result: DeviceCheck, e: str) -> str:
    """Write what was measured for a person."""
    lets_go = [] if result.deadline is None else [f"by itself after {result.deadline:g} s"]
    lets_go += ["by its watchdog process"] * result.watchdog
    lines = [
        f"{DEVICE_KINDS[e].word} {result.device}: {number_of(result.axes, 'axis', 'axes')}, "
        f"{'with a' if result.senses else 'without a'} force sensor{', simulated' * result.simulated}",
        f"  read    {_time(result.read_median)} median, {_time(result.read_99)} for 99 of 100, "
        f"{_time(result.read_most)} at most, of {number_of(result.reads, 'call')}",
        f"  hold    {_time(result.hold_median)} median, {_time(result.hold_most)} at most",
        *([] if (bus := result.bus) is None else [
            f"  bus     {_time(bus.median)} median, {_time(bus.most_99)} for 99 of 100, {_time(bus.most)} at most: it "
            f"carries {bus.carries:,.0f} exchanges a second"]),
        f"  rate    {result.rate:,.0f} a second, 1 / {'(read + hold)' if bus is None else 'exchange'} by the medians, "
        "measured now on this machine",
        f"  force   lets go {' and '.join(lets_go) or 'not at all if this process dies'}",
    ]
    if any(result.moved):
        pushes = zip(result.pushed, result.moved, result.axis_names, result.axis_units, strict=True)
        moved = ", ".join(f"{by:.3g} {unit} along {name} ({force:.3g} {FORCE_UNIT[unit]})"
                          for force, by, name, unit in pushes)
        lines.append(f"  push    moved it by {moved}: the right way")
    return "\n".join([*lines, *[f"  note    {note}" for note in result.notes]])


def _time(seconds: float) -> str:
    return f"{seconds * 1e6:.1f} us" if seconds < 1e-3 else f"{seconds * 1e3:.2f} ms"
