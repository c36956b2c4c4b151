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
from typing import Annotated, Any, ClassVar, NamedTuple

from teleop.errors import enough
from teleop.knob import Knob, check_knobs
from teleop.law import At
from teleop.law.offers import Facts
from teleop.laws.around.compose import Message, StageEnd


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
    def end(cls, name: str, _sends: Mapping[str, str]) -> StageEnd[Any, Any, Any, Any]:
        """At the master: the tool, and what the law is told of it; at the slave nothing."""
        return MASTER if name == "master" else SLAVE

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


class CoupledTool(NamedTuple):
    y: float  # m
    u: float  # m/s
    net: float  # force that the law holds on it, N


def hand_force(coupling: VirtualCouplingWrapper, s: CoupledTool, at: At) -> float:
    """Force of the coupling on the hand (N)."""
    return coupling.K * (at.x - s.y) + coupling.B * (at.v - s.u)


def move_tool(coupling: VirtualCouplingWrapper, s: CoupledTool, at: At) -> tuple[At, CoupledTool]:
    """The tool at this tick, and the situation of a law that has it for a device."""
    K, B, m, T = coupling.K, coupling.B, coupling.mass, at.span
    y = s.y + (1.0 - at.gain) * (at.x - s.y)
    u = (m * s.u / T + K * (at.x - y) + B * at.v - s.net) / (m / T + B + K * T + coupling.damping)
    tool = CoupledTool(y + T * u, u, s.net)
    f = hand_force(coupling, tool, at)
    return At(tool.y, u, f, s.net, tool.y - s.y, at.fresh, at.age, at.dt, T, 1.0), tool


def hold(coupling: VirtualCouplingWrapper, s: CoupledTool, at: At, _rx: tuple[()], _over: tuple[()], f: float,
         tx: Message) -> tuple[float, Message, tuple[()], CoupledTool]:
    """The law's force is held on the tool, and that of the coupling on the hand."""
    return hand_force(coupling, s, at), tx, (), CoupledTool(s.y, s.u, f)


MASTER = StageEnd(lambda _, at: (CoupledTool(at.x - at.dt * at.v, at.v, 0.0), ()), hold, before=move_tool)
SLAVE: StageEnd[Any, Any, Any, Any] = StageEnd(
    lambda _, _at: ((), ()), lambda _, s, _at, _rx, _over, f, tx: (f, tx, (), s))
