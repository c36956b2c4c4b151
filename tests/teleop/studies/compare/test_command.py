"""`teleop compare`: what is asked, the rows, the table and its words, the files, and going on after an interrupt."""

from __future__ import annotations

import csv
import json
import shlex
import shutil
from math import inf, isnan
from pathlib import Path
from typing import Any

import pytest

import teleop.studies.compare.command as command_module
from teleop import Direct, Refused, Wave, find_law, load_scene, run
from teleop.__main__ import main
from teleop.law import known_laws
from teleop.studies.compare.cases import BUILT_IN, cases_of, read_comparison
from teleop.studies.compare.command import CaseBatch, ending_of, run_batch
from teleop.studies.compare.figures import BY_KEY, endings, held_back_laws, judge_laws, ranking, rankings, text
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


def row(law: str, link: str, seed: int, ended: str = "ok", place: str = "wall", **figures: float) -> dict[str, Any]:
    return {"law": law, "link": link, "environment": place, "seed": seed, "ended": ended, **figures}


def test_a_law_that_fails_where_it_is_hard_is_not_the_better_for_it() -> None:
    rows = [row("frail", "near", 0, x_err_rms=0.001), row("frail", "far", 0, "diverged", x_err_rms=0.0),
            row("frail", "lost", 0, "unsettled", x_err_rms=0.0),
            *[row("firm", link, 0, x_err_rms=0.005) for link in ("near", "far", "lost")]]
    found = judge_laws(rows, ["frail", "firm"])
    assert [one.figures["x_err_rms"].failed for one in found] == [True, False]
    ranked = ranking(BY_KEY["x_err_rms"], found)
    assert ranked.groups == ((("firm", 0.005),),)
    assert ranked.failed == ("frail",)


def test_laws_closer_than_their_spread_over_seeds_tie_and_without_dice_those_within_one_percent() -> None:
    """Half the force of the rod is as far from it as double."""
    cases: tuple[tuple[str, str, dict[str, tuple[float, ...]], list[list[str]]], ...] = (
        ("x_err_rms", "loss", {"c": (0.0110, 0.0111), "b": (0.0104, 0.0106), "a": (0.01, 0.0104)}, [["a", "b"], ["c"]]),
        ("jerk_rms", "delay", {"a": (100.0,), "b": (100.9,), "c": (102.0,)}, [["a", "b"], ["c"]]),
        ("wall_late", "delay", {"off": (0.5,), "hard": (2.0,), "near": (1.1,)}, [["near"], ["off", "hard"]]))
    for key, link, laws, expected in cases:
        rows = [row(law, link, seed, **{key: value}) for law, values in laws.items()
                for seed, value in enumerate(values)]
        groups = ranking(BY_KEY[key], judge_laws(rows, [*laws])).groups
        assert [[name for name, _ in group] for group in groups] == expected, key


def test_a_row_without_dice_counts_for_every_seed() -> None:
    rows = [row("a", "delay", 0, x_err_rms=0.001), *[row("a", "loss", seed, x_err_rms=0.002 + 0.001 * seed)
                                                    for seed in range(3)]]
    told = judge_laws(rows, ["a"])[0].figures["x_err_rms"]
    assert told.value == pytest.approx(0.003)  # of two cases the worse one is the median
    assert told.spread == pytest.approx(0.002)


def test_drag_counts_where_nothing_is_touched_and_force_where_something_is() -> None:
    rows = [row("a", "delay", 0, place="free", felt_drag=1.0, x_err_rms=0.001),
            row("a", "delay", 0, felt_drag=9.0, wall_late=0.9, x_err_rms=0.003)]
    figures = judge_laws(rows, ["a"])[0].figures
    assert figures["felt_drag"].value == 1.0
    assert figures["wall_late"].value == 0.9
    assert isnan(figures["felt_share"].value)


