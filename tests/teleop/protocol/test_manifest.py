"""What two ends have to agree on: the sentence that they stop with names what differs, and what to type."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from master import Grip, Sine
from slave import Wall
from teleop import Cap, Device, Encoder, LowPass, MassDamper, Scene, Wave, load_scene
from teleop.protocol.manifest import fingerprint, manifest_difference, manifest_of
from teleop.protocol.packet import MOST_CONTROL, Kind, Packet, encode, one_line
from tests import fakes


def test_the_sentence_names_the_knob_both_values_and_what_to_type_and_what_explains_the_rest_first() -> None:
    mine = {"wire version": "1", "scene": "hard_wall", "k_e": "50000.0", "dt": "0.001"}
    assert manifest_difference(mine, mine | {"k_e": "2000.0"}) == (
        "k_e is 50000.0 here and 2000.0 there: start both ends with the same --set k_e=50000.0"
    )
    assert "(1 more differs)" in str(manifest_difference(mine, mine | {"k_e": "2000.0", "dt": "0.01"}))
    assert "--set start='(0, 1)'" in (manifest_difference({"start": "(0, 1)"}, {"start": "0"}) or "")
    for name, more, cure in (("wire version", "", "same release"), ("scene", "", "same scene"),
                             ("law", " (1 more differs)", "law.*")):
        sentence = str(manifest_difference({"k_e": "1", name: "x"}, {"k_e": "2", name: "y"}))
        assert sentence.startswith(f"{name} is x here and y there{more}: ")
        assert cure in sentence
    huge = str(manifest_difference({"k": "x" * 5000}, {"k": "y" * 5000}))
    assert one_line(huge) == huge
    assert "start both ends" in huge


LOCKSTEP, BY_CLOCK = {"mode": "lockstep", "seed": "0"}, {"mode": "live"}


@pytest.mark.parametrize(("here", "there", "name", "more"), [
    ({}, {"k_e": "1e3"}, "k_e", 0), ({"f_max": "3"}, {}, "f_max", 0), ({"delay": "0.1"}, {"k_e": "1e3"}, "delay", 1),
    ({}, {"scene": "soft_tissue"}, "scene", 0), ({}, {"link": "delay(0.1)"}, "link", 0),
    (LOCKSTEP, BY_CLOCK, "mode", 0), (BY_CLOCK, LOCKSTEP | {"k_e": "1e3"}, "mode", 1),
])
def test_what_follows_from_another_is_not_counted(
    here: dict[str, str], there: dict[str, str], name: str, more: int
) -> None:
    """One knob that was turned at one end alone said "(1 more differs)": the part that it sets."""
    def told(typed: dict[str, str]) -> dict[str, str]:
        of_run = {key: typed[key] for key in typed if key in ("mode", "seed")}
        knobs = {key: value for key, value in typed.items() if key not in (*of_run, "scene")}
        return {**manifest_of(load_scene(typed.get("scene", "hard_wall"), **knobs)), **of_run}

    sentence = str(manifest_difference(told(here), told(there)))
    assert sentence.startswith(f"{name} is ")
    assert ("more differ" in sentence) == bool(more)
    assert not more or f"({more} more differs)" in sentence


def test_an_entry_of_one_end_only_is_missing_at_the_other_and_a_knob_of_any_scene_is_typed_at_both() -> None:
    """It said "install the same release, and the same scene file"."""
    for here, there in (({"a": ""}, {}), ({}, {"a": ""})):
        sentence = str(manifest_difference(here, there))
        assert "missing" in sentence
        assert "empty" in sentence
        assert "--set" not in sentence
    for here, there in (({"scale_x": "1.0,2.0"}, {}), ({}, {"scale_x": "1.0,2.0"})):
        assert str(manifest_difference(here, there)).endswith("start both ends with the same --set scale_x=1.0,2.0")


manifests = st.dictionaries(st.sampled_from(["scene", "law", "a", "b"]), st.sampled_from(["", "1", "2"]))


@given(manifests, manifests)
def test_manifests_differ_exactly_if_they_are_not_equal(mine: dict[str, str], theirs: dict[str, str]) -> None:
    assert (manifest_difference(mine, theirs) is None) == (mine == theirs)


SCENE = """
from teleop import MassDamper, Scene

def scene(*, duration: float = 1.0) -> Scene:
    return Scene(law=Springs(), master=MassDamper(mass=0.1), slave=MassDamper(mass=MASS), duration=duration)
