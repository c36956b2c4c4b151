"""A link in figures: the delay, jitter and loss of each direction, and the playouts that are worth trying over it."""

from __future__ import annotations

from math import ceil
from typing import NamedTuple

import numpy as np

from teleop.errors import Refused
from teleop.scene.scene import Scene
from teleop.terminal.units import si

LATE = 0.995  # of the packets that come, which a fixed playout delay is to play


class OneWay(NamedTuple):
    """What one direction does to packets, over the run of a scene. SI units."""

    least: float
    median: float
    late: float  # the delay that `LATE` of them keep to
    greatest: float
    lost: float  # share

    def text(self) -> str:
        """The direction in words."""
        if self.greatest - self.least < 1e-9:
            delay = si(self.median, "s")
        else:
            delay = (f"{si(self.median, 's')} median ({si(self.least, 's')} to {si(self.greatest, 's')}, "
                     f"{LATE:.1%} within {si(self.late, 's')})")
        return f"{delay}, {self.lost:.1%} of packets lost"


def one_way(scene: Scene, direction: int, seed: int) -> OneWay:
    """What direction 0 (forward) or 1 does in a run of `scene`. Raises `Refused` if nothing comes."""
    if scene.link is None:
        return OneWay(scene.dt, scene.dt, scene.dt, scene.dt, 0.0)
    came = scene.link.arrivals(direction, scene.ticks, scene.dt_ns, seed, scene.wire_size)
    if not len(came.packet):
        way = ("forward", "backward")[direction]
        raise Refused(f"nothing gets through the link {way} within {scene.duration:g} s, so no law can do anything; "
                      "give another part of the recording, or another --link")
    ages = (came.time_ns - came.packet * scene.dt_ns) / 1e9
    lost = 1.0 - len(np.unique(came.packet)) / scene.ticks
    late = float(np.quantile(ages, LATE, method="higher"))
    return OneWay(float(ages.min()), float(np.median(ages)), late, float(ages.max()), lost)


def link_text(ways: tuple[OneWay, OneWay]) -> str:
    """Both directions in words."""
    near = all(abs(a - b) <= 0.02 * max(abs(a), abs(b)) + 5e-3 for a, b in zip(*ways, strict=True))
    return f"{ways[0].text()}, each way" if near else f"forward {ways[0].text()}; backward {ways[1].text()}"


def playouts_for(scene: Scene, ways: tuple[OneWay, OneWay]) -> tuple[str, ...]:
    """The playouts that are tried with the scene's law: newest packet and fixed delay, waves by their integral.

    A link that neither jitters nor loses leaves nothing to choose. Playing a message again in the gaps (hold) is
    active for waves and changes nothing for samples, of which the newest stands; playing waves as zero fades a steady
    force: neither is tried.
    """
    gaps = "integral" if scene.has_waves else "zero"
    if all(way.greatest - way.least < scene.dt and way.lost == 0.0 for way in ways):
        return ()
    late = max(way.late for way in ways)
    ticks = max(1, ceil(late / scene.dt - 1e-6))
    fixed = f"fixed:{ticks * scene.dt:.9g}"
    return (gaps, f"{fixed}:integral" if scene.has_waves else fixed)
