"""The command line: what each verb of `teleop` does; `teleop.terminal.commands` has what may be typed."""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from teleop.terminal.commands import parser
from teleop.terminal.options import DONE, INTERRUPTED, guarded, knobs_from

if TYPE_CHECKING:
    from teleop.simulation.result import Result


def main(argv: Sequence[str] | None = None) -> int:
    """Do what `argv` (left out: the command line) asks for; returns the exit code, 0 or that of `guarded`."""
    typed = sys.argv[1:] if argv is None else list(argv)
    return guarded(lambda: _obey(typed))


def _obey(typed: Sequence[str]) -> int:
    known = parser(DO)
    args = known.parse_args(typed)
    if args.do is None:
        known.print_help()
        return DONE
    args.typed = ["teleop", *typed]
    args.do(args)
    return DONE


def _run(args: Namespace) -> None:
    from dataclasses import replace
    from time import perf_counter_ns

    from teleop.scene.loading import load_scene
    from teleop.simulation.virtual import run
    from teleop.storage.folder import new_folder

    scene = load_scene(args.scene, **knobs_from(args))
    _check_plot(args)
    with new_folder(args.out, _stem(args)) as new:  # before the run: a folder that cannot be written is found at once
        result = run(scene, seed=args.seed, clock=perf_counter_ns)
        result.write(new.inside, args.typed)
        _plot(args, result, new.inside)
    _tell(args, replace(result, path=new.path))


def _precision(args: Namespace) -> None:
    from time import monotonic, perf_counter_ns

    from teleop.analysis.precision.measure import measure
    from teleop.analysis.precision.report import summary, table, write
    from teleop.scene.loading import load_scene
    from teleop.storage.folder import new_folder
    from teleop.terminal.plotting import drawable
    from teleop.terminal.progress import Progress

    scene = load_scene(args.scene, **knobs_from(args))
    line = Progress(sys.stderr, 1.0)

    def show(part: float, text: str) -> None:
        if not args.json:
            line.show(part, monotonic(), text)

    with new_folder(args.out, f"{scene.name}-precision") as new:
        try:
            got = measure(scene, seed=args.seed, clock=perf_counter_ns, rounds=args.rounds, show=show)
        finally:
            line.end()
        write(got, new.inside, args.typed)
        if drawable():
            from teleop.analysis.precision.plot import draw

            draw(got, new.inside / "precision.png")
    if args.json:
        _say_object({**summary(got, args.typed), "path": str(new.path)})
    else:
        _say(f"{table(got)}\nwritten to {new.path}")


def _stability(args: Namespace) -> None:
    from teleop.analysis.stability.report import ask, summary, table

    answer = ask(args.scene, knobs_from(args), seed=args.seed, in_time=args.time, continuous=args.continuous,
                 knob=args.critical, span=args.range, tol=args.tol)
    if args.json:
        _say_object({**summary(answer), "command": args.typed})
    else:
        _say(table(answer))


def _passivity(args: Namespace) -> None:
    from teleop.analysis.passivity.command import passivity

    _check_plot(args)
    told, text = passivity(args.scene, knobs_from(args), seed=args.seed, span=args.range, out=args.out,
                           plot=args.plot, command=args.typed)
    if args.json:
        _say_object(told)
    else:
        _say(text)


def _zwidth(args: Namespace) -> None:
    from time import monotonic

    from teleop.analysis.zwidth.command import carry_out
    from teleop.analysis.zwidth.report import summary, table

    got, out = carry_out(args.scene, knobs_from(args), range_k=args.range_k, range_b=args.range_b, seed=args.seed,
                         out=args.out, command=args.typed, clock=monotonic, stream=None if args.json else sys.stderr)
    if args.json:
        _say_object({**summary(got, args.typed), "path": str(out)})
    else:
        _say(f"{table(got)}\nwritten to {out}")
    if got.interrupted:
        raise SystemExit(INTERRUPTED)


def _sweep(args: Namespace) -> None:
    from time import perf_counter

    from teleop.sweeps.command import carry_out
    from teleop.sweeps.pictures.report import Wish, drawn
    from teleop.terminal.plotting import need_plot

    wish = Wish(args.picture, args.metric) if args.plot or args.picture or args.metric else None
    if wish is not None:
        need_plot()
    swept = carry_out(args.scene, knobs_from(args), args.grid, seeds=args.seeds, metrics=args.metrics,
                      latin=args.latin, random=args.random, cluster=args.cluster,
                      engine=args.engine, out=args.out, yes=args.yes, clock=perf_counter, wish=wish,
                      stream=None if args.json else sys.stderr)
    told = swept.write(args.typed)
    where = "" if wish is None else "\n" + drawn(swept.table, swept.folder, told, wish, trust=True)
    if args.json:
        _say_object({**swept.summary(args.typed), "runs": told["runs"]})
    else:
        _say(swept.text() + where)
    if swept.interrupted:
        raise SystemExit(INTERRUPTED)


def _matrix(args: Namespace) -> None:
    from time import perf_counter

    from teleop.sweeps.matrix import answer

    told, text = answer(args.file, out=args.out, command=args.typed, clock=perf_counter,
                        stream=None if args.json else sys.stderr)
    if args.json:
        _say_object(told)
    else:
        _say(text)


