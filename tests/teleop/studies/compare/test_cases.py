"""A comparison's file: what it says is what is run, and what is wrong in it is said with its table and key."""

from __future__ import annotations

from pathlib import Path

import pytest

from teleop import Direct, Refused, Wave, find_law, load_scene
from teleop.law import known_laws
from teleop.studies.compare.cases import BUILT_IN, cases_of, read_comparison

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
