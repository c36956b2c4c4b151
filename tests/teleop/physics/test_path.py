"""A path that is sampled as it is asked for."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pytest

from teleop.physics.carried import Carried, carried
from teleop.physics.contact import wall
from teleop.physics.path import BLOCK, Blocks, Path, Speeds
from teleop.physics.plant import MassDamper
from teleop.physics.relaxing import relaxing

DT = 1e-3
BODY = MassDamper(mass=0.5, damping=1.0)


class Asked:
    """A sine along two axes, which notes what is asked of it."""

    def __init__(self) -> None:
        self.calls: list[tuple[int, int]] = []

    def __call__(self, first: int, count: int) -> tuple[Sequence[float], ...]:
        self.calls.append((first, count))
        wave = [0.03 * math.sin(0.01 * k) for k in range(first, first + count)]
        return wave, [2.0 * y for y in wave]


def test_it_gives_what_sampling_all_of_it_would_give() -> None:
    whole = Asked()(0, 1000)
    blocks = Blocks(Asked())
    paths = [Path(blocks, axis, 1000) for axis in (0, 1)]
    for axis, path in enumerate(paths):
        assert list(path) == whole[axis]
        assert path[3:9] == whole[axis][3:9]
        assert len(path) == 1000


def test_beyond_its_end_it_stays() -> None:
    path = Path(Blocks(Asked()), 0, 700)
    assert path[5000] == path[700] == path[699] != path[698]
    assert Speeds(path, DT)[700] == 0.0 != Speeds(path, DT)[699]


def test_a_day_of_it_costs_what_is_read_of_it() -> None:
    asked = Asked()
    path = Path(Blocks(asked), 0, 86_400_001)
    assert asked.calls == []
    for k in range(3 * BLOCK):
        path[k], path[k + 1], path[max(0, k - 1)]
    assert asked.calls == [(i * BLOCK, BLOCK) for i in range(4)], "each block once, and none ahead of time"
    assert path[86_400_000] == 0.03 * math.sin(0.01 * 86_400_000)
    assert len(asked.calls) == 5


@pytest.mark.parametrize("inner", [False, True])
def test_an_environment_that_is_carried_along_it_moves_to_the_bit_as_along_its_list(inner: bool) -> None:
    still = (relaxing(BODY, DT, k=300.0, k1=2000.0, tau=0.02, at=0.0) if inner else
             wall(BODY, DT, k=5000.0, d=5.0, at=0.0, side=1.0))
    listed = carried(still, Asked()(0, 701)[0], BODY, DT)
    read = carried(still, Path(Blocks(Asked()), 0, 701), BODY, DT)
    assert read.start == listed.start
    assert Carried(*read.c).last == Carried(*listed.c).last == 700
    a, b = (0.0, 0.0, listed.start), (0.0, 0.0, read.start)
    touched = 0
    for k in range(900):
        f = 5.0 * math.sin(0.02 * k)
        a, b = (one.move(one.c, x, v, f, z) for one, (x, v, z) in ((listed, a), (read, b)))
        a, b = (a[0], a[1], a[3]), (b[0], b[1], b[3])
        assert a == b
        force = listed.force(listed.c, *a)
        assert force == read.force(read.c, *b)
        touched += force != 0.0
    assert touched > 30
