"""`python -m teleop.bench [NAME ...]`: measures what this folder's README claims, side by side.

`--table` runs every bench that the README's table is of and prints it anew: which rows of which benches stand in each
line, and the aim. A line that no bench measures names its command, with the figure of the last run.
"""

from __future__ import annotations

import re
import sys
from argparse import ArgumentParser
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import NamedTuple, TextIO

SUMMARY = "Measure the claims of the folder's README, side by side."
Row = tuple[str, str, str]  # of a bench: what, measured, asked
MISSED = "(missed)"
_NUMBER = re.compile(r"\d[\d,]*(?:\.\d+)?")
_BOUND = re.compile(r"asked: at (most|least) (\d[\d./ ]*)")


class Item(NamedTuple):
    """A line of the table. `rows`: patterns of labels, each with that of its heading before it (`labelled`)."""

    what: str
    aimed: str
    bench: str
    rows: tuple[str, ...]


class Elsewhere(NamedTuple):
    """A line that no bench measures: the figure of the last run of a command."""

    what: str
    aimed: str
    command: str
    measured: str


JOINTS = r"{law}: live tick of six joints{more}, master / slave"
LINES: tuple[Item | Elsewhere, ...] = (
    Item("canonical scene in plain Python, a tick, where a loop of 1000 `x=x*1.0001+0.5` takes 30 us", "4 us",
         "virtual", (r".*: the same where the yardstick takes 30 us",)),
    Item("`teleop run hard_wall`, ten seconds at 1 kHz, whole process, over `python -c 'import numpy'`", "3.5",
         "virtual", (r".*: over `python -c 'import numpy'`",)),
    Item("its peak memory", "80 MB", "virtual", (r".*: peak memory of the largest process",)),
    Item("sweep kernels, canonical scene over a C program that steps it by semi-implicit Euler: `c`, `vector`",
         "1.8, 1.0", "sweep", (r"constant delay: c: over C", r"constant delay: vector: over C")),
    Item("the same with ledgers, which the C program has not", "1.8, 1.0", "sweep",
         (r"constant delay: c with ledgers: over C", r"constant delay: vector with ledgers: over C")),
    Item("the same with jitter and loss, a schedule for each row, both playing zero in gaps: `c`, `vector`", "1.8",
         "sweep", (r".*loss: c, playout zero: over C", r".*loss: vector, a sch.*, playout zero: over C")),
    Item("the same by the scene's own playout `integral`, the C program playing zero: `c`, `vector`", "", "sweep",
         (r".*loss: c, playout integral: over C", r".*loss: vector, a sch.*, playout integral: over C")),
    Item("a tick of playout `integral` over one of `zero`, plain, `c`, `vector`; over jitter and loss", "1.5",
         "playout", tuple(rf"{engine}, {link}: zero: integral" for link in ("50 ms", "jitter and loss")
                          for engine in ("plain", "c", "vector"))),
    Item("a live tick of a law's end, the least and the most of all laws, in one axis; in three", "10; 25 us", "laws",
         (r".*: live tick in 1 axis, .*", r".*: live tick in 3 axes, .*")),
    Item("the same of six joints with parts of their own (`leader_follower`), master / slave: `pp`; `four_channel`; "
         "`wave`; `tdpa`", "40 us", "laws",
         tuple(JOINTS.format(law=law, more="") for law in ("pp", "four_channel", "wave", "tdpa"))),
    Item("of it the law alone, without caps, watchdog and ledgers", "", "laws",
         tuple(JOINTS.format(law=law, more=", the law alone") for law in ("pp", "four_channel", "wave", "tdpa"))),
    Item("a law's kernel over that of `wave`, `c`, `tdpa` of it; `vector`", "2, 2.2; 2", "laws",
         (r".*: c, over wave", r"tdpa: c, over wave", r".*: vector, over wave")),
    Item("a new structure of scene, compiled, or from the cache: `c`, `vector`", "8 s, or 1 s", "sweep",
         (r"c, first call.*", r"vector, first call.*")),
    Item("a whole row of ten seconds in a sweep, `c`, `vector`; of 100,000 rows over 1,000", "; 1.15", "scale",
         (r"c, canonical, a row of 100,000", r"vector, canonical, a row of 100,000", r"c, .*: over that of few",
          r"vector.*: over that of few")),
    Item("of it beside the kernel, `c`, `vector`", "60 us", "scale",
         (r"c, .*: beside its kernel", r"vector.*: beside its kernel")),
    Item("a row of 50 ticks with a law of a plug-in, of a file of one's own, over one with a built-in law: plain, "
         "`vector`", "1.1", "own_laws", (r"plain.*: law of a plug-in.*", r"plain.*: law of a file.*",
                                         r"vector.*: law of a plug-in.*", r"vector.*: law of a file.*")),
    Item("two threads over one, `c`, `vector`", "1.8", "scale",
         (r"c, two threads over one", r"vector, two threads over one")),
    Item("a million rows in memory", "1 GB", "scale", (r"1,000,000 rows of 20 ticks",)),
    Item("over `vector` at 1e-6 m: numpy over 2,000 rows, 256 sub-steps a tick; jitcdde; python-control",
         "20, 100, 500", "rivals",
         (r"numpy, 256.*: over ours", r"jitcdde.*(: over ours|: pip.*)", r"python-control.*(: over ours|: pip.*)")),
    Item("numpy over 16,000 rows, contact located and every step exact", "20", "rivals",
         (r"numpy, contact located.*: over ours",)),
    Item("a packet of 100 bytes, sealed and opened", "15 us", "secure", (r".*: sent and received together",)),
    Item("live at 1 kHz, a tick is late by, median: master, slave", "100 us", "live",
         (r"master: tick late by, median", r"slave: tick late by, median")),
    Item("the ticker by itself: median; 99 %", "1.5 times a C loop on a timerfd", "timing",
         (r"Alarm: .*, median", r"Alarm: .*: 99 %")),
    Item("the ends of a live run: 99 % of their ticks, missed ones counted: master, slave",
         "1.5 times a C loop that runs too", "live", (r"master: tick late by, 99 %", r"slave: tick late by, 99 %")),
    Elsewhere("the same beside a busy loop on each core: median; 99 %, over C", "1.5 times",
              "python -m teleop.bench live --busy", "0.8 to 1.2; 0.9 to 1.5 times"),
    Elsewhere("ticks left out there, of 10,000: without real-time scheduling; with", "",
              "python -m teleop.bench live --busy", "3,400 to 5,400; 0 to 8"),
    Item("with `--spin`, median", "5 us", "timing", (r".*\(--spin\).*median",)),
    Item("round trip over loopback, a core for each end; both on one", "2.2 times a C echo", "timing",
         (r"round trip, a Wire at both ends, median", r"round trip, Wires, both ends on one core, median")),
    Item("the relay's error of the delay: median; 99 %", "1.5 times a C relay's", "timing",
         (r"python -m channel: .*, median", r"python -m channel: .*: 99 %")),
    Item("lost by the relay at 20,000 packets a second each way, of 80,000", "0", "timing", (r".*: lost at .*",)),
    Item("a tick of the ends with a page that is looked at and dragged; without, 99 %: master, slave", "1.2 times",
         "page", (r"master: tick late by, 99 %.*", r"slave: tick late by, 99 %.*")),
    Item("the page's process, share of a core; its first rows; the page itself", "5 %; 300 ms; 40 kB", "page",
         (r"the page's process.*", r"from the open socket.*", r"the page, one file")),
    Elsewhere("in a browser: frames a second; share of the main thread", "55", ".figures/page.py --fps", "60; 14 %"),
    Item("live, share of a core: master, slave; of the C loop that wakes up and does nothing", "10 %", "live",
         (r"master: share of a core", r"slave: share of a core", r"C loop.*: its share.*")),
    Item("processor time of a live tick; the same back to back, without waking up, caches warm", "", "cost",
         (r"live, processor time.*", r"back to back")),
    Item("20,000 bad datagrams a second, from another host; with the peer's own address: 99 % of the ticks are late "
         "by less than, master / slave; none at all", "twice that of none, or 200 us more", "flood",
         (r"in the open, 20,000 a second from another.* late", r"in the open, 20,000 a second from the peer.* late",
          r"in the open, no flood.* late")),
    Item("the same sealed", "", "flood",
         (r"sealed, 20,000 a second from another.* late", r"sealed, 20,000 a second from the peer.* late",
          r"sealed, no flood.* late")),
    Item("as many a second from another host at the slave as two cores throw: good packets used by master / slave; the "
         "least gain; in the open; sealed", "99 %; 1", "flood",
         (r"in the open, 200,000 a second from another.*: good packets.*",
          r"sealed, 200,000 a second from another.*: good packets.*")),
    Item("force at a motor without a deadline is zero after SIGKILL, a crash of its end; SIGSTOP, a hang in C: median, "
         "most", "100, 100; 300, 300 ms", "watchdog",
         tuple(rf"force is zero after {blow}.*" for blow in ("SIGKILL", "SIGSEGV", "SIGSTOP", "a hang"))),
    Item("a row of a demo read, encoded and sent to PlotJuggler, in one axis; in three", "2 us", "export",
         (r"one axis, a row read.*", r"three axes, a row read.*")),
    Item("two endpoints stepped in one process, simulated; with the arm in MuJoCo, over a tick of `teleop run`", "",
         "mujoco", (r"two endpoints.*, simulated slave, one axis", r"two endpoints.*, MuJoCo's arm, one axis")),
    Elsewhere("half an hour live, 100 ms, 20 ms of jitter, 2 % loss: memory grown after the first minute, master, "
              "slave, channel", "1 MB", "pytest -m soak tests/live/test_soak.py", "0.00, 0.00, 0.02 MB"),
    Elsewhere("a million hostile datagrams at each of ten targets: memory grown by at most", "flat",
              "pytest -m fuzz tests/fuzz", "16 kB"),
    Elsewhere("10,000 random links: least `E_link` of the wave law", "-1e-9 J",
              "pytest -m soak tests/scenarios/test_random_links.py", "0 J"),
)


