"""A law, a device and a robot in packages of their own, built and put on the path: in every command, unchanged."""

from __future__ import annotations

import csv
import importlib.metadata
import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from teleop import Refused, check_device, check_law, find_law, load_result, load_scene, run, sweep
from teleop.__main__ import main
from teleop.live.devices.opening import find_device
from teleop.scene.library import ROOT
from tests.programs import compiler_of

GAINS = {"law.K": 400.0, "law.kf": 0.8}
LISTED = """
import sys
from teleop.__main__ import main
main(["list", "robots"])
print("imported" if "rail_devices" in sys.modules else "not imported")
"""


@pytest.fixture(scope="session")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with both packages as an installer leaves them, their metadata with the entry points."""
    folder = tmp_path_factory.mktemp("plugins")
    for name in ("plugin", "device_plugin"):
        sources = folder / name
        shutil.copytree(Path(__file__).parent / name, sources, ignore=shutil.ignore_patterns("__pycache__"))
        program = "from hatchling.build import build_wheel; print(build_wheel('.'))"
        done = subprocess.run([sys.executable, "-c", program], cwd=sources, capture_output=True, text=True, check=True)
        with zipfile.ZipFile(sources / done.stdout.split()[-1]) as wheel:
            wheel.extractall(folder / "site")
    return folder / "site"


@pytest.fixture
def installed(site: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.syspath_prepend(str(site))
    return site


def python(site: Path, *words: str, cwd: Path = ROOT) -> subprocess.CompletedProcess[str]:
    """Run a Python that has the packages."""
    own = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    return subprocess.run([sys.executable, *words], cwd=cwd, capture_output=True, text=True, check=False,
                          env={**own, "PYTHONPATH": os.pathsep.join([str(ROOT), str(site)])})


@pytest.mark.usefixtures("installed")
class TestALawOfAPlugIn:
    def test_keeps_the_contract_of_laws(self) -> None:
        check_law(find_law("springs")(), compiled=False)  # the sweeps below compile it

    def test_is_listed_without_being_imported_and_shows_its_knobs(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert main(["list"]) == 0
        listed = [line.split() for line in capsys.readouterr().out.splitlines()]
        assert any(words[:1] == ["springs"] and words[-1] == "laws_of_springs:Springs" for words in listed)
        assert main(["list", "springs"]) == 0
        told = capsys.readouterr().out
        assert "Reflection of the slave's force" in told
        assert "N/m, stiffness of the spring, >= 0" in told

    def test_runs_with_the_bits_of_the_built_in_law_whose_equations_it_has(self) -> None:
        mine, built_in = (run(load_scene("soft_tissue", law=law, duration=0.2, **GAINS)).trace
                          for law in ("springs", "direct"))
        assert mine.keys() == built_in.keys()
        for name in mine:
            np.testing.assert_array_equal(mine[name], built_in[name], err_msg=name)

    @pytest.mark.parametrize("engine", ["plain", pytest.param("vector", marks=pytest.mark.full)])
    def test_is_a_value_of_a_sweeps_axis(self, engine: str) -> None:
        compiler_of(engine)
        fixed = {"duration": 0.2, **GAINS}
        rows = sweep("soft_tissue", {"law": ["springs"], "k_e": [100.0, 1000.0]}, engine=engine, fixed=fixed)
        assert [row["law"] for row in rows] == ["springs", "springs"]
        built_in = sweep("soft_tissue", {"law": ["direct"], "k_e": [100.0, 1000.0]}, engine="plain", fixed=fixed)
        for mine, theirs in zip(rows, built_in, strict=True):
            assert {**mine, "law": "direct"} == theirs

    def test_cost_a_look_through_all_installed_packages_in_every_row_of_a_sweep(self,
            monkeypatch: pytest.MonkeyPatch) -> None:
        looked: list[str] = []
        real = importlib.metadata.entry_points

        def counted(**group: Any) -> Any:
            looked.extend(group.values())
            return real(**group)

        monkeypatch.setattr(importlib.metadata, "entry_points", counted)
        sweep("soft_tissue", {"law": ["springs"], "k_e": [100.0 + i for i in range(20)]}, engine="plain",
              fixed={"duration": 0.01})
        assert looked.count("teleop.laws") == 1

    def test_stands_in_a_comparison_beside_the_built_in_ones(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
            capsys: pytest.CaptureFixture[str]) -> None:
        monkeypatch.chdir(tmp_path)
        Path("two.toml").write_text('seeds = 1\n[[link]]\nname = "10 ms"\nlink = "delay(0.01)"\n[[environment]]\n'
                                    'name = "tissue"\nscene = "soft_tissue"\nset = {duration = 0.3}\n')
        assert main(["compare", "two.toml", "--laws", "springs,direct", "--workers", "1"]) == 0
        assert "springs" in capsys.readouterr().out
        with (tmp_path / "runs" / "two" / "rows.csv").open() as file:
            mine, built_in = csv.DictReader(file)
        assert (mine["law"], built_in["law"]) == ("springs", "direct")
        for name in ("status", "x_err_rms (m)", "f_m_max (N)", "E_port_min (J)", "sent (1)"):
            assert mine[name] == built_in[name]

    def test_is_judged_by_the_analyses(self, capsys: pytest.CaptureFixture[str]) -> None:
        said = []
        for law in ("springs", "direct"):
            assert main(["stability", "soft_tissue", "--set", f"law={law}", "--set", "delay=0.005", "--json"]) == 0
            found = json.loads(capsys.readouterr().out)
            said.append((found["verdict"], found["gain_margin"], found["critical_round_trip"]))
        assert said[0] == said[1]


@pytest.mark.live
def test_a_law_of_a_plug_in_runs_live_as_in_virtual_time(
    site: Path, installed: Path, tmp_path: Path  # noqa: ARG001 - the one is on the path of this process
) -> None:
    knobs = ["--set", "law=springs", "--set", "duration=0.3", "--set", "delay=0.01"]
    done = python(site, "-m", "teleop", "demo", "hard_wall", *knobs, "--lockstep", "--out", "live", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    live = load_result(tmp_path / "live").trace
    virtual = run(load_scene("hard_wall", law="springs", duration=0.3, delay=0.01)).trace
    for name in ("x_m", "f_m", "x_s", "f_s"):
        np.testing.assert_array_equal(live[name], virtual[name], err_msg=name)


@pytest.mark.usefixtures("installed")
class TestDevicesOfAPlugIn:
    def test_are_listed_without_being_imported(self, site: Path) -> None:
        done = python(site, "-c", LISTED)
        assert "rail         from a plug-in, rail_devices:carriage" in done.stdout
        assert done.stdout.splitlines()[-1] == "not imported"

    def test_pass_the_check_by_name_and_take_what_stands_behind_it(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert check_device("rail:0.001", ticks=50).moved[0] > 0.0
        assert main(["check", "device", "rail_handle", "--ticks", "50"]) == 0
        assert "device rail_handle: 1 axis, with a force sensor, simulated" in capsys.readouterr().out

    def test_of_a_wrong_name_or_scene_are_refused(self) -> None:
        with pytest.raises(Refused, match="did you mean rail_handle"):
            find_device("m", "rail_handel")
        with pytest.raises(Refused, match="the rail has one axis, and the scene 3"):
            find_device("s", "rail").open(load_scene("recorded_reach"))
        with pytest.raises(Refused, match=r"which makes the device, raised ValueError: could not convert .*'near'"):
            find_device("s", "rail:near").open(load_scene("hard_wall"))

    @pytest.mark.live
    def test_are_driven_live_by_name_before_a_recorded_hand(self, site: Path, tmp_path: Path) -> None:
        rows = "\n".join(f"{k / 1000},{min(0.1, k / 10_000)}" for k in range(0, 2001, 10))
        (tmp_path / "hand.csv").write_text(f"t,x\n{rows}\n")
        words = ["hard_wall", "--set", "law=direct", "--link", "none", "--set", "duration=1.5"]
        done = python(site, "-m", "teleop", "demo", *words, "--device", "csv:hand.csv", "--robot", "rail:0.03", "--out",
                      "live", cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        trace = np.load(tmp_path / "live" / "trace.npz")
        np.testing.assert_allclose(trace["x_m"], np.minimum(0.1, trace["t"] / 10.0), atol=1e-12)
        assert trace["x_s"].max() > 0.03, "it came to the stop"
        assert trace["f_env"].max() > 0.5, "which pushed back"


def test_without_the_package_its_law_is_unknown(site: Path) -> None:
    assert str(site) not in sys.path
    with pytest.raises(Refused, match="'springs'"):
        find_law("springs")
