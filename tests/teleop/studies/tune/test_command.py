"""`teleop tune`, as it is typed."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from teleop.__main__ import main

TYPED = ["tune", "wave", "--scene", "hard_wall", "--set", "k_e=2000", "--set", "duration=2.5", "--budget", "12",
         "--workers", "1"]


def test_it_leaves_its_points_its_front_and_the_command_that_runs_the_best(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*TYPED, "--out", str(tmp_path / "t"), "--plot"]) == 0
    page = capsys.readouterr().out
    document = json.loads((tmp_path / "t/summary.json").read_text())
    assert document["status"] == "done"
    assert document["rows"] == 12
    assert "run it: teleop run hard_wall --set law=wave" in page
    assert document["run"][:3] == ["teleop", "run", "hard_wall"]
    with (tmp_path / "t/points.csv").open() as file:
        points = list(csv.DictReader(file))
    assert len(points) == document["points"] == 6
    assert min(float(point["value"]) for point in points if not point["broken"]) == document["value"]
    assert (tmp_path / "t/tune.png").stat().st_size > 10_000
    assert main([*document["run"][1:], "--out", str(tmp_path / "r"), "--json"]) == 0
    summary = json.loads((tmp_path / "r/summary.json").read_text())
    assert summary["metrics"]["x_err_rms"]["value"] == document["figures"]["scene"]["x_err_rms"]


@pytest.mark.full
def test_a_best_point_that_breaks_a_condition_of_its_law_says_so_before_it_is_run(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = [{"wave": "p_d", "12": "40"}.get(word, word) for word in TYPED]
    assert main([*words, "--set", "delay=0.2", "--set", "law.B=0.5", "--out", str(tmp_path / "t")]) == 0
    page = " ".join(capsys.readouterr().out.split())
    document = json.loads((tmp_path / "t/summary.json").read_text())
    (sentence,) = document["conditions"]
    assert "it is not: --set law.B=" in sentence
    assert f"but {sentence}" in page
    assert main([*document["run"][1:], "--out", str(tmp_path / "r"), "--json"]) == 0
    assert sentence in json.loads((tmp_path / "r/summary.json").read_text())["notes"]
