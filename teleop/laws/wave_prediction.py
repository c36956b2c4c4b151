"""Wave variables whose returning wave the master predicts with a model of the slave, within the energy that came.

Sends a wave each way, with the model's guess at its answer. Claims E_link over any link; no seed energy.

Source: S. Munir and W. J. Book, "Internet-based teleoperation using wave variables with prediction", IEEE/ASME Trans.
Mechatronics 7(2), 2002, and H. Ching and W. J. Book, "Internet-based bilateral teleoperation based on wave variable
with adaptive predictor and direct drift control", ASME J. Dynamic Systems, Measurement, and Control 128(1), 2006: a
Smith predictor of the returning wave, a regulator of its energy, a correction of drift. Model, weight and regulator
here are derived here. The waves and the slave are those of `teleop.laws.wave`.

Prediction. The master keeps a model of the slave, a mass and a damping behind the law's own coupling, and sends with
each wave u the wave `guess` with which the model answers it; the slave sends the guess back with its answer w: the
link is the memory of the round trip. The master wants to play what came and the change of the guess since then,

    q = w + h (guess - heard) + (D + h L)/tau,   h = lead max(0, 1 - <(w - heard)^2>/<w^2>),

<.> the mean within tau. h is the share of the waves that the model explains: about 1 in free space with the right
mass, 0 where something is touched, and there it is the wave law. D is the integral of what came less what was played,
L that of the guesses under way, so D + h L is what was held back. L is forgotten within FORGET, and with it what loss
and a wrong model leave in it: in the end D comes to nothing, and with it the drift.

Regulator. p = q limited to p^2 <= 2 S/dt, S += dt (w^2 - p^2)/2: so no more is played than came, whatever the model
says. Of a motion that begins the first round trip is felt as the damper b; S has then what the waves under way are
ahead by, and a motion that stays as large is played in full. A steady wave leaves nothing over to make up for what was
held back.

What it is worth, against `wave` with the same gains, 10 s, 50 ms each way (200 ms), the slave's 0.5 kg and 1 N s/m
known: `free_motion` 1.82 mm of tracking error for 7.26 (2.69 for 44.1), at 0.5 Hz a felt mass of 0.50 kg for 0.65
(0.47 for 0.90) and a drag of 1.04 N s/m for 1.34 (1.06 for 5.06). In contact it brings nothing: `hard_wall` 3.49 N for
3.51. Where contact comes and goes, `canonical`, 29.0 mm for 31.8 and 3.1 N of force error for 4.1 (85 mm for 48). Of a
model with a damping of 3 next to nothing is left, 7.2 mm for 7.3. `fitted` takes the slave's own mass and damping, and
for tau the greatest age of a wave: at 200 ms `hard_wall` has then 2.5 N at most, with tau = 0.05 4.2, with `wave` 3.1.

Claims: E_link >= 0 over every link with the playouts of `teleop.laws.wave`. Ticks that are left out: S and D have what
was played for the gap and what came for it; the model stands still.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import isnan, sqrt
from typing import Annotated, ClassVar, NamedTuple

from teleop import kind
from teleop.knob import Knob, check_knobs
from teleop.law import At
from teleop.law.offers import Facts

TINY = 1e-300  # W, in place of no wave under a fraction
FORGET = 5.0  # s


class Forth(NamedTuple):
    u: kind.Wave  # forward, sqrt(W)
    guess: kind.Sample  # the wave with which the model answers it, sqrt(W)


class Back(NamedTuple):
    w: kind.Wave  # returning, sqrt(W)
    guess: kind.Sample  # the guess that came with the wave that it answers, sqrt(W)


class WavePredictionMaster(NamedTuple):
    z: float  # stretch of the model's coupling, m
    v_p: float  # velocity of the model's slave, m/s
    guess: float  # the wave that the model returns, sqrt(W)
    heard: float  # the guess that came with the newest wave, sqrt(W)
    miss: float  # mean square of what the guesses missed, W
    size: float  # mean square of the waves that came, W
    S: float  # energy that came and is not played yet, J
    D: float  # integral that came and is not played yet, sqrt(W) s
    L: float  # integral of the guesses whose waves are under way, sqrt(W) s
    p: float  # the wave that is played, sqrt(W)
    r: float  # the wave that came with the last tick, zero without one, sqrt(W)


class WavePredictionSlave(NamedTuple):
    x_d: kind.Position  # commanded point, m
    v_d: float  # its velocity, m/s


@dataclass(frozen=True, kw_only=True)
class WavePrediction:
    """Wave variables with the returning wave predicted, within the energy that came."""

    b: Annotated[float, Knob("N s/m", "wave impedance", above=0.0, span=(0.1, 300.0))] = 2.0
    K: Annotated[float, Knob("N/m", "stiffness of the coupling", low=0.0, span=(10.0, 3e4))] = 500.0
    B: Annotated[float, Knob("N s/m", "damping of the coupling", low=0.0, span=(0.1, 500.0))] = 20.0
    mass: Annotated[float, Knob("kg", "mass of the predicted slave", above=0.0, stays="the slave's own")] = 0.5
    damping: Annotated[float, Knob("N s/m", "its damping", low=0.0, stays="the slave's own")] = 1.0
    lead: Annotated[float, Knob(
        "", "share of the prediction that is played; 0: none", low=0.0, high=1.0, span=(0.0, 1.0))] = 1.0
    tau: Annotated[float, Knob(
        "s", "time of the means, and of making up for what was held back", above=0.0, span=(2e-3, 1.0))] = 0.05

    claims: ClassVar[Mapping[str, str]] = {"E_link": "any link"}

    def __post_init__(self) -> None:
        check_knobs(self)

    def master_start(self, at: At) -> tuple[WavePredictionMaster, Back]:
        return WavePredictionMaster(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), Back(0.0, 0.0)

    def slave_start(self, at: At) -> tuple[WavePredictionSlave, Forth]:
        return WavePredictionSlave(at.x, 0.0), Forth(0.0, 0.0)

    def master(self, s: WavePredictionMaster, at: At, rx: Back) -> tuple[float, Forth, WavePredictionMaster]:
        b, v, dt = self.b, at.v, at.dt
        gap, here, root = at.span - dt, 1.0 * at.fresh, sqrt(2.0 * b)
        r = here * rx.w
        heard = s.heard + here * (rx.guess - s.heard)
        share = here * at.span / (self.tau + at.span)
        miss = s.miss + share * ((r - heard) * (r - heard) - s.miss)
        size = s.size + share * (r * r - s.size)
        h = self.lead * max(0.0, 1.0 - miss / max(size, TINY))
        S = s.S + gap * (0.5 * (s.r * s.r - s.p * s.p)) + dt * (0.5 * (r * r))
        D = s.D + gap * (s.r - s.p) + dt * r
        L = s.L + at.span * (s.guess - heard - s.L / FORGET)
        most = sqrt(2.0 * max(S, 0.0) / dt)
        q = r + h * (s.guess - here * heard) + (s.D + h * s.L) / self.tau
        p = max(-most, min(q, most))
        u = root * v - p
        # The model's coupling and slave, both at the end of the tick.
        C = self.B + self.K * dt
        pull = self.K * s.z
        v_p = (self.mass * s.v_p + dt * (C * root * u + b * pull) / (b + C)) / (
            self.mass + dt * self.damping + dt * b * C / (b + C))
        v_d = (root * u - pull + C * v_p) / (b + C)
        guess = u - 2.0 / root * (pull + C * (v_d - v_p))
        z = s.z + dt * (v_d - v_p)
        return b * v - root * p, Forth(u, guess), WavePredictionMaster(
            z, v_p, guess, heard, miss, size, S - dt * (0.5 * (p * p)), D - dt * p, L, p, r)

    def slave(self, s: WavePredictionSlave, at: At, rx: Forth) -> tuple[float, Back, WavePredictionSlave]:
        b, K, B, x, v, dt, g = self.b, self.K, self.B, at.x, at.v, at.dt, at.gain
        u = rx.u * at.fresh
        root = sqrt(2.0 * b)
        x_d = s.x_d + (at.span - dt) * s.v_d
        v_d = (root * u - g * (K * (x_d - x) - B * v)) / ((2.0 - g) * b + g * (B + K * dt))
        x_d = x_d + dt * v_d
        f_s = K * (x_d - x) + B * (v_d - v)
        return f_s, Back(root * v_d - u, rx.guess), WavePredictionSlave(x_d, v_d)

    def conditions(self, facts: Facts) -> tuple[str, ...]:
        """The slave's own mass and damping, where the model's differ from them by more than a fifth."""
        wanted = self.fitted(facts)
        pairs = (self.mass, wanted.mass), (self.damping, wanted.damping)
        if all(abs(model - real) <= real / 5.0 for model, real in pairs):
            return ()
        return (f"the prediction is worth little of a slave that is not the model: the model has {self.mass:g} kg and "
                f"{self.damping:g} N s/m; set law.mass to {wanted.mass:g} and law.damping to {wanted.damping:g}",)

    def fitted(self, facts: Facts) -> WavePrediction:
        """The same with the slave's mass and damping, and a time that goes with the link's."""
        ages = [way.greatest for way in (facts.fwd, facts.bwd) if way is not None]
        return replace(self, mass=self.mass if isnan(facts.mass_s) else facts.mass_s,
                       damping=self.damping if isnan(facts.damping_s) else facts.damping_s,
                       tau=max([*ages, 0.01]) if ages else self.tau)
