"""The engine `vector`: a kernel compiled by numba that runs eight scenes side by side over the whole horizon.

The eight share their structure, their number of ticks and every whole number; each float has a lane for each of them.
Where they share their link's schedule and their hand's path too, these are read once for all eight.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from teleop.batch.compiled import module
from teleop.batch.kernel import Inputs, Kernel, Told
from teleop.batch.lane_parts import NotVectorised, lane_end, lane_part
from teleop.batch.lanes import WIDTH
from teleop.batch.lanewise import came, load, some, spread, where, whole, within
from teleop.batch.rings import ago, packet, power_of_two, received, ring, sample, sent, tell
from teleop.bodies import Bodies
from teleop.scene import Scene
from teleop.tick import features

__all__ = ["WIDTH", "ago", "came", "lane_end", "lane_part", "load", "packet", "received", "ring", "sample",
           "sent", "some", "spread", "tell", "where", "whole", "within"]

FEATURES = frozenset({"compiled", "lanes"})
REAL = f"load(reals, {{}} * {WIDTH})"
CALL = """\
    loop(given, law, dt, count, x_limit, start_m, start_s, play_m, play_s, size, ref, held, lag_x, lag_f, out,
         spread(0.0))"""
SOURCES = ("teleop.batch.lanes", "teleop.batch.lanewise", "teleop.batch.rings", "teleop.batch.lane_parts",
           "teleop.batch.vector")
OF_THE_LAW = ("begin_", "law_", "sums_")


def maker(word: str) -> str:
    """What makes the part called `word`."""
    return "lane_end" if word.startswith(OF_THE_LAW) else "lane_part"


def vector(scene: Scene, bodies: Bodies, measures: Sequence[str]) -> Kernel:
    """The kernel of a scene's structure. Raises `NotVectorised` where that has no lanes, `NotCompiled` as `scalar`."""
    import numpy as np

    if features(scene) & {"inner_m", "inner_s"}:
        raise NotVectorised("a body with an inner state is moved one scene at a time")
    loop = module(scene, bodies, measures, "vector").kernel

    def run(rows: Sequence[Inputs], lags: Sequence[tuple[int, int]]) -> list[Told]:
        told: list[Told] = []
        for first in range(0, len(rows), WIDTH):
            told += tile(rows[first:first + WIDTH], lags[first:first + WIDTH])
        return told

    def tile(rows: Sequence[Inputs], lags: Sequence[tuple[int, int]]) -> list[Told]:
        count = len(rows)
        rows = [*rows, *[rows[-1]] * (WIDTH - count)]  # lanes without a row of their own repeat the last
        lags = [*lags, *[lags[-1]] * (WIDTH - count)]
        one, alike = rows[0], all(row.water is rows[0].water and row.path is rows[0].path for row in rows)
        flats = [row.flat for row in rows if row.flat is not None]
        size = power_of_two(max([row.water.size for row in rows] + [max(lag) for lag in lags]))
        out = np.empty((len(measures) + 2) * WIDTH)
        reals = np.array([flat.reals for flat in flats]).T.ravel()
        wholes = np.array(flats[0].wholes, dtype=np.int64)
        if alike and all(lag == lags[0] for lag in lags):
            forth, back = one.water.plays
            loop(reals, wholes, (), one.ticks, back, forth,
                 size, one.path, *lags[0], out)
        else:
            forths, backs = zip(*[row.water.plays for row in rows], strict=True)
            paths = tuple(zip(*[row.path for row in rows], strict=True))
            lag_x, lag_f = zip(*lags, strict=True)
            loop(reals, wholes, (), one.ticks, backs, forths,
                 size, paths, lag_x, lag_f, out)
        columns: Any = out.reshape(-1, WIDTH).T[:count].tolist()
        return [Told(int(column[0]), tuple(column[1:])) for column in columns]

    return Kernel("vector", tuple(measures), run, WIDTH)
