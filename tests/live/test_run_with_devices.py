"""`teleop run SCENE --device NAME --robot NAME`: in virtual time, with what stands at each end by its name."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from teleop.__main__ import main
from teleop.simulation.result import read_result

SHORT = ["--set", "duration=0.3", "--link", "delay(0.02) | uniform(0.01) | bernoulli(0.1)", "--seed", "3"]


def ran(capsys: pytest.CaptureFixture[str], out: Path, *words: str) -> dict[str, Any]:
    """The summary that `teleop run` prints."""
    assert main(["run", *words, "--out", str(out), "--json"]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def test_with_the_simulated_ones_named_it_is_the_run_without_a_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plain = ran(capsys, tmp_path / "plain", "arm", *SHORT)
    named = ran(capsys, tmp_path / "named", "arm", *SHORT, "--device", "simulated", "--robot", "simulated")
    own = ("command", "run_time", "path")
    assert {k: v for k, v in named.items() if k not in own} == {k: v for k, v in plain.items() if k not in own}
    one, other = (read_result(tmp_path / name).trace for name in ("plain", "named"))
    assert list(one) == list(other)
    assert all(one[name].tobytes() == other[name].tobytes() for name in one)


def test_a_robot_in_mujoco_leaves_a_folder_as_every_run_does(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("mujoco", reason="mujoco-core is not installed (extra mujoco)")
    summary = ran(capsys, tmp_path / "run", "arm", *SHORT, "--robot", "mujoco")
    assert (summary["status"], summary["mode"], summary["robot"], summary["ticks"]) == ("ok", "virtual", "mujoco", 300)
    assert summary["notes"][0].startswith("pressed slowly before the run along +x")
    assert read_result(tmp_path / "run").trace["f_env"].shape == (300, 3)
    assert main(["report", str(tmp_path / "run"), "--html", str(tmp_path / "page.html")]) == 0
    assert "pressed slowly" in (tmp_path / "page.html").read_text()


@pytest.mark.parametrize(("words", "says"), [
    (["arm", "--robot", "mujoco:none.xml"], "there is no file none.xml; write --robot mujoco:FILE.xml"),
    (["arm", "--robot", "mujco"], "did you mean mujoco?"),
    (["hard_wall", "--robot", "simulated", "--bodies", "semi_implicit_euler:4"], "--bodies moves the scene's"),
    (["virtual_wall", "--robot", "simulated"], "scene virtual_wall has no slave"),
])
def test_what_cannot_be_run_so_is_refused_in_one_sentence(
    words: list[str], says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if "none.xml" in says:
        pytest.importorskip("mujoco", reason="mujoco-core is not installed (extra mujoco)")
    assert main(["run", *words, "--out", str(tmp_path / "out")]) == 2
    err = capsys.readouterr().err
    assert says in err
    assert err.count("\n") == 1
    assert not (tmp_path / "out").exists()
