"""The Z-width of a scene: passive and stable region, impedance curves, what comes to rest, and what widens it.

    assess(load_scene("virtual_wall")).rows[0].curves.width

Quick first: theory takes a second, the runs in virtual time come last. Ctrl-C keeps what is done.

In virtual time comes to rest, or does not, what has no eigenvalues: an encoder, friction, a passivity controller. The
experiment: the hand holds still where its reference ends, inside the wall; the device starts at rest `BEFORE` the
wall and is let go, so the hand's spring pulls it in. It runs for `LASTING` s and on for as long as
`teleop.analysis.models.rest` needs to say what it comes to: a swing of a few steps of the encoder still counts as rest
there, a limit cycle beyond them does not.

Behind an encoder what rests and what hums may alternate as K grows. So K is raised from well below in steps of `RATIO`
to the first that does not rest, and the step before it halved: up to there all that were tried rest. A nonlinear loop
may answer otherwise to another start.

Over frequency, the least and the greatest impedance that a device shows and stays passive:

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

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from math import log10, pi
from typing import Any, NamedTuple

import numpy as np

from teleop.analysis.models.law_parts import check, law_parts, left_out, scales, with_gains
from teleop.analysis.models.peak import Points, Reals
from teleop.analysis.models.rest import HeldGrip, settled
from teleop.analysis.zwidth.passive import Point, Region, passive_region
from teleop.analysis.zwidth.plane import ALL, Boundary, LoopFamily, Span, boundary, loop, rows
from teleop.errors import Refused
from teleop.law import find_law
from teleop.law.analysis_offers import coupling_of, instead
from teleop.physics.relaxing import ElectricalDamping
from teleop.scene.scene import Scene
from teleop.stages.device import Device
from teleop.stages.encoder import Encoder
from teleop.stages.passivity_controller import PassivityController
from teleop.stages.velocity.backward_difference import BackwardDifference
from teleop.stages.velocity.low_pass import LowPass
from teleop.terminal.options import typed_range

Show = Callable[[float, str], None]
THEORY = 0.15  # of the work
LEVERS = 10  # of which there are about so many
RUNS = 17  # a search of the stiffest at rest has about so many
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


class LeverRow(NamedTuple):
    """Figures of a lever, at the scene's own B where a single one is meant. None: not claimed, not looked at.

    Stiffnesses in N/m; inf is beyond the range looked at, 0 below all of it.
    """

    name: str
    what: str
    region: Region
    curves: Curves
    stable: float | None  # with the scene's hand
    stable_free: float | None
    stable_any: float | None  # with the hand if there is one, at the B where it is greatest
    rest: float | None = None  # measured in virtual time


@dataclass(frozen=True, kw_only=True)
class ZWidth:
    """Result of the analysis. `rows` begin with the scene as it is; `measured` is (B, greatest K at rest or None)."""

    scene: Scene
    seed: int
    span_K: Span
    span_B: Span
    stable: Boundary | None = None  # with the scene's hand; None: it has none, or the loop is not linear
    stable_free: Boundary | None = None
    rows: list[LeverRow] = field(default_factory=list)
    measured: list[tuple[float, float | None]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    interrupted: bool = False

    @property
    def base(self) -> LeverRow:
        """The scene as it is."""
        return self.rows[0]


def span(name: str, typed: str | None) -> Span:
    """LOW:HIGH as it was typed; `Refused` if it is no range of numbers from 0 up."""
    if typed is None:
        return Span()
    return Span(*typed_range(name, typed, example="0:2000", low=0.0))


def assess(scene: Scene, *, span_K: Span = ALL, span_B: Span = ALL, seed: int = 0, show: Show = lambda *_: None
           ) -> ZWidth:
    """Find a scene's Z-width. `show` is told how much is done, 0 to 1.

    The spans are where the stable region and what rests are looked for; the passive region is always whole. Raises
    `Refused` for a scene with a slave and for a law without K and B, and KeyboardInterrupt if nothing is done yet.
    """
    scene = check(scene)
    z_width = ZWidth(scene=scene, seed=seed, span_K=span_K, span_B=span_B)
    try:
        for further in _steps(z_width, show):
            z_width = further
    except KeyboardInterrupt:
        if not z_width.rows:
            raise
        return replace(z_width, interrupted=True)
    show(1.0, "done")
    return z_width


def _steps(z_width: ZWidth, show: Show) -> Iterator[ZWidth]:
    """Yield the result so far, again and again."""
    scene, span_K, span_B = z_width.scene, z_width.span_K, z_width.span_B
    show(0.0, "the scene as it is")
    every = levers(scene)
    tried = [next(every)]
    z_width = replace(z_width, rows=[_row(scene, tried[0], scene.law.B, span_K, span_B)], notes=_notes(scene))
    yield z_width
    show(0.02, "stable region")
    with_hand, why = _loop(scene, hand=True) if scene.hand is not None else (None, "")
    free, why = _loop(scene, hand=False) if not why else (None, why)
    if why:
        z_width = replace(z_width, notes=[*z_width.notes, f"no stable region: {why}"])
    elif free is not None:
        some = rows(with_hand or free, span_B, span_K)
        z_width = replace(z_width, stable_free=boundary(free, rows(free, span_B, span_K), span_K),
                        stable=None if with_hand is None else boundary(with_hand, some, span_K))
    yield z_width
    for i, lever in enumerate(every, 1):
        tried.append(lever)
        show(0.04 + (THEORY - 0.04) * min(i / LEVERS, 1.0), lever.name)
        if lever.scene is None:
            z_width = replace(z_width, notes=[*z_width.notes, f"{lever.name} {lever.what}"])
        else:
            z_width = replace(z_width, rows=[*z_width.rows, _row(lever.scene, lever, scene.law.B, span_K, span_B)])
        yield z_width
    yield from _runs(z_width, {lever.name: lever for lever in tried}, with_hand, show)


def _runs(z_width: ZWidth, tried: dict[str, Lever], linear: LoopFamily | None, show: Show) -> Iterator[ZWidth]:
    """The same with what comes to rest in virtual time, one search after another."""
    scene_B, high = z_width.scene.law.B, z_width.span_B.high
    try:
        let_go(z_width.scene)
    except Refused as refused:
        yield replace(z_width, notes=[*z_width.notes, str(refused)])
        return
    b = z_width.scene.master.damping or 4.0 * scales(z_width.scene)[1]
    low = z_width.span_B.low
    some = sorted({B for B in (0.0, 0.5 * b, b, 2.0 * b, 5.0 * b) if low <= B <= (high or B)} | {scene_B})
    some.sort(key=lambda B: scene_B != B)  # the scene's own first
    total = len(some) + len(z_width.rows) - 1
    done = 0.0

    def find(scene: Scene, B: float, near: float | None, text: str) -> float | None:
        nonlocal done
        begun = done

        def tell() -> None:
            nonlocal done
            done = min(done + 1.0 / RUNS, begun + 0.95)
            show(THEORY + (1.0 - THEORY) * done / total, text)

        near = near if near is not None and 0.0 < near < float("inf") else scales(scene)[0]
        edge = stiffest_at_rest(let_go(scene), B, near=near, low=z_width.span_K.low, high=z_width.span_K.high,
                                seed=z_width.seed, tell=tell)
        done = begun + 1.0
        return edge

    for B in some:
        near = None if linear is None else boundary(linear, [B], z_width.span_K).K[0]
        edge = find(z_width.scene, B, near, f"at rest, B = {B:.3g} N s/m")
        z_width = replace(z_width, measured=sorted([*z_width.measured, (B, edge)], key=lambda one: one[0]))
        if scene_B == B:
            z_width = replace(z_width, rows=[z_width.base._replace(rest=edge), *z_width.rows[1:]])
        yield z_width
    for i, row in enumerate(z_width.rows[1:], 1):
        scene = tried[row.name].scene
        if scene is not None:
            near = row.stable or z_width.base.stable or z_width.base.stable_free
            edge = find(scene, scene_B, near, f"at rest, {row.name}")
            z_width = replace(z_width, rows=[*z_width.rows[:i], row._replace(rest=edge), *z_width.rows[i + 1:]])
            yield z_width


def _row(scene: Scene, lever: Lever, B: float, span_K: Span, span_B: Span) -> LeverRow:
    region = passive_region(scene)
    stable, free, most = None, None, None
    if scene.passivity is None:  # whose damping no eigenvalue knows
        with suppress(Refused):
            alone = loop(scene, hand=False)
            held = alone if scene.hand is None else loop(scene, hand=True)
            if scene.hand is None or not alone.coarse:  # which would take seconds for each lever
                free = boundary(alone, [B], span_K).K[0]
            stable = None if scene.hand is None else boundary(held, [B], span_K).K[0]
            if not held.coarse:
                most = boundary(held, rows(held, span_B, span_K), span_K).stiffest
    return LeverRow(lever.name, lever.what, region, curves(scene, region), stable, free, most)


def _loop(scene: Scene, *, hand: bool) -> tuple[LoopFamily | None, str]:
    try:
        return loop(scene, hand=hand), ""
    except Refused as refused:
        return None, str(refused)


def _notes(scene: Scene) -> list[str]:
    gone = left_out(scene)
    notes = [f"the stable region is that of the scene without {', '.join(gone)}"] if gone else []
    if words := instead(scene.law):
        notes.append(f"{words}, but in what was measured")
    if scene.cap is not None:
        notes.append("the force cap is in what was measured and in nothing else")
    return notes


STEP = 2.0 * pi * 0.010 / 1024.0  # m: of an encoder of 1024 lines on a drum of 10 mm
CUTOFF = 30.0  # Hz, of the velocity filter
SHUNT = 10.0  # Hz, below which the shunt of the motor damps less


class Lever(NamedTuple):
    """Change to the scene."""

    name: str
    what: str  # in words
    scene: Scene | None  # None: it does not apply, and `what` says why


def levers(scene: Scene) -> Iterator[Lever]:
    """The scene as it is, and then each change alone."""
    yield Lever("as it is", "the scene's own values", scene)
    b = scene.master.damping
    if b > 0.0:
        yield Lever("damping x2", f"device damping {b:g} to {2.0 * b:g} N s/m",
                    replace(scene, master=replace(scene.master, damping=2.0 * b)))
    else:
        yield Lever("damping x2", "left out: the device has no damping to double", None)
    yield from _resolution(scene)
    yield _rate(scene)
    yield _filter(scene)
    yield _coupling(scene)
    yield _controller(scene)
    yield _electrical(scene)


def _rate(scene: Scene) -> Lever:
    try:
        faster = replace(scene, dt=0.5 * scene.dt)
    except Refused as refused:  # a scene's tick is bounded below
        return Lever("rate x2", f"left out: {refused}", None)
    return Lever("rate x2", f"{1e-3 / scene.dt:g} to {2e-3 / scene.dt:g} kHz; delay and renewal stay the same count of "
                 "ticks", faster)


def _resolution(scene: Scene) -> Iterator[Lever]:
    device = scene.device_m or Device()
    encoder = device.encoder
    if encoder is None:
        yield Lever("encoder", f"an encoder of {STEP * 1e6:.3g} um; none before",
                    replace(scene, device_m=replace(device, encoder=Encoder(step=STEP))))
        return
    for word, factor in (("resolution x4", 0.25), ("resolution /4", 4.0)):
        step = factor * encoder.step
        yield Lever(word, f"encoder step {encoder.step * 1e6:.3g} to {step * 1e6:.3g} um",
                    replace(scene, device_m=replace(device, encoder=replace(encoder, step=step))))
    yield Lever("no encoder", "positions as they are", replace(scene, device_m=replace(device, encoder=None)))


def _filter(scene: Scene) -> Lever:
    device = scene.device_m or Device()
    if isinstance(device.velocity, BackwardDifference):
        return Lever("velocity filter", f"backward difference through a low-pass of {CUTOFF:g} Hz",
                     replace(scene, device_m=replace(device, velocity=LowPass(cutoff=CUTOFF))))
    return Lever("no velocity filter", "plain backward difference", replace(
        scene, device_m=replace(device, velocity=BackwardDifference())))


def _coupling(scene: Scene) -> Lever:
    law: Any = scene.law
    gains = {"K": law.K, "B": law.B, "at": float(getattr(law, "at", 0.0))}
    if coupling_of(law, scene.dt_ns / 1e9) is not None:
        return Lever("no coupling", "the wall felt directly", replace(scene, law=find_law("virtual_wall")(**gains)))
    coupled: Any = replace(scene, law=find_law("virtual_coupling")(**gains))
    corners = passive_region(coupled).corners
    K, B = max(corners) if corners else (law.K, law.B)
    tool = f"to a tool of {coupled.law.mass * 1e3:g} g"
    words = f"the stiffest passive coupling, {K:.4g} N/m and {B:.3g} N s/m, {tool}: any passive environment behind it"
    return Lever("virtual coupling", words if corners else f"a coupling of the same K and B {tool}",
                 replace(scene, law=replace(coupled.law, K=K, B=B)))


def _controller(scene: Scene) -> Lever:
    if scene.passivity is not None:
        return Lever("no controller", "without the passivity controller", replace(scene, passivity=None))
    cap = scene.master.damping or 0.02 * scene.master.mass / scene.dt
    return Lever("passivity controller", f"adds at most {cap:.3g} N s/m of damping while the port has made energy",
                 replace(scene, passivity=PassivityController(cap=cap)))


def _electrical(scene: Scene) -> Lever:
    name = "electrical damping"
    if scene.electrical is not None:
        return Lever("no shunt", "without electrical damping", replace(scene, electrical=None))
    if scene.master.friction > 0.0:
        return Lever(name, "left out: it does not go together with friction yet", None)
    b = scene.master.damping
    if b == 0.0:
        return Lever(name, "left out: the device has no damping to match", None)
    return Lever(name, f"a shunt of the motor adds {b:g} N s/m above {SHUNT:g} Hz",
                 replace(scene, electrical=ElectricalDamping(b=b, cutoff=SHUNT)))


BEFORE = 1e-3  # m
LASTING = 1.5  # s
TICKS = (400, 20_000)  # the first run has at least and at most so many
RATIO, HALVED = 1.25, 5  # 1.25^(1/32) is 1.007
HIGHER, LOWER = 32, 10  # steps up and halvings down that are tried: a factor of 1000 each


@dataclass(frozen=True, kw_only=True, slots=True)
class _Staying:
    at: float

    def samples(self, axes: int, count: int, dt_ns: int) -> tuple[list[float], ...]:
        """For each axis the position (m) at the ticks 0 .. count-1."""
        return ([self.at] * count, *[[0.0] * count] * (axes - 1))


def let_go(scene: Scene) -> Scene:
    """The experiment's scene. Refused if no hand presses the device into the wall."""
    if scene.hand is None:
        raise Refused("nothing is measured: without a hand the device leaves the wall; give the scene a hand")
    held = scene.hand.reference.samples(scene.axes, scene.ticks + 1, scene.dt_ns)[0][-1]
    wall = float(getattr(scene.law, "at", 0.0))
    if held <= wall:
        raise Refused(f"nothing is measured: the hand ends at {held:g} m, outside the wall at {wall:g} m; let it reach "
                      "further")
    hand = scene.hand
    T = scene.dt_ns / 1e9
    ticks = min(max(round(LASTING / T), TICKS[0]), TICKS[1])
    return replace(
        scene, start_m=wall - BEFORE, duration=(ticks + 0.5) * T, energy=False,
        hand=HeldGrip(mass=hand.mass, k=hand.k, d=hand.d, reference=_Staying(at=held)),
    )


