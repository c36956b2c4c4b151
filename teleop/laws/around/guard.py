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
from typing import Annotated, Any, ClassVar, NamedTuple

from teleop import kind
from teleop.errors import enough
from teleop.knob import Knob, check_knobs
from teleop.law import At
from teleop.law.offers import Facts
from teleop.laws.around.compose import Message, StageEnd

TINY = 1e-30  # m/s: below this a velocity is none


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
    def end(cls, name: str, _sends: Mapping[str, str]) -> StageEnd[Any, Any, Any, Any]:
        """At each end: its account, what it has told and what it has seen; the force after the law."""
        return MASTER if name == "master" else SLAVE

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


class Account(NamedTuple):
    H: float  # J
    E: float  # told to the other end so far, J
    seen: float  # of what the other end has told, J


class FromMaster(NamedTuple):
    E: kind.Total  # J


class FromSlave(NamedTuple):
    E: kind.Total  # J
    H: float  # J


class Work(NamedTuple):
    w: float  # of the last tick, over all axes, J
    n: float  # axes


def settle(guard: GuardWrapper, s: Account, E_rx: float, over: Work) -> Account:
    """The account after the work of a tick, where the other end tells of `E_rx` J."""
    seen = max(s.seen, E_rx)
    H = s.H + over.w + (seen - s.seen)
    gives = max(H - guard.E0, 0.0)
    return Account(H - gives, s.E + gives, seen)


def let_through(guard: GuardWrapper, s: Account, at: At, over: Work, g: float, drag: float) -> float:
    """Force (N) that an account lets through to drive a device; see the head of the file."""
    v, energy = at.v, max(s.H, 0.0) / over.n
    most = sqrt(2.0 * guard.k * energy)
    drive = min(most, energy / (at.dt * max(abs(v), TINY)))
    brake = max(most, guard.alpha * abs(v))
    ahead, astern = (v > 0.0) * 1.0, (v < 0.0) * 1.0
    rest = (1.0 - ahead - astern) * most
    damper = min(max(-s.H, 0.0) / (at.dt * max(v * v, guard.v_min * guard.v_min)), guard.alpha) + drag
    return min(max(g - damper * v, -(ahead * brake + astern * drive + rest)), ahead * drive + astern * brake + rest)


def master(guard: GuardWrapper, s: Account, at: At, rx: FromSlave, over: Work, f: float, tx: Message
           ) -> tuple[float, Message, FromMaster, Account]:
    """The master after the law, with a damper for a slave that has less than it began with."""
    s = settle(guard, s, rx.E, over)
    drag = guard.drag * min(max(1.0 - rx.H / max(guard.E0, TINY), 0.0), 1.0)
    return -let_through(guard, s, at, over, -f, drag), tx, FromMaster(s.E), s


def slave(guard: GuardWrapper, s: Account, at: At, rx: FromMaster, over: Work, f: float, tx: Message
          ) -> tuple[float, Message, FromSlave, Account]:
    """The slave after the law."""
    s = settle(guard, s, rx.E, over)
    return let_through(guard, s, at, over, f, 0.0), tx, FromSlave(s.E, s.H), s


MASTER = StageEnd(lambda guard, _: (Account(guard.E0, 0.0, 0.0), FromSlave(0.0, guard.E0)), master,
                  share=lambda _, _s, at: Work(at.f_held * at.dx, 1.0), stored=lambda s: s.H + s.E - s.seen)
SLAVE = StageEnd(lambda guard, _: (Account(guard.E0, 0.0, 0.0), FromMaster(0.0)), slave,
                 share=lambda _, _s, at: Work(-at.f_held * at.dx, 1.0), stored=lambda s: s.H + s.E - s.seen)
