"""Integrators of scipy's: as contenders called once per tick, and held tight as an independent reference.

The contenders are used the way anybody would: `solve_ivp` over the tick, the wall's force in the right-hand
side, no events. The reference locates every change of mode as an event and polishes its instant by Newton's
method on integrations that end there, since an event is only as exact as the interpolation it is found on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib.util import find_spec
from math import hypot, inf, isfinite, nan, sqrt
from typing import TYPE_CHECKING, Any, NamedTuple

from teleop.bodies import Bodies, exact_bodies
from teleop.plant import Gripped
from teleop.precision.contenders import slave_of, touch_of
from teleop.precision.methods import Touch

if TYPE_CHECKING:
    from teleop.scene import Scene

SOLVERS = ("DOP853", "LSODA", "Radau")
TOLERANCES = (1e-3, 1e-6, 1e-9)  # relative; absolute 1e-3 of it, in m and m/s
MOST_RADIANS = 500.0  # of a mode's own motion within a tick that the reference still follows
MOST_EVENTS = 32


def there() -> bool:
    """Is scipy installed?"""
    return find_spec("scipy") is not None


def outsider_bodies(scene: Scene, solver: str, rtol: float) -> Bodies:
    """The scene with its slave moved by one call of `solver` per tick; the master, which is linear, stays exact."""
    dt = scene.dt_ns / 1e9
    exact = exact_bodies(scene)
    moves = [outsider(touch_of(plant, slave_of(scene)), dt, solver, rtol) for plant in exact.slaves]
    return Bodies(exact.master, [plant._replace(move=move) for plant, move in zip(exact.slaves, moves, strict=True)])


def outsider(touch: Touch, dt: float, solver: str, rtol: float) -> Callable[..., tuple[float, float, int]]:
    """`move` by `solver` over one tick; NaN where it gives up."""
    from scipy.integrate import solve_ivp

    m, b, k, d, side, at, edge, floor = touch

    def rate(_: float, y: Any, f: float) -> tuple[float, float]:
        p, u = y
        pull = f - b * u
        if p > edge:
            g = k * p + d * u
            if g > floor:
                pull -= g
        return u, pull / m

    def move(_: Any, x: float, v: float, f: float) -> tuple[float, float, int]:
        if not isfinite(abs(x) + abs(v) + abs(f)):
            return nan, nan, 0
        start = side * (x - at), side * v
        done = solve_ivp(rate, (0.0, dt), start, solver, args=(side * f,), rtol=rtol, atol=1e-3 * rtol)
        if not done.success:
            return nan, nan, 0
        return at + side * float(done.y[0, -1]), side * float(done.y[1, -1]), 0

    return move


class Mode(NamedTuple):
    """One linear piece of `m p'' + c p' + k p = f`, and the functions alpha p + beta p' that end it where they fall."""

    k: float
    c: float
    exits: tuple[tuple[float, float, str], ...]  # alpha, beta, the mode that follows


def modes(touch: Touch) -> dict[str, Mode]:
    """The pieces of a wall; without an edge there is one."""
    _, b, k, d, _, _, edge, _ = touch
    if abs(edge) == inf:
        return {"contact": Mode(k, b + d, ())}
    left = (("free" if d == 0.0 else "detached"),)
    return {
        "free": Mode(0.0, b, ((-1.0, 0.0, "contact"),)),
        "contact": Mode(k, b + d, ((k, d, *left),)),
        "detached": Mode(0.0, b, ((1.0, 0.0, "free"), (-k, -d, "contact"))),
    }


def radians(touch: Touch, dt: float) -> float:
    """How far the fastest rate of any mode goes within a tick."""
    return max(max(sqrt(mode.k / touch.m), mode.c / touch.m) for mode in modes(touch).values()) * dt


