"""A run that nobody disturbed, and two ends with keys."""

from __future__ import annotations

import pytest

from tests.teleop.protocol.ends import Both
from tests.teleop.protocol.secure.conftest import associated, keys, meet
from tests.teleop.protocol.threats.hands import WATCHED

__all__ = ["associated", "keys", "meet", "plain"]


@pytest.fixture(scope="session")
def plain() -> Both:
    """The run of `WATCHED` over its link."""
    return Both(WATCHED).run()
