"""Wrong forms of the wave laws, each a slip that a person may make, as a mixture of a law that is right and one part.

`wrong(law, ...)` takes the methods of a law and puts others in their places; the claims stay those of the law.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, make_dataclass
from math import pi, sqrt
from typing import Any

from teleop.law import At
from teleop.laws.wave import Wave
from teleop.laws.wave_filter import WaveFilter, low_pass
from teleop.laws.wave_matched import WaveMatched
from teleop.laws.wave_position import WavePosition
from teleop.laws.wave_prediction import WavePrediction
from teleop.laws.wave_scaled import WaveScaled

STATES = ("master_start", "slave_start", "master", "slave")
E_LINK = {"E_link": "any link"}


def wrong(law: Any, name: str, **parts: Callable[..., Any]) -> Any:
    """A law of the class `name` with the methods of `law`, those in `parts` but in place of its own."""
    kind = type(law)
    space = {each: getattr(kind, each) for each in (*STATES, "__post_init__")} | {"claims": E_LINK} | parts
    knobs = [(each.name, float, getattr(law, each.name)) for each in fields(law)]
    return make_dataclass(name, knobs, namespace=space, frozen=True, kw_only=True)()


def seen(at: At) -> At:
    """What the ends of these laws read, named where check_law sees it."""
    _ = at.x, at.v, at.fresh, at.age, at.dt, at.span, at.gain
    return at


def changed(kind: Any, end: str, **how: Callable[[Any], Any]) -> Callable[..., Any]:
    """An end of a law, the wave that it receives, or its answer's force or wave, put through a function."""
    own = getattr(kind, end)

    def tick(self: Any, s: Any, at: At, rx: Any) -> Any:
        f, tx, after = own(self, s, seen(at), how["came"](rx) if "came" in how else rx)
        return how.get("force", float)(f), how.get("went", lambda sent: sent)(tx), after

    return tick


def deaf(kind: Any, end: str) -> Callable[..., Any]:
    """An end to which each tick brings a wave: in gaps the last one is played again."""
    own = getattr(kind, end)

    def tick(self: Any, s: Any, at: At, rx: Any) -> Any:
        return own(self, s, seen(at)._replace(fresh=True), rx)

    return tick


def times(factor: float) -> Callable[[Any], Any]:
    """A message with its wave times a factor."""
    return lambda message: message._replace(**{message._fields[0]: factor * message[0]})


# The wave law itself


def missing_half(self: Wave, s: Any, at: At, rx: Any) -> Any:
    """u = sqrt(2b) v - w as it has to be; the force with sqrt(b/2) in place of sqrt(2b)."""
    w, root = rx.w * at.fresh, sqrt(2.0 * self.b)
    return self.b * at.v - sqrt(self.b / 2.0) * w, type(self.slave_start(at)[1])(root * at.v - w), s


def last_force(self: Wave, s: Any, at: At, rx: Any) -> Any:
    """The slave's force and its wave of the commanded point before this tick: a loop that is one tick late."""
    u, root = rx.u * at.fresh, sqrt(2.0 * self.b)
    f_s = self.K * (s.x_d - at.x) + self.B * (s.v_d - at.v)
    v_d = (root * u - f_s) / self.b
    return f_s, type(self.master_start(at)[1])(u - 2.0 / root * f_s), type(s)(s.x_d + at.dt * v_d, v_d)


def wave_of_no_force(self: Wave, s: Any, at: At, rx: Any) -> Any:
    """A force in one sign and its wave in the other."""
    f_s, back, after = Wave.slave(self, s, seen(at), rx)
    return -f_s, back, after


WAVE = {
    "a wave is played twice": wrong(Wave(), "PlaysTwice", master=deaf(Wave, "master")),
    "the slave too": wrong(Wave(), "SlavePlaysTwice", slave=deaf(Wave, "slave")),
    "a half is missing in the force": wrong(Wave(), "MissingHalf", master=missing_half),
    "the loop is one tick late": wrong(Wave(), "OneTickLate", slave=last_force),
    "the force has the wrong sign": wrong(Wave(), "WrongSign", slave=wave_of_no_force),
    "the returned wave has the wrong size": wrong(Wave(), "Louder", slave=changed(Wave, "slave", went=times(1.05))),
    "what comes is scaled by more than 1": wrong(Wave(), "Gain", slave=changed(Wave, "slave", came=times(1.02))),
}


# Filtered


def filtered_force(self: WaveFilter, s: Any, at: At, rx: Any) -> Any:
    """The filter on the force, outside the waves: the force that the hand feels lags that of the waves."""
    w, root = rx.w * at.fresh, sqrt(2.0 * self.b)
    f = low_pass(s.y, 0.0, self.b * at.v - root * w, 2.0 * pi * self.f_c, at.dt, 0.0)
    return f, type(self.slave_start(at)[1])(root * at.v - w), type(s)(f, w)


