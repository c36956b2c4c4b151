"""`python -m master` and `python -m slave`: one live end as a process of its own."""

from __future__ import annotations

import sys
import time
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from functools import partial
from pathlib import Path
from secrets import randbits
from shlex import quote
from typing import TYPE_CHECKING, Any

from teleop.errors import Refused, number
from teleop.live.devices.guarded_device import LiveDevice, is_simulated
from teleop.live.devices.opening import close, find_device, open_device, watchdog_of
from teleop.live.driving import run
from teleop.live.leaving import LastResort
from teleop.live.live_line import live_text
from teleop.live.net.wire import Address, Wire, address, bind_towards, bind_udp, host_port, peer_address
from teleop.live.options import key_options, secure_link, ticks_of
from teleop.live.orders import orders_option, tell
from teleop.live.process import output, realtime
from teleop.live.process.interrupt import Interrupt
from teleop.live.records.end_result import NAMES, UNRELEASED
from teleop.live.records.record import EVERY, RecordWriter, fresh_folder
from teleop.live.shell import TRACEBACK, Shell, write_traceback
from teleop.live.summary import UNWATCHED, holds_on, write_end
from teleop.naming import DEVICE_KINDS
from teleop.protocol.endpoint import Endpoint, Stepped
from teleop.protocol.guard import Event
from teleop.protocol.manifest import live_manifest, manifest_of
from teleop.protocol.session import Session
from teleop.scene.loading import asks_for_trust, live_knobs, load_scene
from teleop.scene.scene import Scene, both_ends
from teleop.simulation.result import Result
from teleop.terminal import screen
from teleop.terminal.options import (
    DONE,
    FAULT,
    FORCED,
    WRONG,
    complain,
    guarded,
    knobs_from,
    realtime_option,
    scene_options,
    tick_options,
    whole,
)
from teleop.terminal.progress import Progress

if TYPE_CHECKING:
    from teleop.protocol.secure.secure_link import SecureLink


def end_main(e: str, device: Callable[[Scene], LiveDevice], argv: Sequence[str] | None = None, *,
             ordered: Callable[[Scene], LiveDevice] | None = None) -> int:
    """The command line of the end `e`, "m" or "s"; `device` makes what stands at that end from the scene.

    `ordered`: makes it where the end takes orders (--orders); left out: `device` does. Returns the exit code, as the
    live README has them.
    """
    return guarded(lambda: _run(e, device, ordered or device, sys.argv[1:] if argv is None else list(argv)))


def _run(e: str, device: Callable[[Scene], LiveDevice], ordered: Callable[[Scene], LiveDevice], argv: list[str]) -> int:
    args = _arguments(e, argv)
    devices: list[LiveDevice] = []
    try:
        code = _run_with(e, ordered if args.orders else device, args, argv, devices)
    finally:
        # The last of all, when signals end this process again: a driver may hang here too.
        sound = [_close(each) for each in devices]
    return code if all(sound) else code or FAULT


def _close(device: LiveDevice) -> bool:
    """Close a device that can be closed; False, and said on stderr, if it raised something."""
    if (why := close(device)) is None:
        return True
    complain(f"the run is over and its folder is whole, and the device did not close: {why}", FAULT)
    return False


