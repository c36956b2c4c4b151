"""A page of memory by which a policy of another process sends its actions to the master's end of a live run.

The end makes the file `policy.page` in its run's folder, and looks there at each tick: it costs no call of the system,
and no tick waits for whoever writes. Whoever may write in the folder may write there. The words:

    number (odd while somebody writes), switch (how often it was set, times 2, and 1 if it is on), actions so far, axes,
    the action

A policy that is gone sends no more, and gives way: see `teleop.stages.handover`.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from mmap import ACCESS_WRITE, mmap
from pathlib import Path
from types import TracebackType
from typing import Any

from teleop.errors import Refused, number, number_of
from teleop.protocol.policy import PolicyWord

NAME = "policy.page"
HEAD = 4  # words
SIZE = 8 * (HEAD + 16)


class PolicyPage:
    """The end's side of the page, in the folder of its run while it lasts."""

    def __init__(self, folder: Path, axes: int) -> None:
        self._path, self._axes = folder / NAME, axes
        with self._path.open("wb+") as file:
            file.write(bytes(SIZE))
            file.flush()
            self._page = mmap(file.fileno(), SIZE)
        self._words, self._reals = _words_of(self._page)
        self._words[3] = axes
        self._number = self._switch = self._count = 0

    def read(self) -> PolicyWord | None:
        """Message written since the last call; None: there is none, or somebody is writing it just now."""
        words = self._words
        seen = words[0]
        if seen == self._number or seen % 2:
            return None  # nearly always
        switch, count, action = words[1], words[2], tuple(self._reals[HEAD:HEAD + self._axes])
        if words[0] != seen:
            return None
        word = PolicyWord(switch % 2 == 1 if switch != self._switch else None, action if count != self._count else None)
        self._number, self._switch, self._count = seen, switch, count
        return word

    def __enter__(self) -> PolicyPage:
        return self

    def __exit__(self, _kind: type[BaseException] | None, _error: BaseException | None,
                 _trace: TracebackType | None) -> None:
        self._words.release()
        self._reals.release()
        self._page.close()
        with suppress(OSError):
            self._path.unlink()


class PolicyWriter:
    """Sends a policy's actions to the master's end of the live run in `folder`, which a demo or that end writes.

    Its scene has a `Handover`. Raises `Refused` where no such end runs there.
    """

    def __init__(self, folder: Path | str) -> None:
        tried = [Path(folder) / NAME, Path(folder) / "master" / NAME]
        path = next((each for each in tried if each.is_file()), None)
        if path is None:
            raise Refused(f"{folder} is no folder of a master that runs and takes a policy's actions; give that of a "
                          "run of a scene with handover=Handover(), for example: teleop demo handover")
        with path.open("rb+") as file:
            self._page = mmap(file.fileno(), SIZE, access=ACCESS_WRITE)
        self._words, self._reals = _words_of(self._page)
        self.axes = self._words[3]

    def send(self, to: Sequence[float]) -> None:
        """Send the next action: where the handle is to be, m or rad, one for each axis. Raises `Refused`."""
        if isinstance(to, str) or len(to) != self.axes:
            raise Refused(f"an action has one number for each of {number_of(self.axes, 'axis', 'axes')}, and this has "
                          f"{len(to)}; send one for each")
        action = [number(f"to[{i}]", each) for i, each in enumerate(to)]
        self._write(None, action)

    def switch(self, on: bool) -> None:
        """Switch the policy on, by which it has authority with its next action, or off."""
        self._write(on, None)

    def _write(self, on: bool | None, action: list[float] | None) -> None:
        words, seen = self._words, self._words[0] | 1
        words[0] = seen
        if on is not None:
            words[1] = (words[1] // 2 + 1) * 2 + on
        if action is not None:
            for i, each in enumerate(action):
                self._reals[HEAD + i] = each
            words[2] += 1
        words[0] = seen + 1

    def close(self) -> None:
        """Let go of the page; the policy is as its switch was left."""
        self._words.release()
        self._reals.release()
        self._page.close()


def _words_of(page: mmap) -> tuple[memoryview, Any]:
    """The page as whole numbers and as real ones."""
    plain = memoryview(page)
    return plain.cast("q"), plain.cast("d")
