"""What `teleop report` does: show a stored run or sweep again, or put the two ends of a live run together."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from teleop.errors import Refused
from teleop.live.records.merge import load_result, merge, scene_of
from teleop.simulation.result import RUNNING, stored_summary
from teleop.storage.folder import new_folder
from teleop.sweeps.pictures.report import PictureRequest, check_run, report
from teleop.terminal.answer import Answer
from teleop.terminal.plotting import asked_formats
from teleop.terminal.run import answer_of, with_plot


def command(args: Namespace) -> Answer:
    """Show what the folder holds, and draw it if asked to. Raises `Refused`."""
    folder = Path(args.run)
    request = PictureRequest(args.picture, args.metric)
    formats = asked_formats(args, asked=any(request))
    if args.slave is not None:
        return _both_ends(args, formats)
    if (folder / "sweep.json").is_file():
        _refuse_comparison(folder)
        return report(folder, request, formats, trust=args.trust, rows=args.rows)
    check_run(folder, request)
    if args.rows is not None:
        raise Refused(f"{folder} holds a run, which has no rows to show; leave --rows out")
    result = load_result(folder, trust=args.trust)
    if result.status == RUNNING:
        return answer_of(result, args.typed)
    answer = answer_of(result, args.typed)
    if args.json:  # as it is stored
        answer = answer._replace(document={**stored_summary(folder), "path": str(result.path)})
    return with_plot(answer, result, folder, formats)


def _refuse_comparison(folder: Path) -> None:
    """Refuse the folder of a comparison: its rows are of many scenes, and its own command tells them again."""
    from teleop.sweeps.definition import read_definition

    if read_definition(folder).get("scene") == "compare":
        raise Refused(f"{folder} holds a comparison; type the teleop compare that wrote it again, which runs no row "
                      f"twice, with --plot for its figures, or read {folder / 'rows.csv'}")


def _both_ends(args: Namespace, formats: Sequence[str]) -> Answer:
    """The two ends of a live run that was started by hand, as one run in a new folder."""
    result = merge(scene_of(Path(args.run), trust=args.trust), Path(args.run), Path(args.slave))
    if result.status == RUNNING:
        return answer_of(result, args.typed)
    with new_folder(args.out, Path(result.scene).name.removesuffix(".py")) as new:
        result.write(new.inside, args.typed)
    result = replace(result, path=new.path)
    return with_plot(answer_of(result, args.typed), result, new.path, formats)
