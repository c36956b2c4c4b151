"""Parts written as calls, read by name and refused with what to write."""

from __future__ import annotations

import pytest

from teleop import load_scene
from teleop.errors import Refused
from teleop.naming import find
from teleop.stages.velocity import ESTIMATORS
from teleop.stages.velocity.adaptive_window import EndFit
from teleop.stages.velocity.levant import Levant
from teleop.stages.velocity.low_pass import LowPass


@pytest.mark.parametrize(("text", "part"), [
    ("low_pass(cutoff=25)", LowPass(cutoff=25.0)), (" levant( L = 2.5 ) ", Levant(L=2.5)),
    ("end_fit(noise=1e-5, most=9)", EndFit(noise=1e-5, most=9)),
])
def test_a_text_makes_the_part_that_it_names(text: str, part: object) -> None:
    assert ESTIMATORS.read(text) == part
    assert load_scene("virtual_wall", velocity=text).device_m.velocity == part  # type: ignore[union-attr]  # it has one


@pytest.mark.parametrize("name", ESTIMATORS.places)
def test_every_example_is_of_its_part(name: str) -> None:
    made = find(ESTIMATORS.word, ESTIMATORS.group, ESTIMATORS.places, name)
    assert type(ESTIMATORS.read(ESTIMATORS.examples[name])) is made


@pytest.mark.parametrize(("text", "words"), [
    ("low_pass", r"needs brackets: write for example low_pass\(cutoff=30\)"),
    ("lowpass(3)", r"did you mean low_pass\?"),
    ("low_pass(30)", "at most 0 arguments without their names"),
    ("levant()", "needs L"),
    ("low_pass(cutoff=2, cutoff=3)", "twice"),
    ("low_pass(cut=3)", "does not take cut"),
    ("low_pass(cutoff=print)", "must be numbers"),
    ("low_pass(cutoff=0)", "cutoff must be above 0"),
    ("low_pass(cutoff=1) + 2", "no velocity estimator"),
    ("(((", "cannot be read"),
    ("__import__('os').system('true')", "no velocity estimator"),
])
def test_what_makes_none_is_refused_with_what_to_write(text: str, words: str) -> None:
    with pytest.raises(Refused, match=words):
        ESTIMATORS.read(text)
