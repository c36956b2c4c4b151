"""Run folders: claimed by one process, and written whole or not at all.

`mkdir` is the claim, for it succeeds in one process alone; every folder of a run is made so, in virtual time, live and
by a sweep. A folder is removed again only by the process that made it.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path
from typing import NamedTuple

from teleop.errors import Refused

PART = ".part"  # within a folder: what is not whole yet
AGAIN = 100  # times that a parent is made anew which another process, having no more use for it, has removed
BEGUN = "is being written, and there is nothing to show of it yet; ask again in a moment"
LAST = "summary.json"  # moved after all other files: where it is, they are


class NewFolder(NamedTuple):
    """A folder that is being written: `path` is its name, `inside` where to write until it is whole."""

    path: Path
    inside: Path


class Claim:
    """A folder that this process has made, and the parents made for it; `close` it when all in it is written."""

    def __init__(self, path: Path, parents: list[Path]) -> None:
        self.path = path
        self._parents = parents  # innermost first
        self._held = _open_folder(path)  # while it is open, no other folder gets its number
        if self._held is not None:
            lock(self._held, shared=False)
        self._made = _identity(path)

    def drop(self) -> None:
        """Remove the folder and all in it, if it is still the one made here, and the parents made for it if empty."""
        with suppress(OSError):
            if _identity(self.path) == self._made:
                shutil.rmtree(self.path, ignore_errors=True)
        self.drop_empty()

    def drop_empty(self) -> None:
        """Remove the folder, and then the parents made for it, as far as there is nothing in them."""
        with suppress(OSError):
            if _identity(self.path) == self._made:
                self.path.rmdir()
        if not os.path.lexists(self.path):
            _remove(self._parents)

    def close(self) -> None:
        """Let go of the folder; it stays."""
        if self._held is not None:
            with suppress(OSError):  # others have closed it
                os.close(self._held)
        self._held = None


def numbered(parent: Path, stem: str) -> Iterator[Path]:
    """`stem-1`, `stem-2`, ... in `parent`, those that are not there."""
    return (path for number in count(1) if not os.path.lexists(path := parent / f"{stem}-{number}"))


def claim(out: Path | str | None, stem: str = "run") -> Claim:
    """Make the folder `out`, or without one the first of runs/STEM-1, runs/STEM-2, ... that is free.

    Of processes that ask for one name at the same moment one gets it; the others go on to the next number, or with
    `out` are refused. Raises `Refused`.
    """
    for path in numbered(Path("runs"), stem) if out is None else [Path(out)]:
        try:
            return Claim(path, _make(path))
        except FileExistsError:
            if out is None:
                continue
            unfinished = (path / PART).is_dir()
            state = "already" + ", not whole: another process writes it, or was killed while it did" * unfinished
            raise Refused(f"{path} is there {state}; give another folder with --out, or remove it") from None
        except (OSError, ValueError) as error:  # ValueError: a name with a null byte, or with half a surrogate pair
            why = getattr(error, "strerror", None) or error
            raise Refused(f"cannot write to {path} ({why}); give a folder you may write to with --out") from error
    raise AssertionError("numbers do not end")


@contextmanager
def new_folder(out: Path | str | None, stem: str = "run") -> Iterator[NewFolder]:
    """A folder to write into, claimed as `claim` does; it is whole in the end, or gone if not all went well."""
    claimed = claim(out, stem)
    new = NewFolder(claimed.path, claimed.path / PART)
    written = [new.inside]
    try:
        new.inside.mkdir()
        _alone(new.path)
        yield new
        _alone(new.path)
        for path in sorted(new.inside.iterdir(), key=lambda path: path.name == LAST):
            written.append(new.path / path.name)
            path.rename(written[-1])
        new.inside.rmdir()
        written.clear()
    except OSError as error:
        raise Refused(
            f"could not write {new.path} ({error.strerror or error}), so nothing was left there; free some space, "
            f"or give another folder with --out"
        ) from error
    finally:
        if written:
            for path in written:
                _remove_tree(path)
            claimed.drop_empty()
        claimed.close()


def _alone(folder: Path) -> None:
    """Refuse a folder that another process has written into."""
    others = sorted(path.name for path in folder.iterdir() if path.name != PART)
    if others:
        raise Refused(f"another process has written {others[0]} into {folder} meanwhile, so nothing was left there; "
                      "give another folder with --out")


def _make(folder: Path) -> list[Path]:
    """Make `folder`, which must not be there, and its parents; those that were made here, innermost first."""
    made: list[Path] = []
    try:
        for again in count():
            try:
                for parent in reversed(folder.parents):
                    if not os.path.lexists(parent):
                        with suppress(FileExistsError):  # another process was faster
                            parent.mkdir()
                            made.insert(0, parent)
                folder.mkdir()
                return made
            except FileNotFoundError:
                if again == AGAIN:
                    raise
    except BaseException:
        _remove(made)
        raise
    raise AssertionError("it is made, or raised")


def _remove(parents: list[Path]) -> None:
    with suppress(OSError):  # one that another process uses stays
        for parent in parents:
            parent.rmdir()


def _remove_tree(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink()


def is_being_written(folder: Path) -> bool:
    """True if the process that claimed `folder` lives and has not closed the claim.

    That process holds a lock on the folder, which the system releases when it ends, however it ends. False too where
    folders cannot be locked, as on some network file systems.
    """
    held = _open_folder(folder)
    if held is None:
        return False
    try:
        return not lock(held, shared=True)
    finally:
        os.close(held)


def _open_folder(folder: Path) -> int | None:
    """The open folder; None where the system opens none, as Windows."""
    with suppress(OSError):
        return os.open(folder, os.O_RDONLY | getattr(os, "O_DIRECTORY", 0) | getattr(os, "O_NOFOLLOW", 0))
    return None


def lock(held: int, *, shared: bool) -> bool:
    """Take a lock on an open file or folder (its descriptor); False if another process has one in the way.

    True too where there are no locks. The system releases it when the descriptor is closed, however a process ends.
    """
    with suppress(ImportError):
        import fcntl

        try:
            fcntl.flock(held, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        except OSError:  # a file system that has no locks
            pass
    return True


def _identity(path: Path) -> tuple[int, int]:
    status = path.lstat()
    return status.st_dev, status.st_ino
