"""The lock on a device, so that one end at a time drives it: a locked file in a folder of the user's own, by its name.

The system lets go of it with its process, whatever that dies of. No other user can take the name first, and processes
in other network namespaces find the same file.
"""

from __future__ import annotations

import os
import re
import stat
import time
from contextlib import suppress
from hashlib import sha256
from pathlib import Path

from teleop.errors import Refused
from teleop.storage.folder import lock

WAIT_S = 3.0  # for the watchdog process of an end that was there before
LOOK_S = 0.02
FOLDER = "bilateral-teleop"
RUNTIME = "XDG_RUNTIME_DIR"
_OTHERS = stat.S_IRWXG | stat.S_IRWXO
_CURE = f"set {RUNTIME} to a folder that is yours alone (mode 700)"


def take_lock(device: str, end: int) -> int | None:
    """The locked file of the device of this name, open as a descriptor; None where a system has no such locks.

    `end`: the process that drives the device, which another one is told. Raises `Refused` if another process has it
    for `WAIT_S`, or if there is no folder of the user's own.
    """
    if not hasattr(os, "geteuid"):
        return None
    path = folder() / f"{re.sub(r'[^A-Za-z0-9.-]+', '_', device)[:60]}-{sha256(device.encode()).hexdigest()[:16]}.lock"
    try:
        held = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
    except OSError as error:
        why = error.strerror or error
        raise Refused(f"the lock on the device {device}, {path}, cannot be opened ({why}); {_CURE}") from error
    until = time.monotonic() + WAIT_S
    while not lock(held, shared=False):
        if time.monotonic() > until:
            other = os.pread(held, 20, 0).decode(errors="replace").strip()
            os.close(held)
            raise Refused(f"another end drives this device already ({device}), process {other or 'unknown'}; end that "
                          f"one first{f', for example by kill {other}' if other.isdecimal() else ''}")
        time.sleep(LOOK_S)
    os.ftruncate(held, 0)
    os.pwrite(held, f"{end}\n".encode(), 0)
    return held


def folder() -> Path:
    """The folder of the locks, which is made if it is missing: of no other user, and no link. Raises `Refused`."""
    runtime = os.environ.get(RUNTIME, "")
    if not (os.path.isabs(runtime) and _is_own(Path(runtime))):
        import pwd

        try:
            runtime = str(Path(pwd.getpwuid(os.geteuid()).pw_dir) / ".cache")
            os.makedirs(runtime, mode=0o700, exist_ok=True)
        except (KeyError, OSError) as error:
            raise Refused(f"there is no folder for the lock on a device ({error}); {_CURE}") from error
    path = Path(runtime) / FOLDER
    try:
        with suppress(FileExistsError):
            path.mkdir(mode=0o700)
        if not _is_own(path):
            raise Refused(f"{path}, where the locks on devices are, is a link, of another user, or open to others; "
                          f"remove it (rm -r {path}), or {_CURE}")
    except OSError as error:
        raise Refused(f"{path}, for the lock on a device, cannot be made ({error.strerror}); {_CURE}") from error
    return path


def _is_own(path: Path) -> bool:
    """True if it is a folder of this user that others may not enter."""
    try:
        found = path.lstat()
    except OSError:
        return False
    return stat.S_ISDIR(found.st_mode) and found.st_uid == os.geteuid() and not found.st_mode & _OTHERS
