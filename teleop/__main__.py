"""The command line: `teleop run | demo | precision | stability | passivity | zwidth | list | report`."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from teleop.options import DONE, INTERRUPTED, Parser, guarded, knobs_from, scene_options, whole

if TYPE_CHECKING:
    from teleop.result import Result

EXAMPLES = """\
examples:
  teleop run hard_wall
  teleop run canonical --set law=pfra --set law.alpha=0.2 --set delay=0.1 --plot
  teleop run hard_wall --link 'delay(0.04) | uniform(0.02) | bernoulli(0.02)' --seed 7 --json
  teleop demo jittery_wan
  teleop precision hard_wall --set k_e=1e6
  teleop stability soft_tissue --set law=direct --critical k_e
  teleop passivity virtual_coupling --plot
  teleop zwidth virtual_wall --set step=1e-5 --set friction=0.02
  teleop list hard_wall
  teleop report runs/hard_wall-1
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Do what `argv` (left out: the command line) asks for; returns the exit code, 0 or that of `guarded`."""
    typed = sys.argv[1:] if argv is None else list(argv)
    return guarded(lambda: _obey(typed))


def _obey(typed: Sequence[str]) -> int:
    parser = _parser()
    args = parser.parse_args(typed)
    if args.do is None:
        parser.print_help()
        return DONE
    args.typed = ["teleop", *typed]
    args.do(args)
    return DONE


def _run(args: Namespace) -> None:
    from dataclasses import replace
    from time import perf_counter_ns

    from teleop.folder import new_folder
    from teleop.lockstep import run
    from teleop.scene import load_scene

    scene = load_scene(args.scene, **knobs_from(args))
    _check_plot(args)
    out = _out(args)
    with new_folder(out) as inside:  # before the run: a folder that cannot be written is found at once
        result = run(scene, seed=args.seed, clock=perf_counter_ns)
        result.write(inside, args.typed)
        _plot(args, result, inside)
    _tell(args, replace(result, path=out))


def _precision(args: Namespace) -> None:
    from time import monotonic, perf_counter_ns

    from teleop.console import Progress
    from teleop.figure import drawable
    from teleop.folder import new_folder, numbered
    from teleop.precision.measure import measure
    from teleop.precision.report import summary, table, write
    from teleop.scene import load_scene

    scene = load_scene(args.scene, **knobs_from(args))
    out = Path(args.out) if args.out is not None else numbered(Path("runs"), f"{scene.name}-precision")
    line = Progress(sys.stderr, 1.0)

    def show(part: float, text: str) -> None:
        if not args.json:
            line.show(part, monotonic(), text)

    with new_folder(out) as inside:
        try:
            got = measure(scene, seed=args.seed, clock=perf_counter_ns, rounds=args.rounds, show=show)
        finally:
            line.end()
        write(got, inside, args.typed)
        if drawable():
            from teleop.precision.figure import draw

            draw(got, inside / "precision.png")
    if args.json:
        _say_object({**summary(got, args.typed), "path": str(out)})
    else:
        _say(f"{table(got)}\nwritten to {out}")


def _stability(args: Namespace) -> None:
    from teleop.stability.report import ask, summary, table

    answer = ask(args.scene, knobs_from(args), seed=args.seed, in_time=args.time, continuous=args.continuous,
                 knob=args.critical, span=args.range, tol=args.tol)
    if args.json:
        _say_object({**summary(answer), "command": args.typed})
    else:
        _say(table(answer))


def _passivity(args: Namespace) -> None:
    from teleop.passivity.command import passivity

    _check_plot(args)
    told, text = passivity(args.scene, knobs_from(args), seed=args.seed, span=args.range, out=args.out,
                           plot=args.plot, command=args.typed)
    if args.json:
        _say_object(told)
    else:
        _say(text)


def _zwidth(args: Namespace) -> None:
    from time import monotonic

    from teleop.zwidth.command import carry_out
    from teleop.zwidth.report import summary, table

    got, out = carry_out(args.scene, knobs_from(args), range_k=args.range_k, range_b=args.range_b, seed=args.seed,
                         out=args.out, command=args.typed, clock=monotonic, stream=None if args.json else sys.stderr)
    if args.json:
        _say_object({**summary(got, args.typed), "path": str(out)})
    else:
        _say(f"{table(got)}\nwritten to {out}")
    if got.interrupted:
        raise SystemExit(INTERRUPTED)


def _demo(args: Namespace) -> None:
    from teleop.live.demo import demo

    _check_plot(args)
    result = demo(args.scene, knobs_from(args), seed=args.seed, out=_out(args), json=args.json,
                  lockstep=args.lockstep, command=args.typed)
    _tell(args, result)
    if result.path is not None:  # a live run takes its time anyway
        _draw_if_possible(args, result, result.path)


def _list(args: Namespace) -> None:
    from teleop.catalogue import details, overview

    _say(overview() if args.name is None else details(args.name))


def _report(args: Namespace) -> None:
    from teleop.result import load_result

    if args.slave is not None:
        _put_together(args)
        return
    result = load_result(args.run)
    if args.json:
        from json import loads

        _say_json(loads((Path(args.run) / "summary.json").read_text()), result)
        return
    _tell(args, result)
    _draw_if_possible(args, result, Path(args.run))


def _put_together(args: Namespace) -> None:
    from dataclasses import replace

    from teleop.folder import new_folder
    from teleop.live.merge import merge, scene_of

    result = merge(scene_of(Path(args.run)), Path(args.run), Path(args.slave))
    args.scene = result.scene
    out = _out(args)
    with new_folder(out) as inside:
        result.write(inside, args.typed)
    _tell(args, replace(result, path=out))
    _draw_if_possible(args, result, out)


def _draw_if_possible(args: Namespace, result: Result, folder: Path) -> None:
    """The figure, where the extra is there; that it cannot be written is no error, for what was asked is done."""
    from teleop.errors import Refused
    from teleop.figure import draw, drawable

    if not drawable():
        return
    try:
        draw(result, folder / "figure.png")
    except Refused as refused:
        if not args.json:
            _say(f"no figure: {refused}")


def _tell(args: Namespace, result: Result) -> None:
    if args.json:
        _say_json(result.summary(args.typed), result)
        return
    from teleop.console import table

    _say(f"{table(result)}\nwritten to {result.path}")


def _say_json(summary: dict[str, Any], result: Result) -> None:
    _say_object({**summary, "path": str(result.path)})


def _say_object(value: dict[str, Any]) -> None:
    from json import dumps

    _say(dumps(value, allow_nan=False, default=str))


def _say(text: str) -> None:
    """Print `text`; what the terminal's encoding does not know is escaped, and stops nothing."""
    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    print(text.encode(encoding, "backslashreplace").decode(encoding))