def filtered_force_alone(self: WaveFilter, s: Any, at: At, rx: Any) -> Any:
    """The force of the filtered wave, and the wave that is sent of the bare one."""
    r, root = rx.w * at.fresh, sqrt(2.0 * self.b)
    w = low_pass(s.y, s.r, r, 2.0 * pi * self.f_c, at.dt, at.span - at.dt)
    return self.b * at.v - root * w, type(self.slave_start(at)[1])(root * at.v - r), type(s)(w, r)


def overshooting(self: WaveFilter, s: Any, at: At, rx: Any) -> Any:
    """Explicit Euler with a cut-off above what the tick can follow: y + l dt (r - y) with l dt = 2.5."""
    w, root = s.y + 2.5 * (rx.w * at.fresh - s.y) * (abs(s.y) < 1e6), sqrt(2.0 * self.b)
    return self.b * at.v - root * w, type(self.slave_start(at)[1])(root * at.v - w), type(s)(w, w)


def remembers_in_gaps(self: WaveFilter, s: Any, at: At, rx: Any) -> Any:
    """In a gap the filter's input is what it gave last, in place of zero: it holds its wave."""
    own = rx.w * at.fresh + s.y * (1.0 - at.fresh)
    return WaveFilter.master(self, s, seen(at)._replace(fresh=True), type(rx)(own))


FILTER = {
    "the filter is on the force": wrong(WaveFilter(), "FiltersForce", master=filtered_force),
    "the filter is on the force of the wave alone": wrong(WaveFilter(), "FiltersHalf", master=filtered_force_alone),
    "the filter steps too far": wrong(WaveFilter(), "Overshoots", master=overshooting),
    "the filter holds its wave in gaps": wrong(WaveFilter(), "HoldsInGaps", master=remembers_in_gaps),
    "a wave is played twice": wrong(WaveFilter(f_c=200.0), "FilterPlaysTwice", slave=deaf(WaveFilter, "slave")),
}


# Matched


def dampers_alone(self: WaveMatched, s: Any, at: At, rx: Any) -> Any:
    """The halving by the damper undone by playing the wave doubled."""
    return WaveMatched.slave(self, s, seen(at), type(rx)(2.0 * rx.u))


def sent_doubled(self: WaveMatched, s: Any, at: At, rx: Any) -> Any:
    """The same at the master: the wave doubled as it is sent into the force alone."""
    f, sent, after = WaveMatched.master(self, s, seen(at), rx)
    return 2.0 * f, sent, after


def pushed_point(self: WaveMatched, s: Any, at: At, rx: Any) -> Any:
    """The master's force in the sign of the slave's, whose point it follows: it pulls the hand on."""
    f, sent, after = WaveMatched.master(self, s, seen(at), rx)
    return -f, sent, after


def velocity_of_the_device(self: WaveMatched, s: Any, at: At, rx: Any) -> Any:
    """The wave of the device's velocity in place of the point's: damper and spring are between the two."""
    f, _, after = WaveMatched.master(self, s, seen(at), rx)
    root = sqrt(2.0 * self.b)
    return f, type(self.slave_start(at)[1])(root * at.v - rx.w * at.fresh), after


MATCHED = {
    "the halving is undone by doubling what comes": wrong(WaveMatched(), "Doubles", slave=dampers_alone),
    "the halving is undone by doubling the force": wrong(WaveMatched(), "DoublesForce", master=sent_doubled),
    "the master's coupling has the wrong sign": wrong(WaveMatched(), "PullsOn", master=pushed_point),
    "the wave is of the device and not of the point": wrong(WaveMatched(), "OfTheDevice",
                                                            master=velocity_of_the_device),
    "a wave is played twice": wrong(WaveMatched(), "MatchedPlaysTwice", master=deaf(WaveMatched, "master")),
}


# With positions, which may not claim the link at all


def position_beside(self: WavePosition, s: Any, at: At, rx: Any) -> Any:
    """Springs alone, in the wrong sign."""
    f, sent, after = WavePosition.master(self, s, seen(at), rx)
    return f - 2.0 * self.K_p * (at.x - rx.x), sent, after


POSITION = {
    "it claims the link": wrong(WavePosition(), "ClaimsTheLink"),
    "it claims the link with much damping": wrong(WavePosition(K_p=50.0, B_p=20.0), "DampedClaims"),
    "it claims the ports": wrong(
        WavePosition(K_p=500.0, B_p=0.0), "ClaimsThePort", claims={"E_port": "constant delay"}),
    "it claims the ports with its spring turned around": wrong(
        WavePosition(K_p=500.0), "TurnedSpring", master=position_beside, claims={"E_port": "constant delay"}),
}


