"""What a comparison asks and what is said of laws: failing is never better than working, within a spread is a tie."""

from __future__ import annotations

from math import inf, isnan
from pathlib import Path
from typing import Any

import pytest

from teleop import Direct, Refused, Wave, find_law, load_scene
from teleop.law import known_laws
from teleop.studies.compare.cases import BUILT_IN, cases_of, read_comparison
from teleop.studies.compare.figures import BY_KEY, endings, held_back_laws, judge_laws, ranking, rankings, text


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