"""


def test_scenes_of_the_same_name_that_differ_anywhere_do_not_run_together(tmp_path: Path) -> None:
    source = Path(fakes.__file__).read_text()  # with a law in it

    def manifest(folder: str, change: tuple[str, str] = ("", ""), mass: str = "0.5") -> dict[str, str]:
        path = tmp_path / folder / "mine.py"
        path.parent.mkdir()
        path.write_text(source.replace(*change, 1) + SCENE.replace("MASS", mass))
        return manifest_of(load_scene(str(path)))

    one = manifest("one")
    assert manifest_difference(one, manifest("copy")) is None
    body = str(manifest_difference(one, manifest("body", mass="0.6")))
    assert "slave is MassDamper(mass=0.5" in body or "law source" in body  # the file differs, and the part too
    turned = str(manifest_difference(one, manifest("turned", ("self.K * (rx.x - at.x)", "-self.K * (rx.x - at.x)"))))
    assert turned.startswith("law source is mine.py (")


def test_a_recorded_motion_may_lie_elsewhere_but_not_differ(tmp_path: Path) -> None:
    manifests = []
    for folder, reach in (("one", "0.1"), ("two", "0.1"), ("three", "0.2")):
        path = tmp_path / folder / "motion.csv"
        path.parent.mkdir()
        path.write_text(f"t,x,y,z\n0,0,0,0\n1,{reach},0,0\n")
        manifests.append(manifest_of(load_scene("recorded_reach", motion=str(path))))
    assert manifest_difference(manifests[0], manifests[1]) is None
    assert str(manifest_difference(manifests[0], manifests[2])).startswith("motion is motion.csv (")


def test_of_a_law_the_knob_is_named_with_a_number_for_each_axis_as_it_is_typed() -> None:
    for mine, theirs, name, one, other in (
            ({"law.K": "3,2,1"}, {"law.K": "3,2,4"}, "law.K", "3.0,2.0,1.0", "3.0,2.0,4.0"),
            ({"law.K": "3,2,1"}, {}, "law.K", "3.0,2.0,1.0", "500.0"),
            ({"law.b": "7"}, {"law.b": "8"}, "law.b", "7.0", "8.0")):
        here, there = (manifest_of(load_scene("recorded_reach", law="wave", **end)) for end in (mine, theirs))
        assert manifest_difference(here, there) == (
            f"{name} is {one} here and {other} there: start both ends with the same --set {name}={one}")
    here, there = ({"m_m": fingerprint((1.0, last))} for last in (2.0, 3.0))
    assert manifest_difference(here, there) == (
        "m_m is 1.0,2.0 here and 1.0,3.0 there: start both ends with the same --set m_m=1.0,2.0")
    here = manifest_of(replace(load_scene("recorded_reach"), names=("a", "b", "c")))
    told = str(manifest_difference(here, manifest_of(load_scene("recorded_reach"))))
    assert told.startswith("names is a,b,c here and () there: start both ends with the same file of the scene")


def test_sixteen_axes_that_have_nothing_in_common_fit_the_first_exchange_and_any_part_tells() -> None:
    """They were more than a datagram of 8,192 bytes, and the run ended at its first tick."""
    here, there = (manifest_of(sixteen(last)) for last in (0.3, 0.4))
    hello = encode(Packet(Kind.HELLO, 1, 0, 0, None, here))
    assert len(hello) < MOST_CONTROL
    told = str(manifest_difference(here, there))
    assert told.startswith("device_s is (Device("), "the last of its sixteen numbers is behind what is sent of the text"


def sixteen(last: float) -> Scene:
    """Sixteen axes; `last`: the cutoff of the last one at the slave."""
    def bodies(friction: float) -> tuple[MassDamper, ...]:
        return tuple([MassDamper(mass=0.1 + i / 7, damping=i / 13, friction=friction) for i in range(16)])

    def devices(last: float) -> tuple[Device, ...]:
        cutoffs = [*[30.0 + i / 3 for i in range(15)], last]
        return tuple([Device(encoder=Encoder(step=1e-5 + i / 7e6), velocity=LowPass(cutoff=cutoff))
                      for i, cutoff in enumerate(cutoffs)])

    return Scene(
        law=tuple([Wave(b=2.0 + i / 7, K=300.0 + i / 13) for i in range(16)]), axes=16,
        names=tuple([f"joint_with_a_long_name_{i}" for i in range(16)]), units=("rad",) * 16,
        master=bodies(0.1), slave=bodies(0.2), device_m=devices(35.0), device_s=devices(last),
        hand=tuple([Grip(mass=0.05 + i / 70, k=20.0, d=1.0, reference=Sine(amplitude=0.2, frequency=1.0))
                    for i in range(16)]),
        environment=tuple([Wall(k=100.0 + i / 7, d=1.0 + i / 13, at=0.1) for i in range(16)]),
        cap=tuple([Cap(f_max=5.0 + i / 7, slew=1000.0 + i / 7) for i in range(16)]))
