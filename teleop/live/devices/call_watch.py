"""Watch over the calls of a device under test: one that does not return ends the process, with a sentence."""

from __future__ import annotations

import faulthandler
import os
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Event, Thread

from teleop.live.devices.guarded_device import GuardedDevice
from teleop.terminal.options import FAULT, FORCED, complain

BLOCKED_S, LOOK_S, LET_GO_S = 1.2, 0.1, 0.3  # a call that takes so long does not return; between looks; to set zero
STUCK_S = 1.8  # without a look, where compiled code keeps Python's lock


class CallWatch:
    """A thread that ends the process where a call of the device does not return."""

    def __init__(self, device: str) -> None:
        self.guarded: GuardedDevice | None = None  # whose force is to be zero then
        self._device = device
        self._call, self._calls = "", 0
        self._done = Event()

    def __enter__(self) -> CallWatch:
        self._arm()
        self._thread = Thread(target=self._look, name="call watch", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._done.set()
        self._thread.join()

    @contextmanager
    def calling(self, method: str) -> Iterator[None]:
        """Look after one call."""
        self._calls += 1
        self._call = method
        try:
            yield
        finally:
            self._call = ""

    def _look(self) -> None:
        """Count the looks that find the same call; time that this thread stood still itself does not count."""
        seen, looks = 0, 0
        try:
            while not self._done.wait(LOOK_S):
                self._arm()
                looks = looks + 1 if self._call and self._calls == seen else 0
                seen = self._calls
                if looks * LOOK_S >= BLOCKED_S:
                    self._end()
        finally:
            faulthandler.cancel_dump_traceback_later()

    @staticmethod
    def _arm() -> None:
        """Have the process end with a traceback if no look is taken: this needs no lock of Python's."""
        faulthandler.dump_traceback_later(STUCK_S, exit=True, file=2)

    def _end(self) -> None:
        faulthandler.cancel_dump_traceback_later()
        method, guarded, took = self._call or "call", self.guarded, list[bool]()
        forced = guarded is not None and guarded.forced
        if guarded is not None:
            worker = Thread(target=lambda: took.append(guarded.let_go()), daemon=True)
            worker.start()
            worker.join(LET_GO_S)
        zero = took == [True]
        force = ("its force was set to zero" if zero else "it did not take zero force either, and the force may still "
                 "be on: switch it off" if forced else "no force was on")
        complain(f"{self._device}: its {method} did not return for {BLOCKED_S:g} s, and a live end stands still for as "
                 f"long; let a thread of the device do the waiting, or have {method} raise DeviceError after a short "
                 f"timeout of its driver ({force})", FAULT)
        os._exit(FORCED if forced and not zero else FAULT)
