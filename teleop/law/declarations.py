"""Checks of a law's declarations, when a scene is made of it: its claims, its messages and its other offers.

Each check raises `Wrong`, whose text is the rest of a sentence that begins with the law's class and its line.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import Any

from teleop.errors import nearest
from teleop.kind import waves
from teleop.law import At
from teleop.law.offers import CONDITIONS, LEDGERS, stores

COSTLY = frozenset(At._fields) - {"x", "v"}  # the position and the velocity are known at every tick
LONGEST = 80  # characters of a value that a sentence shows


class Wrong(Exception):
    """Fault of a law; the text is the rest of a sentence that begins with the law or one of its methods."""


def check_claims(law: Any) -> None:
    """Claims are ledgers with their conditions."""
    claims = getattr(law, "claims", {})
    if not isinstance(claims, Mapping):
        raise Wrong(f"has claims={claims!r}; write claims: ClassVar[dict[str, str]] = {{}}, or "
                    '{"E_link": "any link"}')
    for ledger, condition in claims.items():
        if ledger not in LEDGERS:
            raise Wrong(f"claims {ledger!r}, which is no ledger; {nearest(str(ledger), LEDGERS)}")
        if condition not in CONDITIONS:
            raise Wrong(f"claims {ledger} over {condition!r}, which is no condition; "
                        f"{nearest(str(condition), CONDITIONS)}")
    if "E_law" in claims and not stores(law):
        raise Wrong("claims E_law, but has no master_stored and slave_stored; write both: of a state the energy in J "
                    "that it keeps")


def check_waves(law: Any, sent: Mapping[str, Any]) -> None:
    """A message has one wave or none, in both directions or in neither; E_link is claimed with waves alone."""
    sent_waves = {type(message).__name__: waves(type(message)) for message in sent.values()}
    claims = "E_link" in getattr(law, "claims", ())
    if two := next((message for message, fields in sent_waves.items() if len(fields) > 1), None):
        raise Wrong(f"sends a message {two} of {len(sent_waves[two])} waves, {', '.join(sent_waves[two])}, and one "
                    "direction has one wave; write float for what is none")
    without = [message for message, fields in sent_waves.items() if not fields]
    if without and (claims or len(without) < len(sent_waves)):
        why = "claims E_link" if claims else "has a wave in one direction"
        raise Wrong(f"{why}, and its message {without[0]} has no field that is a wave; write `u: kind.Wave` for the "
                    "one that is, with `from teleop import kind`")


def check_offers(law: Any, states: Mapping[str, Any]) -> None:
    """A stored energy is a finite float, and each field that is shown is one of a state. `states`: by end."""
    for end, state in states.items():
        stored = getattr(law, f"{end}_stored", None)
        if stored is not None and not (isinstance(energy := stored(state), float) and isfinite(energy)):
            raise Wrong(f"returns {short_repr(energy)} from {end}_stored; return the state's energy in J as a float")
    fields = sorted({field for state in states.values() for field in getattr(state, "_fields", ())})
    shows = getattr(law, "shows", ())
    if not isinstance(shows, tuple) or not all(isinstance(field, str) for field in shows):
        raise Wrong(f'has shows={shows!r}; write shows: ClassVar[tuple[str, ...]] = ("H",)')
    for field in shows:
        if field not in fields:
            raise Wrong(f"shows {field!r}, which no state of its has; {nearest(field, fields)}")


def check_names(parts: Mapping[str, Sequence[Any]]) -> None:
    """No field has the name of one of `At`: what reads it would seem to read that, which may take a sensor."""
    for what, each in parts.items():
        for field in (field for part in each for field in getattr(part, "_fields", ())):
            if field in COSTLY:
                raise Wrong(f"has a {what} with the field {field}, a name of At: what reads it would seem to read "
                            f"at.{field}, and have it worked out at every tick; give it another name")


def short_repr(value: object) -> str:
    """A value in one line of a sentence."""
    try:
        text = " ".join(repr(value).split())
    except Exception:  # a repr of the author's own may be what is broken
        text = f"a {type(value).__name__}"
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}..."
