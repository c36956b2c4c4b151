"""Files that a user names, or that a folder of unknown origin holds: read with a bound, written beside and renamed.

Only a regular file is ever opened, so neither a pipe without a writer nor a device without an end holds up a command.
What is written never goes through a link: it is made under a new name in the same folder and takes the place of the
old file, or of the link, by a rename.
"""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import TextIOWrapper
from pathlib import Path
from typing import IO, BinaryIO

MOST = 64 * 2**20  # bytes of a file that is read as a whole: a day of ping at 10 Hz is 60 MB
_KINDS = ((stat.S_ISDIR, "a folder"), (stat.S_ISFIFO, "a pipe"), (stat.S_ISLNK, "a link"), (stat.S_ISSOCK, "a socket"),
          (stat.S_ISCHR, "a device"), (stat.S_ISBLK, "a device"))
_BLOCK = 1 << 18  # bytes that are read at a time
_ATTEMPTS = 1000  # at a name that is not taken


def open_regular(path: str | os.PathLike[str], *, links: bool = True) -> BinaryIO:
    """The regular file at `path`, open to be read; without `links` the file itself must not be a symbolic link.

    Raises `OSError`, whose `strerror` says why: there is no such file, or it is a folder, a pipe, a device, ...
    """
    flags = os.O_RDONLY
    for name in ("O_BINARY", "O_CLOEXEC", "O_NOCTTY", "O_NONBLOCK", *([] if links else ["O_NOFOLLOW"])):
        flags |= getattr(os, name, 0)
    try:
        _check_regular(os.stat(path, follow_symlinks=links), path)  # opening a device may already do something
        file = os.open(path, flags)
    except ValueError:  # a zero byte in its name
        raise OSError(errno.EINVAL, "no file has such a name", str(path)) from None
    try:
        _check_regular(os.fstat(file), path)  # the name may lead elsewhere by now
        return os.fdopen(file, "rb")
    except BaseException:
        os.close(file)
        raise


def read_bytes(path: str | os.PathLike[str], *, most: int = MOST, links: bool = True) -> bytes:
    """Read all bytes of the regular file at `path`, at most `most`. Raises `OSError`, as `open_regular` does."""
    with open_regular(path, links=links) as file:
        size, data = os.fstat(file.fileno()).st_size, bytearray()
        while size <= most and len(data) <= most and (block := file.read(_BLOCK)):  # it may grow meanwhile
            data += block
    if max(size, len(data)) > most:
        raise OSError(errno.EFBIG, f"it is larger than {_size(most)}", str(path))
    return bytes(data)


@contextmanager
def replacing(path: Path, *, settle: bool = False) -> Iterator[BinaryIO]:
    """A new file to write into that takes the place of `path` when all went well, and is gone when it did not.

    `settle`: wait until the disk has it. Raises `OSError`.
    """
    part, file = _new_beside(path)
    try:
        with file:
            yield file
            if settle:
                file.flush()
                os.fsync(file.fileno())
        os.replace(part, path)
    finally:
        with suppress(OSError):  # it has taken its place
            part.unlink()


@contextmanager
def creating(path: Path) -> Iterator[BinaryIO]:
    """A new file to write into that gets the name `path` when all went well, and is gone when it did not.

    Raises `OSError`: a `FileExistsError` if there is such a name already, at the begin or by the end.
    """
    _check_free(path)
    part, file = _new_beside(path)
    try:
        with file:
            yield file
        try:
            os.link(part, path, follow_symlinks=False)  # unlike a rename it never takes the place of a file
        except FileExistsError:
            raise
        except (OSError, NotImplementedError):  # a file system without hard links
            _check_free(path)
            os.rename(part, path)
    finally:
        with suppress(OSError):
            part.unlink()


@contextmanager
def replacing_text(path: Path) -> Iterator[IO[str]]:
    """The same for text in UTF-8, whose line ends stay as they are written."""
    with replacing(path) as file:
        lines = TextIOWrapper(file, encoding="utf-8", newline="")
        yield lines
        lines.detach()  # having written the rest


def is_part(path: Path, name: str) -> bool:
    """True if it is what a killed process left of a file `name` that was written by `replacing`."""
    return path.name.startswith(f".{name}.") and path.name.endswith(".part")


def _check_free(path: Path) -> None:
    if os.path.lexists(path):
        raise FileExistsError(errno.EEXIST, "it is there already", str(path))


def _new_beside(path: Path) -> tuple[Path, BinaryIO]:
    for attempt in range(_ATTEMPTS):
        part = path.with_name(f".{path.name}.{os.getpid()}-{attempt}.part")
        with suppress(FileExistsError):  # a link of that name too: the open below never follows one
            return part, part.open("xb")
    raise FileExistsError(errno.EEXIST, f"{_ATTEMPTS} unfinished files are in the way", str(path))


def _check_regular(status: os.stat_result, path: str | os.PathLike[str]) -> None:
    if not stat.S_ISREG(status.st_mode):
        kind = next((text for is_kind, text in _KINDS if is_kind(status.st_mode)), "no regular file")
        raise OSError(errno.EINVAL, f"it is {kind}, not a file", str(path))


def _size(count: int) -> str:
    return f"{count >> 20} MB" if count >= 1 << 20 else f"{count >> 10} kB"
