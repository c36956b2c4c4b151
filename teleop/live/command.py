"""What `teleop demo`, `teleop keygen`, and `teleop run` with a device or robot by name do."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable

from teleop.errors import Refused
from teleop.scene.scene import Scene
from teleop.simulation.result import Result
from teleop.terminal.answer import Answer
from teleop.terminal.options import INTERRUPTED, knobs_from
from teleop.terminal.plotting import asked_formats


def demo(args: Namespace) -> Answer:
    """Run the scene live, as three processes, leave its folder, and draw it if asked to; or show it as a page.

    Raises `Refused`.
    """
    if args.page and (args.device is not None or args.robot is not None):
        raise Refused("--page has a simulated device in the browser's hand, and a simulated robot; leave --device and "
                      "--robot out, or --page")
    if args.page:
        from teleop.live.page.command import command

        return command(args)
    if args.port is not None or args.open:
        raise Refused("--port and --open are of the page; add --page")
    from teleop.live.demo import demo as run_live
    from teleop.terminal.run import answer_of, stem, with_plot

    formats = asked_formats(args)
    result = run_live(args.scene, knobs_from(args), seed=args.seed, out=args.out, stem=stem(args.scene),
                      json=args.json, lockstep=args.lockstep, command=args.typed, realtime=args.realtime,
                      rate=args.rate, spin=args.spin, device=args.device, robot=args.robot)
    answer = answer_of(result, args.typed)
    if result.status == "stopped":  # by a signal: a script that goes on with what the run came to must not
        answer = answer._replace(code=INTERRUPTED)
    return answer if result.path is None else with_plot(answer, result, result.path, formats)


def run(args: Namespace) -> Answer:
    """Run the scene in virtual time with a device or a robot by name, and leave its folder. Raises `Refused`."""
    from teleop.live.devices.opening import find_device
    from teleop.live.in_process import run_stepped
    from teleop.terminal.run import command

    if args.bodies is not None:
        raise Refused("--bodies moves the scene's own bodies, and a device or robot by name moves by itself; leave one "
                      "of them out")
    texts = {"m": args.device or "simulated", "s": args.robot or "simulated"}
    make = {e: find_device(e, text).open for e, text in texts.items()}
    other = {word: texts[e] for word, e in (("device", "m"), ("robot", "s")) if texts[e] != "simulated"}

    def stepped(scene: Scene, *, seed: int, clock: Callable[[], int], **_bodies: None) -> Result:
        return run_stepped(scene, make, seed=seed, clock=clock, named=other)

    return command(args, stepped)


def keygen(args: Namespace) -> Answer:
    """Make a key with its certificate, and say what each end is started with. Raises `Refused`."""
    from teleop.protocol.secure.keys import keygen as make

    path, fingerprint = make(args.name)
    text = (f"{path} written: it stays at this end, started with\n  --key {path}\n"
            f"and the other end is told whom to expect with\n  --peer-fingerprint {fingerprint}")
    return Answer(text, {"path": str(path), "fingerprint": fingerprint})
