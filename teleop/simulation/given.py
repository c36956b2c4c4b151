"""The numbers that a run of the tick is given, nested: by end, then by stage."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

from teleop.scene.scene import Scene
from teleop.simulation.structure import EndStructure, structure_of


def numbers_of(scene: Scene, starts: Mapping[str, Sequence[float]]) -> Any:
    """A NamedTuple of an entry for each of these ends, a NamedTuple of what each of its stages is given.

    `starts`: where each end starts, m, per axis.
    """
    dt = scene.dt_ns / 1e9
    ends = {}
    for e, start in starts.items():
        own: EndStructure = getattr(structure_of(scene), e)
        places = list(start)
        found = {stage.name: stage.given(scene, e, dt, places) for stage in own.stages}
        ends[e] = record("GivenEnd", tuple(found))(*found.values())
    return record("Given", tuple(ends))(*ends.values())


@lru_cache
def record(name: str, names: tuple[str, ...]) -> Any:
    """A NamedTuple of these fields: one and the same class whenever it is asked for."""
    return namedtuple(name, names)
