"""Knobs that every scene takes beside its own: each replaces a part of the scene that its function made.

Where a scene has a knob of the same name, that one is set.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from teleop.errors import Refused
from teleop.knob import Declared, Knob
from teleop.scene.axes import each_axis, scales
from teleop.scene.library import import_bundled
from teleop.scene.playout import Playout, as_typed, integrates
from teleop.scene.scene import Scene

_SCALES = ("scale_x", "scale_f")
WIDE = {
    "x_limit": Declared(float, Scene.x_limit, Knob(
        "m", "position beyond which a run has diverged, of master and slave", above=0.0)),
    "scale_x": Declared(float | tuple[float, ...], 1.0, Knob(
        "", "metres (or rad) of the slave, where there is one, for one of the master; one number, or one an axis",
        above=0.0)),
    "scale_f": Declared(float | tuple[float, ...], 1.0, Knob(
        "", "newtons (or N m) of the slave, where there is one, for one of the master; one number, or one an axis",
        above=0.0)),
    "left_out": Declared(float, 0.0, Knob(
        "", "share of its ticks that each end leaves out, at random", low=0.0, high=1.0)),
    "deadband": Declared(float, 0.0, Knob(
        "", "share by which a value differs from the last that was sent before a message is sent; 0: each is",
        low=0.0, high=1.0)),
    "clutch_ramp": Declared(float | None, "the scene's", Knob(
        "s", "time in which the force fades out, and in, where the operator's clutch opens or nobody is there; "
        "none: no switches are heeded", low=0.0)),
    "playout": Declared(Playout, "the scene's", Knob(
        "", "message that a tick plays, where there is a link: see `teleop list playout`")),
    "link": Declared("Link | None", "the scene's", Knob(
        "", "link in place of the scene's, where there is a slave, as --link takes it; none: no link")),
    "hand": Declared("HandRecording", "the scene's", Knob(
        "", "folder of a live page whose hand the scene's moves as, for as long where duration is not set")),
}


def read_link(value: object) -> tuple[str, Any]:
    """A link as it is shown, and the link. Raises `Refused`."""
    module = import_bundled("channel.link")
    if value is None or value == "none":
        return "none", None
    if isinstance(value, str):
        link = module.parse_link(value)
        return module.record_text(value, link), link
    return module.describe(value), value  # what is no link, the scene refuses


def read_hand(value: object) -> tuple[str, Any]:
    """The folder of a recorded hand, and the reference that it holds. Raises `Refused`."""
    kind = import_bundled("master.hand_record").HandRecording
    reference = value if isinstance(value, kind) else kind(value)
    return reference.path, reference


def with_wide(scene: Scene, values: Mapping[str, Any]) -> Scene:
    """The scene with knobs of `WIDE` set. Raises `Refused`."""
    parts = {key: value for key, value in values.items() if key not in _SCALES}
    scaling = {key: value for key, value in values.items() if key in _SCALES}
    if scaling:
        from teleop.stages.scaling import Scaling

        usual = [one if isinstance(scene.scaling, tuple) else one[0] for one in zip(*scales(scene), strict=True)]
        parts["scaling"] = each_axis(Scaling, scene.axes, **{**dict(zip(_SCALES, usual, strict=True)), **scaling})
    if "left_out" in parts:
        share = parts.pop("left_out")
        ticks = import_bundled("channel.left_out").LeftOut(share) if share > 0.0 else None
        parts |= {"left_out_m": ticks, "left_out_s": ticks if scene.slave is not None else None}
    if "deadband" in parts:
        from teleop.stages.deadband import Deadband

        k = parts.pop("deadband")
        parts["deadband"] = None if k == 0.0 else replace(scene.deadband or Deadband(), k=k)
    if "clutch_ramp" in parts:
        from teleop.stages.operator import Operator

        ramp = parts.pop("clutch_ramp")
        parts["operator"] = None if ramp is None else replace(scene.operator or Operator(), ramp=ramp)
    if "hand" in parts:
        if scene.hand is None:
            raise Refused(f"hand={parts['hand'].path} moves nothing in a scene without a hand; leave it out, or take "
                          "a scene with one")
        parts["hand"].check(scene.axes, scene.dt_ns)
        grip, moved = import_bundled("master.hand").Grip, parts["hand"]
        hands = [hand and grip(mass=hand.mass, k=hand.k, d=hand.d, reference=moved) for hand in scene.per_axis("hand")]
        parts["hand"] = tuple(hands) if isinstance(scene.hand, tuple) else hands[0]
    made = replace(scene, **parts)
    along = made.has_waves and integrates(made.played_as)  # what waves have come to is sent without a link too
    if "playout" in parts and made.link is None and not along:
        cure = "" if made.slave is None else ", or write for example link='delay(0.05)'"
        raise Refused(f"playout={as_typed(values['playout'])} sets nothing in a scene without a link; leave it "
                      f"out{cure}")
    return made
