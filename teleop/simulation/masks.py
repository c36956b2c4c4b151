"""Masks: what generated text says in place of a branch where several scenes run side by side.

A mask is a truth for each scene. Here is what each word means of one scene; `teleop.sweeps.kernels.lanes` prints what
it means of several.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


def select(mask: Any, here: Any, otherwise: Any) -> Any:
    """`here` where the mask is true, else `there`: numbers, or tuples of such."""
    return here if mask else otherwise


def invert(mask: Any) -> Any:
    """The mask that is true where this one is not."""
    return not mask


def any_lane(mask: Any) -> bool:
    """True if the mask is true of any scene."""
    return bool(mask)


def broadcast(tree: Any) -> Any:
    """A number, or a tuple of such, for each scene."""
    return tree


def one_by_one(mask: Any, function: Callable[..., Any], otherwise: Any, *arguments: Any) -> Any:
    """The function's answer where the mask is true, else `otherwise`; it is asked for one scene after the other."""
    return function(*arguments) if mask else otherwise


def put_selected(mask: Any, ring: Any, k: Any, size: int, message: Any) -> None:
    """`teleop.stages.memory.put` where the mask is true."""
    if mask:
        ring[k % size] = message


def store(out: Any, mask: Any, ran: int, figures: tuple[Any, ...]) -> None:
    """Write how many ticks ran, and the figures, where the mask is true."""
    if mask:
        out[:] = ran, *figures
