"""Offers of a law to the analyses. An analysis asks for the offer, never for the law's class.

    linear(self) -> law            of a law that is not linear: the linear law that `stability`, `passivity` and
                                   `zwidth` take in its place, with the same kinds of ends
    linear_at: ClassVar[Mapping[str, float]]       values of the law's parameters at which it is linear, for the
                                   sentence that refuses it elsewhere
    coupling(self, dt) -> Coupling of a one-port law that joins the device to something simulated by a coupling: the
                                   impedances of both, for ticks of dt (s)

All of them are optional. A law that offers a coupling has it judged as `VirtualCoupling` has: what the environment
behind it may lack of passivity, the passive region of its K and B, Z-width with the device's own least impedance.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from types import MappingProxyType
from typing import Any, NamedTuple

from teleop.errors import Refused
from teleop.law import law_name

Impedance = Callable[[Any], Any]  # of z (a number or an array): force over backward-difference velocity, N s/m

NOTHING: Mapping[str, Any] = MappingProxyType({})


class Coupling(NamedTuple):
    """A coupling, and what is simulated behind it, as impedances per backward difference of the reading.

    With theta the frequency in rad per tick, z = exp(j theta) and no delay, `C` is the force over the velocity of the
    device with what is behind held fast, `E` the force on what is behind over its own velocity. Where the law has a
    stiffness K and a damping B, `C` must be linear in them, as a spring and a damper are: for that reason the region of
    the passive K and B is convex.
    """

    C: Impedance  # the coupling
    E: Impedance  # what is behind it, in contact
    free: Impedance  # what the device feels where nothing is in the way of what is behind: the least that it can feel
    flaw: str = ""  # why no damper makes `E` passive: a zero or a pole outside the unit circle; empty: it has none
    series: bool = True  # is what the device feels C E/(C + E)
    keeps: bool = True  # is `E` passive whenever the environment that it simulates is
    others: Mapping[str, Any] = NOTHING  # the same law with other integrators, by their names


def coupling_of(law: Any, dt: float) -> Coupling | None:
    """The coupling that a law offers for ticks of `dt` (s); None if it offers none. Raises `Refused`."""
    offer = getattr(law, "coupling", None)
    if not callable(offer):
        return None
    coupling = offer(dt)
    if not isinstance(coupling, Coupling):
        raise Refused(f"{type(law).__name__}.coupling returned {type(coupling).__name__}; write return Coupling(C=..., "
                      "E=..., free=...) with functions of z, and from teleop import Coupling")
    return coupling


def linear_law(law: Any) -> Any | None:
    """The linear law that a law offers in its place; None if it offers none."""
    offer = getattr(law, "linear", None)
    return offer() if callable(offer) else None


def instead(law: Any) -> str:
    """The linear law that stands for `law`, in words for a report; empty if none does."""
    linear = linear_law(law)
    if linear is None:
        return ""
    if type(linear) is type(law):
        changed = [each.name for each in fields(linear) if getattr(linear, each.name) != getattr(law, each.name)]
        with_these = ", ".join(f"{name}={getattr(linear, name):g}" for name in changed)
        return f"{law_name(law)} is taken with {with_these}, as it is linear" if changed else ""
    return f"{law_name(law)} is not linear: {described(linear)} stands in its place"


def linear_hint(law: Any, lead: str) -> str:
    """Options to type so that the law is linear, after `lead`; empty if it names none.

    >>> from teleop.laws.pfra import PFRA
    >>> linear_hint(PFRA(), "write ")
    'write --set law.alpha=1'
    """
    values: Mapping[str, float] = getattr(law, "linear_at", NOTHING)
    typed = " ".join(f"--set law.{name}={value:g}" for name, value in values.items())
    return f"{lead}{typed}" if typed else ""


def described(law: Any) -> str:
    """A law with its parameters, in one line.

    >>> from teleop.laws.direct import Direct
    >>> described(Direct(K=400.0, B=4.0))
    'direct(K=400, B=4, kf=1)'
    """
    parameters = fields(law) if is_dataclass(law) else ()
    return f"{law_name(law)}({', '.join(f'{each.name}={getattr(law, each.name):g}' for each in parameters)})"
