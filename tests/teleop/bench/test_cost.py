"""What the bench of a tick's cost times: parts that there are, in ends that run."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from teleop.bench.cost import PARTS, place_of
from teleop.scene.library import ROOT


@pytest.mark.parametrize("name", [name for names in PARTS.values() for name in names])
def test_each_part_that_is_timed_is_a_function_of_the_stack(name: str) -> None:
    owner, last = place_of(name)
    assert callable(getattr(owner, last))


@pytest.mark.live
def test_two_ends_back_to_back_hear_each_other_and_have_all_the_parts() -> None:
    program = Path(place_of("bench.cost:main")[0].__file__)
    code = f"import runpy, sys; m = runpy.run_path({str(program)!r}); g = m['main'].__globals__; " \
           "g['TICKS'], g['WARM'] = 300, 50; m['main']()"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    found = json.loads(done.stdout)
    assert found.keys() == {"whole", *PARTS}
    assert all(us > 0.0 for us in found.values())
