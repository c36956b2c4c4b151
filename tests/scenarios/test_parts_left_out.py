"""Parts of a scene that its knobs leave out with `none`: force cap, slew limit, watchdog."""

from __future__ import annotations

import json
from pathlib import Path

from teleop import Cap, load_scene, run, sweep
from teleop.__main__ import main
from teleop.scene.knobs import knobs_of
from teleop.scene.library import built_in_scenes, scene_function
from teleop.simulation.structure import structure_of

OTHERS = ("lte", "pose", "bench_top", "servo_arm", "handover")  # which needs files, and whose caps are others
LIMITED = [name for name in built_in_scenes() if "slew" in knobs_of(scene_function(name)) and name not in OTHERS]
NONE = {"f_max": "none", "slew": "none", "timeout": "none"}


def test_a_cap_and_a_watchdog_could_not_be_left_out_by_a_knob() -> None:
    for name in LIMITED:
        bare = load_scene(name, **NONE)
        assert (bare.cap, bare.watchdog) == (None, None), name
        assert load_scene(name, f_max="none").cap == Cap(slew=2000.0), name
        assert load_scene(name, slew="none").cap == Cap(f_max=20.0), name
        assert load_scene(name, **NONE, v_max=0.3).cap == Cap(v_max=0.3), name
    for name in ("encoder_wall", "virtual_wall", "virtual_coupling"):
        assert load_scene(name, f_max="none").cap is None


def test_what_is_left_out_is_neither_in_the_tick_nor_in_the_record(tmp_path: Path) -> None:
    words = [word for key, value in NONE.items() for word in ("--set", f"{key}={value}")]
    assert main(["run", "hard_wall", *words, "--set", "duration=0.2", "--out", str(tmp_path / "out")]) == 0
    told = json.loads((tmp_path / "out" / "summary.json").read_text())["parameters"]
    assert {key: told[key] for key in NONE} == dict.fromkeys(NONE)
    assert "g_m" not in run(load_scene("hard_wall", **NONE, duration=0.2)).trace


def test_limits_that_are_never_met_are_limits_that_are_not_there() -> None:
    bare, wide = (run(load_scene("hard_wall", f_max=most, slew=slew, timeout="none", duration=3.0))
                  for most, slew in (("none", "none"), (1e300, 1e300)))
    assert bare.trace["x_s"].tobytes() == wide.trace["x_s"].tobytes()


def test_a_sweep_has_rows_with_and_without_a_part_each_as_its_run() -> None:
    table = sweep("hard_wall", {"f_max": ["none", 1.0], "slew": [None, 50.0]}, fixed={"duration": 1.2}, engine="plain")
    for row in table:
        alone = run(load_scene("hard_wall", f_max=row["f_max"], slew=row["slew"], duration=1.2))
        assert row["f_m_max"] == alone.metrics["f_m_max"]
    shapes = {structure_of(load_scene("hard_wall", f_max=most, slew="none")) for most in ("none", 1.0, 10.0)}
    assert len(shapes) == 2
