"""A scene's packets have room for its law's messages, or the scene is refused before anything runs."""

from __future__ import annotations

from dataclasses import replace

import pytest

from teleop import Refused, Scene, around, load_scene
from teleop.laws.direct import Direct
from teleop.laws.wave import Wave
from teleop.protocol.endpoint import Endpoint
from teleop.protocol.manifest import manifest_of
from teleop.protocol.session import Session


def scene(law: object, **parts: object) -> Scene:
    return replace(load_scene("canonical"), law=law, **parts)  # type: ignore[arg-type]


def test_a_packet_that_is_too_small_is_refused_with_the_size_that_is_needed() -> None:
    with pytest.raises(Refused, match="at least 81 bytes, which the message of law direct in 1 axis needs"):
        scene(Direct(), packet_size=80)
    assert scene(Direct(), packet_size=81).wire_size == 81
    assert scene(Direct(), packet_size=73, energy=False).wire_size == 73  # no stamp of energy behind it


def test_a_packet_is_as_large_as_usual_or_as_its_messages_need() -> None:
    assert scene(Direct()).wire_size == 100
    assert load_scene("recorded_reach").wire_size == 200
    # Three numbers, and T, U and E: a live end takes it as the scene is made.
    large = load_scene("canonical", law="guard | wave", playout="integral")
    assert large.wire_size == large.least_packet == 109
    Endpoint(large, "s", Session(master=False, manifest=manifest_of(large), number=7))


def test_the_room_is_asked_for_whatever_scene_was_made_before() -> None:
    scene(Wave(), packet_size=91)
    with pytest.raises(Refused, match="at least 109 bytes"):
        scene(around("guard", Wave()), packet_size=91, playout=load_scene("canonical", playout="integral").playout)
