"""Laws of the stack, each with one mistake that is easily made: `check_law`, which knows none of them, refuses it."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from teleop import Refused, check_law

E_LINK = ("claims: ClassVar[Mapping[str, str]] = {}", 'claims: ClassVar[Mapping[str, str]] = {"E_link": "any link"}')
E_PORT = (E_LINK[0], E_LINK[1].replace("E_link", "E_port").replace("any link", "constant delay"))
WAVES = r"claims E_link, but by tick \d+.* its (master|slave) gave its port .* J more than the waves brought"
BOOKS = r"claims E_law, but at tick \d+ its (master|slave) keeps"
KEEPS = rf"{BOOKS}|claims E_law, which fell to"

Wrong = dict[str, tuple[Any, ...]]  # the mistake: lines and those in their place, knobs, what the refusal says


def damped(speed: str) -> tuple[tuple[str, str], ...]:
    """Both ends of PSPM add a bound on what their damper took, in place of what was really held."""
    return tuple([(f"PSPMSums({sign}at.f_held * at.dx,", "PSPMSums(0.5 * self.K * (e * e - (e - at.dx) * (e - at.dx)) "
                   f"+ self.{B} * {speed},") for sign, B in (("", "B_m"), ("-", "B_s"))])


LAWS: dict[str, Wrong] = {
    "wave": {
        "the master plays a wave again in gaps": (
            ("w = rx.w * at.fresh", "w = rx.w"), r"its master gave its port .*; put zero for a wave"),
        "the slave does": (("u = rx.u * at.fresh", "u = rx.u"), "its slave gave its port"),
        "a half is missing in the force": (("self.b * v - root * w, F", "self.b * v - 0.5 * root * w, F"), WAVES),
        "the loop is one tick late": (
            ("f_s = K * (x_d - x)", "f_s = K * (s.x_d - x)"),
            "its slave gave its port.*solve force and velocity together"),
        "the force has the wrong sign": (("return f_s, Back", "return -f_s, Back"), "turn the sign of f_s"),
        "more is returned": (("Back(u - 2.0 / root", "Back(1.05 * u - 2.1 / root"), WAVES),
        "more is played than comes": (("u = rx.u * at.fresh", "u = 1.02 * rx.u * at.fresh"), WAVES),
    },
    "wave_filter": {
        "the filter is on the force": (
            ("w = low_pass(s.y, s.r, r, 2.0 * pi * self.f_c, at.dt, at.span - at.dt)", "w = r"),
            ("return self.b * at.v - root * w, Forth(root * at.v - w), WaveFilterMaster(w, r)",
             "f = low_pass(s.y, 0.0, self.b * at.v - root * w, 2.0 * pi * self.f_c, at.dt, 0.0)\n"
             "        return f, Forth(root * at.v - w), WaveFilterMaster(f, r)"), WAVES),
        "the filter is on the wave of the force alone": (("Forth(root * at.v - w)", "Forth(root * at.v - r)"), WAVES),
        "the filter steps too far": (
            ("w = low_pass(s.y, s.r, r, 2.0 * pi * self.f_c, at.dt, at.span - at.dt)",
             "w = s.y + 2.5 * (r - s.y) * (abs(s.y) < 1e6)"), "turn the sign of f_m"),
        "the filter holds its wave in gaps": (
            ("r = rx.w * at.fresh", "r = rx.w * at.fresh + s.y * (1.0 - at.fresh)"), WAVES),
        "a wave is played again in gaps": (("r = rx.u * at.fresh", "r = rx.u"), {"f_c": 200.0}, WAVES),
    },
    "wave_matched": {
        "the halving is undone by doubling what comes": (("rx.u * at.fresh", "2.0 * rx.u * at.fresh"), WAVES),
        "the halving is undone by doubling the force": (
            ("return K * (x - x_d) + b * (v - v_d)", "return 2.0 * (K * (x - x_d) + b * (v - v_d))"), WAVES),
        "the master's coupling has the wrong sign": (
            ("return K * (x - x_d) + b * (v - v_d)", "return K * (x_d - x) + b * (v_d - v)"), "turn the sign of f_m"),
        "the wave is of the device and not of the point": (("Forth(root * v_d - w)", "Forth(root * v - w)"), WAVES),
        "a wave is played again in gaps": (("w = rx.w * at.fresh", "w = rx.w"), WAVES),
    },
    "wave_position": {
        "it claims the link": (E_LINK, WAVES),
        "it claims the link with much damping": (E_LINK, {"K_p": 50.0, "B_p": 20.0}, WAVES),
        "it claims the ports": (E_PORT, {"K_p": 500.0, "B_p": 0.0}, "claims E_port, which fell to"),
        "it claims them with its spring turned around": (
            E_PORT, ("+ (self.K_p * (x - rx.x)", "+ (self.K_p * (rx.x - x)"), {"K_p": 500.0},
            "turn the sign of f_m"),
    },
    "wave_scaled": {
        **{f"the scale is {scale} whatever comes": (
            ("now = scale_wave(s.g2, s.S, s.p, s.r, rx.w, at.fresh, at.age, self.tau, at.dt, at.span)",
             f"now = ScaledWave(1.0, 0.0, {scale} * rx.w, 0.0)"), WAVES) for scale in (0.98, 1.05)},
        "more is returned": (("w = u - 2.0 / root", "w = 1.05 * u - 2.1 / root"), WAVES),
        "it is not held within the energy that came": (
            ("p = max(-most, min(sqrt(g2) * newest, most))", "p = sqrt(g2) * newest"), {"tau": 1.0}, WAVES),
        "the force is of the bare wave": (
            ("self.b * at.v - root * now.p, F", "self.b * at.v - root * rx.w * at.fresh, F"), {"tau": 0.2}, WAVES),
        "a wave counts again while it is held": (("arrived = n * newest", "arrived = newest"), {"tau": 1.0}, WAVES),
        "half of what is played is paid": (("(0.5 * (p * p))", "(0.25 * (p * p))"), {"tau": 1.0}, WAVES),
    },
    "wave_prediction": {
        "no regulator": (("p = max(-most, min(q, most))", "p = q"), WAVES),
        "a regulator that begins with energy": (
            ("return WavePredictionMaster(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0",
             "return WavePredictionMaster(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.02"), WAVES),
        "half of what is played is paid": (("(0.5 * (p * p))", "(0.25 * (p * p))"), WAVES),
        "what was sent is spent": (("(0.5 * (p * p))", "(0.5 * (p * p - u * u))"), WAVES),
        "a wave counts again in gaps": (("1.0 * at.fresh", "1.0"), WAVES),
        "more is returned": (("Back(root * v_d - u, ", "Back(1.05 * (root * v_d - u), "), WAVES),
    },
    "p_d": {
        "the slave flees its master": (
            ("self.K * (apart - offset) - self.B * at.v, B", "-self.K * (apart - offset) - self.B * at.v, B"),
            {"B": 0.0}, "turn the sign of f_s"),
        "the master goes on where the slave is stopped": (
            ("self.K * (apart - offset) + self.B * at.v, F", "-self.K * (apart - offset) + self.B * at.v, F"),
            {"B": 0.0}, "turn the sign of f_m"),
        "the other end is taken to stand at zero": (
            ("PDampedEnd(0.0), Back(at.x)", "PDampedEnd(0.0), Back(0.0)"), {"B": 0.0}, "would jump"),
        "where it was let go is kept in the law": (
            ("offset = (s.offset", "self.__dict__['rejoin'] = 1.0; offset = (s.offset"), {"B": 0.0}, "changes the law"),
        "the condition counts the damper once for both ends": (
            ('"P+d", facts, self.K, 0.0, self.B)', '"P+d", facts, self.K, 0.0, 0.5 * self.B)'), {"B": 0.0},
            "broken still"),
        "the condition tells more than is needed": (
            ("facts, self.K, 0.0, self.B)", "facts, self.K * (1.1 if self.B == 0.0 else 1.0), 0.0, self.B)"),
            {"B": 0.0}, "is enough"),
        "what it is fitted with may be anything": (("check_knobs(self)", "pass"), {"B": 0.0}, "accepts K=nan"),
    },
    "two_layer": {
        "quanta are told and not sums": (
            ("(S_rx - s.seen), H_max", "S_rx, H_max"), ("H - gives, s.S + gives", "H - gives, gives"),
            ("return s.H + (s.S - s.seen)", "return s.H"), KEEPS),
        "what is sent is kept": (("return H - gives", "return H"), KEEPS),
        "debt is forgiven": (
            ("H = min(s.H + w + (S_rx - s.seen), H_max)", "H = max(min(s.H + w + (S_rx - s.seen), H_max), 0.0)"),
            KEEPS),
        "the tank pays for nothing": (("return sqrt(min(", "return 1.0 or sqrt(min("), KEEPS),
        "the force that was asked for is booked": (
            ("seen: float  # what it has taken of the other end's S, J", "seen: float\n    f_was: float = 0.0"),
            ("TwoLayerSums(at.f_held * at.dx", "TwoLayerSums(s.f_was * at.dx"),
            ("Forth(at.x, at.v, S), Tank(H, S, rx.S)", "Forth(at.x, at.v, S), Tank(H, S, rx.S, f_m)"), KEEPS),
        "the slave's work has the master's sign": (("TwoLayerSums(-at.f_held", "TwoLayerSums(at.f_held"), KEEPS),
        "work is force times velocity": (
            ("TwoLayerSums(at.f_held * at.dx", "TwoLayerSums(at.f_held * at.v * at.span"), KEEPS),
    },
    "pspm": {
        "its dampers are booked by the velocity": (*damped("at.v * at.v * at.span"), KEEPS),
        "its dampers are booked by the motion": (*damped("at.dx * at.dx / at.span"), KEEPS),
        "quanta are told and not sums": (
            ("S_rx - s.seen", "S_rx"), ("s.S + gives, S_rx", "gives, S_rx"),
            ("return s.T + (s.S - s.seen)", "return s.T"), KEEPS),
        "what does not fit is taken and sent on": (
            ("T = T + min(S_rx - s.seen, max(E_max - E, 0.0))",
             "fits = min(S_rx - s.seen, max(E_max - E, 0.0))\n    T = T + (S_rx - s.seen)"),
            ("s.S + gives, S_rx", "s.S + gives + (S_rx - s.seen - fits), S_rx"), KEEPS),
        "the spring counts twice": (("2.0 * max(T, 0.0)", "2.0 * max(T + 0.5 * K * over.ee, 0.0)"), KEEPS),
        "a set point moves for nothing": (("go = sqrt(", "go = 1.0 or sqrt("), KEEPS),
        "debt is forgiven": (
            ("max(E_max - E, 0.0))\n", "max(E_max - E, 0.0))\n    T = max(T, 0.0)\n"),
            {"E_0": 1e-4, "E_max": 0.0, "B_m": 0.2, "B_s": 1.0}, KEEPS),
    },
    "tdpa": {
        "its controller is one damper": (
            ("takes = min(max(-G, 0.0)", "takes = min(max(-over.fv * dt - G, 0.0)"),
            ("f_m = max(min(most, 0.0) - owes_little, min(f, max(most, 0.0) + owes_little))", "f_m = rx.f_s"), KEEPS),
        "the command is scaled by the force of now": (
            ("v_d = c - beyond * (c + 0.5 * f_0 / z)", "v_d = c * min(max(G, 0.0) / max(dt * f_0 * c, TINY), 1.0)"),
            KEEPS),
        "what paid a debt is told as well": (("E + (max(w, 0.0) - paid)", "E + max(w, 0.0)"), KEEPS),
        "debt is forgiven": (("return G + paid", "return max(G + paid, 0.0)"), KEEPS),
        "quanta are told and not sums": (
            ("rx.E - s.seen", "rx.E"), ("E + (max(w, 0.0) - paid)", "max(w, 0.0) - paid"),
            (" + (s.E - s.seen)", ""), KEEPS),
        "the slave's work has the master's sign": (
            ("s.f_d * step + done, at.f_held * step + done, at.f_held * at.dx",
             "-at.f_held * step - done, -s.f_d * step - done, -at.f_held * at.dx"), KEEPS),
        "the force that the slave asked for is booked": (
            ("at.f_held * step + done, at.f_held * at.dx", "s.f_d * step + done, s.f_d * at.dx"),
            ("class TDPA:", "class AskedForByTheSlave:"),  # what is tried goes by the name
            {"K": 2000.0, "B": 5.0, "drift": 50.0, "E0": 0.005}, KEEPS),
        "it takes back by the force that was asked for": (("NEARLY = 1e-9", "NEARLY = 1e300"), KEEPS),
        "the force that the master asked for is booked": (
            ("seen: float  # the other end's E so far, J", "seen: float\n    f_was: float = 0.0"),
            ("TDPAMasterSums(at.f_held * at.dx", "TDPAMasterSums(s.f_was * at.dx"),
            ("Forth(at.x, at.v, E), TDPAMaster(G, E, rx.E)", "Forth(at.x, at.v, E), TDPAMaster(G, E, rx.E, f_m)"),
            KEEPS),
    },
}
NIGHTLY = {"wave_filter", "wave_matched", "wave_scaled", "wave_prediction", "pspm", "two_layer"}


def wrong_law(monkeypatch: pytest.MonkeyPatch, module: str, *changes: tuple[str, str], **knobs: float) -> Any:
    """A law whose file has other lines in place of some of its own."""
    file = import_module(f"teleop.laws.{module}").__file__
    text = Path(str(file)).read_text(encoding="utf-8")
    for lines, instead in changes:
        assert lines in text, f"no longer in {file}, so nothing would be tried: {lines}"
        text = text.replace(lines, instead)
    changed = ModuleType("changed")
    monkeypatch.setitem(sys.modules, "changed", changed)
    exec(compile(text, f"{module}.py", "exec"), vars(changed))
    law, = [each for each in vars(changed).values() if hasattr(each, "master_start")]
    return law(**knobs)


@pytest.mark.parametrize(("of", "mistake"), [
    pytest.param(of, mistake, id=f"{of}: {mistake}", marks=[pytest.mark.full] * (of in NIGHTLY))
    for of, mistakes in LAWS.items() for mistake in mistakes])
def test_a_law_with_one_mistake_is_refused(monkeypatch: pytest.MonkeyPatch, of: str, mistake: str) -> None:
    *how, said = LAWS[of][mistake]
    knobs = how.pop() if isinstance(how[-1], dict) else {}
    with pytest.raises(Refused, match=said):
        check_law(wrong_law(monkeypatch, of, *how, **knobs), compiled=False)
