"""Rows of numbers as JSON objects, the same text for every reader: shortest digits that give the same bits again.

JSON has neither NaN nor infinity, and a reader of JSON Schema such as Foxglove takes no field that may be a number or
null: so a number that is not finite is left out of its object, and what it leaves empty too.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from math import isfinite
from typing import Any

Path = tuple[str, ...]  # of a number in an object: the names on the way to it


class Objects:
    """Writes rows as objects, the numbers of a row at `paths`. A number that another path leads through is none."""

    def __init__(self, paths: Sequence[Path]) -> None:
        self._paths = list(paths)
        tree: dict[str, Any] = {}
        for i, path in enumerate(self._paths):
            _put(tree, path, i)
        self._order: list[int] = []
        self._template = self._of(tree)

    def _of(self, tree: dict[str, Any]) -> str:
        parts = []
        for name, inner in tree.items():
            if isinstance(inner, dict):
                text = self._of(inner)
            else:
                self._order.append(inner)
                text = "%s"
            parts.append(f"{json.dumps(name).replace('%', '%%')}:{text}")
        return "{" + ",".join(parts) + "}"

    def texts(self, cells: Sequence[Sequence[float]]) -> list[str]:
        """The object of each row; `cells` has for each path the numbers of all rows."""
        texts = [self._template % row for row in zip(*[cells[i] for i in self._order], strict=True)]
        doubtful = [column for column in cells if not isfinite(sum(column))]  # the sum of sound ones may overflow too
        for i in {i for column in doubtful for i, value in enumerate(column) if not isfinite(value)}:
            texts[i] = self._sparse([column[i] for column in cells])
        return texts

    def _sparse(self, row: Sequence[float]) -> str:
        tree: dict[str, Any] = {}
        for path, value in zip(self._paths, row, strict=True):
            if isfinite(value):
                _put(tree, path, value)
        return json.dumps(tree, separators=(",", ":"), allow_nan=False)


def _put(tree: dict[str, Any], path: Path, value: Any) -> None:
    for name in path[:-1]:
        tree = tree.setdefault(name, {})
    tree[path[-1]] = value
