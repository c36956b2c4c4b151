"""Options of a live end that are checked before it starts: its keys beyond this machine, and the rate of its ticks."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING

from teleop.errors import Refused, number
from teleop.live.net.wire import Address, host_port
from teleop.protocol.guard import UNNAMED
from teleop.protocol.manifest import MOST_EVERY
from teleop.scene.playout import Fixed, Integral, Playout, as_typed, integrates
from teleop.scene.scene import Scene

if TYPE_CHECKING:
    from teleop.protocol.secure.secure_link import SecureLink
    from teleop.terminal.answer import Answer


def keygen(args: Namespace) -> Answer:
    """Make a key with its certificate, and say what each end is started with. Raises `Refused`."""
    from teleop.protocol.secure.keys import keygen as make
    from teleop.terminal.answer import Answer

    path, fingerprint = make(args.name)
    text = (f"{path} written: it stays at this end, started with\n  --key {path}\n"
            f"and the other end is told whom to expect with\n  --peer-fingerprint {fingerprint}")
    return Answer(text, {"path": str(path), "fingerprint": fingerprint})


def key_options(parser: ArgumentParser) -> None:
    """Let a live end take its keys."""
    insecure_option(parser)
    parser.add_argument("--key", metavar="FILE", help="this end's key, as `teleop keygen` made it; what is sent is "
                        "then encrypted, and needs --peer-fingerprint too")
    parser.add_argument("--peer-fingerprint", metavar="TEXT", help="the fingerprint of the other end's key: no other "
                        "end is let in")


def insecure_option(parser: ArgumentParser) -> None:
    """Let a live process be asked to go beyond this machine without keys."""
    parser.add_argument("--insecure", action="store_true",
                        help="go beyond this machine without keys: any host on the path can read and change all of it")


def is_local(at: Address) -> bool:
    """True if this is an address of this machine's loopback, which no other host reaches."""
    return at[0].startswith("127.")


def tell_insecure(link: str) -> None:
    """Say on the terminal that `link` is in the open."""
    print(f"teleop: INSECURE: {link} neither authenticated nor encrypted", file=sys.stderr, flush=True)


def secure_link(e: str, args: Namespace, at: Address) -> tuple[SecureLink | None, bool]:
    """The secure link of an end, None without keys; and True if the link is in the open beyond this machine.

    Raises `Refused`. `at`: the address of --peer or --listen, as it was resolved.
    """
    if args.key is None and args.peer_fingerprint is None:
        return None, _open(at, args)
    if args.insecure:
        raise Refused("--insecure and --key do not go together; leave one of them out")
    if args.key is None or args.peer_fingerprint is None:
        raise Refused("--key and --peer-fingerprint go together: this end's key, and the fingerprint that `teleop "
                      "keygen` printed where the other end's was made")
    if args.lockstep:
        raise Refused("--lockstep runs the same to the bit every time, and encryption has dice of its own; leave out "
                      "--lockstep, or the keys")
    from secrets import token_bytes

    from teleop.protocol.secure.keys import load_key, need_secure, parse_fingerprint

    need_secure()
    from teleop.protocol.secure.secure_link import SecureLink  # not before: it cannot be imported without the extra

    key, peer = load_key(args.key), parse_fingerprint(args.peer_fingerprint)
    if key.fingerprint == peer:
        raise Refused(f"--peer-fingerprint is the fingerprint of this end's own key {args.key}, and each end has a "
                      "key of its own; give the one that `teleop keygen` printed at the other end")
    return (SecureLink.calling(key, peer, at) if e == "m" else SecureLink.listening(key, peer, token_bytes(32))), False


def _open(at: Address, args: Namespace) -> bool:
    """True if a link without keys leaves this machine. `Refused` without --insecure; a warning with it."""
    if is_local(at):
        return False
    if not args.insecure:
        raise Refused(f"{host_port(at)} reaches beyond this machine, and a link without keys can be read, changed and "
                      "taken over; make a key at each end with `teleop keygen NAME` and give --key and "
                      "--peer-fingerprint, or write --insecure in a network you trust")
    tell_insecure(f"the link to {host_port(at)} is")
    return True


def ticks_of(scene: Scene, rate: float | None, *, lockstep: bool, spin: bool) -> int:
    """The ticks of the scene to one of an end that ticks at `rate` (Hz); None: the scene's own.

    Raises `Refused`, also where what is asked of the clock is asked of an end that goes by packets.
    """
    if lockstep and spin:
        raise Refused("--spin is for ends that tick by the clock, and with --lockstep they tick by packets; leave one "
                      "of them out")
    if lockstep and scene.deadband is not None:
        raise Refused("with --lockstep each end waits for the other's packet of every tick, and a deadband leaves "
                      "packets out; leave one of them out")
    if rate is None:
        return 1
    number("--rate", rate, above=0.0)
    every: int = round(1.0 / (rate * scene.dt))
    if every > MOST_EVERY:
        raise Refused(f"--rate {rate:g} is less than a {MOST_EVERY}th of the scene's {1.0 / scene.dt:g} Hz; "
                      "set the scene's dt instead")
    if every < 1 or abs(every * rate * scene.dt - 1.0) > 1e-6:
        scene_rate = 1.0 / scene.dt
        raise Refused(f"--rate {rate:g} is no whole part of the scene's {scene_rate:g} Hz; write for example --rate "
                      f"{scene_rate / 2:g}, or set the scene's dt")
    if every != 1 and scene.has_waves and not integrates(scene.played_as):
        raise Refused(f"--rate {rate:g} is not the scene's, and ends at different rates exchange waves by their "
                      f"integral; write --set playout={as_typed(_integrated(scene.played_as))} at both ends")
    if lockstep and every != 1:
        raise Refused("--lockstep runs both ends at the scene's own rate; leave out --rate")
    dog = scene.watchdog or UNNAMED
    if every * scene.dt > dog.timeout:
        raise Refused(f"--rate {rate:g} sends a message every {every * scene.dt:g} s, which the other end takes "
                      f"for silence: its watchdog's timeout is {dog.timeout:g} s; write a higher --rate, or a longer "
                      "timeout in the scene")
    return every


def _integrated(playout: Playout) -> Playout:
    return Fixed(playout.delay, Integral()) if isinstance(playout, Fixed) else Integral()
