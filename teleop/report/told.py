"""What a folder holds, as all kinds of folders are told of."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from teleop.report.page import Section
from teleop.simulation.result import Result
from teleop.terminal.answer import Answer


class Told(NamedTuple):
    """A folder: what the terminal says of it, and either its run or what makes its part of the page."""

    folder: Path
    answer: Answer
    result: Result | None = None
    running: bool = False  # it is of a run or a sweep that goes on: there is no page of it yet
    section: Callable[[], Section] | None = None
