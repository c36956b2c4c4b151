"""An asyncio loop that calls its timers' readers from within its selector.

To asyncio a timer that rings is a readable file: a key to look up, a list of events, a handle that is queued and run in
a context, and all that a thousand times a second with cold caches. Here the selector calls the reader itself and
returns what else there is, which is nearly always nothing.
"""

from __future__ import annotations

import asyncio
import gc
import select
import selectors
from collections.abc import Callable, Coroutine
from contextlib import suppress
from typing import Any

_MOST = 16  # events in one call
_LOOK_S = 0.1  # without any event, after which it is looked whether the timers are still there


if hasattr(select, "epoll"):

    class _Ringing(selectors.EpollSelector):
        """`readers`: by the file of a timer, what is called when it rings."""

        def __init__(self) -> None:
            super().__init__()
            self.readers: dict[int, Callable[[], None]] = {}
            self.epoll: Any = self._selector  # type: ignore[attr-defined]  # typeshed lacks it

        def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
            """What is ready besides timers, which are dealt with."""
            readers = self.readers
            if not readers:
                return super().select(timeout)
            ready: list[tuple[selectors.SelectorKey, int]] = []
            longest = _LOOK_S if timeout is None else min(max(timeout, 0.0), _LOOK_S)
            try:
                events = self.epoll.poll(longest, _MOST)
            except InterruptedError:
                return ready
            if not events and longest == _LOOK_S:
                for fd in readers:
                    self.epoll.modify(fd, select.EPOLLIN)  # raises OSError if somebody has closed that timer
            for fd, event in events:
                if fd in readers:
                    readers[fd]()
                else:
                    key = self.get_map()[fd]
                    mask = (selectors.EVENT_WRITE if event & ~select.EPOLLIN else 0) | (
                        selectors.EVENT_READ if event & ~select.EPOLLOUT else 0)
                    ready.append((key, mask & key.events))
            return ready


class TickLoop(asyncio.SelectorEventLoop):
    """asyncio's own loop with `ring`. Only where there is epoll, which `available` tells."""

    available = hasattr(select, "epoll")

    def __init__(self) -> None:
        self._ringing = _Ringing()
        super().__init__(self._ringing)

    def ring(self, fd: int, reader: Callable[[], None]) -> None:
        """Call `reader` whenever the timer behind `fd` rings; what it raises is reported as asyncio does."""
        def call() -> None:
            try:
                reader()
            except Exception as error:
                self.call_exception_handler({"message": "a timer's reader raised", "exception": error})

        self._ringing.readers[fd] = call
        self._ringing.epoll.register(fd, select.EPOLLIN)

    def ring_no_more(self, fd: int) -> None:
        """Forget that timer."""
        del self._ringing.readers[fd]
        with suppress(OSError):  # others have closed it
            self._ringing.epoll.unregister(fd)


def in_tick_loop(main: Coroutine[Any, Any, None], failed: Callable[[BaseException], None] = lambda _: None) -> None:
    """`asyncio.run`, in such a loop where there can be one; `failed` is told what ended it before it is taken down."""
    with asyncio.Runner(loop_factory=TickLoop if TickLoop.available else None) as runner:
        try:
            runner.run(main)
        except BaseException as error:
            failed(error)
            gc.freeze()  # a loop whose files are gone cannot be closed, and would say so when it is collected
            raise
