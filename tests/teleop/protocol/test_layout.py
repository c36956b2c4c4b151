"""The numbers of a law's messages in a packet come out as they went in; a total of coupled axes goes once."""

from __future__ import annotations

from typing import NamedTuple

import pytest

from teleop import kind
from teleop.protocol.packet import Layout


class Mixed(NamedTuple):
    E: kind.Total
    x: float
    S: kind.Total
    v: float


def message(i: int, **shared: float) -> Mixed:
    return Mixed(10.0 + i, 20.0 + i, 30.0 + i, 40.0 + i)._replace(**shared)


@pytest.mark.parametrize("axes", [1, 2, 3])
def test_messages_of_axes_that_are_not_coupled_are_all_there(axes: int) -> None:
    layout, sent = Layout(Mixed, axes, couples=False), tuple(message(i) for i in range(axes))
    assert layout.width == 4 * axes
    assert layout.messages((*layout.flat(sent), 7.0, 8.0)) == sent


@pytest.mark.parametrize("axes", [1, 2, 3])
def test_a_total_of_coupled_axes_goes_once(axes: int) -> None:
    layout = Layout(Mixed, axes, couples=True)
    sent = tuple(message(i, E=1.5, S=2.5) for i in range(axes))
    numbers = layout.flat(sent)
    assert len(numbers) == layout.width == 4 + 2 * (axes - 1)
    assert layout.messages((*numbers, 7.0)) == sent
    assert all(type(one) is Mixed for one in layout.messages(numbers))


def test_whole_numbers_of_a_law_are_sent_as_floats() -> None:
    assert [type(number) for number in Layout(Mixed, 1, couples=False).flat((Mixed(1, 2, 3, 4),))] == [float] * 4
