"""The states of a session, and the table that says which event leads from which state to which.

`MASTER` and `SLAVE` are all there is to it: an event that a state has no line for is ignored, in `Session.take` and
nowhere else. The diagrams in `teleop/protocol/README.md` are made from the two tables, by

    python -m tests.teleop.protocol.diagrams

and a test compares them. The form is that of h11's `_state.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import NamedTuple


class SessionState(Enum):
    """State of an end in its exchange with the other; each value is a sentence for the diagram's legend."""

    __hash__ = object.__hash__  # `Enum` has one in Python, and the tables are asked at every datagram

    LISTENING = "the slave waits for a master"
    ASKED = "the slave has answered a HELLO and waits for START"
    ASKING = "the master asks for its first session and measures the clock offset"
    STARTING = "the session runs; the master repeats START until the slave has answered it"
    RUNNING = "the session runs"
    OVER = "the session is over for this end: it sends and takes no message of the law"
    RENEWING = "the master, whose device holds no force, asks for the next session"
    REFUSED = "the two ends are not set up for the same run; this end stops"


class SessionEvent(Enum):
    """Event of a session, once the packet or the instant has been checked."""

    __hash__ = object.__hash__

    HELLO = "HELLO came, and the slave may answer it"
    WELCOME = "WELCOME came"
    BEGIN = "tick 0 is known: by enough WELCOMEs at the master, by START at the slave"
    START = "START of this very session came again, or its answer"
    DATA = "a message of the law came"
    BYE = "BYE came: the reason is kept"
    REFUSE = "the manifests differ, or REFUSE came"
    END = "silence, no echo, a stall, RENEW, or the master's next HELLO ended the session"
    ZERO_FORCE = "this end's device holds no force"


class Cause(Enum):
    """Cause for which an end holds no force: see `teleop.protocol.guard`."""

    __hash__ = object.__hash__

    SILENCE = "no fresh packet came for the watchdog's timeout"
    AGE = "messages come, older than the watchdog allows"
    NO_ANSWER = "the other end has not heard this one for the watchdog's timeout"
    STALL = "this end did not tick for the watchdog's timeout, or its device let the force lapse"
    DEVICE = "the device fails, or its reading is not finite"
    CLOCK = "the clock of the grid of ticks went back"
    SESSION_OVER = "the session is over"
    ORDERED = "a person ended the session, at this end or the other: another law is to come, or the clutch is open"
    ASKED_AGAIN = "the session is over, for the master asks for another"
    STOOD_STILL = "the session is over, for this end stood still"
    NEW_SESSION = "another session begins, or the first one away from where the scene begins"


class Reason(NamedTuple):
    """A cause, and the sentence on it."""

    cause: Cause
    why: str


Table = Mapping[tuple[SessionState, SessionEvent], SessionState]
_S, _E = SessionState, SessionEvent

MASTER: Table = {
    (_S.ASKING, _E.WELCOME): _S.ASKING,
    (_S.ASKING, _E.BEGIN): _S.STARTING,
    (_S.ASKING, _E.BYE): _S.ASKING,
    (_S.ASKING, _E.REFUSE): _S.REFUSED,
    (_S.STARTING, _E.START): _S.RUNNING,
    (_S.STARTING, _E.DATA): _S.RUNNING,
    (_S.STARTING, _E.BYE): _S.STARTING,
    (_S.STARTING, _E.END): _S.OVER,
    (_S.RUNNING, _E.START): _S.RUNNING,
    (_S.RUNNING, _E.DATA): _S.RUNNING,
    (_S.RUNNING, _E.BYE): _S.RUNNING,
    (_S.RUNNING, _E.END): _S.OVER,
    (_S.OVER, _E.BYE): _S.OVER,
    (_S.OVER, _E.ZERO_FORCE): _S.RENEWING,
    (_S.RENEWING, _E.WELCOME): _S.RENEWING,
    (_S.RENEWING, _E.BYE): _S.RENEWING,
    (_S.RENEWING, _E.BEGIN): _S.STARTING,
}

SLAVE: Table = {
    (_S.LISTENING, _E.HELLO): _S.ASKED,
    (_S.ASKED, _E.HELLO): _S.ASKED,
    (_S.ASKED, _E.BEGIN): _S.RUNNING,
    (_S.ASKED, _E.BYE): _S.ASKED,
    (_S.ASKED, _E.REFUSE): _S.REFUSED,
    (_S.RUNNING, _E.HELLO): _S.RUNNING,
    (_S.RUNNING, _E.BEGIN): _S.RUNNING,
    (_S.RUNNING, _E.START): _S.RUNNING,
    (_S.RUNNING, _E.DATA): _S.RUNNING,
    (_S.RUNNING, _E.BYE): _S.RUNNING,
    (_S.RUNNING, _E.END): _S.OVER,
    (_S.OVER, _E.HELLO): _S.OVER,
    (_S.OVER, _E.BEGIN): _S.RUNNING,
    (_S.OVER, _E.START): _S.OVER,
    (_S.OVER, _E.BYE): _S.OVER,
}

CARRIES_DATA = frozenset((_S.STARTING, _S.RUNNING))
"""The states in which messages of the law are sent and taken."""

MEETING = frozenset((_S.LISTENING, _S.ASKED, _S.ASKING, _S.RENEWING, _S.REFUSED))
"""The states in which an exchange has yet to be done."""
