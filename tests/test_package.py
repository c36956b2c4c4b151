"""The package as a user gets it: sdist and wheel are built, looked into, and installed where nothing else is."""

from __future__ import annotations

import importlib
import os
import re
import subprocess
import sys
import tarfile
import zipfile
from email import message_from_bytes
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import msgpack
import numpy as np
import pytest

from tests.programs import program

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("teleop", "master", "slave", "channel", "scenarios")
REPOSITORY_ALONE = ("teleop/bench/rivals/", "teleop/bench/c/")
"""What measures the stack beside other programs: of use in a clone of the repository only."""

pytestmark = pytest.mark.skipif(not (ROOT / "pyproject.toml").is_file(), reason="needs the sources")


def run(start: str | Path, *words: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    own = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "PIP_", "TELEOP_"))}
    return subprocess.run([program(start), *map(str, words)], cwd=cwd, env=own, capture_output=True, text=True,
                          check=False)


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The sdist, and the wheel that is built from the sdist alone, without a network."""
    folder = tmp_path_factory.mktemp("built")
    done = run(sys.executable, "-m", "build", "--no-isolation", "--outdir", folder, ROOT, cwd=folder)
    assert done.returncode == 0, done.stdout + done.stderr
    (sdist,), (wheel,) = folder.glob("*.tar.gz"), folder.glob("*.whl")
    return sdist, wheel


@pytest.fixture(scope="module")
def installed(built: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fresh environment with the wheel and, by their folders, the two packages that it depends on."""
    folder = tmp_path_factory.mktemp("installed")
    done = run(sys.executable, "-m", "venv", "--without-pip", "env", cwd=folder)
    assert done.returncode == 0, done.stderr
    python = folder / "env" / "bin" / "python"
    done = run(sys.executable, "-m", "pip", "--python", python, "install", "--no-deps", "--no-index", "--quiet",
               built[1], cwd=folder)
    assert done.returncode == 0, done.stderr
    site, = (folder / "env" / "lib").glob("python*/site-packages")
    dependencies = {Path(package.__file__ or "").parents[1] for package in (np, msgpack)}
    (site / "dependencies.pth").write_text("".join(f"{path}\n" for path in sorted(dependencies)))
    return python.parent


def tracked(*folders: str) -> set[str]:
    """The files of the repository below these folders, for what a build takes of them; bytecode is none."""
    paths = [path for folder in folders for path in (ROOT / folder).rglob("*") if path.is_file()]
    return {path.relative_to(ROOT).as_posix() for path in paths
            if "__pycache__" not in path.parts and path.suffix != ".key"}


def test_the_wheel_has_the_five_packages_and_none_of_the_rivals(built: tuple[Path, Path]) -> None:
    with zipfile.ZipFile(built[1]) as wheel:
        assert wheel.testzip() is None
        names = {name for name in wheel.namelist() if ".dist-info/" not in name}
    assert names == {name for name in tracked(*PACKAGES) if not name.startswith(REPOSITORY_ALONE)}
    assert {"teleop/py.typed", "scenarios/matrix.toml", "scenarios/reach.csv"} <= names


def test_the_sdist_has_the_tests_and_all_that_they_read(built: tuple[Path, Path]) -> None:
    with tarfile.open(built[0]) as sdist:
        names = {name.partition("/")[2] for name in sdist.getnames()}
    pages = {path.name for path in ROOT.glob("*.md")}
    assert tracked(*PACKAGES, "tests", ".figures") | pages | {"CITATION.cff", "LICENSE", "pyproject.toml"} <= names
    assert any(name.startswith("teleop/bench/rivals/") for name in names)


def test_the_metadata_names_licence_command_and_the_pythons_that_are_tried(built: tuple[Path, Path]) -> None:
    with zipfile.ZipFile(built[1]) as wheel:
        folder, = {name.partition("/")[0] for name in wheel.namelist() if ".dist-info/" in name}
        told = message_from_bytes(wheel.read(f"{folder}/METADATA"))
        assert f"{folder}/licenses/LICENSE" in wheel.namelist()
        commands = wheel.read(f"{folder}/entry_points.txt").decode()
    assert told["Name"] == "bilateral-teleop"
    assert told["License-Expression"] == "BSD-3-Clause"
    assert told["Requires-Python"] == ">=3.11"
    pythons = [line.rpartition(" ")[2] for line in told.get_all("Classifier") or [] if ":: 3." in line]
    assert pythons == ["3.11", "3.12", "3.13"]
    tried = re.search(r"python: \[(.*)\]", (ROOT / ".github/workflows/tests.yml").read_text())
    assert tried is not None
    assert re.findall(r"[\d.]+", tried[1]) == pythons
    assert told["Description-Content-Type"] == "text/markdown"
    assert "teleop = scenarios.__main__:main" in commands


def test_the_installed_command_runs_a_scene(installed: Path, tmp_path: Path) -> None:
    done = run(installed / "teleop", "run", "local", "--set", "duration=0.5", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "runs" / "local-1" / "summary.json").is_file()
    where = run(installed / "python", "-c", "import teleop; print(teleop.__file__)", cwd=tmp_path)
    assert Path(where.stdout).is_relative_to(installed.parent)


def test_an_installed_package_says_where_the_rivals_are(installed: Path, tmp_path: Path) -> None:
    done = run(installed / "python", "-m", "teleop.bench", "rivals", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[1:] == ["not in an installed package: run it in a clone of the repository"]


@pytest.mark.parametrize("name", ["master", "slave", "channel"])
def test_beside_another_package_called_teleop_each_says_so(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another project's has the same name."""
    spec = spec_from_file_location(f"{name}_again", importlib.import_module(name).__file__)
    assert spec is not None
    assert spec.loader is not None
    monkeypatch.setitem(sys.modules, "teleop", ModuleType("teleop"))
    monkeypatch.delitem(sys.modules, "teleop.version", raising=False)
    with pytest.raises(ImportError, match=r"another package called teleop .* install bilateral-teleop"):
        spec.loader.exec_module(module_from_spec(spec))