def table(run: Callable[[str], Sequence[Row]], lines: Sequence[Item | Elsewhere] = LINES) -> str:
    """The table in Markdown. `run` gives the rows of a bench by its name; each is asked for once."""
    benches = {name: labelled(run(name)) for name in dict.fromkeys(
        line.bench for line in lines if isinstance(line, Item))}
    text = ["| | measured | aimed at | by |", "|---|---|---|---|"]
    for line in lines:
        if isinstance(line, Item):
            text.append(f"| {line.what} | {measured(line, benches[line.bench])} | {line.aimed} | `{line.bench}` |")
        else:
            text.append(f"| {line.what} | {line.measured} | {line.aimed} | `{line.command}` |")
    return "\n".join(text)


def labelled(rows: Sequence[Row]) -> dict[str, tuple[str, str]]:
    """Measured and asked of each row, by its label; of one that is indented with its heading before it.

    >>> labelled([("c", "20 ns", ""), ("  over C", "1.2 times", "asked: at most 1.8")])["c: over C"]
    ('1.2 times', 'asked: at most 1.8')
    """
    labels, heading = {}, ""
    for what, value, bound in rows:
        heading = heading if what.startswith(" ") else what
        label = f"{heading}: {what.strip()}" if what.startswith(" ") else what
        labels[label] = value, bound
    return labels


