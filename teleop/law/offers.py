"""Offers of a law beside its two ends: claims, stored energy, conditions, and parameters that suit a scene.

    claims = {"E_link": "any link"}        ledger -> the links over which the law keeps it from going below zero
    master_stored(s), slave_stored(s)      J, what the state of an end keeps of energy
    shows = ("H",)                         fields of its state that are recorded
    conditions(facts) -> sentences         those of its conditions that these facts break
    fitted(facts) -> law                   itself, with the parameters that follow from link and bodies, and those that
                                           break a condition at the bound where it can tell one

and to the analyses, its linear form and its coupling: `teleop.law.analysis_offers`.

Ledgers. `E_link` is the energy of the waves under way. `E_port` is what law and link together have taken up at the
two ends. `E_law` is what the law itself says that it keeps: the sum of both ends' `*_stored`. An end counts what it has
sent less what it has seen arrive, so that the sum has what is under way. With several axes they are summed; an end with
sums over the axes keeps one energy for all of them, the same in the state of each, and that of the first counts.

With E_law(0), the energy that the law is given to begin with, the books are honest if

    E_port(k) + E_law(0) - E_law(k) >= 0,

for then it keeps no energy that did not come in by a port; and with E_law(k) >= 0 the ports never get more than
E_law(0) out of it. Under a force that is held from tick to tick no law knows the work of the tick that is running, so
the claim "E_law" is E_law(k) >= -(the greatest work of one tick so far). What an end sends, and what it sees arrive,
leaves its own `*_stored` as it is, so the books are honest at each end by itself, with the work at its own port.

What the claim "E_law" does not cover. The law is told the force that was held and the motion that was read, and the
force that it sets is there at once. A slew limit of the force cap holds a force that the law has given up: up to
f^2/(2 slew) |v| goes out each time, tens of mJ at 100 N/s, and joules where it is so slow that the loop swings. The
work over an encoder's readings differs from the true one by up to a step times each change of the force. Under a force
cap the force that would pay is not held, and what several ticks took may add up. So it may where a device turns round
while a force is held, as with a grip or wall of k T^2/m or d T/m above 1/4: no reading says what a force will do then.

A damper B that is held over T against a body m on which h acts besides takes B v dx, dx = v T + (h - B v) T^2/(2 m),
which is at least -B h^2 T^3/(16 m^2 (1 - B T/(2 m))). Without h that is nothing for B <= 2 m/T; with it there is no
bound as B comes near, so conditions have B <= m/T, where it is -h^2 T^2/(8 m). T is (n + 1) dt over n ticks left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from teleop.kind import waves
from teleop.law import messages, start_at

LEDGERS = ("E_link", "E_port", "E_law")
CONDITIONS = {
    "any link": "over every link, with waves played as zero in gaps or by their integral",
    "zero in gaps": "over every link, with waves played as zero in gaps",
    "constant delay": "over a constant delay without loss",
}


class AgeRange(NamedTuple):
    """The age of the newest message that one direction of a link has played, at the ticks from the first one on, s."""

    least: float
    greatest: float  # gaps included, in which the newest message ages


class Facts(NamedTuple):
    """Facts on which a law's conditions depend: the clock, the bodies and the link of a scene. SI units."""

    dt: float
    axes: int
    mass_m: float  # of the master
    damping_m: float
    mass_s: float  # of the slave, in the master's units where the scene scales
    damping_s: float
    fwd: AgeRange | None  # None: no message was played
    bwd: AgeRange | None
    lossy: bool  # a packet was lost
    playout: str  # in gaps: zero, hold, integral, energy or scaled; fixed: at a fixed delay, and zero in gaps
    held: float  # longest time that a force is held, s: dt, and more where ticks are left out


def stores(law: Any) -> bool:
    """True if the law says how much energy it keeps."""
    return hasattr(law, "master_stored") and hasattr(law, "slave_stored")


def claims_of(law: Any) -> Mapping[str, str]:
    """The ledgers that a law keeps from going below zero, each with its condition."""
    claims: Mapping[str, str] = getattr(law, "claims", {})
    return claims


def seed_energy(law: Any, dt: float = 1e-3, axes: int = 1) -> float:
    """E_law(0), J: the energy that the law is given before its first tick. `dt` in s. 0.0 of a law that keeps none."""
    return sum(seeds(law, dt, axes)) if stores(law) else 0.0


def seeds(law: Any, dt: float, axes: int) -> tuple[float, float]:
    """The same of each end of a law that keeps energy, master and slave."""
    still = start_at(0.0, 0.0, 0.0, dt)

    def seed(end: str) -> float:
        state, _ = getattr(law, f"{end}_start")(still)
        each = float(getattr(law, f"{end}_stored")(state))
        return each if hasattr(law, f"{end}_sums") else each * axes

    return seed("master"), seed("slave")


def broken(law: Any, facts: Facts) -> list[str]:
    """Sentences on the conditions of a law that these facts break, those of its claims among them."""
    conditions = getattr(law, "conditions", None)
    return [*_claims_broken(law, facts), *(conditions(facts) if conditions is not None else ())]


def _claims_broken(law: Any, facts: Facts) -> list[str]:
    """The conditions of claims that the link or its playout breaks."""
    has_waves = all(map(waves, messages(law, facts.dt)))
    varies = facts.lossy or any(way is not None and way.greatest > way.least + 0.5 * facts.dt
                                for way in (facts.fwd, facts.bwd))
    sentences = []
    for ledger, condition in claims_of(law).items():
        if has_waves and facts.playout in ("hold", "scaled"):
            sentences.append("playout holds waves in the gaps, which is active: " + _may_fall(ledger))
        elif has_waves and facts.playout == "energy" and facts.held > 1.5 * facts.dt:
            sentences.append(f"playout energy plays short waves, which are held over the ticks that are left out: "
                        f"{_may_fall(ledger)}; type --set playout=integral")
        elif condition == "zero in gaps" and facts.playout not in ("zero", "fixed"):
            sentences.append(f"the law keeps {ledger} where waves are played as zero in gaps, and the playout is "
                        f"{facts.playout}: {_may_fall(ledger)}; type --set playout=zero")
        elif condition == "constant delay" and varies:
            sentences.append(f"the law keeps {ledger} over a constant delay without loss, and this link varies: "
                        f"{_may_fall(ledger)}; type --set playout=fixed:SECONDS, as long as the longest delay")
    return sentences


def _may_fall(ledger: str) -> str:
    return f"{ledger} may fall below zero"
