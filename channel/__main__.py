"""`python -m channel SCENE --listen HOST:PORT --peer HOST:PORT`: the link between the two ends, as a process."""

from __future__ import annotations

import json
import sys
from argparse import Namespace
from collections.abc import Sequence
from functools import partial
from shlex import quote
from typing import Any

from channel.link import describe
from channel.shell import RelayShell
from teleop.errors import Refused
from teleop.live.net.wire import Address, Wire, address, bound, peer_address, shown, towards
from teleop.live.options import insecure_option, is_local, tell_insecure
from teleop.live.orders import OF_THE_RELAY, Orders, orders_option, refuse, tell
from teleop.live.process import output, realtime
from teleop.live.process.interrupt import Interrupt
from teleop.scene.loading import live_knobs, load_scene
from teleop.scene.scene import both_ends
from teleop.terminal.options import Parser, guarded, knobs_from, realtime_option, scene_options


def main(argv: Sequence[str] | None = None) -> int:
    """Relay a scene's session until Ctrl-C or SIGTERM; returns the exit code."""
    return guarded(lambda: _run(sys.argv[1:] if argv is None else list(argv)))


def _run(argv: list[str]) -> int:
    parser = Parser(prog="python -m channel", description="The impaired link of a scene, as a relay over UDP.")
    scene_options(parser)
    parser.add_argument("--listen", metavar="HOST:PORT", required=True, help="where the master sends to")
    parser.add_argument("--peer", metavar="HOST:PORT", required=True, help="where the slave listens")
    insecure_option(parser)
    realtime_option(parser)
    orders_option(parser)
    parser.add_argument("--json", action="store_true", help="write events as lines of JSON for a machine")
    args = parser.parse_args(argv)
    scene = both_ends(load_scene(args.scene, **live_knobs(args.scene, knobs_from(args))))
    peer = _with_host(peer_address(args.peer), "127.0.0.1")  # answers come from there
    listen = address(args.listen, "--listen")
    with (output.live(), bound(listen, "--listen") as near, towards(peer) as far, Interrupt() as interrupt,
          realtime.asked(args, interrupt, realtime.RELAY_PRIORITY) as scheduling):
        beyond = next((at for at in (listen, peer) if not is_local(at)), None)
        shell = RelayShell(scene, args.seed, Wire(near, None), Wire(far, peer), beyond=beyond, insecure=args.insecure)
        if args.orders:
            shell.orders = Orders(OF_THE_RELAY, partial(_turn, shell, args))
        if beyond is not None and args.insecure:
            tell_insecure(beyond)
        at = near.getsockname()[:2]
        if args.json:
            _event("listening", address=shown(at), port=at[1], realtime=scheduling.told)
        else:
            link: Any = scene.link  # a scene asks less of its link than a text does
            named = "no link" if link is None else describe(link)
            print(f"channel: {named}; {shown(at)} <-> {shown(peer)}; start the master with: "
                  f"python -m master {_typed(args)} --peer {shown(_with_host(at, 'THIS-HOST'))}"
                  f"{'' if beyond is None else _open_or_sealed(args)}", flush=True)
            if scheduling.told is not None:
                print(f"channel: {realtime.sentence(scheduling.told)}", flush=True)
        shell.run(interrupt)
    router = shell.router
    counts = {way: router.counts(direction)._asdict() for direction, way in enumerate(("fwd", "bwd"))}
    if args.json:
        _event("done", summary={"counts": counts, "foreign": router.foreign, "unsealed": router.unsealed})
    else:
        for way, count in counts.items():
            print(f"channel: {way}: " + ", ".join(f"{n} {name.replace('_', ' ')}" for name, n in count.items()))
    return 0


def _turn(shell: RelayShell, args: Namespace, order: dict[str, Any]) -> None:
    """Go on with the link of the scene as an order has its knobs."""
    try:
        shell.router.turn(both_ends(load_scene(args.scene, **live_knobs(args.scene, order["knobs"]))))
    except Refused as refused:
        refuse(str(refused))
    else:
        tell("turned")


def _with_host(at: Address, here: str) -> Address:
    """The address, its host named where it is "any of this machine's"."""
    return (here, at[1]) if at[0] == "0.0.0.0" else at


def _typed(args: Namespace) -> str:
    """The scene as the master has to be given it. The link too: the two ends compare theirs, though none draws."""
    words = [quote(args.scene), *(f"--set {quote(each)}" for each in args.set)]
    return " ".join([*words, f"--link {quote(args.link)}"] if args.link else words)


def _open_or_sealed(args: Namespace) -> str:
    """The options of a master on a link beyond this machine, where this channel drops packets without keys."""
    return " --insecure" if args.insecure else " --key master.key --peer-fingerprint THE-SLAVES"


def _event(name: str, **fields: Any) -> None:
    print(json.dumps({"event": name, **fields}), flush=True)


if __name__ == "__main__":
    raise SystemExit(main())
