"""Markers of a session for other recorders, as a stream of Lab Streaming Layer (extra `lsl`)."""

from __future__ import annotations

from collections.abc import Callable

from teleop.errors import Refused

NEEDS = ("--lsl needs pylsl, which is not installed; type pip install 'bilateral-teleop[lsl]', or leave --lsl out")


def silent(text: str) -> None:
    """Send no marker."""


def lsl_markers(study: str, participant: int) -> Callable[[str], None]:
    """Open a stream of markers; return the function that sends one. Raises `Refused` without pylsl.

    Markers name trials and intervals, never a condition.
    """
    try:
        from pylsl import StreamInfo, StreamOutlet
    except (ImportError, RuntimeError) as error:  # the library that it loads may be missing
        raise Refused(NEEDS) from error
    outlet = StreamOutlet(StreamInfo(f"teleop-{study}", "Markers", 1, 0.0, "string", f"{study}-sub-{participant:02d}"))
    return lambda text: outlet.push_sample([text])