def _demo(args: Namespace) -> None:
    from teleop.live.demo import demo

    _check_plot(args)
    result = demo(args.scene, knobs_from(args), seed=args.seed, out=args.out, stem=_stem(args), json=args.json,
                  lockstep=args.lockstep, command=args.typed, realtime=args.realtime)
    _tell(args, result)
    if result.path is not None:  # a live run takes its time anyway
        _draw_if_possible(args, result, result.path)


def _doctor(args: Namespace) -> None:
    from teleop.doctor import clear, findings, text

    removed = clear() if args.clear else 0
    found = findings()
    if args.json:
        _say_object({**found, "removed": removed})
    else:
        _say(f"{removed} kernels removed\n{text(found)}" if args.clear else text(found))


def _keygen(args: Namespace) -> None:
    from teleop.protocol.secure.keys import keygen

    path, printed = keygen(args.name)
    if args.json:
        _say_object({"path": str(path), "fingerprint": printed})
    else:
        _say(f"{path} written: it stays at this end, started with\n  --key {path}\n"
             f"and the other end is told whom to expect with\n  --peer-fingerprint {printed}")


def _list(args: Namespace) -> None:
    from teleop.scene.catalogue import details, overview

    _say(overview() if args.name is None else details(args.name))


def _report(args: Namespace) -> None:
    from teleop.simulation.result import RUNNING, load_result
    from teleop.sweeps.pictures.report import Wish, check_run

    if args.slave is not None:
        _put_together(args)
        return
    if (Path(args.run) / "sweep.json").is_file():
        _report_sweep(args)
        return
    check_run(Path(args.run), Wish(args.picture, args.metric))
    result = load_result(args.run, trust=args.trust)
    if result.status == RUNNING:
        _tell(args, result)
        return
    if args.json:
        from teleop.simulation.result import stored_summary

        _say_json(stored_summary(Path(args.run)), result)
        return
    _tell(args, result)
    _draw_if_possible(args, result, Path(args.run))


def _report_sweep(args: Namespace) -> None:
    from teleop.sweeps.pictures.report import Wish, report

    told, text = report(Path(args.run), Wish(args.picture, args.metric), quiet=args.json, trust=args.trust)
    if args.json:
        _say_object(told)
    else:
        _say(text)


def _put_together(args: Namespace) -> None:
    from dataclasses import replace

    from teleop.live.records.merge import merge, scene_of
    from teleop.simulation.result import RUNNING
    from teleop.storage.folder import new_folder

    result = merge(scene_of(Path(args.run), trust=args.trust), Path(args.run), Path(args.slave))
    if result.status == RUNNING:
        _tell(args, result)
        return
    args.scene = result.scene
    with new_folder(args.out, _stem(args)) as new:
        result.write(new.inside, args.typed)
    _tell(args, replace(result, path=new.path))
    _draw_if_possible(args, result, new.path)


def _draw_if_possible(args: Namespace, result: Result, folder: Path) -> None:
    """The figure, where the extra is there; that it cannot be written is no error, for what was asked is done."""
    from teleop.errors import Refused
    from teleop.terminal.plotting import drawable
    from teleop.terminal.run_plot import draw

    if not drawable():
        return
    try:
        draw(result, folder / "plot.png")
    except Refused as refused:
        if not args.json:
            _say(f"no plot: {refused}")


def _tell(args: Namespace, result: Result) -> None:
    if args.json:
        _say_json(result.summary(args.typed), result)
        return
    from teleop.simulation.result import RUNNING
    from teleop.terminal.run_table import table

    running = result.status == RUNNING
    _say(f"{table(result)}\n" + ("nothing is written while it runs" if running else f"written to {result.path}"))


def _say_json(summary: dict[str, Any], result: Result) -> None:
    _say_object({**summary, "path": str(result.path)})


def _say_object(value: dict[str, Any]) -> None:
    from teleop.storage.strict_json import written

    _say(written(value))


def _say(text: str) -> None:
    """Print `text`; what a terminal would obey, or its encoding does not know, is written out, and stops nothing."""
    from teleop.terminal.printable import printable

    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    print(printable(text, lines=True).encode(encoding, "backslashreplace").decode(encoding))


def _stem(args: Namespace) -> str:
    """What the numbered folder of a run is called before its number."""
    return Path(args.scene).name.removesuffix(".py")


def _check_plot(args: Namespace) -> None:
    if args.plot:
        from teleop.terminal.plotting import need_plot

        need_plot()


def _plot(args: Namespace, result: Result, folder: Path) -> None:
    if args.plot:
        from teleop.terminal.run_plot import draw

        draw(result, folder / "plot.png")


DO = {
    "run": _run, "demo": _demo, "sweep": _sweep, "matrix": _matrix, "precision": _precision, "stability": _stability,
    "passivity": _passivity, "zwidth": _zwidth, "list": _list, "doctor": _doctor, "report": _report,
    "keygen": _keygen,
}


if __name__ == "__main__":
    raise SystemExit(main())
