"""Z-width over frequency: the least and the greatest impedance that a device shows and stays passive.

    Z_min(f) = |j w m + b|                                 the device alone, with no hand and nothing rendered
    Z_max(f) = max over the passive (K, B) of |K/(j w) + B F|           w = 2 pi f

(J. E. Colgate and J. M. Brown, "Factors affecting the Z-width of a haptic display", ICRA 1994). Z_max is what is
rendered, without the device's own part. |.| is convex in (K, B), so the greatest is at a corner of the passive region.
F is the velocity filter, 1 for the plain backward difference. A motor damped by a shunt adds b_e j w/(j w + w_c) to the
device. Behind a virtual coupling Z_max is that of the coupling with the tool held fast, and Z_min the device with the
tool in free space.

Z-width as numbers: Z_max - Z_min at 1 Hz, in N s/m, 0 where nothing wider than the device is passive; and the area
between the curves from 0.1 to 100 Hz, or to half the rate if that is less, the integral of log10(Z_max/Z_min) over
log10 f where it is above 0: decades of impedance times decades of frequency. Divided by the decades of frequency (3) it
is the mean gap of the curves in decades.
"""

from math import log10, pi
from typing import NamedTuple

import numpy as np

from teleop.analysis.models.law_parts import law_parts
from teleop.analysis.models.peak import Points, Reals
from teleop.analysis.zwidth.passive import Point, Region
from teleop.law.analysis_offers import coupling_of
from teleop.scene.scene import Scene

BAND = (0.1, 100.0)  # Hz
PLACES = 601  # 200 to a decade, 1 Hz among them
ONE = 1.0  # Hz


class Curves(NamedTuple):
    """The curves over frequency (Hz), in N s/m, and what is made of them; None: no upper curve is claimed."""

    frequency: Reals
    upper: Reals | None
    lower: Reals
    at_one: tuple[float | None, float]  # Z_max and Z_min at 1 Hz
    width: float | None  # N s/m, Z_max - Z_min at 1 Hz
    area: float | None  # decades of impedance times decades of frequency
    gap: float | None  # decades


def curves(scene: Scene, region: Region) -> Curves:
    """Both curves of a scene and its passive region."""
    last = min(BAND[1], 0.5e9 / scene.dt_ns)
    frequency = np.geomspace(BAND[0], last, PLACES)
    lower = device(scene, frequency)
    least = float(device(scene, np.array([ONE]))[0])
    if region.corners is None:
        return Curves(frequency, None, lower, (None, least), None, None, None)
    upper = most(scene, region.corners, frequency)
    greatest = float(most(scene, region.corners, np.array([ONE]))[0])
    with np.errstate(divide="ignore"):
        wide = np.maximum(np.log10(upper / lower), 0.0)
    steps = np.diff(np.log10(frequency))
    area = float((0.5 * (wide[1:] + wide[:-1]) * steps).sum())
    return Curves(frequency, upper, lower, (greatest, least), max(0.0, greatest - least), area,
                  area / log10(last / BAND[0]))


def device(scene: Scene, frequency: Reals) -> Reals:
    """|Z| (N s/m) of the device with nothing rendered; behind a coupling what it simulates is there, in free space."""
    s = 2j * pi * frequency
    impedance = scene.master.mass * s + scene.master.damping
    if scene.electrical is not None:
        impedance = impedance + scene.electrical.b * s / (s + 2.0 * pi * scene.electrical.cutoff)
    T = scene.dt_ns / 1e9
    if (offered := coupling_of(scene.law, T)) is not None:
        impedance = impedance + np.array([offered.free(complex(each)) for each in np.exp(s * T)])
    size: Reals = np.abs(impedance)
    return size


def most(scene: Scene, corners: tuple[Point, ...], frequency: Reals) -> Reals:
    """The greatest |K/(j w) + B F| (N s/m) over the corners at each frequency; 0 without any."""
    if not corners:
        return np.zeros_like(frequency)
    w = 2.0 * pi * frequency
    smooth = velocity_filter(scene, frequency)
    sizes = [np.abs(K / (1j * w) + B * smooth) for K, B in corners]
    greatest: Reals = np.max(sizes, axis=0)
    return greatest


def velocity_filter(scene: Scene, frequency: Reals) -> Points:
    """F: the velocity that the law is given over the backward difference."""
    T = scene.dt_ns / 1e9
    if coupling_of(scene.law, T) is not None:  # of which no other estimator has a passive region
        return np.ones(len(frequency), dtype=np.complex128)
    z = np.exp(2j * pi * T * frequency)
    impedance: Points = law_parts(scene).responses(z)[1] * T / (1.0 - 1.0 / z)
    return impedance
