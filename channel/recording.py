"""Reading a recorded link from a text file: once, whole, with a sentence for whatever is wrong with it."""

from __future__ import annotations

from os import PathLike, fspath
from typing import NoReturn
from zlib import crc32

from teleop.errors import Refused
from teleop.storage.files import read_bytes


def read(name: str, path: str | PathLike[str]) -> tuple[str, list[str], int]:
    """The path as text, the lines of the file, and the CRC-32 of its bytes.

    The checksum makes effects that replay different recordings of the same name different objects.
    """
    if not isinstance(path, str | PathLike):
        raise Refused(f"path must name a recording, not {path!r}; write for example {name}(\"file.txt\")")
    where = fspath(path)
    try:
        data = read_bytes(where)
    except OSError as error:
        raise Refused(f"{where} cannot be read ({error.strerror or error}): {name} replays a recording; "
                      "give the path of a file, or of a part of it that is to be replayed") from None
    try:
        lines = data.decode("utf-8").splitlines()
    except UnicodeDecodeError as error:
        broken(where, data.count(b"\n", 0, error.start) + 1, f"this is not text; {name} reads the text "
               "that was recorded, unpacked")
    if not any(line.strip() for line in lines):
        raise Refused(f"{where} is empty: there is nothing to replay; record again")
    return where, lines, crc32(data)


def broken(path: str, line: int, what: str) -> NoReturn:
    """Refuses a recording because of one line: what is wrong with it and what to do."""
    raise Refused(f"{path}, line {line}: {what}")
