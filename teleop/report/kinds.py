"""Kinds of folders: what the terminal prints of each, and its part of the page."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path

from teleop.errors import Refused
from teleop.live.records.merge import load_result
from teleop.report.of_runs import RunView, of_one, of_several
from teleop.report.page import FolderReport, Section
from teleop.simulation.result import RUNNING, Result, stored_summary
from teleop.sweeps.pictures.report import PictureRequest, check_run
from teleop.terminal.run import answer_of, with_plot

MOST_FOLDERS = 24


def read(folder: Path, args: Namespace, formats: Sequence[str]) -> FolderReport:
    """Report what `folder` holds, drawn in `formats`. Raises `Refused`."""
    request = PictureRequest(args.picture, args.metric)
    if (folder / "page.json").is_file():
        from teleop.report.of_page import page_report

        return page_report(folder, args, formats)
    from teleop.report.of_study import is_study, study_report

    if (folder / "sweep.json").is_file():
        from teleop.sweeps.store import read_definition

        scene = read_definition(folder).get("scene")
        if scene == "compare":
            from teleop.report.of_comparison import comparison_report

            return comparison_report(folder, args)
        if scene == "advise" and not is_study(folder):
            raise Refused(f"{folder} holds an advice that was stopped; type its command again to go on with it")
        if scene != "advise":
            from teleop.report.of_sweep import sweep_report

            return sweep_report(folder, args, formats)
    if is_study(folder):
        return study_report(folder, args)
    check_run(folder, request)
    if args.rows is not None:
        raise Refused(f"{folder} holds a run, which has no rows to show; leave --rows out")
    result = load_result(folder, trust=args.trust)
    if result.status == RUNNING:
        return FolderReport(folder, answer_of(result, args.typed), running=True)
    shape = run_report(folder, result, args.typed, formats)
    if args.json:  # as it is stored
        document = {**stored_summary(folder), "path": str(result.path)}
        plots = {key: shape.answer.document[key] for key in ("plots",) if key in shape.answer.document}
        shape = shape._replace(answer=shape.answer._replace(document={**document, **plots}))
    return shape


def run_report(folder: Path, result: Result, typed: Sequence[str], formats: Sequence[str]) -> FolderReport:
    """A run that lies complete in `folder`."""
    return FolderReport(folder, with_plot(answer_of(result, typed), result, folder, formats), result=result)


def run_of(shape: FolderReport) -> RunView:
    """A run as the page tells of it."""
    assert shape.result is not None
    return RunView(shape.folder.resolve().name, shape.result, stored_summary(shape.folder))


def sections_of(shape: Sequence[FolderReport]) -> list[Section]:
    """The sections of the page: all runs side by side in one, each other folder in one of its own."""
    runs = [run_of(each) for each in shape if each.section is None]
    kind: list[Section] = []
    for each in shape:
        if each.section is not None:
            kind.append(each.section())
        elif runs:
            kind.append(of_one(runs[0]) if len(runs) == 1 else of_several(runs))
            runs = []
    return kind
