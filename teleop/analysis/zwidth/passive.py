"""The passive region in the plane of virtual stiffness K and damping B: a convex polygon with a corner at (0, 0).

A device of damping b with a sampled linear controller is passive to any hand iff at every th in (0, pi] (Colgate and
Schenkel 1997; `teleop.analysis.models.sampled` has the formula with its conditions)

    K a(th) + B c(th) <= b,        a + j .. = -e^(-j(d+1)th) E_K(e^(j th)),   c likewise with E_B,

E_K and E_B the controller's force per backward-difference velocity for K = 1 and for B = 1, d whole ticks of delay. A
spring has a = (T/2) sin((2d+1)th/2)/sin(th/2); a damper on the backward difference through a filter F has
c = -Re[e^(-j(d+1)th) F]. Each th is a half-plane, so the region is convex, and it scales with b. For d = 0 and F = 1 it
is K T/2 + B <= b. Of the plane only K, B >= 0 is looked at: a negative damper is nothing to render.

What else bounds it:

- the force renewed at every n-th tick: the greatest eigenvalue of a Hermitian form that is linear in (K, B), so the
  region is convex all the same (`sampled.damping_curve`). A spring alone has there n T in the place of T, since what
  is computed in between is not used; a damper has not, for its difference is still that over T;
- a motor damped by a shunt: the device has Re Z(jw) = r(w), not constant. The velocity's components at w_l = w + 2 pi
  l/T, which one sample cannot tell apart, lose sum r(w_l) |V_l|^2, and the port gives needed(th) |sum V_l/w_l|^2 / sum
  1/w_l^2. By Cauchy's inequality the first is enough for all V iff

      needed(th) <= b_eff(th),        1/b_eff = (sum 1/(w_l^2 r(w_l))) / (sum 1/w_l^2),

  which for r = b + b_e w^2/(w^2 + w_c^2), by partial fractions, is 1/b (1 - b_e/(b + b_e) S(W)/S(0)) with W^2 = b
  w_c^2/(b + b_e) and S(W) = sum 1/(w_l^2 + W^2) = T sinh(W T)/(2 W (cosh(W T) - cos th));
- an encoder of step D with Coulomb friction fc: the reading is off by e, within D/2 of a constant that only shifts the
  wall; the law makes a force of at most (D/2)(K |h_K|_1 + B |h_B|_1) of it, h the law's impulse responses, held over a
  tick's motion, and friction takes up as much if

      (D/2)(K |h_K|_1 + B |h_B|_1) <= fc,     |h_K|_1 = 1, and |h_B|_1 = 2/T for the backward difference.

  Sufficient, with the condition above. For B = 0 it is K <= 2 fc/D, which is necessary too (Abbott and Okamura 2005);
  so is it for K -> 0 deep in the wall, where a handle that trembles across an edge of the encoder is pushed back and
  pulled on by B D/T at every tick. Without friction nothing is left.

Behind a virtual coupling the tool may meet any passive environment; the polygon is then that of the coupling's K and B
(`teleop.analysis.models.coupling`, from which the formula is: quadratic over linear, so again convex).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from teleop.analysis.models import coupling, sampled
from teleop.analysis.models.law_parts import effective_damping, law_parts, norms, scales, with_gains
from teleop.analysis.models.peak import Points, Reals, grid, highest
from teleop.errors import Refused
from teleop.law.analysis_offers import Coupling, coupling_of
from teleop.scene.scene import Scene
from teleop.stages.velocity.backward_difference import BackwardDifference

Point = tuple[float, float]  # (K, B)
Gauge = Callable[[float, float], tuple[float, Point]]  # how far out a point is, 1 on the boundary, and the gradient

CLOSE = 3e-5  # of the distance from (0, 0): how far the polygon may lie inside the region
ROUNDS = 12  # each makes a curved side at least four times as close
STRAIGHT = 1e-8  # a turn that is less is none
FAR = 1e3  # of the intercepts: nothing passive lies beyond


def polygon(gauge: Gauge, close: float = CLOSE) -> list[Point]:
    """The corners but (0, 0) of the region where a convex gauge that is homogeneous of degree one is at most 1.

    By cutting planes: a corner that lies outside is cut off along the gradient there, until none does by more than
    `close`. What is left encloses the region; each corner is then drawn back onto its boundary.
    """
    most_K, most_B = 1.0 / gauge(1.0, 0.0)[0], 1.0 / gauge(0.0, 1.0)[0]
    corners = [(0.0, 0.0), (FAR * most_K, 0.0), (FAR * most_K, FAR * most_B), (0.0, FAR * most_B)]
    levels: dict[Point, float] = {(0.0, 0.0): 0.0}
    for _ in range(ROUNDS):  # all corners in turn, so that no side is finer than another
        unjudged = {corner: gauge(*corner) for corner in corners if corner not in levels}
        for corner, (value, gradient) in unjudged.items():
            levels[corner] = value
            if value > 1.0 + close:
                corners = clip(corners, gradient)
        if not unjudged:
            break
    points = [(K / level, B / level) for K, B in corners[1:] for level in [levels.get((K, B)) or gauge(K, B)[0]]]

    def straight(a: Point, b: Point, c: Point) -> bool:
        turn = (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0])
        return abs(turn) < STRAIGHT * most_K * most_B

    turning = points[:1]
    for i, corner in enumerate(points[1:-1], 1):
        if not straight(turning[-1], corner, points[i + 1]):
            turning.append(corner)
    return [*turning, points[-1]]


def clip(corners: list[Point], line: tuple[float, ...]) -> list[Point]:
    """The part of a convex polygon in which line[0] K + line[1] B <= 1; the first corner, (0, 0), stays the first."""
    depth = [1.0 - line[0] * K - line[1] * B for K, B in corners]
    points: list[Point] = []
    for i, (here, now) in enumerate(zip(corners, depth, strict=True)):
        j = (i + 1) % len(corners)
        if now >= 0.0:
            points.append(here)
        if (now > 0.0 > depth[j]) or (now < 0.0 < depth[j]):
            part = now / (now - depth[j])
            after = corners[j]
            points.append((here[0] + part * (after[0] - here[0]), here[1] + part * (after[1] - here[1])))
    return points


Curve = Callable[[float, float], Callable[["Reals"], "Reals"]]  # of (K, B): the damping needed over th

CLOSE_SLOW = 3e-4  # for `CLOSE` where the force is renewed more slowly than the tick, which takes longer to ask


class Region(NamedTuple):
    """The polygon's corners (K, B) but (0, 0), from the K axis to the B axis; None: no passive region is claimed."""

    corners: tuple[Point, ...] | None
    sentence: str

    @property
    def stiffest(self) -> float | None:
        """The greatest K (N/m) in it, at whichever B."""
        return None if self.corners is None else max((K for K, _ in self.corners), default=0.0)

    @property
    def most_damped(self) -> float | None:
        """The greatest B (N s/m) in it, at whichever K."""
        return None if self.corners is None else max((B for _, B in self.corners), default=0.0)


