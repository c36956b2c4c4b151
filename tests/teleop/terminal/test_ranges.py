"""Numbers and ranges as they are typed: what is taken, and the one sentence for what is not."""

from __future__ import annotations

from math import inf

import pytest

from teleop import Refused
from teleop.terminal.options import typed_number, typed_range


class TestRange:
    def test_is_two_finite_numbers_the_lower_first(self) -> None:
        assert typed_range("--range", "-1:2e3", example="1:2") == (-1.0, 2000.0)

    @pytest.mark.parametrize(("text", "bounds", "said"), [
        ("5", {}, "--range 5 is not LOW:HIGH in Hz; write for example --range 1:100"),
        ("a:b", {}, "not LOW:HIGH"),
        ("1:", {}, "not LOW:HIGH"),
        ("1:2:3", {}, "not LOW:HIGH"),
        ("0:inf", {}, "must be finite"),
        ("nan:1", {}, "must be finite"),
        ("9:1", {}, "--range 9:1 is empty; write the lower end first, for example --range 1:100"),
        ("5:5", {}, "is empty"),
        ("-1:2", {"low": 0.0}, "must not go below 0"),
        ("0:2", {"above": 0.0}, "must lie above 0"),
    ])
    def test_that_is_none_is_refused_with_one_that_is(self, text: str, bounds: dict[str, float], said: str) -> None:
        with pytest.raises(Refused) as refused:
            typed_range("--range", text, what="Hz", example="1:100", low=bounds.get("low", -inf),
                        above=bounds.get("above", -inf))
        assert said in str(refused.value)
        assert str(refused.value).endswith("--range 1:100")


class TestNumber:
    def test_that_is_none_is_refused_with_one_that_is(self) -> None:
        assert typed_number("--tol", "1e-3", example="0.01") == 1e-3
        with pytest.raises(Refused, match=r"--tol soon is no number; write for example --tol 0\.01"):
            typed_number("--tol", "soon", example="0.01")
        with pytest.raises(Refused, match="--tol must be above 0, not 0"):
            typed_number("--tol", "0", example="0.01", above=0.0)
