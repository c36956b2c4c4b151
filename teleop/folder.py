"""Run folders: written whole or not at all."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from teleop.errors import Refused


def numbered(parent: Path, stem: str) -> Path:
    """The first of `stem-1`, `stem-2`, ... in `parent` that is neither there nor being written."""
    taken = {p.name for p in parent.iterdir()} if parent.is_dir() else set()
    taken |= {name[1:].rsplit(".", 2)[0] for name in taken if name.endswith(".part")}
    number = 1
    while f"{stem}-{number}" in taken:
        number += 1
    return parent / f"{stem}-{number}"


def claim(folder: Path) -> Path:
    """Make the hidden folder beside `folder` that a run is written into first, or say why it cannot be."""
    if os.path.lexists(folder):  # unlike exists(), it has an answer for every path, and knows dangling links
        raise Refused(f"{folder} is there already; give another folder with --out, or remove it")
    hidden = folder.with_name(f".{folder.name}.{os.getpid()}.part")
    try:
        hidden.mkdir(parents=True)
    except OSError as error:
        raise Refused(
            f"cannot write to {folder} ({error.strerror or error}); give a folder you may write to with --out"
        ) from error
    return hidden


@contextmanager
def new_folder(folder: Path) -> Iterator[Path]:
    """A folder to write into that becomes `folder` when all went well, and is gone when it did not."""
    missing = [parent for parent in folder.parents if not os.path.lexists(parent)]  # innermost first
    hidden = None
    try:
        hidden = claim(folder)
        yield hidden
        hidden.rename(folder)
    except OSError as error:
        raise Refused(
            f"could not write {folder} ({error.strerror or error}), so nothing was left there; free some space, "
            f"or give another folder with --out"
        ) from error
    finally:
        if hidden is not None:
            shutil.rmtree(hidden, ignore_errors=True)
        if not os.path.lexists(folder):
            with suppress(OSError):  # a parent in use by somebody else stays
                for parent in missing:
                    parent.rmdir()