def stiffest_at_rest(scene: Scene, B: float, *, near: float, low: float = 0.0, high: float | None = None,
                     seed: int = 0, tell: Callable[[], None] = lambda: None) -> float | None:
    """The stiffness (N/m) up to which a `let_go` scene comes to rest, to 1 %; None: it does at none that was tried.

    Looked for from a tenth of `near` on, within low..high; `tell` is called after each run. inf: at rest up to `high`.
    """
    def good(K: float) -> bool:
        at_rest = settled(with_gains(scene, K, B), seed=seed).rests
        tell()
        return at_rest

    K = max(0.1 * near if high is None else min(0.1 * near, high), low)
    if not good(K):
        for _ in range(LOWER):
            K, worse = 0.5 * K, K
            if worse <= low:
                return None
            K = max(K, low)
            if good(K):
                return _halved(good, K, worse)
        return None
    for _ in range(HIGHER):
        if high == K:
            return float("inf")
        K, better = (K * RATIO if high is None else min(K * RATIO, high)), K
        if not good(K):
            return _halved(good, better, K)
    return float("inf")


def _halved(good: Callable[[float], bool], low: float, high: float) -> float:
    for _ in range(HALVED):
        middle = (low * high) ** 0.5
        low, high = (middle, high) if good(middle) else (low, middle)
    return low
