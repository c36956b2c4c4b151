"""Damping that a delayed spring between two ends needs: the condition of position-position laws, worked out.

Two ends, each drawn to where the other was by K and K_d and damped by B_m and B_s in all,

    f_m = K (x_m - x_s') + K_d (v_m - v_s') + B_m v_m        f_s = K (x_m' - x_s) + K_d (v_m' - v_s) - B_s v_s,

have the impedance matrix with K_d + B + K/s on its diagonal, -(K_d + K/s) e^(-s T1) and -(K_d + K/s) e^(-s T2) beside.
Its Hermitian part has K_d + B_m and K_d + B_s on the diagonal, and beside it, with phi = w (T1 + T2)/2 and c =
K (T1 + T2)/2, numbers of magnitude |K_d cos phi - c sin phi/phi|. So the ends are passive iff

    (K_d + B_m) (K_d + B_s) >= R^2,   R = max over phi of |K_d cos phi - c sin phi/phi|,

and for K_d = 0 iff 4 B_m B_s >= K^2 (T1 + T2)^2 (equal ends: B >= K T).

Sampled, a force is held for a tick dt: what came is dt/2 older still on the mean, and an end's own spring is held too,
which costs its damper K dt/2 (J. E. Colgate and G. G. Schenkel, 1997). With both, below a tenth of the rate,

    (K_d + B_m - K dt/2) (K_d + B_s - K dt/2) >= R^2   with c = K (T1 + T2 + dt)/2:

for equal ends and K_d = 0 the condition above with T + dt in place of T. Near half the rate a held damper is none.

Delay that varies, K_d = 0. x_s(t) - x_s(t - T(t)) is the integral of v_s over T at most, and 2 |a b| <= r a^2 + b^2/r:
so the energy that the delay makes is at most that of the greatest delay, and the condition holds with the greatest
ages, those of loss and gaps among them, as long as the newest position is held. For K_d > 0 there is no such
bound: a velocity that is held or played twice has more energy than was sent. It takes a constant delay.
Ticks that are left out hold a force for longer, which is not counted here.

A condition on the sum of squares, 4 B_m B_s >= K^2 (T1^2 + T2^2), is in circulation; it is too weak by sqrt(2).
"""

from __future__ import annotations

from math import ceil, cos, floor, isnan, log10, pi, sin, sqrt

from teleop.law.offers import Facts

PLACES = 400  # of phi that are tried before the best is closed in on
GOLDEN = 0.6180339887498949


def least_damping(K: float, K_d: float, round_trip: float, dt: float, own_m: float, own_s: float) -> float:
    """The least damper B (N s/m) that both ends have to add to their own damping (N s/m, NaN for none); 0 at least.

    K in N/m, K_d in N s/m, `round_trip` T1 + T2 and the tick `dt` in s; dt = 0 is continuous time.
    """
    leak = 0.5 * K * dt
    p, q = (K_d - leak + (0.0 if isnan(damping) else damping) for damping in (own_m, own_s))
    R = strongest(K_d, 0.5 * K * (round_trip + dt))
    return max(sqrt(0.25 * (p - q) * (p - q) + R * R) - 0.5 * (p + q), 0.0)


def strongest(K_d: float, c: float) -> float:
    """R, the maximum of |K_d cos phi - c sin phi/phi| (N s/m). It lies between 0 and pi.

    Half a turn further on both terms have changed their signs and only the second is smaller; and where they are of one
    sign their difference is no more than the greater of K_d and c/pi, neither of which exceeds R.
    """
    def h(phi: float) -> float:
        return abs(K_d * cos(phi) - c * (sin(phi) / phi if phi > 0.0 else 1.0))

    step = pi / PLACES
    best = max(range(PLACES + 1), key=lambda i: h(i * step))
    low, high = max(best - 1, 0) * step, min(best + 1, PLACES) * step
    for _ in range(60):
        inner, outer = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
        low, high = (low, outer) if h(inner) >= h(outer) else (inner, high)
    return max(h(0.0), h(0.5 * (low + high)), h(best * step))


def varies(facts: Facts) -> bool:
    """True where the age of what an end plays is not always the same, by half a tick or more, or a packet is lost."""
    ways = [way for way in (facts.fwd, facts.bwd) if way is not None]
    return facts.lossy or any(way.greatest - way.least > 0.5 * facts.dt for way in ways)


def needed(facts: Facts, K: float, K_d: float) -> float | None:
    """`least_damping` of these facts, by their greatest ages; None where no message was played one way."""
    if facts.fwd is None or facts.bwd is None:
        return None
    round_trip = facts.fwd.greatest + facts.bwd.greatest
    return least_damping(K, K_d, round_trip, facts.dt, facts.damping_m, facts.damping_s)


def conditions(name: str, facts: Facts, K: float, K_d: float, B: float, cure: str = "--set law.B={:g}"
               ) -> tuple[str, ...]:
    """Sentences on the condition where a law that injects B at both ends breaks it; `cure` sets the least B."""
    least = needed(facts, K, K_d)
    if least is None or facts.fwd is None or facts.bwd is None:
        return (f"{name} is passive up to a greatest delay, and one way no message was played: no damping is enough",)
    sentences = []
    if K_d > 0.0 and varies(facts):
        longest = max(facts.fwd.greatest, facts.bwd.greatest)
        sentences.append(
            f"{name} with a damper K_d = {K_d:g} N s/m over the link is passive for a constant delay without "
            f"loss alone, and what is played here is {_ages(facts)} s old{', some of it lost' * facts.lossy}: "
            f"take K_d = 0, that is --set law=p_d --set law.K={K:g} --set law.B="
            f"{_upwards(needed(facts, K, 0.0) or 0.0):g}, or without loss --set playout=fixed:{longest:g}")
    elif least > B * (1.0 + 1e-12):
        own_m, own_s = (0.0 if isnan(damping) else damping for damping in (facts.damping_m, facts.damping_s))
        what = "(K_d + B_m)(K_d + B_s) >= max (K_d cos phi - c sin phi/phi)^2, c = K (T1 + T2)/2"
        what = "4 B_m B_s >= K^2 (T1 + T2)^2" if K_d == 0.0 else what
        sentences.append(f"{name} is passive where {what}, each T a tick longer than the age of what is played; with "
                    f"B_m = {own_m + B:g}, B_s = {own_s + B:g} N s/m and T1 + T2 = "
                    f"{facts.fwd.greatest + facts.bwd.greatest + 2.0 * facts.dt:g} s it is not: "
                    f"{cure.format(_upwards(least))} is the least")
    return tuple(sentences)


def _ages(facts: Facts) -> str:
    return " and ".join(f"{way.least:g} to {way.greatest:g}" for way in (facts.fwd, facts.bwd) if way is not None)


def _upwards(value: float) -> float:
    """To four digits, so that what is typed is enough."""
    grain = 10.0 ** (floor(log10(value)) - 3) if value > 0.0 else 1.0
    return ceil(value / grain * (1.0 - 1e-12)) * grain
