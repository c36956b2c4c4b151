"""What a worker of a cluster does with a chunk: look whether it may, and run it."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from teleop.errors import Refused
from teleop.scene.library import ROOT, beside
from teleop.storage.files import read_bytes


def answer(version: str, files: Sequence[tuple[str, str]], packed: bytes) -> tuple[str, bytes | str]:
    """What a worker does with a chunk: its address, and the rows as bytes or the sentence why there are none.

    `version`: the sources (see `sources`) that the rows are to be made by. `files`: path and digest of each file with a
    scene or a law that is not built in. Nothing of `packed` is opened before both agree.
    """
    import cloudpickle
    from distributed import get_worker

    at = str(get_worker().address)
    if sources() != version:
        return at, (f"the worker {at} has teleop {sources()}, not {version} as here; install the same there and start "
                    f"it again")
    for path, digest in files:
        if (here := digest_of(path)) != digest:
            has = "no file" if here is None else "another file"
            return at, f"the worker {at} has {has} {path}; put that of here on a disk that all share, or copy it there"
    function, job = pickle.loads(packed)
    try:
        return at, cloudpickle.dumps(function(job))
    except Refused as refused:
        return at, f"{refused} (at the worker {at})"


@cache
def sources() -> str:
    """The version of this package and a digest of its files, as this process found them: others make other rows."""
    from hashlib import sha256

    from teleop.version import __version__

    found = sha256()
    for package in ("teleop", "master", "slave", "channel", "scenarios"):
        for path in sorted((ROOT / package).rglob("*.py"), key=Path.as_posix):
            found.update(path.relative_to(ROOT).as_posix().encode() + b"\0" + path.read_bytes())
    return f"{__version__} ({found.hexdigest()[:12]})"


def digest_of(path: str) -> str | None:
    """What is in a file and those beside it that it imports, in short; none if it cannot be read."""
    from hashlib import sha256

    try:
        found = sha256(read_bytes(path))
        for name, file in beside(Path(path)).items():
            found.update(f"\0{name}\0".encode() + read_bytes(file))
        return found.hexdigest()
    except OSError:
        return None
