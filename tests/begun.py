"""Sessions that have begun, for tests that are not about the exchange."""

from __future__ import annotations

from teleop.protocol.session import Session
from teleop.protocol.states import SessionState


def begin(session: Session, start_ns: int, now: int) -> None:
    """Begin a session on the grid whose tick 0 is at `start_ns`, as if the exchange had been done."""
    session.state = SessionState.ASKING if session.master else SessionState.ASKED
    assert session.begin(start_ns, now)
