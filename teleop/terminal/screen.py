"""What a person sees of a text: on a terminal with its colours and folded between words, elsewhere as it is."""

from __future__ import annotations

import os
from typing import TextIO

from teleop.terminal import colour
from teleop.terminal.table import folded


def shown(text: str, stream: TextIO) -> str:
    """The text of an answer as it is printed on `stream`."""
    width = columns(stream) if stream.isatty() else 0
    return colour.answer(folded(text, width) if width else text, stream)


def columns(stream: TextIO) -> int:
    """The width of the terminal behind `stream`; 0 where it cannot be told."""
    try:
        return os.get_terminal_size(stream.fileno()).columns
    except (OSError, ValueError):
        return 0
