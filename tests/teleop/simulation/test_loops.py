"""A loop and a live end as they are made of the tick stand in `loops/`, so that a review reads plain Python.

After a change of the tick that is meant, write them anew: `python -m tests.teleop.simulation.test_loops`.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from teleop.scene.loading import load_scene
from teleop.simulation.source import rendered

FOLDER = Path(__file__).with_name("loops")


LOOPS = {
    "canonical.txt": lambda: rendered(load_scene("canonical")),
    "canonical_live_master.txt": lambda: rendered(load_scene("canonical"), "m"),
}


@pytest.mark.parametrize("name", LOOPS)
def test_a_scenes_loop_is_the_one_that_was_read(name: str) -> None:
    assert LOOPS[name]() == (FOLDER / name).read_text()


if __name__ == "__main__":
    for each, made in LOOPS.items():
        (FOLDER / each).write_text(made())