def located(touch: Touch, dt: float, x: float, v: float, f: float, solver: str
            ) -> tuple[float, float, int]:
    """Position and speed after one tick by `solver` at its tightest, and how many changes of mode were located.

    NaN if it gives up. It takes some 10 ms to 1 s: DOP853 is the exacter, Radau the independent one.
    """
    m, _, k, d, side, at, edge, _ = touch
    every = modes(touch)
    p, u, f, left = side * (x - at), side * v, side * f, dt
    if edge == 0.0 and p == u == f == 0.0:
        return x, v, 0  # at rest on the surface, where an event would be found for ever
    name = "contact"
    if edge == 0.0 and (p <= 0.0 or k * p + d * u <= 0.0):
        name = "detached" if p > 0.0 else "free"
    for changes in range(MOST_EVENTS):
        mode = every[name]
        piece = _Piece(solver, m, mode, f, dt)
        t, which = piece.end(p, u, left)
        p, u = piece.after(p, u, t)
        if which is None or not isfinite(p):
            return at + side * p, side * u, changes
        name, left, was = mode.exits[which][2], left - t, name
        if "free" in (name, was):
            p = 0.0
    return nan, nan, MOST_EVENTS


class _Piece:
    """One mode under one force, integrated by scipy."""

    def __init__(self, solver: str, m: float, mode: Mode, f: float, dt: float) -> None:
        self._solver, self._m, self._mode, self._f, self._dt = solver, m, mode, f, dt
        self._rtol = 3e-14 if solver == "DOP853" else 1e-13

    def _rate(self, _: float, y: Any) -> tuple[float, float]:
        return y[1], (self._f - self._mode.c * y[1] - self._mode.k * y[0]) / self._m

    def _run(self, p: float, u: float, span: float, events: list[Any] | None = None) -> Any:
        from scipy.integrate import solve_ivp

        m, (k, c, _) = self._m, self._mode
        fast = max(sqrt(k / m), c / m, 1.0 / self._dt)
        speed = hypot(u, fast * p if k else 0.0) + abs(self._f) / m / fast
        tiny = 0.1 * self._rtol
        more = {"jac": [[0.0, 1.0], [-k / m, -c / m]]} if self._solver == "Radau" else {}
        return solve_ivp(
            self._rate, (0.0, span), (p, u), self._solver, events=events, rtol=self._rtol,
            atol=(tiny * speed / fast + 1e-30, tiny * speed + 1e-30), max_step=min(0.1 * self._dt, 0.5 / fast), **more,
        )

    def after(self, p: float, u: float, span: float) -> tuple[float, float]:
        """The state after `span` in this mode, whatever happens."""
        if span <= 0.0:
            return p, u
        done = self._run(p, u, span)
        return (float(done.y[0, -1]), float(done.y[1, -1])) if done.success else (nan, nan)

    def end(self, p: float, u: float, span: float) -> tuple[float, int | None]:
        """When this mode ends within `span`, and by which of its exits; `span` and None if it lasts."""
        exits = self._mode.exits
        done = self._run(p, u, span, list(self._events()))
        which = next((i for i, found in enumerate(done.t_events or ()) if len(found)), None)
        if which is None:
            return span, None
        t, (alpha, beta, _) = float(done.t_events[which][0]), exits[which]
        for _ in range(3):
            q, w = self.after(p, u, t)
            if not isfinite(q):
                break
            _, a = self._rate(t, (q, w))
            slope = alpha * w + beta * a
            if slope == 0.0 or not isfinite(slope):
                break
            t = min(max(t - (alpha * q + beta * w) / slope, 0.0), span)
        return t, which

    def _events(self) -> Iterator[Any]:
        for alpha, beta, _ in self._mode.exits:
            def falls(_: float, y: Any, alpha: float = alpha, beta: float = beta) -> float:
                return float(alpha * y[0] + beta * y[1])

            falls.terminal, falls.direction = True, -1.0  # type: ignore[attr-defined]  # scipy's way
            yield falls


def gripped_touch(grip: Gripped) -> Touch:
    """The held master's equation in `y = x - x_ref`, under the force `-(f_m + b s)` while the reference has slope s."""
    return Touch(grip.mass, grip.b, grip.k, grip.d, edge=-inf, floor=-inf)
