"""What `teleop check device NAME` and `teleop check robot NAME` do."""

from __future__ import annotations

import signal
from argparse import Namespace
from typing import Any

from teleop.live.devices.checking import check_device, report
from teleop.live.devices.judging import DeviceFault, Mistake
from teleop.scene.loading import load_scene
from teleop.terminal.answer import Answer
from teleop.terminal.options import FAULT, FORCED, knobs_from


def command(args: Namespace) -> Answer:
    """Check a device as `check_device` does; a mistake of its is exit code 1. Raises `Refused`."""
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
    return Answer(report(result, e), result.document())


def _interrupted(*_: Any) -> None:
    raise KeyboardInterrupt
