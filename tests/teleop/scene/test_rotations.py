"""Rotations of a scene: which axes, which laws, and what has to be alike on them."""

from __future__ import annotations

import pytest

from teleop import MassDamper, ModelMediated, PositionPosition, Refused, VirtualWall, Wave, around
from teleop.scene.scene import on_axis, without_orientation
from tests.fakes import Springs
from tests.teleop.stages.tumbling import tumbling

LIGHT, HEAVY = MassDamper(mass=0.001, damping=0.005), MassDamper(mass=0.002, damping=0.005)


def test_what_cannot_turn_is_refused_in_one_sentence() -> None:
    tumbling()  # scenes of the same classes have passed before
    for parts, sentence in (
            ({"law": ModelMediated()},
             "law model_mediated does not run on the axes of a rotation: its model is a spring"),
            ({"law": around("virtual_coupling", Wave())}, "its tool has a place on each axis by itself"),
            ({"law": Springs()}, "declares none of its messages or its state as one, as x: kind.Position does"),
            ({"law": (PositionPosition(), PositionPosition(), PositionPosition(K=1.0))}, "has one law for all three"),
            ({"slave": (LIGHT, HEAVY, LIGHT)}, "the slave of one differs; give the three the same slave"),
            ({"slave": None, "link": None, "law": VirtualWall(K=1.0)}, "a scene without a slave has no rotations")):
        with pytest.raises(Refused, match=sentence):
            tumbling(**parts)


def test_axes_of_a_rotation_are_in_rad_and_each_is_analysed_by_itself() -> None:
    scene = tumbling(axes=4, rotations=(1,), hand=None)
    assert scene.axis_units == ("m", "rad", "rad", "rad")
    assert on_axis(scene, 2).rotations == ()
    assert on_axis(scene, 2).axis_units == ("rad",)


def test_a_deadband_around_a_law_keeps_its_positions_positions() -> None:
    law = around("deadband(0.1)", PositionPosition())
    assert without_orientation(law) == ""
    assert tumbling(law=law).rotations == (0,)
