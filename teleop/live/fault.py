"""What ended a run that nothing should have ended: which part raised it, in one sentence, and its traceback in a file.

The event loop logs an exception out of a callback and goes on, and passes KeyboardInterrupt and SystemExit through
everything; CancelledError and the panics of compiled extensions are no `Exception`. So a live end takes whatever is
raised, of any type, for a fault: no force at once, the end of the run, this sentence.
"""

from __future__ import annotations

import traceback
from collections.abc import Iterable
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

from teleop.errors import Refused
from teleop.law.contract import Method, refusal
from teleop.live.devices.guarded_device import GuardedDevice
from teleop.live.records.record import RecordWriter
from teleop.protocol.endpoint import Endpoint
from teleop.protocol.packet import one_line

FILE = "error.txt"
PARTS: dict[CodeType, str] = {
    GuardedDevice.read.__code__: "the device, asked for a reading,",
    GuardedDevice.hold.__code__: "the device, given a force,",
    Endpoint.tick.__code__: "the law",
    Endpoint.receive.__code__: "the reading of a packet",
    **{part.__code__: "the record"
       for part in (RecordWriter.begin, RecordWriter.add, RecordWriter.note, RecordWriter.flush)},
}


def part_of(frames: Iterable[FrameType]) -> str | None:
    """The part that the innermost of these frames, which come last, is in; None of no part that has a name here."""
    found = [PARTS[frame.f_code] for frame in frames if frame.f_code in PARTS]
    return found[-1] if found else None


def sentence(error: BaseException, law: Any = None, method: str = "") -> str:
    """The part that raised `error`, and its text; a method of `law` with the line in its file.

    `method`: the law's method at this end; an error that comes of using its answer names it.
    """
    if isinstance(error, Refused):
        return str(error)
    if law is not None and (refused := refusal(law, error)) is not None:
        return str(refused)
    part = part_of(frame for frame, _ in traceback.walk_tb(error.__traceback__))
    if law is not None and part == PARTS[Endpoint.tick.__code__]:
        part = f"the answer of {Method(law, method).label}{Method(law, method).first_line()}"
    detail = f": {text}" if (text := one_line(_text(error))) else ""
    return f"{part or 'the live loop'} raised {type(error).__name__}{detail}"


def named(function: Any, part: str) -> None:
    """Call the part that `function` belongs to `part` in sentences."""
    PARTS[function.__code__] = part


def _text(error: Any) -> str:
    try:
        return str(error)
    except BaseException:  # an exception's own __str__ may be what is broken
        return ""


def write(error: BaseException, folder: Path) -> None:
    """The traceback, for the author of the part; raises OSError if the disk takes no more."""
    (folder / FILE).write_text("".join(traceback.format_exception(error)), errors="backslashreplace")
