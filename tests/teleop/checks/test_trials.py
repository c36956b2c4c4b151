"""What a law claims is tried: at its ends against the waves they got, and in closed loops against the ledgers."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice
from typing import Any, ClassVar

import numpy as np
import pytest

from teleop.checks.trials import refuse_broken, spread, trials, try_claims
from teleop.errors import Refused, number
from teleop.law import At
from teleop.laws.direct import Direct
from teleop.laws.wave import Wave


@dataclass(frozen=True, kw_only=True)
class OtherWave:
    """A wave law with a way to be wrong."""

    gain: float = 1.0
    deaf: float = 0.0
    claims: ClassVar[dict[str, str]] = {"E_link": "any link"}

    def __post_init__(self) -> None:
        number("gain", self.gain)
        number("deaf", self.deaf)

    def master_start(self, at: At) -> Any:
        return Wave().master_start(at)

    def slave_start(self, at: At) -> Any:
        return Wave().slave_start(at)

    def master(self, s: Any, at: At, rx: Any) -> Any:
        w = rx.w * max(at.fresh, self.deaf)
        return 2.0 * at.v - 2.0 * w, type(Wave().slave_start(at)[1])(2.0 * at.v - w), s

    def slave(self, s: Any, at: At, rx: Any) -> Any:
        u = rx.u * max(at.fresh, self.deaf)
        known = At(at.x, at.v, 0.0, 0.0, 0.0, True, 0.0, at.dt, at.span)
        f_s, back, state = Wave().slave(s, known, type(rx)(u))
        return f_s, type(back)(self.gain * back.w), state


def test_a_ledger_that_is_kept_may_be_claimed() -> None:
    try_claims(OtherWave())


def test_a_ledger_that_is_no_number_is_not_kept() -> None:
    scene = next(trials(Wave(), spread("Wave")))
    with pytest.raises(Refused, match="Wave claims E_link, which fell to nan J"):
        refuse_broken(Wave(), scene, {"E_link": np.array([0.0, np.nan, 1.0])}, ["E_link"])


def test_a_slave_that_sends_back_more_than_it_got_is_caught() -> None:
    with pytest.raises(Refused, match=r"its slave gave its port .* J more than the waves brought"):
        try_claims(OtherWave(gain=1.3))


def test_a_law_that_plays_a_wave_again_in_the_gaps_is_caught() -> None:
    with pytest.raises(Refused, match=r"its master gave its port .*; put zero for a wave"):
        try_claims(OtherWave(deaf=1.0))


def test_a_slave_that_uses_the_last_commanded_point_is_caught() -> None:
    """With the old x_d in f_s, force and velocity of the wave port do not belong together."""

    @dataclass(frozen=True, kw_only=True)
    class Late:
        claims: ClassVar[dict[str, str]] = {"E_link": "any link"}
        master_start = staticmethod(Wave().master_start)
        slave_start = staticmethod(Wave().slave_start)
        master = staticmethod(Wave().master)

        def slave(self, s: Any, at: At, rx: Any) -> Any:
            f_s = 500.0 * (s.x_d - at.x)
            u = rx.u * at.fresh
            back = type(Wave().master_start(at)[1])
            return f_s, back(u - f_s), type(s)(s.x_d + at.dt * (u - 0.5 * f_s))

    with pytest.raises(Refused, match=r"its slave gave its port.*solve force and velocity together"):
        try_claims(Late())


@dataclass(frozen=True, kw_only=True)
class Boasting:
    """Direct reflection that claims what it cannot keep."""

    claims: dict[str, str]
    master_start = staticmethod(Direct().master_start)
    slave_start = staticmethod(Direct().slave_start)
    master = staticmethod(Direct().master)
    slave = staticmethod(Direct().slave)


def test_direct_reflection_cannot_claim_the_port() -> None:
    with pytest.raises(Refused, match=r"Boasting claims E_port, which fell to -\d.* J over RandomLink"):
        try_claims(Boasting(claims={"E_port": "any link"}))


def test_a_law_without_waves_cannot_claim_the_link() -> None:
    with pytest.raises(Refused, match=r"claims E_link, but its messages carry no waves; write `u: kind.Wave`"):
        try_claims(Boasting(claims={"E_link": "any link"}))


def test_a_law_that_claims_nothing_is_not_tried() -> None:
    try_claims(Direct())


def test_trials_are_the_same_every_time_and_of_every_kind() -> None:
    one, other = (list(trials(Wave(), spread("x"))) for _ in range(2))
    assert one == other
    assert {scene.axes for scene in one} == {1, 3}
    assert {scene.observer for scene in one} == {None, 200.0}
    assert len({scene.link for scene in one}) == len(one)
    assert any(scene.link.loss == 0.0 for scene in one)  # type: ignore[union-attr]
    assert any(scene.link.loss > 0.3 for scene in one)  # type: ignore[union-attr]


def test_the_spread_is_even_and_never_reaches_one() -> None:
    numbers = list(islice(spread("any"), 20_000))
    assert 0.0 <= min(numbers) < 1e-3
    assert 1.0 - 1e-3 < max(numbers) < 1.0
    assert sum(numbers) / len(numbers) == pytest.approx(0.5, abs=0.01)
