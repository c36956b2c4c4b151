"""Passivity observer and passivity controller on the master's port (PO/PC).

Source: B. Hannaford and J.-H. Ryu, "Time-domain passivity control of haptic interfaces", IEEE Trans. Robotics and
Automation 18(1), 2002.

The observer sums what the port takes in, each held force with the step that it was held over (the pairing in which a
held force does its work; pairing it with the step before books the hold's leak as dissipation):

    E(k) = E(k-1) + f_m(k-1) (x(k) - x(k-1))

in the readings, as a device has no others, and with the force as it was held: damping and cap included. When the port
has given out more than it took in, E < 0, the controller adds the damping that takes up the balance within one tick
if the velocity stays:

    c = min(-E/(T v^2), cap),   f_m += c v        while E < 0 and |v| > v_min, else 0

`cap` bounds the damping, since c itself is unbounded where v is small, and a damper above about 2 M/T is itself
unstable on a sampled mass; `v_min` leaves velocities alone that are an encoder's noise. One observer and controller
for each axis: ports that are passive one by one are so together.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

from teleop.errors import number
from teleop.stages.end import Column, End, Places, Record, Run, Stage, held_of_law, per_axis


class Limits(NamedTuple):
    dt: float  # s
    cap: float  # N s/m
    v_min: float  # m/s


@dataclass(frozen=True, kw_only=True, slots=True)
class PassivityController:
    """Adds at most `cap` N s/m of damping while the port has made energy and moves faster than `v_min` m/s."""

    cap: float
    v_min: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "cap", number("cap", self.cap, low=0.0))
        object.__setattr__(self, "v_min", number("v_min", self.v_min, low=0.0))

    def limits(self, dt: float) -> Limits:
        """Coefficients of `damp`."""
        return Limits(dt, self.cap, self.v_min)


def damp(c: Limits, E: float, v: float) -> float:
    """The controller's force (N, against the motion) at an observed energy E (J) and a velocity v (m/s)."""
    dt, most, v_min = c
    if E < 0.0 and abs(v) > v_min:
        power = dt * v * v
        return min(-E / power, most) * v if power > 0.0 else most * v
    return 0.0 * E  # NaN stays NaN: it must be seen


class Port(Record):
    """The port of one axis."""

    E_po: float  # what it took in, as it was observed, J


class PassivityControllerStage(Stage):
    """Observer and controller of the master's port, axis by axis. Recorded as `E_po`."""

    name: ClassVar[str] = "passivity_controller"
    axis_kind: ClassVar[type[Record]] = Port
    wants_dx: ClassVar[bool] = True
    c_pc: Limits

    @staticmethod
    def numbers(scene: Any, e: str, dt: float, places: Places) -> Any:
        return scene.passivity.limits(dt)

    def columns(self, e: End) -> tuple[Column, ...]:
        return (per_axis("E_po", self.axes, "E_po"),)

    def begin(self, run: Run, e: End, numbers: Any) -> None:
        self.c_pc = numbers
        for port in self.axes:
            port.E_po = 0.0

    def act(self, run: Run, e: End, k: int) -> None:
        for a, port in zip(e.axes, self.axes, strict=True):
            port.E_po = port.E_po + held_of_law(e, a) * a.dx
            a.f_cmd = a.f_cmd + damp(self.c_pc, port.E_po, a.v_read)