def _out(args: Namespace) -> Path:
    from teleop.folder import numbered

    if args.out is not None:
        return Path(args.out)
    return numbered(Path("runs"), Path(args.scene).name.removesuffix(".py"))


def _check_plot(args: Namespace) -> None:
    if args.plot:
        from teleop.figure import need_plot

        need_plot()


def _plot(args: Namespace, result: Result, folder: Path) -> None:
    if args.plot:
        from teleop.figure import draw

        draw(result, folder / "figure.png")


def _parser() -> ArgumentParser:
    parser = Parser(
        prog="teleop", epilog=EXAMPLES, formatter_class=RawDescriptionHelpFormatter, allow_abbrev=False,
        description="A delayed bilateral teleoperation stack: run a scene in virtual time or live.",
    )
    parser.add_argument("--version", action="version", version=_version())
    parser.set_defaults(do=None)
    commands = parser.add_subparsers(title="commands", metavar="COMMAND")

    def command(name: str, do: object, text: str) -> ArgumentParser:
        added: ArgumentParser = commands.add_parser(name, help=text, description=text, allow_abbrev=False)
        added.set_defaults(do=do)
        return added

    run = command("run", _run, "Run a scene in virtual time: the same seed gives the same bits.")
    demo = command("demo", _demo, "Run a scene live, slave, channel and master as three processes.")
    scene_options(run)
    scene_options(demo, default="hard_wall")
    for sub in (run, demo):
        sub.add_argument("--out", metavar="DIR", help="the new folder to write; default runs/SCENE-NUMBER")
        sub.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
        sub.add_argument("--plot", action="store_true", help="draw figure.png too (needs the extra `plot`)")
    demo.add_argument("--lockstep", action="store_true",
                      help="step both ends together over UDP: bit for bit what `teleop run` gives")
    precision = command("precision", _precision,
                        "Measure error against run time: the exact steps beside every other way to integrate.")
    scene_options(precision)
    precision.add_argument("--out", metavar="DIR", help="the new folder to write; default runs/SCENE-precision-NUMBER")
    precision.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    precision.add_argument("--rounds", metavar="N", type=whole,
                           help="how often each is timed; left out: as often, and as many, as fit into a minute")
    stable = command("stability", _stability,
                     "Count the unstable roots of a linear scene's exact sampled loop, and find its margins.")
    scene_options(stable)
    stable.add_argument("--critical", metavar="KNOB", help="find the value of this knob at which the verdict changes")
    stable.add_argument("--range", metavar="LOW:HIGH", help="where to look for it; left out: a hundredth of the "
                        "knob's own value to a hundred times that")
    stable.add_argument("--tol", metavar="X", help="how closely, in the knob's unit; left out: 1e-6 of the value "
                        "(with --time 1e-3)")
    stable.add_argument("--continuous", action="store_true", help="the delay margin in continuous time too")
    stable.add_argument("--time", action="store_true",
                        help="judge by a run in virtual time: for scenes that are not linear")
    stable.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    passive = command("passivity", _passivity,
                      "Two-port: hybrid matrix, Llewellyn's criterion, transparency; one port: is its sampled "
                      "controller passive.")
    scene_options(passive)
    passive.add_argument("--range", metavar="LOW:HIGH", help="frequencies in Hz; left out: 0.1 to half the rate")
    passive.add_argument("--out", metavar="DIR", help="write summary.json and curves.npz into this new folder")
    passive.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    passive.add_argument("--plot", action="store_true", help="draw passivity.png too (needs the extra `plot`); without "
                         "--out into runs/SCENE-passivity-NUMBER")
    zwidth = command("zwidth", _zwidth,
                     "Z-width of a one-port scene: stable and passive stiffness and damping, impedance over frequency, "
                     "and what widens it. Ctrl-C keeps what is done.")
    scene_options(zwidth)
    zwidth.add_argument("--range-k", metavar="LOW:HIGH", help="stiffness (N/m) in which to look for what is stable and "
                        "what comes to rest; left out: all")
    zwidth.add_argument("--range-b", metavar="LOW:HIGH", help="the same of damping (N s/m)")
    zwidth.add_argument("--out", metavar="DIR", help="the new folder to write; default runs/zwidth-SCENE-NUMBER")
    zwidth.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    listing = command("list", _list, "List scenes, laws, effects and velocity estimators, or the knobs of one of them.")
    listing.add_argument("name", metavar="NAME", nargs="?", help="a scene, a law, an effect or a velocity estimator")
    report = command("report", _report, "Show a stored run again, and draw it if the extra `plot` is there.")
    report.add_argument("run", metavar="RUN", help="the folder that a run wrote; or that of a master that ran by hand")
    report.add_argument("slave", metavar="SLAVE", nargs="?",
                        help="the folder of the slave of that master: puts the two ends together, as a new run")
    report.add_argument("--out", metavar="DIR", help="with SLAVE: the new folder to write; default runs/SCENE-NUMBER")
    report.add_argument("--json", action="store_true", help="print the stored summary and nothing else")
    return parser


def _version() -> str:
    from teleop import __version__

    return f"bilateral-teleop {__version__}"


if __name__ == "__main__":
    raise SystemExit(main())