def test_a_case_ends_as_the_worst_of_its_seeds() -> None:
    rows = [row("a", "loss", 0), row("a", "loss", 1, "limit cycle"), row("a", "loss", 2, "unsettled")]
    assert endings(rows) == {("wall", "loss"): "limit cycle"}


def test_a_law_that_tracks_because_the_wall_is_hardly_touched_is_named() -> None:
    rows = [row("drag", "delay", 0, x_err_rms=0.001, wall_late=0.2), row("good", "delay", 0, x_err_rms=0.002,
            wall_late=0.9), row("slow", "delay", 0, x_err_rms=0.01, wall_late=0.1)]
    found = judge_laws(rows, ["drag", "good", "slow"])
    assert [one.law for one in held_back_laws(found)] == ["drag"]
    assert {one.column.key for one in rankings(found)} == {"x_err_rms", "wall_late"}


def test_a_margin_is_that_of_the_loop_whatever_its_runs_came_to_and_none_is_as_good_as_an_infinite_one() -> None:
    rows = [row("a", "delay", 0, "diverged", gain_margin=0.5), row("b", "delay", 0, gain_margin=3.0),
            row("c", "delay", 0, gain_margin=inf), row("d", "delay", 0)]
    ranked = ranking(BY_KEY["gain_margin"], judge_laws(rows, ["a", "b", "c", "d"]))
    assert ranked.groups == ((("c", inf),), (("b", 3.0),), (("a", 0.5),))
    assert ranked.failed == ()


def test_laws_that_tie_from_both_sides_of_the_rod_are_told_with_the_value_of_each() -> None:
    peaks = {"soft": 0.8, "hard": 1.25, "also soft": 0.5, "softer": 0.499}
    rows = [row(law, "delay", 0, wall_late=1.0, wall_peak=peak) for law, peak in peaks.items()]
    found = judge_laws(rows, [*peaks])
    told = text(found, rankings(found), [], "")
    assert "peak force on the wall  soft 80.0 = hard 125, also soft = softer 50.0 %" in told


GOOD = """
seeds = 2
laws = ["direct", "wave"]
set = {x_limit = 0.3}

[[link]]
name = "10 ms"
link = "delay(0.01)"

[[link]]
name = "loss"
link = "delay(0.01) | bernoulli(0.3)"
set = {playout = "zero"}

[[environment]]
name = "free"
scene = "free_motion"
set = {duration = 0.05}
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "mine.toml"
    path.write_text(text)
    return path


def test_each_law_meets_each_link_with_every_seed_where_the_link_has_dice_and_is_typed_whole(tmp_path: Path) -> None:
    cases = cases_of(read_comparison(written(tmp_path, GOOD)), "mine.toml")
    assert cases[1].command(1) == (
        "teleop run free_motion --set x_limit=0.3 --set duration=0.05 --set playout=zero --set law=direct "
        "--link 'delay(0.01) | bernoulli(0.3)' --seed 1")
    assert [(case.law, case.link, case.seeds) for case in cases] == [
        ("direct", "10 ms", (0,)), ("direct", "loss", (0, 1)), ("wave", "10 ms", (0,)), ("wave", "loss", (0, 1))]


def test_the_built_in_file_has_every_law_with_two_ends_and_makes_scenes_of_all() -> None:
    asked = read_comparison(BUILT_IN)
    assert [law.name for law in asked.laws] == sorted(name for name in known_laws() if hasattr(find_law(name), "slave"))
    one = read_comparison(BUILT_IN, ["direct"])
    assert len(cases_of(one, "compare.toml")) == len(one.links) * len(one.environments) == 72


def test_a_law_has_the_same_numbers_in_every_scene_or_knobs_or_stages_of_its_own(tmp_path: Path) -> None:
    """Its name alone keeps the gains of the scene `hard_wall`, and the others' are defaults."""
    text = GOOD.replace('scene = "free_motion"', 'scene = "hard_wall"')
    cases = cases_of(read_comparison(written(tmp_path, text)), "mine.toml")
    laws = [load_scene(case.scene, **case.knobs).law for case in cases[::2]]
    assert laws == [Direct(), Wave()]
    assert "--set 'law=wave()'" in cases[-1].command(0)
    text = GOOD + '\n[[law]]\nname = "soft wave"\nlaw = "wave"\nset = {b = 1.5}\n'
    cases = cases_of(read_comparison(written(tmp_path, text)), "mine.toml")
    assert [case.law for case in cases[::2]] == ["direct", "wave", "soft wave"]
    assert cases[-1].knobs["law.b"] == 1.5
    assert "--set law=wave --set law.b=1.5" in cases[-1].command(0)
    texts = ["wave", "deadband(0.1) | wave", "guard() | deadband(0.1, floor=1e-3) | wave"]
    comparison = read_comparison(written(tmp_path, GOOD), texts)
    assert [law.name for law in comparison.laws] == ["wave", "deadband(0.1) | wave", "guard | deadband | wave"]
    assert [law.text for law in comparison.laws] == texts


