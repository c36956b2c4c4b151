"""`teleop compare`: the rows, the table, the files, and going on after an interrupt."""

from __future__ import annotations

import csv
import json
import shlex
import shutil
from pathlib import Path
from typing import Any

import pytest

import teleop.studies.compare.command as command_module
from teleop import load_scene, run
from teleop.__main__ import main
from teleop.studies.compare.command import CaseBatch, ending_of, run_batch
from teleop.studies.margin import margin
from teleop.studies.tune.search import LawSearch, SearchJob

Capture = pytest.CaptureFixture[str]
SMALL = """
seeds = 2
set = {x_limit = 0.3}
[[link]]
name = "loss"
link = "delay(0.01) | bernoulli(0.3)"
[[link]]
name = "10 ms"
link = "delay(0.01)"
[[environment]]
name = "tissue"
scene = "soft_tissue"
set = {duration = 0.4}
[[environment]]
name = "free"
scene = "free_motion"
set = {duration = 0.4}
"""


def compare(*more: str) -> int:
    return main(["compare", "small.toml", "--laws", "wave,direct", "--workers", "1", *more])


def rows_of(folder: str = "runs/small") -> list[dict[str, str]]:
    with (Path(folder) / "rows.csv").open() as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which the comparison was run."""
    folder = tmp_path_factory.mktemp("compared")
    (folder / "small.toml").write_text(SMALL)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert compare() == 0
    return folder


@pytest.fixture
def empty(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the file alone."""
    monkeypatch.chdir(tmp_path)
    Path("small.toml").write_text(SMALL)
    return tmp_path


@pytest.fixture
def done(compared: Path, empty: Path) -> Path:
    """The same, with all of its rows."""
    shutil.copytree(compared, empty, dirs_exist_ok=True)
    return empty


@pytest.mark.usefixtures("done")
def test_the_command_beside_a_row_runs_that_row_to_the_bit() -> None:
    rows = rows_of()
    assert len(rows) == 2 * 2 * 3
    row = next(one for one in rows if one["law"] == "wave" and one["link"] == "loss" and one["seed"] == "1")
    assert main([*shlex.split(row["command"])[1:], "--out", "again"]) == 0
    metrics = json.loads(Path("again/summary.json").read_text())["metrics"]
    stored = {name.split(" ")[0]: value for name, value in row.items()}
    assert {name: repr(one["value"]) for name, one in metrics.items()} == {name: stored[name] for name in metrics}


