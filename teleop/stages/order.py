"""The stages in their order: what stands between a device and its law, and between the law and the motor.

A new stage is a file in this folder and its place in this list; `encoder.py` is a short one to start from. The file is
imported only where a scene has the stage.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any, NamedTuple

from teleop.law.offers import stores
from teleop.stages.end import Stage


class Asked(NamedTuple):
    """An end of a scene that may have a stage."""

    scene: Any
    e: str  # m or s
    device: Any  # None: it has none
    body: Any  # of its first axis
    reads: frozenset[str]  # the fields of `At` that its law reads
    tx: Any  # types of the messages that it sends and receives, and of its law's state; None without a slave
    rx: Any
    state: Any


class Place(NamedTuple):
    """A stage: its name, its class as "module:class", whether an end has it, and both in words."""

    name: str
    at: str
    wanted: Callable[[Asked], bool]
    what: str  # it does
    field: str  # of a scene that names it
    ends: str = "both"  # or that of the master or of the slave, which alone may have it

    def stage(self) -> type[Stage]:
        """The stage's class, imported now."""
        module, _, name = self.at.partition(":")
        module_class: type[Stage] = getattr(import_module(f"teleop.stages.{module}"), name)
        return module_class


def _plays(end: Asked, stage: str) -> bool:
    """True if this is the stage of the scene's playout, where its messages have waves."""
    return getattr(end.scene.wave_playout, "stage", None) == stage


def _caps(end: Asked, limit: str) -> bool:
    """True if the cap of an axis has this limit."""
    return any(getattr(each, limit, None) is not None for each in end.scene.per_axis("cap"))


BEFORE_LAW = (  # what the law reads
    Place("servo", "servo:ServoStage", lambda end: getattr(end.body, "inner", False),
          "records the true position of a position servo's shaft, and the true torque on it",
          "slave=Servo(K=17.8, damping=0.6)"),
    Place("encoder", "encoder:EncoderStage", lambda end: getattr(end.device, "encoder", None) is not None,
          "rounds the position that the law reads down to a step", "device_m=Device(encoder=Encoder(step=1e-5))"),
    Place("velocity", "velocity_estimate:VelocityStage",
          lambda end: getattr(end.device, "velocity", None) is not None,
          "makes the velocity that the law reads of the readings of the position",
          "device_m=Device(velocity=LowPass(cutoff=30.0))"),
    Place("observer", "observer:ObserverStage",
          lambda end: end.e == "m" and end.scene.observer is not None and "f" in end.reads,
          "estimates the hand's force, where the law reads it", "observer=200.0", "master"),
    Place("scaling", "scaling:ScalingStage", lambda end: end.e == "s" and (
              end.scene.scaling is not None or end.scene.frame is not None),
          "tells the law the slave's metres, newtons and directions in those of the master, and its force back",
          "scaling=Scaling(scale_x=0.2, scale_f=0.5)", "slave"),
    # what it reads of the other end
    Place("wave_integral", "wave_integral:WaveIntegralStage", lambda end: _plays(end, "wave_integral"),
          "plays waves by their integral, within their energy", "playout=Integral()"),
    Place("wave_energy", "wave_integral:WaveEnergyStage", lambda end: _plays(end, "wave_energy"),
          "plays what is owed of a wave at once, within its energy", "playout=Energy()"),
    Place("wave_scaling", "wave_integral:WaveScalingStage", lambda end: _plays(end, "wave_scaling"),
          "plays the newest wave, and in gaps the last one again, times sqrt(1 - rate)", "playout=Scaled(0.1)"),
)
AFTER_LAW = (  # what its force goes through
    Place("compute_delay", "compute_delay:ComputeDelayStage", lambda end: getattr(end.device, "delay", 0) > 0,
          "holds the force back for some ticks, which its computation takes", "device_m=Device(delay=1)"),
    Place("renewal", "renewal:RenewalStage", lambda end: getattr(end.device, "every", 1) > 1,
          "renews the force at every n-th tick and holds it in between", "device_m=Device(every=5)"),
    Place("passivity_controller", "passivity_controller:PassivityControllerStage",
          lambda end: end.e == "m" and end.scene.passivity is not None,
          "adds damping while the energy observed at the port is below zero", "passivity=PassivityController(cap=0.8)",
          "master"),
    Place("operator", "operator:OperatorStage", lambda end: end.e == "m" and end.scene.operator is not None,
          "fades the force out and holds the slave while the operator's clutch is open, or nobody is there",
          "operator=Operator(clutch=((2.0, 3.0),))", "master"),
    Place("handover", "handover:HandoverStage", lambda end: end.e == "m" and end.scene.handover is not None,
          "adds a policy's force to the law's while the policy has authority, within an energy tank",
          "handover=Handover(takes=((2.0, 4.0),))", "master"),
    # what it is told of both ends where they turn, by what it is told of its own
    Place("orientation", "orientation:OrientationStage", lambda end: bool(end.scene.rotations),
          "counts the orientation on the axes of a rotation, and tells the law positions that go by it",
          "rotations=(3,)"),
    Place("watchdog", "watchdog:WatchdogStage", lambda end: end.scene.watchdog is not None,
          "ramps the force to zero without fresh messages, and back with them", "watchdog=Watchdog(timeout=0.2)"),
    Place("overflow", "force_cap:OverflowStage", lambda end: end.scene.cap is not None,
          "makes an infinite force NaN, so that no cap hides it", "cap=Cap(f_max=20.0)"),
    Place("velocity_cap", "velocity_cap:VelocityCapStage",
          lambda end: _caps(end, "v_max"),
          "fades a force that drives its device near the greatest velocity", "cap=Cap(v_max=0.3)"),
    Place("energy_budget", "energy_budget:EnergyBudgetStage",
          lambda end: _caps(end, "power"),
          "takes away driving force beyond the power that may be given out", "cap=Cap(power=1.0)"),
    Place("force_cap", "force_cap:ForceCapStage", lambda end: end.scene.cap is not None,
          "limits the force and its change within a tick", "cap=Cap(f_max=20.0, slew=2000.0)"),
    # what of its messages is sent
    Place("deadband", "deadband:DeadbandStage", lambda end: end.scene.deadband is not None,
          "sends a message only where it differs from the last that was sent", "deadband=Deadband(k=0.1)"),
    # what the held force did, and the waves
    Place("wave_ledger", "ledger:WaveLedger", lambda end: end.scene.energy and end.scene.has_waves,
          "sums the energy of a law's waves that go into the link and come out: E_in, E_out", "energy=True"),
    Place("port_ledger", "ledger:PortLedger", lambda end: end.scene.energy,
          "sums the work of the held force over the motion at the port: E_port", "energy=True"),
    Place("law_ledger", "ledger:LawLedger",
          lambda end: end.scene.energy and end.scene.slave is not None and stores(end.scene.laws[0]),
          "asks the law what it keeps of energy: E_law", "energy=True"),
    # whose the force is that is held from here on
    Place("handover_share", "handover:ShareStage", lambda end: end.e == "m" and end.scene.handover is not None,
          "tells the law of its own part of the held force, and not of the policy's",
          "handover=Handover(takes=((2.0, 4.0),))", "master"),
)
STAGES = (*BEFORE_LAW, *AFTER_LAW)
