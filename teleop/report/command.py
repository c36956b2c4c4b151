"""The command `teleop report`: tables of stored folders, their plots, and one page of HTML of them all."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Sequence
from dataclasses import replace
from itertools import count
from os.path import lexists
from pathlib import Path

from teleop.errors import Refused
from teleop.live.records.merge import merge, scene_of
from teleop.live.records.reader import FILE
from teleop.report.kinds import MOST_FOLDERS, read, run_report, sections_of
from teleop.report.page import FolderReport, page
from teleop.simulation.result import RUNNING
from teleop.storage.files import read_bytes, replacing
from teleop.storage.folder import new_folder
from teleop.terminal.answer import Answer
from teleop.terminal.plotting import asked_formats
from teleop.terminal.run import answer_of

NAME = "report.html"


def command(args: Namespace) -> Answer:
    """Show what the folders hold, draw it if asked to, and write the page. Raises `Refused`."""
    folders = [Path(folder) for folder in args.folders]
    formats = asked_formats(args, wanted=bool(args.picture or args.metric))
    if len(folders) > MOST_FOLDERS:
        raise Refused(f"{len(folders)} folders are more than one page can show; give at most {MOST_FOLDERS}")
    if len(folders) == 2 and any((folder / FILE).is_file() for folder in folders):
        reports = [_both_ends(args, folders[0], folders[1], formats)]
    elif args.out is not None:
        raise Refused("--out names the new folder of a run whose two ends are given, MASTER SLAVE; to name the file of "
                      "the page, type --html FILE")
    else:
        reports = [read(folder, args, formats) for folder in folders]
    answer = reports[0].answer if len(reports) == 1 else _joined(reports)
    if args.json and args.html is None and not args.open:
        return answer
    return _with_page(answer, reports, args)


def _joined(reports: Sequence[FolderReport]) -> Answer:
    """The answers of several folders, one after the other."""
    return Answer("\n\n".join(each.answer.text for each in reports),
                  {"folders": [dict(each.answer.document) for each in reports]},
                  max(each.answer.code for each in reports))


def _both_ends(args: Namespace, master: Path, slave: Path, formats: Sequence[str]) -> FolderReport:
    """The two ends of a live run that was started by hand, as one run in a new folder."""
    result = merge(scene_of(master, trust=args.trust), master, slave)
    if result.status == RUNNING:
        return FolderReport(master, answer_of(result, args.typed), running=True)
    with new_folder(args.out, Path(result.scene).name.removesuffix(".py")) as new:
        result.write(new.inside, args.typed)
    return run_report(new.path, replace(result, path=new.path), args.typed, formats)


def _with_page(answer: Answer, reports: Sequence[FolderReport], args: Namespace) -> Answer:
    """Write the page and name it; where it was not asked for by name, that it cannot be written is no error."""
    running = next((each for each in reports if each.running), None)
    if running is not None:
        why = f"{running.folder} is still being written; ask again when that is over"
        if args.html is not None or args.open:
            raise Refused(f"no page is made: {why}")
        return answer._replace(text=f"{answer.text}\nno page: {why}")
    path = Path(args.html) if args.html is not None else (reports[0].folder if len(reports) == 1 else Path()) / NAME
    try:
        path = write_page(page(sections_of(reports)), path)
    except OSError as error:
        why = f"could not write {path} ({error.strerror or error}); name another file, --html FILE"
        if args.html is not None or args.open:
            raise Refused(why) from error
        return answer._replace(text=f"{answer.text}\nno page: {why}")
    if args.open:
        import webbrowser

        if not webbrowser.open(path.resolve().as_uri()):
            raise Refused(f"there is no browser that could be opened; open {path} yourself")
    return answer._replace(text=f"{answer.text}\npage: {path}", document={**answer.document, "page": str(path)})


def write_page(data: bytes, path: Path) -> Path:
    """Write a page, whole or not at all; the file.

    No file is overwritten: of NAME.html, NAME-2.html, ... it is the first that is not there, or is this very page.
    Raises `OSError`.
    """
    for number in count(1):
        file = path if number == 1 else path.with_name(f"{path.stem}-{number}{path.suffix}")
        if lexists(file):
            if _holds(file, data):
                return file
            continue
        with replacing(file) as new:
            new.write(data)
        return file
    raise AssertionError("numbers do not end")


def _holds(path: Path, data: bytes) -> bool:
    try:
        return read_bytes(path, most=len(data), links=False) == data
    except OSError:  # larger, a link, a folder, not to be read: something else
        return False