def passive_region(scene: Scene) -> Region:
    """The passive region of a scene without a slave, whatever hand holds it."""
    try:
        return _region(scene)
    except Refused as refused:
        return Region(None, f"no passive region is claimed: {refused}")


def _region(scene: Scene) -> Region:
    if scene.passivity is not None:
        raise Refused("what a passivity controller adds is measured, not proven; leave it out for the region without")
    if scene.master.damping == 0.0:
        if scene.electrical is not None and scene.electrical.b > 0.0:
            raise Refused("a device whose only damping is the shunt of its motor has none to a slow hand; give it some")
        return Region((), "without damping of the device itself nothing is passive; give it some, for example "
                          "--set b=0.8")
    encoder = scene.device_m and scene.device_m.encoder
    friction = scene.master.friction
    if encoder and not friction:
        return Region((), "an encoder without Coulomb friction leaves no passive stiffness or damping: in one step of "
                          "it nothing takes up what the reading's error makes")
    if encoder and coupling_of(scene.law, scene.dt_ns / 1e9) is not None:
        raise Refused("what a tool behind a virtual coupling makes of an encoder's error has no known bound; leave the "
                      "encoder out")
    slow = scene.device_m is not None and scene.device_m.every > 1
    corners = polygon(_gauge(scene), CLOSE_SLOW if slow else CLOSE)
    if encoder:
        parts = law_parts(scene)
        cut = tuple(0.5 * encoder.step / friction * size for size in norms(parts))
        corners = [*clip([(0.0, 0.0), *corners], cut)[1:]]
        return Region(tuple(corners), "passive by the device's damping and, behind the encoder, its Coulomb friction")
    return Region(tuple(corners), "passive to any hand iff inside")


