"""What is common to all tests: the long ones run only when they are asked for, `pytest -m soak`, `pytest -m fuzz`."""

from __future__ import annotations

import pytest

LONG = ("soak", "fuzz")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Skip what takes minutes, unless its marker is named."""
    asked = str(config.getoption("-m"))
    for item in items:
        for name in LONG:
            if name in item.keywords and name not in asked:
                item.add_marker(pytest.mark.skip(reason=f"takes minutes: pytest -m {name}"))
