"""Wrong forms of the wave laws are refused by `check_law`, for the energy that they make or for a sign."""

from __future__ import annotations

from typing import Any

import pytest

from teleop import Refused, check_law
from teleop.laws.wave import Wave
from teleop.laws.wave_filter import WaveFilter
from teleop.laws.wave_matched import WaveMatched
from teleop.laws.wave_prediction import WavePrediction
from teleop.laws.wave_scaled import WaveScaled
from tests.teleop.checks.mutants_wave import (
    FILTER,
    MATCHED,
    POSITION,
    PREDICTION,
    SCALED,
    WAVE,
    seen,
    wrong,
)

FAMILIES = {"wave": WAVE, "filter": FILTER, "matched": MATCHED, "position": POSITION, "scaled": SCALED,
            "prediction": PREDICTION}
MUTANTS = [(f"{family}: {slip}", law) for family, laws in FAMILIES.items() for slip, law in laws.items()]


@pytest.mark.parametrize("law", [law for _, law in MUTANTS], ids=[name for name, _ in MUTANTS])
def test_it_is_refused(law: Any) -> None:
    with pytest.raises(Refused, match=r"claims E_(link|port), |turn the sign of "):
        check_law(law, compiled=False)


@pytest.mark.parametrize("law", [Wave(), WaveFilter(), WaveMatched(), WavePrediction(), WaveScaled()])
def test_the_law_that_a_mutant_is_made_of_passes_in_the_same_clothes(law: Any) -> None:
    own = type(law).master

    def master(self: Any, s: Any, at: Any, rx: Any) -> Any:
        return own(self, s, seen(at), rx)

    check_law(wrong(law, "Right", master=master), compiled=False)


def test_each_energy_law_has_four_at_least() -> None:
    assert min(map(len, FAMILIES.values())) >= 4
