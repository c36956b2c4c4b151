"""The bench of laws of plug-ins and files: the copies that it measures are found, and leave nothing behind."""

from __future__ import annotations

import sys

import pytest

from teleop.bench import sweep
from teleop.errors import Refused
from teleop.law import find_law


def test_it_sweeps_the_built_in_law_and_both_copies_and_takes_them_away(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sweep, "SHORT_ROWS", {"plain": 3})
    path = list(sys.path)
    told = sweep.own_laws(1)
    assert [what.split(",")[0] for what, _, _ in told] == [
        "plain", "  law of a plug-in", "  law of a file"]
    assert all(float(measured.split()[0]) > 0.0 for _, measured, _ in told)
    assert sys.path == path
    with pytest.raises(Refused):
        find_law("bench_waves")
