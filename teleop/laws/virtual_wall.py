"""A virtual wall: a spring-damper that the controller renders from the device's own reading. A one-port law.

With depth p = x - at, for p > 0

    f_m = max(0, K p + B v)        and 0 elsewhere: the wall fills x > at and cannot pull.

Source: J. E. Colgate and G. G. Schenkel, "Passivity of a class of sampled-data systems: application to
haptic interfaces", J. Robotic Systems 14(1), 1997. The force is held for a tick T, so the wall is felt
half a tick late and gives a little more out than it took in. A device of viscous damping b swallows that,
and the device with this wall is passive, iff

    b >= K T/2 + |B|

for v the backward difference of the reading, the force renewed at every tick and no delay. With a
computation delay of d ticks (first d = 0) the least damping is the maximum over th in (0, pi] of

    (K T/2) sin((2d + 1) th/2)/sin(th/2) - B cos((d + 1) th),

which for B = 0 is K (T/2 + d T) (N. Diolaiti et al., IEEE Trans. Robotics 22(2), 2006). An encoder of
step D asks for Coulomb friction fc too, K <= min(2b/T, 2 fc/D) (J. J. Abbott and A. M. Okamura, IEEE Trans.
Robotics 21(5), 2005). The damper asks for device damping as the spring does: it does not replace any.

Claims: nothing of the ledgers. E_port is the wall alone, without the device's damping, and falls below
zero by the hold's leak at any K; what is passive is the device and the wall together.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar

from teleop.knob import Knob, check_knobs
from teleop.law import At


@dataclass(frozen=True, kw_only=True)
class VirtualWall:
    """Spring-damper wall felt by the device itself."""

    K: Annotated[float, Knob("N/m", "stiffness of the wall", low=0.0)] = 1000.0
    B: Annotated[float, Knob("N s/m", "damping of the wall", low=0.0)] = 0.0
    at: Annotated[float, Knob("m", "position of its surface")] = 0.0

    claims: ClassVar[Mapping[str, str]] = {}

    def __post_init__(self) -> None:
        check_knobs(self)

    def start(self, at: At) -> tuple[()]:
        return ()

    def force(self, s: tuple[()], at: At) -> tuple[float, tuple[()]]:
        p = at.x - self.at
        return max(self.K * p + self.B * at.v, 0.0) * (p > 0.0), s
