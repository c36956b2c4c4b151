"""A path that is sampled as it is asked for: what moves beside a run without an end costs neither time nor memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import overload

BLOCK = 256  # samples at a time: 0.05 ms of a sine, of a tick's 1 ms

Sample = Callable[[int, int], tuple[Sequence[float], ...]]


class Blocks:
    """The samples of all axes of a path, of which no more than two blocks are kept.

    `sample(first, count)` gives for each axis those at the ticks first .. first+count-1.
    """

    def __init__(self, sample: Sample) -> None:
        self._sample = sample
        self._blocks: dict[int, tuple[Sequence[float], ...]] = {}

    def at(self, axis: int, k: int) -> float:
        """The sample of one axis at tick k, at least 0."""
        number, place = divmod(k, BLOCK)
        block = self._blocks.get(number)
        if block is None:
            block = self._sample(number * BLOCK, BLOCK)
            if len(self._blocks) > 1:  # one piece of the path has its ends in two blocks at most
                self._blocks.pop(min(self._blocks) if number > max(self._blocks) else max(self._blocks))
            self._blocks[number] = block
        return block[axis][place]


class Path(Sequence[float]):
    """Axis of a path (m) at the ticks 0 .. count-1, read by tick; beyond them it stays at its last position."""

    def __init__(self, blocks: Blocks, axis: int, count: int) -> None:
        self._blocks, self._axis, self._count = blocks, axis, count

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, k: int) -> float: ...
    @overload
    def __getitem__(self, k: slice) -> Sequence[float]: ...
    def __getitem__(self, k: int | slice) -> float | Sequence[float]:
        if isinstance(k, slice):
            return [self[i] for i in range(*k.indices(self._count))]
        return self._blocks.at(self._axis, min(k, self._count - 1))

    def __iter__(self) -> Iterator[float]:
        return map(self.__getitem__, range(self._count))


class Speeds:
    """The speeds (m/s) on the left of the ticks of a `Path`: 0 at the first, and beyond the last."""

    def __init__(self, path: Path, dt: float) -> None:
        self._path, self._dt = path, dt

    def __getitem__(self, k: int) -> float:
        return (self._path[k] - self._path[k - 1]) / self._dt if k else 0.0
