"""Virtual coupling: the master's device is coupled to a simulated tool, and the law has the tool in its place.

Source: J. E. Colgate, M. C. Stanley and J. M. Brown, "Issues in the haptic display of tool use", IROS 1995; R. J. Adams
and B. Hannaford, "Stable haptic interaction with virtual environments", IEEE Trans. Robotics and Automation 15(3),
1999. `teleop.laws.virtual_coupling` is the same coupling in front of a simulated wall.

At the master, with the device's reading x, v and the tool's position y and velocity u,

    f_m = K (x - y) + B (v - u)                       on the hand, and the other way on the tool
    m u' = f_m - f_law - b u,   y' = u                tool of mass m and damping b

The law around which it stands is told y, u, the force f_law that it held on the tool, and f_m as the force of the hand;
its slave is as ever. With T the time since the last tick, the tool is taken through it by backward Euler with f_law
held, as a body between two ticks is:

    u = (m u_0/T + K (x - y_0) + B v - f_law)/(m/T + B + K T + b),   y = y_0 + T u.

So the law holds its force on a body that is known to the number, whatever the device is: its conditions are those of a
master of mass m and damping b. Where the device lets go (`at.gain` below 1) the tool is taken to it,
y_0 += (1 - gain) (x - y_0), so no coupling that was stretched for nothing is paid out afterwards.

Passivity of the device. f_m depends on the reading as a spring K and a damper B in series with what is behind, which is
passive where law and tool are; sampled and held, a device of damping b_m is passive with it if

    b_m >= K dt/2 + B

(derived in `teleop.laws.virtual_coupling`, for forces that are renewed at every tick). A stiffer wall, or a stiffer
law, needs no more.

Claims: nothing of the ledgers, whose ports are those of the devices: the law's own would hold at the tool. Seed energy:
none.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from teleop.knob import Knob, check_knobs
from teleop.law import At
from teleop.law.offers import Facts, enough
from teleop.laws.around.compose import EndLines, InnerEnd


def tool_velocity(y: float, u: float, net: float, x: float, v: float, m: float, b: float, K: float, B: float,
                  T: float) -> float:
    """The tool's velocity (m/s) after T s under the coupling and the held force -`net` (N)."""
    return (m * u / T + K * (x - y) + B * v - net) / (m / T + B + K * T + b)


@dataclass(frozen=True)
class VirtualCouplingWrapper:
    """The master's device is joined by a spring-damper to a simulated tool, which the law has in its place."""

    K: Annotated[float, Knob("N/m", "stiffness of the coupling", low=0.0)] = 400.0
    B: Annotated[float, Knob("N s/m", "damping of the coupling", low=0.0)] = 0.2
    mass: Annotated[float, Knob("kg", "mass of the tool", above=0.0)] = 0.1
    damping: Annotated[float, Knob("N s/m", "damping of the tool", low=0.0)] = 0.5

    name: ClassVar[str] = "virtual_coupling"
    shows: ClassVar[tuple[str, ...]] = ("virtual_coupling_y",)
    is_linear: ClassVar[bool] = True
    no_rotation: ClassVar[str] = "its tool has a place on each axis by itself, and no orientation"

    def __post_init__(self) -> None:
        check_knobs(self)

    @classmethod
    def lines(cls, end: InnerEnd) -> EndLines:
        """At the master: the tool, and what the law is told of it; at the slave nothing."""
        if end.name == "slave":
            return EndLines()
        vc = "virtual_coupling"
        before = (
            f"{vc}_y = s.{vc}_y + (1.0 - at.gain) * (at.x - s.{vc}_y)",
            f"{vc}_u = tool_velocity({vc}_y, s.{vc}_u, s.{vc}_net, at.x, at.v, self.{vc}_mass, "
            f"self.{vc}_damping, self.{vc}_K, self.{vc}_B, at.span)",
            f"{vc}_y = {vc}_y + at.span * {vc}_u",
            f"{vc}_f = self.{vc}_K * (at.x - {vc}_y) + self.{vc}_B * (at.v - {vc}_u)",
            f"at = At({vc}_y, {vc}_u, {vc}_f, s.{vc}_net, {vc}_y - s.{vc}_y, at.fresh, at.age, at.dt, at.span, "
            "1.0)",
        )
        after = (f"{vc}_net = f", f"f = {vc}_f")
        state = {f"{vc}_y": "at.x - at.dt * at.v", f"{vc}_u": "at.v", f"{vc}_net": "0.0"}  # a tick before the first
        return EndLines(state=state, before=before, after=after)

    @classmethod
    def words(cls) -> Mapping[str, Any]:
        """Functions and types that the lines name."""
        return {"tool_velocity": tool_velocity, "At": At}

    @classmethod
    def claims_of(cls, claims: Any) -> Any:  # noqa: ARG003 - those of the law are of the tool's port
        """None, whatever the law claims."""
        return {}

    @classmethod
    def facts_of(cls, law: Any, facts: Facts) -> Facts:
        """Facts for the law's own conditions: the tool in place of the master."""
        return facts._replace(mass_m=law.virtual_coupling_mass, damping_m=law.virtual_coupling_damping)

    @classmethod
    def conditions_of(cls, law: Any, texts: tuple[str, ...], facts: Facts) -> tuple[str, ...]:
        """The law's own, and that of the device."""
        K, B, damping = law.virtual_coupling_K, law.virtual_coupling_B, facts.damping_m
        least, leak = 0.5 * K * facts.dt + B, 0.5 * K * facts.dt
        if not damping < least:
            return texts
        begins = (f"a device is passive at the virtual coupling where its damping is at least K dt/2 + B = {least:.4g} "
                  f"N s/m, and the master has {damping:.4g}")
        if damping > leak:
            return (*texts, f"{begins}; --set law.virtual_coupling_B={enough(damping - leak, least=False)} is the most")
        most = enough(2.0 * damping / facts.dt, least=False)
        return (*texts, f"{begins}; --set law.virtual_coupling_K={most} --set law.virtual_coupling_B=0 are the most")
