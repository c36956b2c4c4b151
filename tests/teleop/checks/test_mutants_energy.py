"""Wrong forms of the laws that keep energy are caught by the check that every law passes."""

from __future__ import annotations

from typing import Any

import pytest

from teleop.checks.law import check_law
from teleop.errors import Refused
from tests.teleop.checks.mutants_energy import PSPM_WRONG, TDPA_WRONG, TWO_LAYER


def named(laws: tuple[Any, ...]) -> dict[str, Any]:
    return {f"{type(law).__qualname__}": law for law in laws}


WRONG = {"two_layer": named(TWO_LAYER), "pspm": named(PSPM_WRONG), "tdpa": named(TDPA_WRONG)}


@pytest.mark.parametrize("law", [
    pytest.param(law, id=f"{of}-{name}") for of, laws in WRONG.items() for name, law in laws.items()
])
def test_a_law_with_one_mistake_is_caught(law: Any) -> None:
    with pytest.raises(Refused, match=r"claims E_law, (but at tick \d+ its (master|slave) keeps|which fell to)"):
        check_law(law, compiled=False)
