"""What the estimators resolve: a slow sine, 1 cm at 1 Hz, read at 1 kHz by encoders of 10 to 60 um."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from teleop import BackwardDifference, BestFit, EndFit, Levant, LowPass
from tests.teleop.stages.velocity.signals import floored, rms, sine, velocities

STEPS = (1e-5, 2e-5, 3e-5, 4e-5, 5e-5, 6e-5)  # m
Make = Callable[[float], Any]

# RMS error in mm/s of a velocity of 44 mm/s RMS, by encoder step, over four periods after the first.
MEASURED: dict[str, tuple[Make, tuple[float, ...]]] = {
    "backward difference": (lambda _: BackwardDifference(), (4.03, 7.67, 11.56, 17.19, 19.40, 21.60)),
    "low-pass 10 Hz": (lambda _: LowPass(cutoff=10.0), (4.43, 4.44, 4.46, 4.48, 4.51, 4.54)),
    "low-pass 30 Hz": (lambda _: LowPass(cutoff=30.0), (1.58, 1.80, 2.20, 2.52, 2.97, 3.30)),
    "end-fit": (lambda step: EndFit(noise=step), (1.69, 2.05, 2.23, 2.36, 2.52, 2.64)),
    "best-fit": (lambda step: BestFit(noise=step), (1.70, 1.99, 2.11, 2.15, 2.20, 2.40)),
    "Levant": (lambda _: Levant(L=1.0), (1.32, 1.72, 2.18, 2.43, 2.48, 2.79)),
}


def error(make: Make, step: float) -> float:
    """mm/s."""
    xs, vs = sine(5000)
    return 1e3 * rms(velocities(make(step), floored(xs, step))[1000:], vs[1000:])


@pytest.fixture(scope="module")
def errors() -> dict[str, list[float]]:
    return {name: [error(make, step) for step in STEPS] for name, (make, _) in MEASURED.items()}


def test_the_errors_are_those_measured(errors: dict[str, list[float]]) -> None:
    for name, (_, measured) in MEASURED.items():
        assert errors[name] == pytest.approx(measured, abs=0.02), name


def test_the_backward_difference_grows_with_the_step_and_is_the_worst_of_all_for_coarse_encoders(
    errors: dict[str, list[float]],
) -> None:
    worst = errors.pop("backward difference")
    assert worst == sorted(worst)
    for others in errors.values():
        assert all(2.0 * other < bad for other, bad in zip(others[2:], worst[2:], strict=True))


def test_a_low_cutoff_pays_in_lag_whatever_the_encoder(errors: dict[str, list[float]]) -> None:
    lagging = errors["low-pass 10 Hz"]
    assert max(lagging) < 1.03 * min(lagging)
    for name in ("low-pass 30 Hz", "end-fit", "best-fit", "Levant"):
        assert max(errors[name]) < min(lagging)


def test_the_adaptive_ones_lead_for_coarse_encoders_and_least_squares_leads_them(
    errors: dict[str, list[float]],
) -> None:
    """F. Janabi-Sharifi et al. 2000; V. Chawda, O. Celik and M. K. O'Malley, World Haptics 2011, for Levant's."""
    for best, end, levant, fixed in zip(
        *(errors[name][3:] for name in ("best-fit", "end-fit", "Levant", "low-pass 30 Hz")), strict=True
    ):
        assert best < min(end, levant)
        assert max(end, levant) < fixed


def test_half_a_step_is_too_little_noise_for_a_window() -> None:
    """The line through two readings misses a third by up to a whole step, so the window keeps collapsing."""
    for make in (EndFit, BestFit):
        for step in STEPS[1:]:
            half = error(lambda step, make=make: make(noise=0.5 * step), step)
            assert half > 1.6 * error(lambda step, make=make: make(noise=step), step)