WRONG = (
    ("seeds = 2", "seeds = 0", "mine.toml: seeds must be at least 1"),
    ("seeds = 2", "seeds = [1, 1]", "names 1 twice"),
    ("seeds = 2", "sead = 2", "mine.toml has no key 'sead'; did you mean seeds?"),
    ("seeds = 2", "fitted = 1", "fitted is true or false, not 1"),
    ("seeds = 2", "seeds = ", "cannot be read"),
    ('laws = ["direct", "wave"]', 'laws = "wave"', "laws is a list of at least one law"),
    ('laws = ["direct", "wave"]', 'laws = ["drect"]', "there is no law 'drect'; did you mean direct?"),
    ('laws = ["direct", "wave"]', 'laws = ["wave", "wave"]', "two laws called 'wave'"),
    ('name = "loss"', 'name = "10 ms"', "two links called '10 ms'"),
    ('name = "loss"', 'name = ""', "[[link]] 2 of mine.toml ()"),
    ('name = "loss"', 'nam = "loss"', "[[link]] 2 of mine.toml has no key 'nam'; did you mean name?"),
    ('link = "delay(0.01)"\n', "", "[[link]] 1 of mine.toml (10 ms) has no link; write link = \"delay(0.05)\""),
    ('link = "delay(0.01)"', 'link = "dealy(0.01)"', "link '10 ms', environment 'free'"),
    ("playout = \"zero\"", "duration = 2.0", "both set duration; leave one of them out"),
    ("playout = \"zero\"", "law = \"pfra\"", "link 'loss' sets law, which has tables of its own"),
    ("duration = 0.05", "durtion = 0.05", "no knob 'durtion'; did you mean duration?"),
    ("duration = 0.05", "duration = -1.0", "duration must be above 0 s, not -1"),
    ('scene = "free_motion"', 'scene = "virtual_wall"', "(law 'direct', link '10 ms', environment 'free')"),
    ("[[environment]]", "[[environments]]", "no key 'environments'; did you mean environment?"),
    (GOOD, "seeds = 1", "mine.toml has no link; write [[link]]"),
)


def test_what_is_wrong_is_said_with_its_table_and_key(tmp_path: Path) -> None:
    for old, new, sentence in WRONG:
        assert old in GOOD
        with pytest.raises(Refused) as refused:
            cases_of(read_comparison(written(tmp_path, GOOD.replace(old, new, 1))), "mine.toml")
        assert sentence in str(refused.value), new


def test_a_link_finds_the_files_that_lie_beside_the_comparison(tmp_path: Path) -> None:
    text = GOOD.replace("delay(0.01) | bernoulli(0.3)", "mahimahi('{folder}/up.txt')")
    (tmp_path / "up.txt").write_text("1\n2\n5\n")
    case = cases_of(read_comparison(written(tmp_path, text)), "mine.toml")[1]
    assert case.knobs["link"] == f"mahimahi('{tmp_path}/up.txt')"
