"""Devices in a package of their own, built and put on the path: named, listed, checked and driven, no line changed."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from teleop import Refused, check_device, load_scene
from teleop.__main__ import main
from teleop.live.devices.opening import find_device
from teleop.scene.library import ROOT

PLUGIN = Path(__file__).parent / "device_plugin"
LISTED = """
import sys
from teleop.__main__ import main
main(["list", "robots"])
print("imported" if "rail_devices" in sys.modules else "not imported")
"""


@pytest.fixture(scope="session")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the package as an installer leaves it, its metadata with the entry points."""
    folder = tmp_path_factory.mktemp("device_plugin")
    shutil.copytree(PLUGIN, folder / "sources", ignore=shutil.ignore_patterns("__pycache__"))
    program = "from hatchling.build import build_wheel; print(build_wheel('.'))"
    done = subprocess.run([sys.executable, "-c", program], cwd=folder / "sources", capture_output=True, text=True,
                          check=True)
    with zipfile.ZipFile(folder / "sources" / done.stdout.split()[-1]) as wheel:
        wheel.extractall(folder / "site")
    return folder / "site"


@pytest.fixture
def installed(site: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.syspath_prepend(str(site))
    return site


def environment(site: Path) -> dict[str, str]:
    own = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    return {**own, "PYTHONPATH": os.pathsep.join([str(ROOT), str(site)])}


def test_they_are_listed_without_being_imported(site: Path) -> None:
    done = subprocess.run([sys.executable, "-c", LISTED], env=environment(site), capture_output=True, text=True,
                          check=True)
    assert "rail       from a plug-in, rail_devices:carriage" in done.stdout
    assert done.stdout.splitlines()[-1] == "not imported"


@pytest.mark.usefixtures("installed")
def test_both_pass_the_check_by_name_and_take_what_stands_behind_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert check_device("rail:0.001", ticks=50).moved[0] > 0.0
    assert main(["check", "device", "rail_handle", "--ticks", "50"]) == 0
    assert "device rail_handle: 1 axis, with a force sensor, simulated" in capsys.readouterr().out


@pytest.mark.usefixtures("installed")
def test_a_wrong_name_finds_the_nearest_of_a_package_and_a_wrong_scene_is_told_of_its_axes() -> None:
    with pytest.raises(Refused, match="did you mean rail_handle"):
        find_device("m", "rail_handel")
    with pytest.raises(Refused, match="the rail has one axis, and the scene 3"):
        find_device("s", "rail").open(load_scene("recorded_reach"))
    with pytest.raises(Refused, match=r"which makes the device, raised ValueError: could not convert .*'near'"):
        find_device("s", "rail:near").open(load_scene("hard_wall"))


@pytest.mark.live
def test_its_robot_is_driven_live_by_name_before_a_recorded_hand(site: Path, tmp_path: Path) -> None:
    rows = "\n".join(f"{k / 1000},{min(0.1, k / 10_000)}" for k in range(0, 2001, 10))
    (tmp_path / "hand.csv").write_text(f"t,x\n{rows}\n")
    words = ["hard_wall", "--set", "law=direct", "--link", "none", "--set", "duration=1.5"]
    done = subprocess.run([sys.executable, "-m", "teleop", "demo", *words, "--device", "csv:hand.csv", "--robot",
                           "rail:0.03", "--out", "live"], cwd=tmp_path, env=environment(site), capture_output=True,
                          text=True, check=False)
    assert done.returncode == 0, done.stderr
    trace = np.load(tmp_path / "live" / "trace.npz")
    np.testing.assert_allclose(trace["x_m"], np.minimum(0.1, trace["t"] / 10.0), atol=1e-12)
    assert trace["x_s"].max() > 0.03, "it came to the stop"
    assert trace["f_env"].max() > 0.5, "which pushed back"
