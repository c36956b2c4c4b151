"""Wrong forms of the laws that keep energy: each a law as its file has it, but for one mistake that is easily made."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from types import FunctionType, MappingProxyType
from typing import Any, NamedTuple

from teleop.law import At
from teleop.laws import pspm, tdpa, two_layer
from teleop.laws.pspm import PSPM
from teleop.laws.tdpa import TDPA
from teleop.laws.two_layer import TwoLayer


def mutant(law: type[Any], name: str, knobs: Mapping[str, float] = MappingProxyType({}), **wrong: Any) -> Any:
    """A law like `law` with these knobs, in which these methods, or plain functions of its file, are others."""
    words = {**vars(sys.modules[law.__module__]), **wrong}
    parts = {key: part for key, part in vars(law).items() if key not in ("__dict__", "__weakref__")}
    for key, part in parts.items():
        if isinstance(part, FunctionType) and not key.startswith("__"):
            parts[key] = FunctionType(part.__code__, words, key, part.__defaults__)
    for key in parts.keys() & wrong.keys():  # by the name of the end: `teleop.law.reads` goes by that
        parts[key] = FunctionType(wrong[key].__code__, wrong[key].__globals__, key, None, wrong[key].__closure__)
    return type(name, (), parts)(**knobs)


# Two layers


class AskedTank(NamedTuple):
    H: float
    S: float
    seen: float
    f_was: float  # the force that was asked for at the tick before, N


def _quantum(beta: float, H_max: float, s: Any, came: float, w: float, ticks: float) -> tuple[float, float]:
    H = min(s.H + w + came, H_max)
    gives = min(beta * ticks, 1.0) * max(H, 0.0)
    return H - gives, gives


def _kept(beta: float, H_max: float, s: Any, came: float, w: float, ticks: float) -> tuple[float, float]:
    H = min(s.H + w + (came - s.seen), H_max)
    return H, s.S + min(beta * ticks, 1.0) * max(H, 0.0)


def _forgiven(beta: float, H_max: float, s: Any, came: float, w: float, ticks: float) -> tuple[float, float]:
    H = max(min(s.H + w + (came - s.seen), H_max), 0.0)
    gives = min(beta * ticks, 1.0) * H
    return H - gives, s.S + gives


def _all_of_it(f_max: float, k: float, H: float, ff: float, vv: float, dt: float) -> float:  # noqa: ARG001 - as it was
    return 1.0


def _asked_tank(self: TwoLayer, at: At) -> Any:
    s, message = TwoLayer.master_start(self, at)
    return AskedTank(*s, 0.0), message


def _asked_work(self: TwoLayer, s: AskedTank, at: At, rx: Any) -> Any:  # noqa: ARG001 - those of the law
    return two_layer.TwoLayerSums(s.f_was * at.dx, rx.f_s * rx.f_s, at.v * at.v)


def _asked(self: TwoLayer, s: AskedTank, at: At, rx: Any, over: Any) -> Any:
    f_m, forth, after = TwoLayer.master(self, two_layer.Tank(s.H, s.S, s.seen), at, rx, over)
    return f_m, forth, AskedTank(*after, f_m)


def _own_stored(self: Any, s: Any) -> Any:  # noqa: ARG001 - those of the law
    return s.H


def _wrong_sign(self: TwoLayer, s: Any, at: At, rx: Any) -> Any:  # noqa: ARG001 - those of the law
    f = self.K * (rx.x - at.x) + self.B * (rx.v - at.v)
    return two_layer.TwoLayerSums(at.f_held * at.dx, f * f, at.v * at.v)


def _by_velocity(self: TwoLayer, s: Any, at: At, rx: Any) -> Any:  # noqa: ARG001 - those of the law
    return two_layer.TwoLayerSums(at.f_held * at.v * at.span, rx.f_s * rx.f_s, at.v * at.v)


TWO_LAYER = (
    mutant(TwoLayer, "QuantaOfEnergy", exchange=_quantum, master_stored=_own_stored, slave_stored=_own_stored),
    mutant(TwoLayer, "KeepsWhatItSends", exchange=_kept),
    mutant(TwoLayer, "ForgivesItsDebt", exchange=_forgiven),
    mutant(TwoLayer, "PaysForNothing", share=_all_of_it),
    mutant(TwoLayer, "AskedForByTheMaster", master_start=_asked_tank, master_sums=_asked_work, master=_asked),
    mutant(TwoLayer, "SlaveOfTheOtherSign", slave_sums=_wrong_sign),
    mutant(TwoLayer, "WorkByTheVelocity", master_sums=_by_velocity),
)


# Set-point modulation


def _modulated(*, taken: str = "fits", radius: str = "T", debt: str = "kept") -> Any:
    def modulated(K: float, E_max: float, s: Any, x: float, x_rx: float, came: float, over: Any) -> Any:
        new = came if taken == "quanta" else came - s.seen
        T = s.T + over.w
        fits = min(new, max(E_max - (T - 0.5 * K * over.ee), 0.0))
        T = T + (new if taken == "all, and the rest sent on" else fits)
        T = max(T, 0.0) if debt == "forgiven" else T
        reach = max(T + 0.5 * K * over.ee if radius == "spring twice" else T, 0.0)
        go = 1.0 if radius == "free" else pspm.sqrt(min(2.0 * reach / max(K * over.aa, pspm.TINY), 1.0))
        gives = max(T - 0.5 * K * (go * go * over.aa) - E_max, 0.0)
        S = gives if taken == "quanta" else s.S + gives + (new - fits) * (taken == "all, and the rest sent on")
        return pspm.PSPMEnd(x + go * (x_rx - x), T - gives, S, came)

    return modulated


def _own_kept(self: Any, s: Any) -> Any:  # noqa: ARG001 - those of the law
    return s.T


def _damped(bound: str) -> dict[str, Any]:
    """Both ends add a bound on what their damper took, in place of w - (P_now - P_before)."""
    def sums(damping: str) -> Any:
        def of(self: PSPM, s: Any, at: At, rx: Any) -> Any:
            e, a, B = at.x - s.y, rx.x - at.x, getattr(self, damping)
            took = B * at.v * at.v * at.span if bound == "v" else B * at.dx * at.dx / at.span
            w = 0.5 * self.K * (e * e - (e - at.dx) * (e - at.dx)) + took
            return pspm.PSPMSums(w, e * e, a * a)

        return of

    return {"master_sums": sums("B_m"), "slave_sums": sums("B_s")}


PSPM_WRONG = (
    mutant(PSPM, "DamperByVelocity", **_damped("v")),
    mutant(PSPM, "DamperByMotion", **_damped("dx")),
    mutant(PSPM, "QuantaOfEnergy", modulate=_modulated(taken="quanta"), master_stored=_own_kept,
           slave_stored=_own_kept),
    mutant(PSPM, "TakenAndSentOn", modulate=_modulated(taken="all, and the rest sent on")),
    mutant(PSPM, "SpringCountedTwice", modulate=_modulated(radius="spring twice")),
    mutant(PSPM, "MovesForNothing", modulate=_modulated(radius="free")),
    mutant(PSPM, "ForgivesItsDebt", {"E_0": 1e-4, "E_max": 0.0, "B_m": 0.2, "B_s": 1.0},
           modulate=_modulated(debt="forgiven")),
)


# Time-domain passivity


class AskedMaster(NamedTuple):
    G: float
    E: float
    seen: float
    f_was: float  # the force that was asked for at the tick before, N


def _observed(*, told: str = "once", debt: str = "kept", sent: str = "sum") -> Any:
    def observed(G: float, E: float, came: float, w: float, most: float) -> tuple[float, float]:
        G = min(G - max(-w, 0.0), most) + came
        paid = min(max(-G, 0.0), max(w, 0.0))
        G = max(G + paid, 0.0) if debt == "forgiven" else G + paid
        took = max(w, 0.0) - (0.0 if told == "twice" else paid)
        return G, took if sent == "quanta" else E + took

    return observed


def _master_of_quanta(self: TDPA, s: Any, at: At, rx: Any, over: Any) -> Any:
    f_m, forth, after = type(QUANTA).master(self, s._replace(seen=0.0), at, rx, over)
    return f_m, forth, after


def _slave_of_quanta(self: TDPA, s: Any, at: At, rx: Any, over: Any) -> Any:
    f_s, back, after = type(QUANTA).slave(self, s._replace(seen=0.0), at, rx, over)
    return f_s, back, after


def _own_left(self: Any, s: Any) -> Any:  # noqa: ARG001 - those of the law
    return s.G


def _capped(self: TDPA, s: Any, at: At, rx: Any, over: Any) -> Any:
    """The whole controller is one damper, of at most alpha_max."""
    G, E = tdpa.observe(s.G, s.E, rx.E - s.seen, over.w, self.store)
    least = self.v_min * self.v_min
    takes = min(max(-over.fv * at.dt - G, 0.0) / (at.dt * max(over.vv, least)), self.alpha_max)
    return rx.f_s + takes * at.v, tdpa.Forth(at.x, at.v, E), tdpa.TDPAMaster(G, E, rx.E)


def _rigid(self: TDPA, s: Any, at: At, rx: Any, over: Any) -> Any:
    """The command is scaled by what there is over the power that the force of now would have."""
    spent = max(over.desired, over.held)
    C = s.C + spent - over.out
    G, E = tdpa.observe(s.G, s.E, rx.E - s.seen, min(C, 0.0) - spent, self.store + self.E0)
    x_d, f_0, c = tdpa.commanded(self.K, self.B, self.drift, s.x_d + at.dx * (1.0 - at.dt / at.span), at.x, at.v,
                                 rx.x, rx.v, at.gain)
    v_d = c * min(max(G, 0.0) / max(at.dt * f_0 * c, tdpa.TINY), 1.0)
    f_s = f_0 + (self.B + self.K * at.dt) * v_d
    after = tdpa.TDPASlave(G, E, rx.E, x_d + at.dt * v_d, v_d, f_s, min(max(C, 0.0), self.store + over.P))
    return f_s, tdpa.Back(at.gain * f_s, E), after


def _booked(which: str) -> Any:
    def sums(self: TDPA, s: Any, at: At, rx: Any) -> Any:
        own = TDPA.slave_sums(self, s, at, rx)
        if which == "asked":
            return own._replace(held=own.desired, out=s.f_d * at.dx)
        return own._replace(desired=-own.held, held=-own.desired, out=-own.out)

    return sums


def hold_unbooked(self: TDPA, s: Any, at: At, rx: Any) -> Any:
    """What the coupling gives out beyond what its commanded point put in is not counted, as TDPA was at first."""
    return TDPA.slave_sums(self, s, at, rx)._replace(out=-tdpa.FREE, vv=0.0)


def _asked_start(self: TDPA, at: At) -> Any:
    s, message = TDPA.master_start(self, at)
    return AskedMaster(*s, 0.0), message


def _asked_sums(self: TDPA, s: Any, at: At, rx: Any) -> Any:
    return TDPA.master_sums(self, s, at, rx)._replace(w=s.f_was * at.dx)


def _asked_master(self: TDPA, s: Any, at: At, rx: Any, over: Any) -> Any:
    f_m, forth, after = TDPA.master(self, s, at, rx, over)
    return f_m, forth, AskedMaster(*after, f_m)


QUANTA = mutant(TDPA, "Quanta", observe=_observed(sent="quanta"))
TDPA_WRONG = (
    mutant(TDPA, "OneDamperWithACap", master=_capped),
    mutant(TDPA, "ForceThatDoesNotChange", slave=_rigid),
    mutant(TDPA, "ToldTwice", observe=_observed(told="twice")),
    mutant(TDPA, "ForgivesItsDebt", observe=_observed(debt="forgiven")),
    mutant(TDPA, "QuantaOfEnergy", master=_master_of_quanta, slave=_slave_of_quanta, master_stored=_own_left,
           slave_stored=_own_left),
    mutant(TDPA, "SlaveOfTheOtherSign", slave_sums=_booked("sign")),
    mutant(TDPA, "AskedForByTheSlave", {"K": 2000.0, "B": 5.0, "drift": 50.0, "E0": 0.005},
           slave_sums=_booked("asked")),
    mutant(TDPA, "TakesBackByTheAskedForce", NEARLY=1e300),
    mutant(TDPA, "AskedForByTheMaster", master_start=_asked_start, master_sums=_asked_sums, master=_asked_master),
)
