"""The stages in their order: what stands between a device and its law, and between the law and the motor.

A new stage is a file in this folder and its place in this list; `scaling.py` is a short one to start from. The file
is imported only where a scene has the stage.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any, NamedTuple

from teleop.stages.end import Stage


class Asked(NamedTuple):
    """An end of a scene that may have a stage."""

    scene: Any
    e: str  # m or s
    device: Any  # None: it has none
    reads: frozenset[str]  # the fields of `At` that its law reads


class Place(NamedTuple):
    """A stage: its name, its class as "module:class", and whether an end has it."""

    name: str
    at: str
    wanted: Callable[[Asked], bool]

    def stage(self) -> type[Stage]:
        """The stage's class, imported now."""
        module, _, name = self.at.partition(":")
        found: type[Stage] = getattr(import_module(f"teleop.stages.{module}"), name)
        return found


STAGES = (
    Place("encoder", "encoder:EncoderStage", lambda end: getattr(end.device, "encoder", None) is not None),
    Place("velocity", "velocity_estimate:VelocityStage",
          lambda end: getattr(end.device, "velocity", None) is not None),
    Place("observer", "observer:ObserverStage",
          lambda end: end.e == "m" and end.scene.observer is not None and "f" in end.reads),
    Place("scaling", "scaling:ScalingStage", lambda end: end.e == "s" and end.scene.scaling is not None),
    # here the law answers
    Place("compute_delay", "compute_delay:ComputeDelayStage", lambda end: getattr(end.device, "delay", 0) > 0),
    Place("renewal", "renewal:RenewalStage", lambda end: getattr(end.device, "every", 1) > 1),
    Place("passivity_controller", "passivity_controller:PassivityControllerStage",
          lambda end: end.e == "m" and end.scene.passivity is not None),
    Place("watchdog", "watchdog:WatchdogStage", lambda end: end.scene.watchdog is not None),
    Place("overflow", "force_cap:OverflowStage", lambda end: end.scene.cap is not None),
    Place("velocity_cap", "velocity_cap:VelocityCapStage",
          lambda end: getattr(end.scene.cap, "v_max", None) is not None),
    Place("energy_budget", "energy_budget:EnergyBudgetStage",
          lambda end: getattr(end.scene.cap, "power", None) is not None),
    Place("force_cap", "force_cap:ForceCapStage", lambda end: end.scene.cap is not None),
    # what the held force did, and the waves
    Place("wave_ledger", "ledger:WaveLedger", lambda end: end.scene.energy and end.scene.has_waves),
    Place("port_ledger", "ledger:PortLedger", lambda end: end.scene.energy),
)
