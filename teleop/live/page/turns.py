"""When the running system is turned: one turn at a time, and of what is asked for meanwhile the newest.

Both ends answer a turn with `turned`, the channel too; 0.2 s after all have, the next may go. Without an answer, or
with one that refuses, the three can no longer be known to agree, and are started anew.
"""

from __future__ import annotations

from typing import NamedTuple

from teleop.live.page.controls import Choice

REST = 0.2  # s between two turns
PATIENCE = 8.0  # s for all to answer: a hand that is aligned takes its time
NAMES = frozenset({"channel", "slave", "master"})


class Turn(NamedTuple):
    """What the three are told. `again`: from the scene's start."""

    choice: Choice
    again: bool


class Turns:
    """Times are in s. `choice`: what the three run with, or will when they have answered."""

    def __init__(self, choice: Choice) -> None:
        self.choice = choice
        self.under_way: Turn | None = None
        self._before = choice  # what they ran with before the turn that is under way
        self._waiting: Turn | None = None
        self._answers: set[str] = set()
        self._since = float("-inf")  # when the turn began, or was over

    @property
    def wanted(self) -> Choice:
        """What has been asked for last."""
        return self.choice if self._waiting is None else self._waiting.choice

    def ask(self, choice: Choice, *, again: bool = False, align: bool = False) -> None:
        """Ask for a turn; that it is to begin again is not forgotten over a later one.

        `align`: turn though nothing is another, for the master to be brought to the slave.
        """
        again = again or (self._waiting is not None and self._waiting.again)
        self._waiting = Turn(choice, again) if again or align or choice != self.choice else None

    def next(self, now: float) -> Turn | None:
        """The turn that is to be told now, if there is one; it is under way from then on."""
        if self.under_way is not None or self._waiting is None or now - self._since < REST:
            return None
        self.under_way, self._waiting = self._waiting, None
        self._before, self.choice = self.choice, self.under_way.choice
        self._answers, self._since = set(), now
        return self.under_way

    def answered(self, name: str, now: float) -> Turn | None:
        """One of the three has turned; the turn, if it was the last of them."""
        self._answers.add(name)
        if self.under_way is None or not self._answers >= NAMES:
            return None
        done, self.under_way, self._since = self.under_way, None, now
        return done

    def late(self, now: float) -> bool:
        """True if a turn has been under way for too long."""
        return self.under_way is not None and now - self._since > PATIENCE

    def give_up(self) -> None:
        """The turn that is under way has failed; the choice is that of before."""
        self.under_way, self.choice = None, self._before

    def begin(self, now: float) -> None:
        """All three were started anew, with what has been asked for last."""
        self.choice, self._waiting, self.under_way, self._since = self.wanted, None, None, now
