"""Guard: a two-port passivity observer and controller around any law, in the time domain.

Source: J.-H. Ryu, J. Artigas and C. Preusche, "A passive bilateral control scheme for a teleoperator with time-varying
communication delay", Mechatronics 20(7), 2010, and J. Artigas, J.-H. Ryu and C. Preusche, "Time domain passivity
control for position-position teleoperation architectures", Presence 19(5), 2010, for the observers that tell each other
the energy that came in; M. Franken, S. Stramigioli, S. Misra, C. Secchi and A. Macchelli, "Bilateral telemanipulation
with time delays: a two-layer approach", IEEE Trans. Robotics 27(4), 2011, for a force that fades with energy.

Each end keeps an account H (J) that begins with the seed energy E_0. With w the work that was done on the end over the
last tick, by the force that was really held, summed over the axes (w = f_held dx at the master, -f_held dx at the
slave), and E the energy that an end has told the other one of so far, a `kind.Total`:

    H += w + (E_rx - seen)      gives = max(H - E_0, 0)      E += gives      H -= gives.

What is taken back from the device first fills the end's own account, so nothing is spent twice, and dissipation of the
guard itself pays what the end owes. Of the force that the law commands, g the part of it that would drive the device
(g = -f_m, g = f_s), in each of n axes:

    |g| <= sqrt(2 k H+/n)                       as much as a spring k would hold with this energy
    |g| <= H+/(n dt |v|)      where it drives   no more than the account pays for over the next tick
    |g| <= max(that of the first line, alpha |v|)      where it brakes

and where H < 0, by what a tick took that was not foreseen, a damper min(-H/(dt max(v^2, v_min^2)), alpha) takes that
back. A floor under |v| or a cap on alpha over the whole force would push for ever at low speed; here they are over the
damper alone; held from tick to tick it takes energy of a body m for alpha <= m/T, T the longest tick. A law that
drives its slave by energy that the hand never gave (position forward, contact force back) would leave the slave without
any: so the slave sends H too, and as far as it has less than E_0 the master has a damper more, drag (1 - H_slave/E_0).
How old that number is makes no difference to passivity, for a damper only takes.

Claim: `E_law`, any link. The accounts, with what is under way (E - seen), sum up to 2 E_0 + E_port exactly, so the
ports get no more than the seed energy out of it, but for what one tick takes that was not foreseen: by a force of its
own from rest at most f^2 dt^2/(2 M) <= (k dt^2/M) H of a body M. Seed energy: 2 E_0. The law's own claims are not kept:
its waves stand for the force that it commanded, and not for the one that it was let have.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import sqrt
from typing import Annotated, Any, ClassVar

from teleop.knob import Knob, check_knobs
from teleop.law.offers import Facts, enough
from teleop.laws.around.compose import EndLines, InnerEnd

TINY = 1e-30  # m/s: below this a velocity is none


def let_through(g: float, v: float, level: float, axes: float, dt: float, k: float, alpha: float, v_min: float,
                drag: float) -> float:
    """Force (N) that an account of `level` J lets through to drive a device; see the head of the file."""
    energy = max(level, 0.0) / axes
    most = sqrt(2.0 * k * energy)
    drive = min(most, energy / (dt * max(abs(v), TINY)))
    brake = max(most, alpha * abs(v))
    ahead, astern = (v > 0.0) * 1.0, (v < 0.0) * 1.0
    rest = (1.0 - ahead - astern) * most
    damper = min(max(-level, 0.0) / (dt * max(v * v, v_min * v_min)), alpha) + drag
    return min(max(g - damper * v, -(ahead * brake + astern * drive + rest)), ahead * drive + astern * brake + rest)


def master_damper(drag: float, level: float, seed: float) -> float:
    """The damper at the master (N s/m) for a slave whose account has `level` J."""
    return drag * min(max(1.0 - level / max(seed, TINY), 0.0), 1.0)


@dataclass(frozen=True)
class GuardWrapper:
    """A passivity observer and controller at both ends lets the law give out no more energy than came in."""

    E0: Annotated[float, Knob("J", "energy that each end is given to begin with", low=0.0)] = 0.05
    k: Annotated[float, Knob("N/m", "stiffness of the spring whose force an account allows", low=0.0)] = 5000.0
    alpha: Annotated[float, Knob("N s/m", "most damping with which an end takes back what it owes", low=0.0)] = 50.0
    v_min: Annotated[float, Knob("m/s", "speed below which that damping grows no more", above=0.0)] = 1e-3
    drag: Annotated[float, Knob("N s/m", "damping at the master for a slave that has no energy left", low=0.0)] = 5.0

    name: ClassVar[str] = "guard"
    shows: ClassVar[tuple[str, ...]] = ("guard_H",)

    def __post_init__(self) -> None:
        check_knobs(self)

    @classmethod
    def lines(cls, end: InnerEnd) -> EndLines:
        """At each end: its account, what it has told and what it has seen; the force after the law."""
        master = end.name == "master"
        sign = "" if master else "-"
        drag = "master_damper(self.guard_drag, rx.guard_H, self.guard_E0)" if master else "0.0"
        after = (
            "guard_seen = max(s.guard_seen, rx.guard_E)",
            "guard_H = s.guard_H + over.guard_w + (guard_seen - s.guard_seen)",
            "guard_gives = max(guard_H - self.guard_E0, 0.0)",
            "guard_E = s.guard_E + guard_gives",
            "guard_H = guard_H - guard_gives",
            f"f = let_through({'-' if master else ''}f, at.v, guard_H, over.guard_n, at.dt, self.guard_k, "
            f"self.guard_alpha, self.guard_v_min, {drag})",
            *(("f = -f",) if master else ()),
        )
        return EndLines(
            state={"guard_H": "self.guard_E0", "guard_E": "0.0", "guard_seen": "0.0"},
            sends={"guard_E": ("total", "0.0"), **({} if master else {"guard_H": ("sample", "self.guard_E0")})},
            sums={"guard_w": f"{sign}at.f_held * at.dx", "guard_n": "1.0"},
            after=after, stored="s.guard_H + s.guard_E - s.guard_seen")

    @classmethod
    def words(cls) -> Mapping[str, Any]:
        """The functions of this file that the lines name."""
        return {"let_through": let_through, "master_damper": master_damper}

    @classmethod
    def conditions_of(cls, law: Any, sentences: tuple[str, ...], facts: Facts) -> tuple[str, ...]:
        """Conditions of the law, and for each end one on its mass, for the guard's damper."""
        added = [f"the damper of the guard takes energy at the {end} where alpha <= m/T, T the longest tick, which "
                f"alpha = {law.guard_alpha:g} N s/m is not; --set law.guard_alpha="
                f"{enough(mass / facts.held, least=False)} is the most"
                for end, mass in (("master", facts.mass_m), ("slave", facts.mass_s))
                if law.guard_alpha * facts.held > mass]
        return (*sentences, *added)

    @classmethod
    def claims_of(cls, claims: Any) -> Any:  # noqa: ARG003 - those of the law are of a force that is not held
        """`E_law` alone, whatever the law claims."""
        return {"E_law": "any link"}
