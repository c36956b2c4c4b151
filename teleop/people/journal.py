"""The journal of a person: one line of JSON for each trial, break and answer, appended and synced to the disk.

The first line names the study, the person and the code. A line counts once its line end is there: what a cut left of
a last line is removed when the journal is opened again, and that step is run again. So after a cut at any byte a person
goes on with the same bytes as an undisturbed one. One process has the journal at a time.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any

from teleop.errors import Refused
from teleop.storage.files import read_bytes
from teleop.storage.folder import lock
from teleop.storage.strict_json import Misshapen, json_text, parse

NAME = "journal.jsonl"


def read_journal(path: Path) -> list[dict[str, Any]]:
    """The whole lines of a journal; none if there is no file. Raises `Refused` for one that is damaged."""
    try:
        data = read_bytes(path, links=False)
    except FileNotFoundError:
        return []
    except OSError as error:
        raise Refused(f"{path} cannot be read ({error.strerror or error}); give the folder of a study") from None
    rows = []
    for number, line in enumerate(data.split(b"\n")[:-1], 1):
        try:
            row = parse(line)
        except Misshapen as error:
            raise Refused(f"line {number} of {path} is damaged ({error}); put it back from a copy") from None
        if not isinstance(row, dict) or not isinstance(row.get("kind"), str):
            raise Refused(f"line {number} of {path} is no line of a journal; give the folder of a study")
        rows.append(row)
    return rows


class Journal:
    """The journal of a person, open to be appended to. `rows` has all its lines."""

    def __init__(self, path: Path, *, sync: bool = True) -> None:
        self.path = path
        self._sync = sync
        flags = os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_NOFOLLOW", 0)
        self._file: IO[bytes] = os.fdopen(os.open(path, flags, 0o644), "r+b", buffering=0)
        if not lock(self._file.fileno(), shared=False):
            self._file.close()
            raise Refused(f"{path.parent.name} is being run by another process; end that one first")
        try:
            self.rows: list[dict[str, Any]] = read_journal(path)
        except Refused:
            self._file.close()
            raise
        data = self._file.read()
        whole = data.rfind(b"\n") + 1
        if whole < len(data):
            self._file.truncate(whole)
        if sync:
            _sync_folder(path.parent)

    def append(self, row: Mapping[str, Any]) -> None:
        """Write a line, and wait until the disk has it."""
        line = json_text(row).encode() + b"\n"
        while line:
            line = line[self._file.write(line):]
        if self._sync:
            os.fsync(self._file.fileno())
        self.rows.append(dict(row))

    def close(self) -> None:
        """Let go of the journal."""
        self._file.close()

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _sync_folder(folder: Path) -> None:
    """Have the disk keep the names in a folder, where the system can be asked to."""
    try:
        descriptor = os.open(folder, os.O_RDONLY)
    except OSError:
        return
    try:
        os.fsync(descriptor)
    except OSError:  # a file system that syncs no folders
        pass
    finally:
        os.close(descriptor)


def of_kind(rows: Sequence[Mapping[str, Any]], kind: str) -> list[Mapping[str, Any]]:
    """The lines of this kind."""
    return [row for row in rows if row["kind"] == kind]