def measured(line: Item, rows: Mapping[str, tuple[str, str]]) -> str:
    """The cell of a line: for each of its patterns the value, or from the least to the most of several.

    One that misses what its bench asks for is marked so; a pattern without a row says that there is none.
    """
    cells = []
    for pattern in line.rows:
        fitting = [row for label, row in rows.items() if re.fullmatch(pattern, label)]
        cell = _spread([_with_ratio(*row) for row in fitting]) if fitting else "no row"
        cells.append(f"{cell} {MISSED}" if any(_misses(*row) for row in fitting) else cell)
    return "; ".join(cells)


def _with_ratio(value: str, aim: str) -> str:
    """A value, with the ratio that stands in what is asked: "30 us, 0.93 times C"."""
    ratio = aim.partition("; ")[0]
    return f"{value}, {ratio}" if re.match(r"[\d.]+ times", ratio) else value


def _spread(values: Sequence[str]) -> str:
    """Several values as from the least to the most, with the unit of the first."""
    if len(values) == 1:
        return values[0].strip()
    every = [number for value in values for number in _numbers(value)]
    if not every:
        return "; ".join(values)
    unit = values[0][[*_NUMBER.finditer(values[0])][-1].end():]
    return f"{min(every):g} to {max(every):g}{unit}"


def _misses(value: str, aim: str) -> bool:
    """True if a value, or a ratio that stands in what is asked, is beyond the bound that is asked for."""
    bound = _BOUND.search(aim)
    if bound is None:
        return False
    ratio = re.match(r"[\d.]+(?= times)", aim)
    numbers, limits = [float(ratio[0])] if ratio else _numbers(value), _numbers(bound[2])
    limits = limits if len(limits) == len(numbers) else limits[:1] * len(numbers)
    return any(number > limit if bound[1] == "most" else number < limit
               for number, limit in zip(numbers, limits, strict=True))


