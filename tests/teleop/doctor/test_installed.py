"""Another project's package called `teleop`."""

from __future__ import annotations

from pathlib import Path

import pytest

from teleop.doctor import command
from teleop.scene.library import ROOT


@pytest.fixture(autouse=True)
def alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """No distribution but ours has the name."""
    monkeypatch.setattr(command, "packages_distributions", lambda: {"teleop": ["bilateral-teleop"]})


def test_ours_is_no_other(tmp_path: Path) -> None:
    assert command.other_packages([str(ROOT), str(tmp_path), "no such folder"]) == []
    assert command.judge_name([]).good


def test_a_package_and_a_file_of_the_name_are_found(tmp_path: Path) -> None:
    (tmp_path / "one" / "teleop").mkdir(parents=True)
    (tmp_path / "one" / "teleop" / "__init__.py").touch()
    (tmp_path / "two").mkdir()
    (tmp_path / "two" / "teleop.py").touch()
    found = command.other_packages([str(ROOT), str(tmp_path / "one"), str(tmp_path / "two"), str(tmp_path / "one")])
    assert found == [str(tmp_path / "one" / "teleop"), str(tmp_path / "two" / "teleop.py")]
    assert not command.judge_name(found).good


def test_a_command_or_a_folder_of_the_name_is_no_package(tmp_path: Path) -> None:
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "teleop").touch()
    (tmp_path / "notes" / "teleop").mkdir(parents=True)
    assert command.other_packages([str(tmp_path / "bin"), str(tmp_path / "notes")]) == []


def test_a_distribution_that_has_written_over_ours_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    both = {"teleop": ["bilateral-teleop", "teleop", "teleop"]}
    monkeypatch.setattr(command, "packages_distributions", lambda: both)
    assert command.other_packages([]) == ["teleop"]
    found = command.judge_name(["teleop"])
    assert "another package called teleop is here too, teleop" in found.says
    assert "pip install bilateral-teleop" in str(found.cure)
