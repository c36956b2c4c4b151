"""Where a law's parameters are looked for: a range for each of its numbers, from its knob's bounds and its default."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from math import ceil, floor, log, log10
from typing import Any, NamedTuple

from teleop.errors import Refused, enumerated, nearest
from teleop.knob import Declared, knobs_of_fields
from teleop.law import law_name
from teleop.law.offers import seed_energy, stores
from teleop.sweeps.grid import Range

FACTOR = 30.0  # on either side of the default, where a knob has no bound


class Ranges(NamedTuple):
    """The knobs that are turned, and those that stay, with the reason."""

    turned: dict[str, Range]  # by name, with "law." before it
    stay: dict[str, str]


def ranges_of(law: Any, fixed: Collection[str] = ()) -> Ranges:
    """The ranges of the numbers of `law`, except those in `fixed` ("law.K"), which somebody has set.

    A knob that declares a span (`teleop.knob`) goes through that, by equal ratios if it begins above 0; one that
    declares what its value follows from stays.

    Of the others, a knob whose value is above 0 goes by equal ratios, from 1/30 of its value, or its lower bound, to 30
    times that, or its upper bound. One with a lower bound of 0, or below, and an upper one goes evenly from one to the
    other, if its value is a tenth of that range or more, or the lower bound itself. One whose value is 0 and that has
    no upper bound goes evenly from 0 to the greatest value among the law's knobs of its unit, and stays if there is
    none. So does any that the law's seed energy, E_law(0), depends on: what is given out unpaid is not for tuning.
    Raises `Refused` for a law that has no number to turn, and for a name in `fixed` that it has not.
    """
    knobs = {name: each for name, each in knobs_of_fields(type(law)).items() if each.kind is float}
    values = {name: float(getattr(law, name)) for name in knobs}
    unknown = next((name for name in fixed if name.removeprefix("law.") not in values), None)
    if unknown is not None:
        raise Refused(f"law {law_name(law)} has no knob {unknown.removeprefix('law.')!r}; "
                      f"{nearest(unknown.removeprefix('law.'), values)}")
    turned: dict[str, Range] = {}
    stay: dict[str, str] = {}
    for name, each in knobs.items():
        if f"law.{name}" in fixed:
            stay[name] = "as set"
            continue
        if each.knob.stays:
            stay[name] = f"{values[name]:g}: {each.knob.stays}"
            continue
        if _seeds_energy(law, name):
            stay[name] = f"{values[name]:g}: the energy that the law may give out unpaid depends on it"
            continue
        span = _range(each, values[name], [values[other] for other, one in knobs.items()
                                           if other != name and one.knob.unit == each.knob.unit != ""])
        if span is None:
            stay[name] = f"{values[name]:g}: neither its value nor its bounds say where to look"
        else:
            turned[f"law.{name}"] = span
    if not turned:
        why = f"{enumerated(values)} as set" if fixed and values else "no number of its own"
        raise Refused(f"law {law_name(law)} has nothing to tune ({why}); run it as it is: teleop run SCENE "
                      f"--set law={law_name(law)}")
    return Ranges(turned, stay)


def _seeds_energy(law: Any, name: str) -> bool:
    """True if the energy that the law begins with depends on this number: more of it is no better law."""
    value = getattr(law, name)
    try:
        return stores(law) and any(seed_energy(replace(law, **{name: other})) != seed_energy(law)
                                   for other in (0.5 * value, value + 1e-3))
    except Refused:  # that is out of bounds
        return False


def _range(each: Declared, value: float, alike: list[float]) -> Range | None:
    knob = each.knob
    if knob.span is not None:
        return Range(*knob.span, log=knob.span[0] > 0.0)
    low = knob.low if knob.low is not None else knob.above
    if low is not None and low <= 0.0 and knob.high is not None and not low < value < low + 0.1 * (knob.high - low):
        return Range(low, knob.high) if knob.low is not None else Range(value / FACTOR, knob.high, log=True)
    if value > 0.0:
        bottom = max(value / FACTOR, low if low is not None else 0.0)
        top = knob.high if knob.high is not None else value * FACTOR
        return Range(bottom, top, log=True) if bottom < top else None
    most = max(alike, default=0.0)
    return Range(0.0, most) if value == 0.0 and low == 0.0 and knob.high is None and most > 0.0 else None


def at(span: Range, u: float) -> float:
    """The value at the part `u` of a range, 0 to 1, to four digits: what a person types and a table shows."""
    value = float(f"{span.at(u):.4g}")
    return min(max(value, min(span.low, span.high)), max(span.low, span.high))


def beyond(value: float, bound: float) -> float:
    """The bound that a value is moved to, in four digits, rounded on beyond it.

    >>> beyond(3.0, 40.239), beyond(50.0, 40.239), beyond(40.239, 40.239)
    (40.24, 40.23, 40.239)
    """
    if bound in (value, 0.0):
        return bound
    grain = 10.0 ** (floor(log10(abs(bound))) - 3)
    steps = bound / grain
    return float(f"{(ceil(steps) if bound > value else floor(steps)) * grain:.4g}")


def part(span: Range, value: float) -> float:
    """The part of the way at which a value lies, held to 0 .. 1."""
    if span.log:
        low = max(value, min(span.low, span.high))
        u = log(low / span.low) / log(span.high / span.low)
    else:
        u = (value - span.low) / (span.high - span.low)
    return min(max(u, 0.0), 1.0)
