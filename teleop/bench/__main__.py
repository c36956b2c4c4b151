"""`python -m teleop.bench [NAME ...]`: measures what this folder's README claims, side by side."""

from __future__ import annotations

import sys
from argparse import ArgumentParser
from collections.abc import Sequence
from importlib import import_module
from typing import TextIO

from teleop.bench.table import Row, table

BENCHES = ("virtual", "playout", "laws", "sweep", "scale", "own_laws", "rivals", "live", "page", "cost", "secure",
           "flood", "export", "timing", "watchdog", "mujoco")
"""Functions in modules of their names, loaded when they run."""


def main() -> int:
    """Run the named benches, or all of them."""
    parser = ArgumentParser(prog="python -m teleop.bench", description=__doc__)
    parser.add_argument("bench", nargs="*", help=f"{', '.join(BENCHES)}; default: all")
    parser.add_argument("--rounds", type=int, default=5, help="interleaved rounds of each measurement; default 5")
    parser.add_argument("--against", metavar="TREE", help="of cost alone: another worktree to measure beside this one")
    parser.add_argument("--busy", action="store_true",
                        help="`live` beside a busy loop on each core, with real-time scheduling and without")
    parser.add_argument("--table", action="store_true",
                        help="run all that the table of this folder's README is of, and print it as Markdown")
    args = parser.parse_args()
    unknown = set(args.bench) - set(BENCHES)
    if unknown:
        print(f"bench: there is no bench {unknown.pop()!r}; there are {', '.join(BENCHES)}", file=sys.stderr)
        return 2
    if args.busy and args.bench != ["live"]:
        print("bench: --busy is an option of the bench live; type python -m teleop.bench live --busy", file=sys.stderr)
        return 2
    if args.table and args.bench:
        print("bench: --table runs what the table needs; type python -m teleop.bench --table", file=sys.stderr)
        return 2
    if args.table:
        print(table(lambda name: _rows(name, sys.stderr, args.rounds)))
        return 0
    for name in args.bench or BENCHES:
        more = {"against": args.against} if name == "cost" and args.against else {"busy": True} if args.busy else {}
        for what, value, asked in _rows(name, sys.stdout, args.rounds, **more):
            print(f"{what:<58} {value:<22} {asked}")
    return 0


def _rows(name: str, stream: TextIO, rounds: int, **more: object) -> Sequence[Row]:
    """The rows of a bench, whose name goes to `stream`; none of one that an installed package is without."""
    print(f"-- {name}", flush=True, file=stream)
    try:
        bench = getattr(import_module(f"teleop.bench.{name}"), name)
    except ModuleNotFoundError as missing:
        if missing.name != f"teleop.bench.{name}":
            raise
        print("not in an installed package: run it in a clone of the repository", file=stream)
        return ()
    rows: Sequence[Row] = bench(rounds, **more)
    return rows


if __name__ == "__main__":
    raise SystemExit(main())
