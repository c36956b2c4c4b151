"""What `teleop list` says of a law beside its knobs: what it sends, what it claims on which condition, its energy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from teleop.kind import kinds
from teleop.law import BUILT_IN, find_law, known_laws, messages
from teleop.law.offers import CONDITIONS, claims_of, seed_energy, stores
from teleop.scene.loading import load_scene
from teleop.simulation.notes import unmet
from teleop.terminal.units import si

LINKS = (("a constant 50 ms each way", "delay(0.05)"),  # over which the conditions of one law are asked for
         ("50 to 70 ms each way with 5 % loss", "delay(0.05) | uniform(0.02) | bernoulli(0.05)"))


@dataclass(frozen=True, kw_only=True)
class LawLine:
    """What a law with two ends sends each way, "x, v, wave u"; what it claims; the energy it begins with, J."""

    fwd: str
    bwd: str
    claims: Mapping[str, str]
    seed: float | None  # None: it keeps no energy

    @property
    def claimed(self) -> str:
        """The ledgers that it keeps from going below zero, each with its condition."""
        return ", ".join(f"{ledger} over {condition}" if condition != "zero in gaps" else f"{ledger} with {condition}"
                         for ledger, condition in self.claims.items()) or "nothing"


def law_line(law: Any) -> LawLine | None:
    """What is said of a law; None of a one-port law, which sends and claims nothing."""
    if not hasattr(law, "master"):
        return None
    fwd, bwd = (_fields(message) for message in messages(law))
    return LawLine(fwd=fwd, bwd=bwd, claims=claims_of(law), seed=seed_energy(law) if stores(law) else None)


def _fields(message: type[Any]) -> str:
    told = [name if kind == "sample" else f"{kind} {name}" for name, kind in kinds(message).items()]
    return ", ".join(told) or "nothing"


def law_rows(meanings: Mapping[str, str]) -> tuple[list[dict[str, Any]], list[str]]:
    """A row for each law, `meanings` by its name; one of a plug-in is not imported, so little is known of it."""
    rows: list[dict[str, Any]] = []
    for name in sorted(known_laws()):
        said = law_line(find_law(name)()) if name in BUILT_IN else None
        row: dict[str, Any] = {"name": name, "fwd": None, "bwd": None, "claims": None, "seed_energy": None}
        if said is not None:
            row |= {"fwd": said.fwd, "bwd": said.bwd, "claims": said.claimed,
                    "seed_energy": None if said.seed is None else si(said.seed, "J")}
        elif name in BUILT_IN:
            row |= {"fwd": "(one port)"}
        rows.append({**row, "meaning": meanings[name]})
    return rows, [
        "fwd is what the master sends, bwd the slave: samples, and where it says so a wave or a total.",
        "A claimed ledger does not fall below zero; E_law is what the law keeps, with the energy that it begins with.",
        "`teleop list NAME` shows the knobs of one of them, and its conditions."]


def _condition(condition: str, said: LawLine) -> str:
    """A claim's condition in words; of a law without waves nothing of how they are played."""
    words = CONDITIONS[condition]
    return words if "wave " in said.fwd + said.bwd else words.partition(", with waves")[0]


def law_words(law: Any) -> tuple[list[str], dict[str, Any]]:
    """The lines on one law after its knobs, and the same as a document; `law` is its class."""
    try:
        made = law()
    except Exception:  # a law that has to be given numbers is known without them by its knobs alone
        return [], {}
    said = law_line(made)
    if said is None:
        return ["  one port: it sends nothing"], {}
    lines = [f"  sends fwd {said.fwd}; bwd {said.bwd}"]
    lines += [f"  claims {ledger} >= 0 {_condition(condition, said)}" for ledger, condition in said.claims.items()]
    lines += [] if said.claims else ["  claims no ledger"]
    if said.seed is not None:
        lines.append(f"  keeps energy, {si(said.seed, 'J')} to begin with, granted again with every session")
    conditions = {}
    for where, link in LINKS:
        found = unmet(load_scene("canonical", law=made, link=link, duration=2.0))
        conditions[where] = found
        lines += [f"  over {where}, in the scene canonical: {sentence}" for sentence in found]
    return lines, {"sends": {"fwd": said.fwd, "bwd": said.bwd}, "claims": dict(said.claims),
                   "seed_energy": said.seed, "conditions": conditions}
