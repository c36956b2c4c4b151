"""A law of your own: position-force control whose slave sends back a low-passed force. Run it as it stands."""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, pi
from typing import ClassVar, NamedTuple

from teleop import At, check_law, load_scene, run


class Forth(NamedTuple):
    x: float  # the master's position, m


class Back(NamedTuple):
    f_env: float  # the slave's force on the environment, low-passed, N


class Memory(NamedTuple):
    f_low: float  # N, the filter's last output


@dataclass(frozen=True, kw_only=True)
class SmoothReflection:
    """The slave tracks the master's position by a spring-damper; the hand feels a low-passed contact force."""

    K: float = 500.0  # N/m, coupling stiffness
    B: float = 20.0  # N s/m, damping of the slave
    cutoff: float = 5.0  # Hz, of the force that goes back
    claims: ClassVar[dict[str, str]] = {}  # no ledger is promised to stay above zero

    def master_start(self, at: At) -> tuple[tuple[()], Back]:
        return (), Back(0.0)

    def slave_start(self, at: At) -> tuple[Memory, Forth]:
        return Memory(0.0), Forth(at.x)  # until the first message comes: stay

    def master(self, s: tuple[()], at: At, rx: Back) -> tuple[float, Forth, tuple[()]]:
        return rx.f_env, Forth(at.x), s

    def slave(self, s: Memory, at: At, rx: Forth) -> tuple[float, Back, Memory]:
        f_env = s.f_low + (1.0 - exp(-2.0 * pi * self.cutoff * at.span)) * (at.f - s.f_low)
        return self.K * (rx.x - at.x) - self.B * at.v, Back(f_env), Memory(f_env)


if __name__ == "__main__":
    check_law(SmoothReflection())  # raises one sentence for the first promise that is broken
    for cutoff in (0.5, 1.0, 5.0):
        result = run(load_scene("soft_tissue", law=SmoothReflection(cutoff=cutoff), delay=0.02, x_limit=0.3))
        print(f"{cutoff:2g} Hz: {result.status}, {1e3 * result.metrics['x_err_rms']:.1f} mm rms of tracking error")
