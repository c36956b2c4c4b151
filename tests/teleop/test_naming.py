"""Parts written as calls, read by name and refused with what to write."""

from __future__ import annotations

from teleop import EndFit, Levant, LowPass, load_scene
from teleop.naming import find
from teleop.stages.velocity import ESTIMATORS


def test_a_text_makes_the_part_that_it_names() -> None:
    """What makes none: tests/refusals.toml."""
    for text, part in (
            ("low_pass(cutoff=25)", LowPass(cutoff=25.0)), (" levant( L = 2.5 ) ", Levant(L=2.5)),
            ("end_fit(noise=1e-5, most=9)", EndFit(noise=1e-5, most=9))):
        assert ESTIMATORS.read(text) == part
        assert load_scene("virtual_wall", velocity=text).device_m.velocity == part
    for name in ESTIMATORS.places:
        made = find(ESTIMATORS.word, ESTIMATORS.group, ESTIMATORS.places, name)
        assert type(ESTIMATORS.read(ESTIMATORS.examples[name])) is made, name
