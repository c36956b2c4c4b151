"""The user's cache folder, where compiled kernels are kept, and whether other users may write there.

It needs no numpy, so `teleop doctor` tells of it also where numpy cannot be loaded.
"""

from __future__ import annotations

import os
import stat
import warnings
from pathlib import Path

_OTHERS = stat.S_IWGRP | stat.S_IWOTH
_ENTER = stat.S_IXGRP | stat.S_IXOTH
_warned: set[str] = set()


class KernelsNotKept(UserWarning):
    """Compiled kernels are neither kept nor taken from the cache folder."""


def folder() -> Path:
    """Folder of the modules."""
    home = os.environ.get("XDG_CACHE_HOME")
    return (Path(home) if home else Path.home() / ".cache") / "bilateral-teleop" / "kernels"


def made_private(folder: Path) -> None:
    """Make a folder that is its owner's alone, and those above it that are missing. Raises `OSError`."""
    for missing in reversed([each for each in (folder, *folder.parents) if not each.exists()]):
        missing.mkdir(mode=0o700, exist_ok=True)


def open_to_others(folder: Path, stem: str = "") -> str | None:
    """Why what lies in `folder` may be of another user; None if it cannot be.

    No other user but root may own the folder, a folder above it, or a file in it whose name begins with `stem`, nor
    write to one, unless it lies below a folder that they may not enter. One above it that is like /tmp, where all may
    make but only owners remove, is no way in.
    """
    if not hasattr(os, "geteuid"):  # no system whose files have an owner and bits for others
        return None
    try:
        hidden = False
        for end in dict.fromkeys((folder.absolute(), folder.resolve())):
            hidden = False  # below a folder that no other user may enter
            for each in (*reversed(end.parents), end):
                status = each.stat()
                if why := _wrong(each, status, hidden or (each != end and bool(status.st_mode & stat.S_ISVTX))):
                    return why
                hidden = hidden or not status.st_mode & _ENTER
        for part in folder.glob(f"{stem}*") if stem else ():
            if why := _wrong(part, part.lstat(), hidden):
                return why
    except OSError as error:
        return f"{error.filename or folder} cannot be looked at ({error.strerror})"
    return None


def tell_once(why: str) -> None:
    """Warn, once in a process, that kernels are not kept."""
    if why not in _warned:
        _warned.add(why)
        warnings.warn(f"compiled kernels are not kept, and each process compiles its own: {why}", KernelsNotKept,
                      stacklevel=2)


def _wrong(path: Path, status: os.stat_result, shared: bool) -> str | None:
    """Say what lets another user write at `path`; `shared`: its permission bits do no harm."""
    if status.st_uid not in (0, os.geteuid()):
        return f"{path} belongs to another user (number {status.st_uid}); set XDG_CACHE_HOME to a folder of your own"
    if stat.S_ISLNK(status.st_mode):
        return f"{path} is a link; remove it"
    if status.st_mode & _OTHERS and not shared:
        return (f"others may write to {path} (mode {stat.S_IMODE(status.st_mode):o}); remove what it holds and type: "
                f"chmod go-w '{path}'")
    return None