def _run_with(
    e: str, device: Callable[[Scene], LiveDevice], args: Namespace, argv: list[str], devices: list[LiveDevice]
) -> int:
    """The run, of the device that was typed or that `device` makes, added to `devices` as soon as it is open."""
    by_name = find_device(e, args.named) if args.named else None
    knobs = knobs_from(args) if args.lockstep else live_knobs(args.scene, knobs_from(args))
    endpoint = _endpoint(scene := both_ends(load_scene(args.scene, **knobs)), e, args)
    # Once: of a name that is looked up twice the answers may differ, and only one of them would have been judged.
    at = peer_address(args.peer) if e == "m" else address(args.listen, "--listen")
    sealed, insecure = secure_link(e, args, at)
    with output.live(), Interrupt() as interrupt, LastResort(interrupt) as last, _wire(e, at, sealed) as wire:
        devices.append(made := open_device(device, scene) if by_name is None else by_name.open(scene))
        interrupt.retake()
        _check_stepped(args, made)
        stem = f"{scene.name}-{NAMES[e]}"
        with (realtime.scheduling_of(args, interrupt) as scheduling, fresh_folder(args.out, stem) as folder,
              _with_watchdog(e, args, knobs, made, folder.path, scheduling.above) as watched_device,
              _policy_page(endpoint, folder.path)):
            progress = Progress(sys.stderr, scene.ticks)
            command = ["python", "-m", NAMES[e], *argv]
            about = {"scene": args.scene, "seed": args.seed, "command": command,
                     "mode": "lockstep" if args.lockstep else "live", "every": endpoint.every}

            def recorder_of(scene: Scene, knobs: dict[str, str]) -> RecordWriter:
                return RecordWriter(scene, e, folder.path, {**about, "knobs": knobs}, args.flush or EVERY)

            shell = Shell(endpoint, watched_device, wire, recorder_of(scene, knobs), partial(_say, args, progress),
                          peer_timeout=args.wait, interrupt=interrupt)
            shell.realtime = scheduling
            last.stand_by(shell)
            shell.insecure = insecure
            turning = None
            if args.orders:
                from teleop.live.turning import Turning  # for an end that takes no orders it need not be there

                shell.report = partial(_report_event, e)
                turning = Turning(shell, made, folder, knobs, partial(_turned, args), recorder_of)
                shell.obey = turning.obey
            _warn(shell, NAMES[e], quiet=args.json or args.quiet)
            _greet(e, args, wire, scheduling.report)
            try:
                run(shell, spin_ns=realtime.SPIN_NS if args.spin else 0)
            finally:
                scheduling.give_back()  # what is left to do has time
                if turning is not None:
                    turning.close()
                progress.end()
            if shell.counts.ticks or _leaves_a_traceback(shell):
                folder.keep()
            code = _report_fault(shell, folder.path)
            if shell.counts.ticks:
                result = write_end(shell, folder.path, args.seed, command)
            elif code != DONE:
                return code
            elif interrupt.name is not None:
                raise KeyboardInterrupt
            else:
                raise Refused(shell.outcome.sentence)
    _tell_result(args, result, folder.path, command)
    return code


def _say(args: Namespace, progress: Progress, numbers: dict[str, Any]) -> None:
    """Say the newest numbers of a tick: to a machine, or on the one line of a terminal."""
    if args.json:
        tell("live", **numbers)
    elif not args.quiet and sys.stderr.isatty():
        progress.show(numbers["k"] + 1, time.monotonic(), *live_text(numbers))


def _arguments(e: str, argv: list[str]) -> Namespace:
    """Parse the command line. Raises `Refused` for options that do not go together."""
    if e not in NAMES:
        raise Refused("end_main begins with the end, \"m\" for the master's or \"s\" for the slave's, not "
                      f"{e!r}; write for example end_main(\"s\", MyRobot)")
    args = _parser(e).parse_args(argv)
    if args.orders and args.lockstep:
        raise Refused("--orders are for ends that go by the clock; leave --lockstep out")
    if args.watchdog and args.lockstep:
        raise Refused("--watchdog is for ends that go by the clock; leave --lockstep out")
    if args.watchdog and not args.named:
        raise Refused(f"--watchdog opens the {DEVICE_KINDS[e].word} a second time by its name; give it one by "
                      f"{DEVICE_KINDS[e].option} NAME, or see teleop/live/devices/README.md")
    if args.wait is not None:
        number("--wait", args.wait, above=0.0)
    return args


def _check_stepped(args: Namespace, device: LiveDevice) -> None:
    """Refuse a machine where a tick takes as long as its packets do."""
    if args.lockstep and args.named and not is_simulated(device):
        raise Refused("--lockstep holds a force for as long as packets are waited for, so it is for what is "
                      f"simulated, and {args.named} does not say that it is; leave --lockstep out")


