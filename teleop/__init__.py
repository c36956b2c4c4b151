"""A delayed bilateral teleoperation stack: laws, plants, the tick, and what both ends share.

    from teleop import load_scene, run
    result = run(load_scene("canonical", delay=0.1), seed=1)

The names below are the public ones: with those of `master`, `slave` and `channel` they are all that a scene, a law, an
effect, a device or a test of yours imports, and the modules underneath may move. A name is loaded when it is first
used: importing `teleop` loads neither numpy nor asyncio.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from teleop.version import DISTRIBUTION, __version__

if TYPE_CHECKING:
    from teleop.checks.law import check_law
    from teleop.errors import DeviceError, Refused, number, whole_number
    from teleop.export.stream import GrowingRun
    from teleop.knob import Knob, check_knobs
    from teleop.law import At, Law, OnePortLaw, find_law, messages
    from teleop.law.analysis_offers import Coupling
    from teleop.law.offers import Facts, seed_energy
    from teleop.laws.around.names import around
    from teleop.laws.direct import Direct
    from teleop.laws.four_channel import FourChannel
    from teleop.laws.iss import ISS
    from teleop.laws.model_mediated import ModelMediated
    from teleop.laws.p_d import PDamped
    from teleop.laws.pd_d import PDDamped
    from teleop.laws.pfra import PFRA
    from teleop.laws.pp import PositionPosition
    from teleop.laws.pspm import PSPM
    from teleop.laws.tdpa import TDPA
    from teleop.laws.two_layer import TwoLayer
    from teleop.laws.virtual_coupling import VirtualCoupling
    from teleop.laws.virtual_wall import VirtualWall
    from teleop.laws.wave import Wave
    from teleop.laws.wave_filter import WaveFilter
    from teleop.laws.wave_matched import WaveMatched
    from teleop.laws.wave_position import WavePosition
    from teleop.laws.wave_prediction import WavePrediction
    from teleop.laws.wave_scaled import WaveScaled
    from teleop.live.devices.arm_model import ArmModel
    from teleop.live.devices.checking import check_device
    from teleop.live.devices.compensated import Compensated
    from teleop.live.devices.device_watchdog import DeviceWatchdog
    from teleop.live.end import end_main
    from teleop.live.policy_page import PolicyWriter
    from teleop.live.records.merge import load_result
    from teleop.physics.implicit import Resistance
    from teleop.physics.plant import MassDamper, Plant
    from teleop.physics.relaxing import ElectricalDamping
    from teleop.physics.rotation import RotationAxes
    from teleop.physics.servo import Servo
    from teleop.protocol.endpoint import Reading
    from teleop.scene.axes import each_axis
    from teleop.scene.loading import load_scene
    from teleop.scene.parts import Environment, Hand, Reference, Vector
    from teleop.scene.playout import Energy, Fixed, Hold, Integral, Playout, Scaled, Zero
    from teleop.scene.scene import Scene
    from teleop.scene.servo_file import servos_of_file
    from teleop.simulation.notes import facts_of, fitted
    from teleop.simulation.result import Result
    from teleop.simulation.virtual import run
    from teleop.stages.deadband import Deadband
    from teleop.stages.device import Device, VelocityEstimator
    from teleop.stages.encoder import Encoder
    from teleop.stages.force_cap import Cap
    from teleop.stages.handover import Handover
    from teleop.stages.operator import Operator
    from teleop.stages.passivity_controller import PassivityController
    from teleop.stages.scaling import Frame, Scaling
    from teleop.stages.velocity.adaptive_window import BestFit, EndFit
    from teleop.stages.velocity.backward_difference import BackwardDifference
    from teleop.stages.velocity.levant import Levant
    from teleop.stages.velocity.low_pass import LowPass
    from teleop.stages.watchdog import Watchdog
    from teleop.sweeps.runner import sweep
    from teleop.sweeps.table import Table

__all__ = [
    "DISTRIBUTION", "ISS", "PFRA", "PSPM", "TDPA", "ArmModel", "At", "BackwardDifference", "BestFit", "Cap",
    "Compensated", "Coupling", "Deadband", "Device", "DeviceError", "DeviceWatchdog", "Direct", "ElectricalDamping",
    "Encoder", "EndFit", "Energy", "Environment", "Facts", "Fixed", "FourChannel", "Frame", "GrowingRun", "Hand",
    "Handover", "Hold", "Integral", "Knob", "Law", "Levant", "LowPass", "MassDamper", "ModelMediated", "OnePortLaw",
    "Operator", "PDDamped", "PDamped", "PassivityController", "Plant", "Playout", "PolicyWriter", "PositionPosition",
    "Reading", "Reference", "Refused", "Resistance", "Result", "RotationAxes", "Scaled", "Scaling", "Scene", "Servo",
    "Table", "TwoLayer", "Vector", "VelocityEstimator", "VirtualCoupling", "VirtualWall", "Watchdog", "Wave",
    "WaveFilter", "WaveMatched", "WavePosition", "WavePrediction", "WaveScaled", "Zero", "__version__", "around",
    "check_device", "check_knobs", "check_law", "each_axis", "end_main", "facts_of", "find_law", "fitted",
    "load_result", "load_scene", "messages", "number", "run", "seed_energy", "servos_of_file", "sweep", "whole_number",
]
_HOMES = {  # the module of each name, under this package
    "checks.law": ("check_law",),
    "errors": ("DeviceError", "Refused", "number", "whole_number"),
    "export.stream": ("GrowingRun",),
    "knob": ("Knob", "check_knobs"),
    "law": ("At", "Law", "OnePortLaw", "find_law", "messages"),
    "law.analysis_offers": ("Coupling",),
    "law.offers": ("Facts", "seed_energy"),
    "laws.around.names": ("around",),
    "laws.direct": ("Direct",),
    "laws.four_channel": ("FourChannel",),
    "laws.iss": ("ISS",),
    "laws.model_mediated": ("ModelMediated",),
    "laws.p_d": ("PDamped",),
    "laws.pd_d": ("PDDamped",),
    "laws.pfra": ("PFRA",),
    "laws.pp": ("PositionPosition",),
    "laws.pspm": ("PSPM",),
    "laws.tdpa": ("TDPA",),
    "laws.two_layer": ("TwoLayer",),
    "laws.virtual_coupling": ("VirtualCoupling",),
    "laws.virtual_wall": ("VirtualWall",),
    "laws.wave": ("Wave",),
    "laws.wave_filter": ("WaveFilter",),
    "laws.wave_matched": ("WaveMatched",),
    "laws.wave_position": ("WavePosition",),
    "laws.wave_scaled": ("WaveScaled",),
    "laws.wave_prediction": ("WavePrediction",),
    "live.devices.arm_model": ("ArmModel",),
    "live.devices.checking": ("check_device",),
    "live.devices.compensated": ("Compensated",),
    "live.devices.device_watchdog": ("DeviceWatchdog",),
    "live.end": ("end_main",),
    "live.policy_page": ("PolicyWriter",),
    "physics.implicit": ("Resistance",),
    "physics.plant": ("MassDamper", "Plant"),
    "physics.servo": ("Servo",),
    "physics.relaxing": ("ElectricalDamping",),
    "physics.rotation": ("RotationAxes",),
    "protocol.endpoint": ("Reading",),
    "scene.axes": ("each_axis",),
    "scene.loading": ("load_scene",),
    "scene.parts": ("Environment", "Hand", "Reference", "Vector"),
    "scene.playout": ("Energy", "Fixed", "Hold", "Integral", "Playout", "Scaled", "Zero"),
    "scene.scene": ("Scene",),
    "scene.servo_file": ("servos_of_file",),
    "live.records.merge": ("load_result",),
    "simulation.notes": ("facts_of", "fitted"),
    "simulation.result": ("Result",),
    "simulation.virtual": ("run",),
    "stages.deadband": ("Deadband",),
    "stages.device": ("Device", "VelocityEstimator"),
    "stages.encoder": ("Encoder",),
    "stages.handover": ("Handover",),
    "stages.operator": ("Operator",),
    "stages.passivity_controller": ("PassivityController",),
    "stages.force_cap": ("Cap",),
    "stages.scaling": ("Frame", "Scaling"),
    "stages.watchdog": ("Watchdog",),
    "stages.velocity.adaptive_window": ("BestFit", "EndFit"),
    "stages.velocity.backward_difference": ("BackwardDifference",),
    "stages.velocity.levant": ("Levant",),
    "stages.velocity.low_pass": ("LowPass",),
    "sweeps.runner": ("sweep",),
    "sweeps.table": ("Table",),
}


def _strips_of(result: Result) -> str:
    """The figures of a result in a notebook, made by a room far above the result's own."""
    from teleop.report.of_runs import in_a_notebook

    return in_a_notebook(result)


if not TYPE_CHECKING:  # a type checker goes by the imports above, and finds a name that is misspelt

    def __getattr__(name: str) -> object:
        from teleop.naming import public_name

        value = public_name(__name__, _HOMES, name)
        if name in ("Result", "load_result", "run"):
            from teleop.simulation import result

            result.strips_of = _strips_of
        return value


def __dir__() -> list[str]:
    return sorted(__all__)  # and not what this file needs for itself