def _gauge(scene: Scene) -> Gauge:
    """Build the gauge: the share of the device's damping that a point takes, at the th where it is greatest."""
    T = scene.dt_ns / 1e9
    d, every = (0, 1) if scene.device_m is None else (scene.device_m.delay, scene.device_m.every)
    if every > 1 and scene.electrical is not None:
        raise Refused("a force renewed more slowly than the tick on a motor damped by a shunt has no known condition; "
                      "set every=1")
    turns = (d + 1) / every
    places = grid(turns)
    on_grid: dict[str, Any] = {}
    needed = _needed(scene, T, d, every, places)

    def damping(th: Reals) -> Reals:
        if len(th) != len(places):
            return effective_damping(scene, th)
        if "b" not in on_grid:
            on_grid["b"] = effective_damping(scene, th)
        effective: Reals = on_grid["b"]
        return effective

    def gauge(K: float, B: float) -> tuple[float, Point]:
        curve = needed(K, B)
        peak = highest(lambda th: curve(th) / damping(th), turns)
        at = np.array([peak.th])

        def there(K: float, B: float) -> float:
            return float((needed(K, B)(at) / damping(at))[0])

        h_K, h_B = 1e-6 * max(K, scales(scene)[0]), 1e-6 * max(B, scales(scene)[1])  # homogeneous of degree one
        return peak.value, ((there(K + h_K, B) - there(K, B)) / h_K, (there(K, B + h_B) - there(K, B)) / h_B)

    return gauge


def _needed(scene: Scene, T: float, d: int, every: int, places: Reals) -> Curve:
    """The damping needed for (K, B) over th."""
    if (offered := coupling_of(scene.law, T)) is not None:
        return _coupled(scene, offered, d, every)
    parts = law_parts(scene)

    def halves(th: Reals) -> tuple[Reals, Reals]:
        turned = T * np.exp(-1j * (d + 1) * th) / sampled.step(th)
        H_K, H_B = parts.responses(np.exp(1j * th))
        return -(turned * H_K).real, -(turned * H_B).real

    if every == 1:
        halves_on_grid = halves(places)

        def linear(K: float, B: float) -> Callable[[Reals], Reals]:
            def curve(th: Reals) -> Reals:
                a, c = halves_on_grid if len(th) == len(places) else halves(th)
                return K * a + B * c

            return curve

        return linear

    often: list[tuple[Points, Points]] = []  # the responses on the grid, which every point asks for

    def responses(z: Points) -> tuple[Points, Points]:
        if len(z) != every * len(places):
            return parts.responses(z)
        if not often:
            often.append(parts.responses(z))
        return often[0]

    def slow(K: float, B: float) -> Callable[[Reals], Reals]:
        def E(z: Any) -> Any:
            H_K, H_B = responses(z.astype(complex).ravel())
            return (K * H_K + B * H_B).reshape(z.shape) * T / (1.0 - 1.0 / z)

        return lambda th: sampled.damping_curve(E, T, th, d=d, every=every)

    return slow


def _coupled(scene: Scene, offered: Coupling, d: int, every: int) -> Curve:
    """The same for the coupling that the law offers, in front of the worst passive environment."""
    velocity = scene.device_m and scene.device_m.velocity
    if every > 1 or not isinstance(velocity, BackwardDifference) or not (offered.series and offered.keeps):
        raise Refused("behind a coupling the condition is known for a force renewed at every tick, the backward "
                      "difference, coupling and environment in series, and an integrator that keeps the environment "
                      f"passive{_integrators(offered)}")

    def curve(K: float, B: float) -> Callable[[Reals], Reals]:
        if K == B == 0.0:
            return np.zeros_like
        offer = coupling_of(with_gains(scene, K, B).law, scene.dt_ns / 1e9)
        assert offer is not None
        C = offer.C
        return lambda th: coupling.damping_curve(C, 0.0, th, d=d)

    return curve


def _integrators(offered: Coupling) -> str:
    """The integrators of the same law that will do, for a refusal."""
    known = [f"{name} Euler" if name == "backward" else name for name, law in offered.others.items()
             if (offer := coupling_of(law, 1e-3)) is not None and offer.series and offer.keeps]
    return f"; take {' or '.join(known)}" if known else ""
