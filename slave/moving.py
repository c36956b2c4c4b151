"""Moving environment: another environment that is carried along a path."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from teleop.errors import Refused

if TYPE_CHECKING:
    from teleop.scene.parts import ExactEnvironment, IntegratedEnvironment, Reference


@dataclass(frozen=True, kw_only=True, slots=True)
class Moving:
    """`environment` carried along `path`, a beating heart's wall for example, whatever the slave does to it.

    `path` is a reference like a hand's, along the axis that the environment is in: the positions of the
    environment's own (`at` of a wall) are counted from there. Between the ticks it is straight. A run follows it
    with `teleop.physics.carried`.
    """

    inner: ClassVar[bool] = True  # its plants have an inner state: the tick, and that of the environment

    environment: ExactEnvironment | IntegratedEnvironment
    path: Reference

    def __post_init__(self) -> None:
        still, path = self.environment, self.path
        if hasattr(still, "path"):
            raise Refused("environment moves already; write one path that is the sum of both")
        if isinstance(still, type) or not (hasattr(still, "plant") or hasattr(still, "resistance")):
            raise Refused(f"environment must be something with plant, not {_text_of(still)}; "
                          "write for example environment=Wall(k=1e3)")
        if isinstance(path, type) or not hasattr(path, "samples"):
            raise Refused(f"path must be something with samples, not {_text_of(path)}; "
                          "write for example path=Sine(amplitude=0.005, frequency=1.0)")


def _text_of(part: object) -> str:
    return f"the class {part.__name__}" if isinstance(part, type) else repr(part)
