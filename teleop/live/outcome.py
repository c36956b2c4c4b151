"""How a live run ended: its status, its sentence, and what a part of it raised."""

from __future__ import annotations

import asyncio

from teleop.live.records.end_result import UNRELEASED

MAY_BE_ON = "THE FORCE MAY STILL BE ON, switch the device off"


class Outcome:
    """The end of one run: `status` (ok, stopped, diverged, refused or unreleased), its `sentence`, and `over`.

    `fault`: what a part of the end raised, of which the run has ended; None if nothing did.
    """

    def __init__(self) -> None:
        self.status = "stopped"
        self.sentence = "did not start"
        self.over = asyncio.Event()
        self.fault: BaseException | None = None

    def end(self, status: str, sentence: str) -> None:
        """The run is over; the first call counts."""
        if not self.over.is_set():
            self.status = status
            self.sentence = sentence
            self.over.set()

    def fail(self, error: BaseException, why: str, t: float) -> None:
        """The run is over at time `t` (s), for a part of the end raised `error`; the first error counts."""
        if self.fault is None:
            self.fault = error
            if self.status != UNRELEASED:  # which weighs more
                self.status = "stopped"
                self.sentence = f"stopped at t = {t:.3f} s: {why}"
        self.over.set()

    def unreleased(self, why: str) -> None:
        """The device did not take zero force."""
        self.status = UNRELEASED
        self.sentence += f"; {why}: {MAY_BE_ON}"