# Scaled


def constant_scale(factor: float) -> Callable[..., Any]:
    """Each wave held in gaps and scaled by a constant."""
    def master(self: WaveScaled, s: Any, at: At, rx: Any) -> Any:
        w, root = factor * rx.w, sqrt(2.0 * self.b)
        return self.b * at.v - root * w, type(self.slave_start(at)[1])(root * at.v - w), s

    return master


def unbounded(self: WaveScaled, s: Any, at: At, rx: Any) -> Any:
    """Held and scaled by the rate, but not within the energy that came."""
    g2 = s.g2 + at.span / (self.tau + at.span) * (at.fresh - s.g2)
    w, root = sqrt(g2) * rx.w, sqrt(2.0 * self.b)
    return self.b * at.v - root * w, type(self.slave_start(at)[1])(root * at.v - w), type(s)(g2, 0.0, w, w)


def scaled_wave_unscaled_force(self: WaveScaled, s: Any, at: At, rx: Any) -> Any:
    """The wave that is sent of the scaled one, the force of the bare one."""
    _, sent, after = WaveScaled.master(self, s, seen(at), rx)
    return self.b * at.v - sqrt(2.0 * self.b) * rx.w * at.fresh, sent, after


def counts_gaps(self: WaveScaled, s: Any, at: At, rx: Any) -> Any:
    """The energy of a wave counted again at every tick that it is held."""
    return WaveScaled.master(self, s, seen(at)._replace(fresh=True), rx)


def pays_half(self: WaveScaled, s: Any, at: At, rx: Any) -> Any:
    """p^2 dt/2 taken off as p^2 dt/4: the half is missing."""
    f, sent, after = WaveScaled.master(self, s, seen(at), rx)
    return f, sent, after._replace(S=after.S + 0.25 * at.dt * after.p * after.p)


SCALED = {
    "a constant scale below 1": wrong(WaveScaled(), "ConstantBelow", master=constant_scale(0.98)),
    "a constant scale above 1": wrong(WaveScaled(), "ConstantAbove", master=constant_scale(1.05)),
    "what goes back is scaled above 1": wrong(WaveScaled(), "AboveBack", slave=changed(WaveScaled, "slave",
                                                                                     went=times(1.05))),
    "not within the energy that came": wrong(WaveScaled(tau=1.0), "Unbounded", master=unbounded),
    "the force is of the bare wave": wrong(WaveScaled(tau=0.2), "BareForce", master=scaled_wave_unscaled_force),
    "a wave counts again while it is held": wrong(WaveScaled(tau=1.0), "CountsGaps", master=counts_gaps),
    "a half of what is played is paid": wrong(WaveScaled(tau=1.0), "PaysHalf", master=pays_half),
}


# Predicted


def unregulated(self: WavePrediction, s: Any, at: At, rx: Any) -> Any:
    """The prediction as it is, however little came."""
    return WavePrediction.master(self, s._replace(S=1e9), seen(at), rx)


def seeded(self: WavePrediction, at: At) -> Any:
    """A regulator that is given 20 mJ to begin with, which no claim of E_link allows."""
    s, held = WavePrediction.master_start(self, at)
    return s._replace(S=0.02), held


def pays_half_of_guesses(self: WavePrediction, s: Any, at: At, rx: Any) -> Any:
    """p^2 dt/2 taken off as p^2 dt/4."""
    f, sent, after = WavePrediction.master(self, s, seen(at), rx)
    return f, sent, after._replace(S=after.S + 0.25 * at.dt * after.p * after.p)


def spends_what_it_sent(self: WavePrediction, s: Any, at: At, rx: Any) -> Any:
    """The energy of the master's own wave booked as if it had come back: it is the slave's to spend too."""
    f, sent, after = WavePrediction.master(self, s, seen(at), rx)
    return f, sent, after._replace(S=after.S + 0.5 * at.dt * sent.u * sent.u)


PREDICTION = {
    "no regulator": wrong(WavePrediction(), "Unregulated", master=unregulated),
    "a regulator that begins with energy": wrong(WavePrediction(), "Seeded", master_start=seeded),
    "a half of what is played is paid": wrong(WavePrediction(), "PaysHalfOfGuesses", master=pays_half_of_guesses),
    "what was sent is spent": wrong(WavePrediction(), "SpendsTwice", master=spends_what_it_sent),
    "a wave counts again in gaps": wrong(WavePrediction(), "CountsAgain", master=deaf(WavePrediction, "master")),
    "the slave's answer is too large": wrong(
        WavePrediction(), "LouderAnswer", slave=changed(WavePrediction, "slave", went=times(1.05))),
}