@pytest.mark.usefixtures("done")
def test_the_table_fits_the_terminal_and_json_is_one_document_with_every_figure_of_each_law(
        capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    compare()
    wide = capsys.readouterr().out
    assert max(map(len, wide.splitlines()[:6])) <= 120
    assert [line.split()[0] for line in wide.splitlines()[4:6]] == ["wave", "direct"]
    assert "tracking error" in wide
    monkeypatch.setattr("teleop.studies.compare.command._width", lambda: 60)
    compare()
    narrow = capsys.readouterr().out
    assert max(map(len, narrow.split("best first")[0].splitlines()[1:])) <= 60
    assert narrow.count("\nlaw ") >= 2  # the table in two parts
    compare("--json")
    document = json.loads(capsys.readouterr().out)
    assert document == {**json.loads(Path("runs/small/summary.json").read_text()), "path": "runs/small"}
    assert [law["law"] for law in document["laws"]] == ["wave", "direct"]
    assert document["laws"][0]["figures"]["x_err_rms"]["value"] > 0.0
    assert document["laws"][0]["ended"] == {"ok": 4}


@pytest.mark.usefixtures("empty")
def test_an_interrupt_leaves_what_it_has_and_the_same_command_goes_on(
        monkeypatch: pytest.MonkeyPatch, capsys: Capture, compared: Path) -> None:
    ran: list[Any] = []

    def once(job: CaseBatch) -> list[dict[str, Any]]:
        if ran:
            raise KeyboardInterrupt
        ran.append(job)
        return run_batch(job)

    monkeypatch.setattr(command_module, "run_batch", once)
    assert compare() == 130
    assert "interrupted: the same command goes on" in capsys.readouterr().out
    assert len(rows_of()) == 3  # wave in tissue
    monkeypatch.setattr(command_module, "run_batch", run_batch)
    assert compare() == 0
    assert rows_of() == rows_of(str(compared / "runs/small"))


@pytest.mark.usefixtures("done")
def test_another_comparison_is_not_mixed_into_the_folder_and_a_refused_one_writes_none(capsys: Capture) -> None:
    Path("small.toml").write_text(SMALL.replace("0.3)", "0.2)"))
    assert compare() == 2
    assert "holds another" in capsys.readouterr().err
    Path("small.toml").write_text(SMALL.replace("soft_tissue", "soft_tisue"))
    shutil.rmtree("runs")
    assert compare() == 2
    assert not Path("runs").exists()


@pytest.mark.full
@pytest.mark.usefixtures("empty")
def test_a_law_of_the_users_own_stands_in_the_table_and_figures_are_drawn_one_a_question(capsys: Capture) -> None:
    pytest.importorskip("matplotlib")
    example = Path(__file__).parents[4] / "scenarios" / "examples" / "law.py"
    Path("law_mine.py").write_text(example.read_text())
    assert main(["compare", "small.toml", "--laws", "law_mine.py", "--workers", "1", "--plot", "--format", "svg"]) == 0
    assert "\nlaw_mine " in capsys.readouterr().out
    assert {"status", "wall"} <= {path.stem for path in Path("runs/small").glob("*.svg")}


def test_a_swing_that_stays_at_the_wall_or_a_motion_that_law_and_link_feed_is_not_ok_though_nothing_diverged() -> None:
    unsettled = (load_scene("hard_wall", law="direct", link="delay(0.05)", timeout=None, duration=3.5),
                 load_scene("soft_tissue", law="direct", link="delay(0.1)", duration=4.0))
    for result in map(run, unsettled):
        assert result.status == "ok"
        assert ending_of(result)[0] == "unsettled", result.scene
    assert ending_of(run(load_scene("hard_wall", link="delay(0.05)", duration=3.5))) == ("ok", "")


@pytest.mark.full
@pytest.mark.usefixtures("empty")
def test_tuned_laws_run_everywhere_with_what_tune_finds_for_each_link(capsys: Capture) -> None:
    assert compare("--tuned", "8", "--json") == 0
    assert json.loads(capsys.readouterr().out)["tuned"] == 8
    fixed = {"x_limit": 0.3, "duration": 0.4, "link": "delay(0.01)"}
    best = LawSearch(SearchJob("soft_tissue", "wave", 8, fixed=fixed, engine="plain")).run().best
    row = next(one for one in rows_of() if (one["law"], one["link"], one["environment"]) == ("wave", "10 ms", "free"))
    assert all(f"--set {name}={value}" in row["command"] for name, value in best.items())


@pytest.mark.usefixtures("done")
def test_the_gain_margin_of_a_case_is_that_of_its_scene() -> None:
    margins = {(one["law"], one["environment"], one["link"]): one["gain_margin (1)"] for one in rows_of()}
    scene = load_scene("soft_tissue", law="direct", link="delay(0.01)", duration=0.4)
    assert float(margins["direct", "tissue", "10 ms"]) == margin(scene).gain
    assert margins["direct", "tissue", "loss"] == ""  # no constant delay


def test_the_name_of_a_scene_compares_laws_in_it_in_the_units_of_its_axes(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    """Six joints in rad. Each law breaks its condition on every joint, which is told once, with what to type."""
    monkeypatch.chdir(tmp_path)
    assert main(["compare", "leader_follower", "--laws", "four_channel", "--workers", "1"]) == 0
    out = capsys.readouterr().out
    head, units = (line.split() for line in out.splitlines()[2:4])
    assert head[:5] == ["ok", "osc", "div", "track", "force"]
    assert "mrad    N m     %" in out.splitlines()[3]
    assert units[0] == "law"
    assert " mm" not in out
    sentences = " ".join(out.split())
    assert sentences.count("passive between equal ends") == 1
    assert "(and shoulder, elbow, forearm, wrist and flange, with their own numbers)" in sentences
    document = json.loads(Path("runs/leader_follower/summary.json").read_text())
    assert document["axis_units"] == ["rad"]
    assert document["columns"]["felt_drag"]["unit"] == "N m s/rad"
    assert "x_err_rms (rad)" in rows_of("runs/leader_follower")[0]
    assert main(["report", "runs/leader_follower"]) == 0
    assert "mrad    N m     %" in capsys.readouterr().out


def test_figures_over_axes_in_m_and_in_rad_have_no_unit_and_say_why(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["compare", "pose", "--laws", "wave", "--workers", "1"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "slave against the master of one delay ago, rms, over axes in m and in rad" in out
    assert "its wall feels 46 % of a rigid rod's force every row" in out  # no drag: none is known
    assert {"x_err_rms", "f_err_rms", "E_port_min (J)"} <= set(rows_of("runs/pose")[0])