def _with_watchdog(e: str, args: Namespace, knobs: dict[str, str], device: LiveDevice, folder: Path,
                   priority: int | None) -> AbstractContextManager[LiveDevice]:
    """The device with its watchdog process, if it names one, or --watchdog asks for one."""
    default = watchdog_of(e, args.named, args.scene, knobs) if args.watchdog else None
    if args.lockstep or (default is None and getattr(device, "watchdog", None) is None):
        return nullcontext(device)
    from teleop.live.devices.device_watchdog import with_watchdog

    return with_watchdog(device, folder, priority, default)


def _policy_page(endpoint: Endpoint, folder: Path) -> AbstractContextManager[object]:
    """The page by which a policy of another process sends its actions, at an end whose scene has one."""
    if endpoint.policy is None:
        return nullcontext()
    from teleop.live.policy_page import PolicyPage

    page = PolicyPage(folder, endpoint.scene.axes)
    endpoint.policy.page = page.read
    return page


def _tell_result(args: Namespace, result: Result, folder: Path, command: list[str]) -> None:
    if args.json:
        tell("done", path=str(folder), summary=result.summary(command))
    else:
        from teleop.terminal.run_table import table

        trust = " --trust" if asks_for_trust(args.scene, knobs_from(args)) else ""
        print(screen.render(f"{table(result)}\nwritten to {folder}; `teleop report{trust} MASTER SLAVE` puts the two "
                           "ends together", sys.stdout))


def _leaves_a_traceback(shell: Shell) -> bool:
    return shell.outcome.fault is not None and not isinstance(shell.outcome.fault, Refused)


def _report_fault(shell: Shell, folder: Path) -> int:
    """The exit code; what is not DONE is said on stderr, before anything else may fail."""
    if shell.outcome.fault is None and shell.outcome.status != UNRELEASED:
        return DONE
    where = ""
    if shell.outcome.fault is not None and _leaves_a_traceback(shell):
        with suppress(OSError):
            write_traceback(shell.outcome.fault, folder)
            where = f"; its traceback is in {folder / TRACEBACK}"
    code = WRONG if isinstance(shell.outcome.fault, Refused) else FAULT
    return complain(shell.outcome.sentence + where, FORCED if shell.outcome.status == UNRELEASED else code)


def _report_event(e: str, event: Event) -> None:
    tell("event", end=e, **event.document(), cause=event.cause and event.cause.name)


def _turned(args: Namespace, knobs: dict[str, str]) -> tuple[Scene, dict[str, str], dict[str, str]]:
    """The scene of a turn, its knobs as its record has them, and its manifest. Raises `Refused`."""
    knobs = live_knobs(args.scene, knobs)
    scene = both_ends(load_scene(args.scene, **knobs))
    ticks_of(scene, args.rate, lockstep=False, spin=args.spin)
    return scene, knobs, _manifest(scene, args)


def _manifest(scene: Scene, args: Namespace) -> dict[str, str]:
    """Manifest of the entries on which the two ends have to agree."""
    return {**manifest_of(scene), "mode": "lockstep"} if args.lockstep else live_manifest(scene)


def _endpoint(scene: Scene, e: str, args: Namespace) -> Endpoint:
    """The end without its sockets. What the two ends have to agree on goes into the session's manifest."""
    manifest = _manifest(scene, args)
    inbox = None
    if args.lockstep:
        from teleop.simulation.plan import link_plans

        manifest["seed"] = str(args.seed)  # by the clock, the channel alone draws
        inbox = Stepped(link_plans(scene, args.seed)[0 if e == "s" else 1])
    session = Session(master=e == "m", manifest=manifest, number=randbits(64) if e == "m" else None,
                      every=ticks_of(scene, args.rate, lockstep=args.lockstep, spin=args.spin),
                      heals=not args.lockstep)
    return Endpoint(scene, e, session, inbox)


