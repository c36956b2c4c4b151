"""The rows of a sweep as a compiled kernel is given them: tile after tile in flat arrays.

A *tile* holds the rows that a kernel runs side by side: one, or as many as it has lanes. All numbers of all tiles stand
in flat arrays, tile after tile; within a tile number after number, each with its lanes. Schedules and paths are not
copied: a kernel gets their addresses. Many tiles go to one call, so that no Python runs meanwhile.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from teleop.sweeps.kernels.kernel import KernelOutput, RowInputs

Tile = list[tuple[RowInputs, tuple[int, int]]]  # rows with their lags, one for each lane


def call_kernel(kernel: Callable[..., Any], tiles: Sequence[Tile], figures: int) -> list[list[KernelOutput]]:
    """Run the rows of these tiles by a kernel; `figures`: their number for each row."""
    rows = [row for tile in tiles for row, _ in tile]
    if rows[0].flat is not None and rows[0].flat.arrays and len(tiles) > 1:  # arrays of its own for each tile
        return [outputs for tile in tiles for outputs in call_kernel(kernel, [tile], figures)]
    width, first = len(tiles[0]), rows[0]
    flats = [row.flat for row in rows if row.flat is not None]
    reals = np.frombuffer(b"".join([flat.reals for flat in flats])).reshape(len(tiles), width, -1)
    schedules = [row.schedule for row in rows]
    played = _for_each(schedules, lambda one: (address_of(one.orders[1]), address_of(one.orders[0])))
    paths = _for_each([row.path for row in rows], lambda path: [address_of(axis) for axis in path])
    lags = np.array([lag for tile in tiles for _, lag in tile], dtype=np.int64)
    sizes = np.maximum(lags.max(axis=1), _for_each(schedules, lambda one: (one.size,))[:, 0])
    out = np.empty(len(tiles) * (figures + 2) * width)
    kernel(len(tiles), by_lane(reals), np.array(flats[0].wholes, dtype=np.int64), tuple(flats[0].arrays), first.ticks,
           by_lane(played.reshape(len(tiles), width, 2)), by_lane(paths.reshape(len(tiles), width, -1)),
           np.array([1 << size.bit_length() for size in sizes.reshape(len(tiles), width).max(axis=1).tolist()],
                    dtype=np.int64),
           by_lane(lags.reshape(len(tiles), width, 2)), *first.windows, out)
    columns: list[Any] = out.reshape(len(tiles), figures + 2, width).transpose(0, 2, 1).tolist()
    return [[KernelOutput(int(column[0]), tuple(column[1:])) for column in tile] for tile in columns]


def _for_each(parts: Sequence[Any], numbers: Callable[[Any], Sequence[int]]) -> Any:
    """Whole numbers of each part as rows of an array; worked out once for a part that is there several times."""
    distinct = {id(part): part for part in parts}
    if len(distinct) == 1:
        return np.tile(np.array(numbers(parts[0]), dtype=np.int64), (len(parts), 1))
    worked_out = {key: numbers(part) for key, part in distinct.items()}
    return np.array([worked_out[id(part)] for part in parts], dtype=np.int64)


def by_lane(numbers: Any) -> Any:
    """Numbers (tile, row, number) as a flat array in the order tile, number, lane."""
    return np.ascontiguousarray(numbers.transpose(0, 2, 1)).ravel()


def address_of(array: Any) -> int:
    """Address in memory of an array's numbers."""
    address: int = array.ctypes.data
    return address
