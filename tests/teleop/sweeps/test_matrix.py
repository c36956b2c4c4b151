"""The delay-scenario matrix: how its file is read, what its rows are, and what the command says of them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from teleop import Refused, load_scene, run
from teleop.scene.library import ROOT
from teleop.sweeps.matrix import BUILT_IN, MatrixBlock, Row, read_matrix, run_block, run_matrix, summary, table

FULL = """
[[block]]
scene = "soft_tissue"
laws = ["wave", "direct"]
delays = [0, 0.01, 0.05]
losses = [0.0, 0.1]
seeds = [1, 2]
set = {duration = 0.2, x_limit = 0.3, k_e = 500}
expect = "ok"
why = "the rule"
[[block.except]]
laws = ["direct"]
delays = {from = 0.01}
expect = "diverged"
why = "late"
[[block.except]]
laws = ["direct"]
losses = 0.1
delays = [0.05]
seeds = {to = 1}
expect = "ok"
why = "the last that fits"
"""
SMALL = """
[[block]]
name = "at_rest"
scene = "free_motion"
laws = ["wave", "direct"]
delays = [0.0, 0.02]
set = {duration = 0.05}
expect = "ok"
why = "nothing has moved yet"
[[block]]
scene = "local"
laws = ["pfra"]
set = {law.alpha = 0.5, duration = 1.0, x_limit = 1e-3}
expect = "ok"
why = "a hope"
"""
BLOCK = """
[[block]]
scene = "soft_tissue"
laws = ["wave"]
delays = [0.0, 0.1]
expect = "ok"
why = "passive"
"""

Written = Callable[[str], tuple[MatrixBlock, ...]]


@pytest.fixture
def written(tmp_path: Path) -> Written:
    def read(text: str) -> tuple[MatrixBlock, ...]:
        (tmp_path / "m.toml").write_text(text)
        return read_matrix(tmp_path / "m.toml")

    return read


class TestABlock:
    def test_crosses_its_lists_and_names_each_row_but_for_what_it_leaves_to_the_scene(self, written: Written) -> None:
        block, = written(FULL)
        rows = block.rows()
        assert len(rows) == 24
        assert [row.id for row in rows][:3] == [
            "soft_tissue-wave-0ms-0%-seed1", "soft_tissue-wave-0ms-0%-seed2", "soft_tissue-wave-0ms-10%-seed1"]
        assert rows[-1] == Row("soft_tissue-direct-50ms-10%-seed2", "direct", 0.05, 0.1, 2, "diverged", "late")
        at_rest, local = written(SMALL)
        assert [row.id for row in at_rest.rows()] == [
            "at_rest-wave-0ms", "at_rest-wave-20ms", "at_rest-direct-0ms", "at_rest-direct-20ms"]
        assert [row.id for row in local.rows()] == ["local-pfra"]
        assert local.fixed["law.alpha"] == 0.5

    def test_expects_what_the_last_exception_says_that_fits(self, written: Written) -> None:
        block, = written(FULL)
        said = {row.id.removeprefix("soft_tissue-"): row.why for row in block.rows() if row.why != "the rule"}
        late = {f"direct-{delay}-{loss}-{seed}": "late" for delay in ("10ms", "50ms") for loss in ("0%", "10%")
                for seed in ("seed1", "seed2")}
        assert said == {**late, "direct-50ms-10%-seed1": "the last that fits"}

    def test_runs_each_row_as_the_run_that_it_names(self, written: Written) -> None:
        block, = written(FULL)
        for outcome in run_block(block):
            row = outcome.row
            link = f"delay({row.delay})" + (f" | bernoulli({row.loss})" if row.loss else "")
            single = run(load_scene("soft_tissue", law=row.law, link=link, **block.fixed), seed=row.seed)
            assert (outcome.status, outcome.ticks) == (single.status, single.ticks)
            assert outcome.figures["x_err_max"] == single.metrics["x_err_max"]

    @pytest.mark.parametrize(("status", "good"), [("limit cycle", 1), ("unstable", 0)])
    def test_may_expect_a_limit_cycle(self, status: str, good: int, written: Written) -> None:
        block, = written(BLOCK.replace("soft_tissue", "hard_wall").replace("wave", "direct").replace("0.0, ", "")
                         .replace('"ok"', f'"{status}"'))
        outcome, = run_block(block)
        assert (outcome.status, outcome.as_expected) == ("limit cycle", bool(good))
        assert "came limit cycle: stayed within" in outcome.line()

    def test_without_losses_keeps_the_scenes_own_link(self, written: Written) -> None:
        block, = written(BLOCK.replace("soft_tissue", "jittery_wan") + "seeds = 3\nset = {duration = 0.2}")
        for outcome in run_block(block):
            single = run(load_scene("jittery_wan", delay=outcome.row.delay, duration=0.2), seed=3)
            assert outcome.figures["x_err_max"] == single.metrics["x_err_max"]


class TestWhatIsSaid:
    def test_counts_by_block_and_has_a_line_for_each_surprise(self, written: Written) -> None:
        blocks, shown = written(SMALL), list[tuple[int, int]]()
        came = run_matrix(blocks, show=lambda done, of: shown.append((done, of)))
        assert shown == sorted(shown)
        assert shown[-1] == (5, 5)
        lines = table(blocks, came).splitlines()
        assert [line.split() for line in lines[1:4]] == [
            ["at_rest", "free_motion", "4", "4"], ["local", "local", "1", "0"], ["in", "all", "5", "4"]]
        assert lines[4] == "1 of 5 rows not as expected:"
        assert len(lines) == 6
        assert lines[5] == ("local-pfra: expected ok (a hope), came diverged: was not finite or passed x_limit = "
                            "0.001 m in 715 ticks, x_err_max 0.000156, f_m_max 0")

    def test_can_be_held_by_json(self, written: Written) -> None:
        blocks = written(SMALL)
        told = json.loads(json.dumps(summary(blocks, run_matrix(blocks)), allow_nan=False))
        assert (told["rows"], told["as_expected"], len(told["unexpected"])) == (5, 4, 1)
        assert told["outcomes"][-1]["status"] == "diverged"
        assert told["blocks"][1] == {"name": "local", "scene": "local", "rows": 1, "as_expected": 0}


WRONG = {
    "no TOML": ("[[block]\n", ["cannot be read", "[[block]]"]),
    "nothing": ("", ["has no blocks", "[[block]]"]),
    "something else": ("[tool]\nx = 1", ["'tool'", "[[block]]"]),
    "one table": ('[block]\nscene = "local"', ["[[block]]"]),
    "unknown scene": (BLOCK.replace("soft_tissue", "soft_tisue"), ["soft_tisue", "did you mean soft_tissue?"]),
    "unknown law": (BLOCK.replace('"wave"', '"wave", "wavee"'), ["wavee", "did you mean wave"]),
    "a law that does not fit": (BLOCK.replace('"wave"', '"virtual_wall"'), ["virtual_wall", "one-port"]),
    "unknown key": (BLOCK + "delay = 0.1", ["'delay'", "did you mean delays?"]),
    "a knob beside the keys": (BLOCK + "k_e = 1.0", ["'k_e'", "set = {...}"]),
    "unknown knob": (BLOCK + "set = {stiffness = 1.0}", ["block 'soft_tissue'", "no knob 'stiffness'"]),
    "a knob twice": (BLOCK + "set = {delay = 1.0}", ["delay is an axis", "leave one of them out"]),
    "no scene": (BLOCK.replace("scene =", "name ="), ["has no scene", 'write scene = "soft_tissue"']),
    "no laws": (BLOCK.replace("laws =", "seeds =").replace('"wave"', "1"), ["has no laws", 'laws = ["wave"]']),
    "no expect": (BLOCK.replace('expect = "ok"', ""), ["has no expect", 'write expect = "ok"']),
    "no why": (BLOCK.replace('why = "passive"', ""), ["has no why"]),
    "another status": (BLOCK.replace('"ok"', '"stable"'), ["'stable'", 'expect = "ok"']),
    "negative delay": (BLOCK.replace("0.0", "-0.1"), ["delays must be at least 0, not -0.1"]),
    "a loss of packets above all": (BLOCK + "losses = [1.5]", ["losses must be at most 1, not 1.5"]),
    "half a seed": (BLOCK + "seeds = [0.5]", ["seeds must be a whole number"]),
    "a value twice": (BLOCK.replace("0.1", "0"), ["delays names 0.0 twice"]),
    "an empty list": (BLOCK.replace('["wave"]', "[]"), ["laws is empty"]),
    "losses alone": (BLOCK.replace("delays", "losses"), ["losses and no delays", "delays = [0.0]"]),
    "a name for a folder": (BLOCK + 'name = "../x"', ["'../x'", 'name = "soft_tissue"']),
    "two blocks of one name": (BLOCK + BLOCK, ["'soft_tissue'", 'name = "soft_tissue_2"']),
    "an exception without expect": (BLOCK + '[[block.except]]\nwhy = "x"', ["exception 1", "has no expect"]),
    "an exception without why": (BLOCK + '[[block.except]]\nexpect = "ok"', ["exception 1", "has no why"]),
    "an exception of nothing": (BLOCK + '[[block.except]]\ndelays = {from = 1}\nexpect = "ok"\nwhy = "x"',
                                ["picks none of the block's delays", "0.0, 0.1"]),
    "an exception of another law": (BLOCK + '[[block.except]]\nlaws = "pfra"\nexpect = "ok"\nwhy = "x"',
                                    ["'pfra'", "there are: wave"]),
    "an exception of seeds that are not listed": (BLOCK + '[[block.except]]\nseeds = 1\nexpect = "ok"\nwhy = "x"',
                                                  ["block's seeds", "none"]),
    "an exception with a misspelt range": (BLOCK + '[[block.except]]\ndelays = {form = 1}\nexpect = "ok"\nwhy = "x"',
                                           ["'form'", "did you mean from?"]),
}


def test_a_wrong_file_is_refused_in_one_sentence(written: Written) -> None:
    for case, (text, words) in WRONG.items():
        with pytest.raises(Refused) as refused:
            pytest.fail(f"{case}: {written(text)}")
        assert [word for word in words if word not in str(refused.value)] == [], case


class TestTheCommand:
    def test_is_done_whatever_came_and_keeps_the_rows_and_goes_on_where_it_is_told_to(
        self, tmp_path: Path, typed: Callable[..., Any]
    ) -> None:
        (tmp_path / "m.toml").write_text(SMALL)
        got = typed("matrix", "m.toml")
        assert got.code == 0, got.err
        assert "1 of 5 rows not as expected:" in got.out
        assert [path.name for path in tmp_path.iterdir()] == ["m.toml"]
        first = typed("matrix", "m.toml", "--json", "--out", "kept")
        kept = tmp_path / "kept" / "at_rest" / "rows.jsonl"
        lines = kept.read_text().splitlines()
        assert len(lines) == 4
        kept.write_text("".join(line.replace('"ok"', '"diverged"') + "\n" for line in lines))  # what no run would give
        again = typed("matrix", "m.toml", "--json", "--out", "kept")
        assert json.loads(first.out)["as_expected"] == 4
        assert json.loads(again.out)["as_expected"] == 0

    def test_has_a_matrix_of_its_own_beside_the_scenes(self) -> None:
        assert BUILT_IN.parent == ROOT / "scenarios"
        assert BUILT_IN.is_file()