def _parser(e: str) -> ArgumentParser:
    from teleop.terminal.options import Parser

    name = NAMES[e]
    parser = Parser(prog=f"python -m {name}", description=f"The {name}'s end of a scene, live over UDP.")
    scene_options(parser)
    if e == "m":
        parser.add_argument("--peer", metavar="HOST:PORT", required=True,
                            help="where the slave, or the channel, listens")
    else:
        parser.add_argument("--listen", metavar="HOST:PORT", required=True, help="where to wait for the master")
    word = DEVICE_KINDS[e].word
    parser.add_argument(DEVICE_KINDS[e].option, dest="named", metavar="NAME", help=f"the {word} at this end: a name "
                        f"(see `teleop list {word}s`), NAME:ARGUMENT, or FILE.py:CLASS of your own; left out: this "
                        "program's own")
    parser.add_argument("--watchdog", action="store_true", help=f"have a process beside this one open the {word} "
                        "by the same name, and set its force to zero where this one dies or hangs: for hardware that "
                        "holds its last force and that two may open")
    parser.add_argument("--out", metavar="DIR", help=f"folder for the record; default runs/SCENE-{name}-N")
    parser.add_argument("--wait", metavar="SECONDS", type=float, default=10.0 if e == "m" else None,
                        help="give up if the other end does not answer in this time"
                        + ("; default 10" if e == "m" else "; default: wait on"))
    parser.add_argument("--lockstep", action="store_true",
                        help="tick by packets instead of by the clock: both ends step together, and the run equals the "
                        "one in virtual time bit for bit (both ends need it, and the same --seed); for simulated "
                        "devices, since a force is held while packets are waited for")
    key_options(parser)
    tick_options(parser)
    realtime_option(parser)
    orders_option(parser)
    parser.add_argument("--flush", metavar="ROWS", type=whole, help="hand every so many rows of the record to the "
                        f"system, for whoever follows it as it grows; left out: {EVERY}")
    parser.add_argument("--json", action="store_true", help="write events as lines of JSON for a machine")
    parser.add_argument("--quiet", action="store_true", help="no live line")
    return parser


@contextmanager
def _wire(e: str, at: Address, secure_link: SecureLink | None) -> Iterator[Wire]:
    wire = Wire(bind_towards(at), at, secure_link) if e == "m" else Wire(bind_udp(at, "--listen"), None, secure_link)
    try:
        yield wire
    finally:
        with suppress(OSError):  # a driver has closed it
            wire.sock.close()


def _greet(e: str, args: Any, wire: Wire, scheduling: dict[str, str] | None) -> None:
    at = wire.sock.getsockname()[:2]
    if args.json:
        tell("listening", address=host_port(at), port=at[1], realtime=scheduling)
    elif e == "m":
        assert wire.peer is not None
        print(f"master: asking {host_port(wire.peer)} for a session", flush=True)
    else:
        host = "THIS-HOST" if at[0] == "0.0.0.0" else at[0]
        knobs = "".join(f" --set {quote(each)}" for each in args.set or ())
        link = f" --link {quote(args.link)}" if args.link else ""
        keys = " --insecure" if args.insecure else ""
        if wire.secure_link is not None:
            keys = f" --key master.key --peer-fingerprint {wire.secure_link.fingerprint}"
        print(f"slave: listening on {host_port(at)}; start the master with: "
              f"python -m master {args.scene}{knobs}{link} --peer {host}:{at[1]}{keys}", flush=True)
    if scheduling is not None and not args.json:
        print(f"{NAMES[e]}: {realtime.sentence(scheduling)}", flush=True)


def _warn(shell: Shell, name: str, *, quiet: bool) -> None:
    """Say on standard error what is wrong, and let it be said later."""
    if not quiet:
        shell.hint = lambda sentence: print(f"{name}: {sentence}", file=sys.stderr, flush=True)
    if holds_on(shell):
        complain(UNWATCHED, DONE)
