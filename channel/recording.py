"""Reading a recorded link from a text file: once, whole, with a sentence for whatever is wrong with it."""

from __future__ import annotations

from os import PathLike, fspath
from typing import NoReturn
from zlib import crc32

from teleop.errors import Refused

_LARGEST = 64 * 2**20  # bytes; a day of ping at 10 Hz is 60 MB, the LTE recordings are half a MB


def read(name: str, path: str | PathLike[str]) -> tuple[str, list[str], int]:
    """The path as text, the lines of the file, and the CRC-32 of its bytes.

    The checksum makes effects that replay different recordings of the same name different objects.
    """
    if not isinstance(path, str | PathLike):
        raise Refused(f"path must name a recording, not {path!r}; write for example {name}(\"file.txt\")")
    where = fspath(path)
    try:
        with open(where, "rb") as file:
            data = file.read(_LARGEST + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise Refused(f"{where} cannot be read ({reason}): {name} replays a recording; "
                      "give the path of one") from None
    if len(data) > _LARGEST:
        raise Refused(f"{where} is larger than {_LARGEST >> 20} MB, so it is hardly a recording for {name}; "
                      "cut out the part to be replayed")
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