def _numbers(text: str) -> list[float]:
    return [float(number.replace(",", "")) for number in _NUMBER.findall(text)]


BENCHES = {
    "virtual": "virtual", "playout": "laws", "laws": "laws", "sweep": "sweep", "scale": "sweep", "own_laws": "sweep",
    "rivals": "rivals", "live": "live", "page": "page", "cost": "cost", "secure": "secure", "flood": "flood",
    "export": "export", "timing": "timing", "watchdog": "watchdog", "mujoco": "virtual", "emit": "emit",
    "dynamics": "dynamics",
}
"""The module of each bench, a function of its name there; it is loaded when the bench runs."""


def main() -> int:
    """Run the named benches, or all of them."""
    parser = ArgumentParser(prog="python -m teleop.bench", description=SUMMARY)
    parser.add_argument("bench", nargs="*", help=f"{', '.join(BENCHES)}; default: all")
    parser.add_argument("--rounds", type=int, default=5, help="interleaved rounds of each measurement; default 5")
    parser.add_argument("--against", metavar="TREE", help="of cost alone: another worktree to measure beside this one")
    parser.add_argument("--model", metavar="FILE.xml", action="append",
                        help="of dynamics alone: an arm to measure in place of this project's; once for each")
    parser.add_argument("--busy", action="store_true",
                        help="`live` beside a busy loop on each core, with real-time scheduling and without")
    parser.add_argument("--table", action="store_true",
                        help="run all that the table of this folder's README is of, and print it as Markdown")
    args = parser.parse_args()
    unknown = set(args.bench) - set(BENCHES)
    if unknown:
        print(f"bench: there is no bench {unknown.pop()!r}; there are {', '.join(BENCHES)}", file=sys.stderr)
        return 2
    for option, bench, typed in ((args.busy, "live", "--busy"), (args.against, "cost", "--against TREE"),
                                 (args.model, "dynamics", "--model FILE.xml")):
        if option and args.bench != [bench]:
            print(f"bench: {typed.split()[0]} is an option of the bench {bench}; type python -m teleop.bench {bench} "
                  f"{typed}", file=sys.stderr)
            return 2
    if args.table and args.bench:
        print("bench: --table runs what the table needs; type python -m teleop.bench --table", file=sys.stderr)
        return 2
    if args.table:
        print(table(lambda name: _rows(name, sys.stderr, args.rounds)))
        return 0
    options = {"busy": args.busy, "against": args.against, "models": args.model}
    options = {name: value for name, value in options.items() if value}  # of the one bench that is named then
    for name in args.bench or BENCHES:
        for what, value, bound in _rows(name, sys.stdout, args.rounds, **options):
            print(f"{what:<58} {value:<22} {bound}")
    return 0


def _rows(name: str, stream: TextIO, rounds: int, **options: object) -> Sequence[Row]:
    """The rows of a bench, whose name goes to `stream`; none of one that an installed package is without."""
    print(f"-- {name}", flush=True, file=stream)
    try:
        bench = getattr(import_module(f"teleop.bench.{BENCHES[name]}"), name)
    except ModuleNotFoundError as missing:
        if missing.name != f"teleop.bench.{BENCHES[name]}":
            raise
        print("not in an installed package: run it in a clone of the repository", file=stream)
        return ()
    rows: Sequence[Row] = bench(rounds, **options)
    return rows


if __name__ == "__main__":
    raise SystemExit(main())
