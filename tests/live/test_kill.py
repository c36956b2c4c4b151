"""Processes that are killed, started again, stopped and continued: who is left lets go, and all resume again."""

from __future__ import annotations

import random
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from tests.live.conftest import pair_of_keys
from tests.live.killing import Site
from tests.live.verdict import judge

pytestmark = [
    pytest.mark.live,
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="processes are looked for in /proc"),
]


class Form(NamedTuple):
    """How many blows to one run; each joining process first has to simulate the run so far."""

    blows: int
    sealed: bool
    seed: int
    timeout: float = 0.2  # s, of the watchdogs
    knobs: tuple[str, ...] = ()


SHORT = [pytest.param(Form(3, False, 56), id="in the open"), pytest.param(Form(2, True, 1), id="sealed")]
LONG = [
    pytest.param(Form(25, sealed, seed), id=f"{'sealed' if sealed else 'in the open'} {seed}",
                 marks=[pytest.mark.soak, pytest.mark.timeout(600)])
    for seed in range(10, 14) for sealed in (False, True)
]
LONG += [  # a session ends before such a watchdog lets go: its force is there still when the next one begins
    pytest.param(Form(10, False, 20, timeout=1.5, knobs=("law=direct", "friction=6")), id="with patient watchdogs",
                 marks=[pytest.mark.soak, pytest.mark.timeout(600)])
]


@pytest.mark.parametrize("form", SHORT + LONG)
def test_whoever_is_left_lets_go_and_all_resume(form: Form, command: Callable[..., Any], tmp_path: Path) -> None:
    keys = pair_of_keys(tmp_path) if form.sealed else {}
    dice = random.Random(form.seed)
    site = Site(command, tmp_path, keys, 60 + 15 * form.blows, form.timeout, form.knobs)
    site.resumed(site.every[-1].began)
    for _ in range(form.blows):
        site.upset(dice)
    site.end()
    print(judge(site))
