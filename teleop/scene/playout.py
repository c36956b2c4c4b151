"""Playout: the choice of the packet that a tick plays among those that have arrived, and of the message in gaps.

A packet sent at tick k arrives at tick `max(k+1, ceil(time/dt))`. With a fixed playout delay, packet k is played at
exactly tick k + D if it has come by then, and never otherwise. With any other playout the newest wins: a tick plays the
greatest number that has come, if it is greater than every one played before. Either way a packet is played at most once
and the numbers played only grow.

What is played in a gap, and of a wave at every tick, is the choice among `Zero`, `Hold`, `Integral`, `Energy` and
`Scaled`; the last three are for laws with waves (`teleop.kind`), and are `Zero` for any other law.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import ClassVar

from teleop.errors import Refused, WrongNumber, number


@dataclass(frozen=True, kw_only=True, slots=True)
class Zero:
    """Playout of the newest packet; a tick without one tells the law so; a wave law plays zero, which is passive."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Hold:
    """Playout of the newest packet; a tick without one plays the last message again, which is active."""


@dataclass(frozen=True, slots=True)
class Integral:
    """Playout of waves by their integral within their energy, both sent along: `teleop.stages.wave_integral`.

    Nothing that was sent is forgotten, so a steady wave stays steady through loss and jitter; and no more energy is
    played than was sent, so E_link >= 0 over any link, but for a wave that is held over ticks that are left out, until
    it is paid. The queue that fills the gaps is as long as the longest gap of the last `memory` s, and at least
    `target` s, which trades delay for smoothness; what is beyond is released with the time constant `settle` (s), as
    far as the energy allows. What is held in a gap counts as played, up to `ahead` s.
    """

    stage: ClassVar[str] = "wave_integral"
    target: float = 0.0
    _: KW_ONLY
    settle: float = 0.5
    memory: float = 10.0
    ahead: float = 0.05

    def __post_init__(self) -> None:
        number("target", self.target, low=0.0, high=10.0)
        number("settle", self.settle, above=0.0)
        number("memory", self.memory, low=0.0)
        number("ahead", self.ahead, low=0.0)


@dataclass(frozen=True, kw_only=True, slots=True)
class Energy:
    """Playout of what is owed of a wave at once, as far as its energy allows: passive over any link, and restless.

    Over ticks that are left out the short waves that it plays are held, which may be more energy than was sent.
    """

    stage: ClassVar[str] = "wave_energy"


@dataclass(frozen=True, slots=True)
class Scaled:
    """Playout of the newest wave, in gaps of the last again, times sqrt(1 - rate), for comparison.

    Passive where no packet is lost and the delay grows by at most `rate` s a second; a steady wave fades. Source: R.
    Lozano, N. Chopra and M. W. Spong, "Passivation of force reflecting bilateral teleoperators with time varying
    delay", Mechatronics 2002.
    """

    stage: ClassVar[str] = "wave_scaling"
    rate: float

    def __post_init__(self) -> None:
        number("rate", self.rate, low=0.0, high=1.0)


Gaps = Zero | Hold | Integral | Energy | Scaled


@dataclass(frozen=True, slots=True)
class Fixed:
    """Playout of every packet `delay` s after it was sent, of late ones never; gaps are filled as `gaps` has it."""

    delay: float
    gaps: Gaps = Zero()

    def __post_init__(self) -> None:
        number("playout delay", self.delay, above=0.0, high=3600.0)
        if not isinstance(self.gaps, Gaps):
            raise Refused(f"gaps are Zero(), Hold(), Integral(), Energy() or Scaled(...), not {self.gaps!r}; write "
                          "gaps=Integral()")

    def ticks(self, dt_ns: int) -> int:
        """The delay in ticks: rounded up, at least 1."""
        # By way of whole nanoseconds: 0.1 + 0.2 s are 300 ticks of 1 ms, not 301.
        return max(1, -(-round(self.delay * 1e9) // dt_ns))


Playout = Gaps | Fixed
FORMS = ("zero, hold, integral, integral:SECONDS of queue, energy, scaled:RATE, or fixed:SECONDS with one of these "
         "behind another colon")


def gaps_of(playout: Playout) -> Gaps:
    """Rule of a playout for gaps, and for waves at every tick."""
    return playout.gaps if isinstance(playout, Fixed) else playout


def repeats(playout: Playout) -> bool:
    """True if the last message is played again in the gaps, whatever energy came with it."""
    return isinstance(gaps_of(playout), Hold | Scaled)


def integrates(playout: Playout) -> bool:
    """True if waves are played by what they have come to, which is sent along with them."""
    return isinstance(gaps_of(playout), Integral | Energy)


def as_typed(playout: Playout) -> str:
    """A playout as it is typed: zero, integral, fixed:0.1, fixed:0.1:integral; but `settle` and `memory` are not."""
    if isinstance(playout, Fixed):
        gaps = as_typed(playout.gaps)
        return f"fixed:{playout.delay:g}" + ("" if gaps == "zero" else f":{gaps}")
    if isinstance(playout, Scaled):
        return f"scaled:{playout.rate:g}"
    if isinstance(playout, Integral) and playout.target:
        return f"integral:{playout.target:g}"
    return type(playout).__name__.lower()


def read_playout(key: str, value: object) -> Playout:
    """The playout of a text as `FORMS` has it, or a playout as it is. Raises `Refused`."""
    if isinstance(value, Playout):
        return value
    text = str(value)
    word, _, rest = text.partition(":")
    try:
        if word == "fixed" and rest:
            delay, colon, gaps = rest.partition(":")
            return Fixed(float(delay), _gaps(gaps) if colon else Zero())
        return _gaps(text)
    except WrongNumber as error:
        wrong = str(error).partition(";")[0]  # it goes on with the field's name, which is not typed
        raise Refused(f"in {key}={text} the {wrong}; {key} is {FORMS}; write {key}=fixed:0.1") from None
    except (KeyError, ValueError):
        raise Refused(f"{key} is {FORMS}, not {value!r}; write {key}=fixed:0.1") from None


def _gaps(text: str) -> Gaps:
    word, _, rest = text.partition(":")
    if word == "scaled":
        return Scaled(float(rest))
    if word == "integral" and rest:
        return Integral(float(rest))
    named: dict[str, Gaps] = {"zero": Zero(), "hold": Hold(), "integral": Integral(), "energy": Energy()}
    return named[text]
