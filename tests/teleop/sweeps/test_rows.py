"""Rows made ready: what a row takes over from one that was worked out before, and what not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from channel.delay import Delay
from slave.wall import Wall
from teleop import Refused, Wave, load_scene
from teleop.scene.library import scene_function
from teleop.scene.loading import SceneMaker
from teleop.sweeps.chunk import Job, work
from teleop.sweeps.rows import RowMaker, same
from tests.programs import compiler_of

MEASURES = ("x_err_rms", "f_err_max", "f_env_max", "E_link_min")
FIXED = {"duration": 0.2, "link": "delay(0.02) | bernoulli(0.05)"}
KNOBS: list[dict[str, Any]] = [  # one after another, each with another part changed, and back again
    {"k_e": 5e3}, {"k_e": 6e3}, {"k_e": 6e3, "d_e": 7.0}, {"k_e": 0.0, "d_e": 0.0}, {"k_e": 5e3},
    {"law.K": 400.0}, {"law": "pfra"}, {"law": "wave"}, {"law": "wave", "k_e": 1e3}, {"law": "pfra", "k_e": 1e3},
    {"amplitude": 0.04}, {"k_h": 100.0}, {"k_h": 100.0, "k_e": 2e3}, {"link": "delay(0.01)"},
    {"link": "delay(0.01)", "k_e": 2e3}, {"observer": 100.0}, {"observer": None}, {"energy": False}, {"dt": 0.002},
    {"duration": 0.1}, {"wall": -0.0}, {"wall": 0.0}, {"k_e": -1.0}, {"k_e": 5e3},
]


def job(knobs: list[dict[str, Any]], engine: str) -> Job:
    return Job("canonical", {}, [(i, {**FIXED, **own}, 1) for i, own in enumerate(knobs)], MEASURES, engine)


ALIKE = [own for own in KNOBS if not {"law", "energy", "observer"} & own.keys()]  # all run by one kernel


@pytest.mark.parametrize(("engine", "given"), [("plain", KNOBS), ("c", ALIKE), *[
    pytest.param(engine, KNOBS, marks=pytest.mark.full) for engine in ("c", "vector")]],
    ids=["plain", "c, of one law", "c", "vector"])
def test_a_row_is_what_it_is_alone_whatever_rows_came_before_it(engine: str, given: list[dict[str, Any]]) -> None:
    compiler_of(engine)
    # Rows of one job have the same knobs: each has all of them here.
    every = dict.fromkeys(name for own in given for name in own)
    default = {"k_e": 5e3, "d_e": 5.0, "law": "wave", "law.K": 500.0, "amplitude": 0.05, "k_h": 200.0,
               "observer": 200.0, "energy": True, "dt": 1e-3, "wall": 0.03, **FIXED}
    rows = [{name: {**default, **own}[name] for name in every} for own in given]
    rows = [row if row.get("law", "wave") == "wave" else {**row, "law.K": 30.0} for row in rows]
    done = work(job(rows, engine))
    assert given is KNOBS or {*done.ran} == {(engine, "")}
    together = done.rows
    alone = [{**work(job([row], "plain")).rows[0], "row": i} for i, row in enumerate(rows)]
    assert together == alone
    assert {row["status"] for row in together} >= {"ok", "refused"}


def test_rows_that_differ_in_a_wall_alone_share_all_but_its_numbers() -> None:
    maker = RowMaker("canonical", {"duration": 0.02}, MEASURES, "plain")
    for k_e in (1e3, 2e3, 3e3):
        maker.add({}, {"k_e": k_e}, 0)
    group, = maker.groups
    first, second, third = group.rows
    assert first.path is second.path is third.path
    assert first.schedules is second.schedules is third.schedules
    assert len({str(ready.tree[-1].c_s) for ready in group.rows}) == 3
    assert first.tree[:-1] == second.tree[:-1] == third.tree[:-1]


def test_knobs_that_rows_share_are_read_once_and_those_that_differ_in_every_row() -> None:
    function = scene_function("canonical")
    maker = SceneMaker(function, "canonical", {"duration": "0.3", "law.K": 400.0, "link": "delay(0.01)", "x_limit": 5})
    for k_e in (1e3, "2e3", 3):
        scene = maker.scene({"k_e": k_e})
        assert scene == load_scene(
            "canonical", **{"duration": 0.3, "law.K": 400.0, "link": "delay(0.01)", "x_limit": 5.0, "k_e": k_e})
        assert scene.knobs["k_e"] == float(k_e)
    for wrong, why in ((-1.0, "k_e must be at least 0 N/m"), ("soft", "k_e must be a number"), (True, "k_e")):
        with pytest.raises(Refused, match=why):
            maker.scene({"k_e": wrong})
    for law in ("wave", Wave(K=1.0)):  # the shared K is that of any law
        assert maker.scene({"law": law}).law.K == 400.0


def test_same_is_to_the_bit() -> None:
    assert same(Wall(k=1.0, at=0.0), Wall(k=1.0, at=0.0))
    assert not same(Wall(k=1.0, at=0.0), Wall(k=1.0, at=-0.0))
    assert not same(1, True)
    assert not same(1, 1.0)
    assert not same(float("nan"), float("nan"))
    assert same((1.0, None, "a"), (1.0, None, "a"))
    assert same(Wave(), Wave())
    assert not same(Delay(0.1), Delay(0.2))


def test_a_part_that_may_change_is_never_the_same() -> None:
    class Soft:
        k = 1.0

    soft = Soft()
    assert not same(soft, soft)
    assert not same([1.0], [1.0])


def test_a_scene_that_changes_an_object_of_its_own_from_row_to_row_gets_what_it_changed(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        "from dataclasses import replace\n"
        "from scenarios.canonical import scene as canonical\n"
        "from slave.wall import Wall\n"
        "class Mine:\n    k = 0.0\n    def plant(self, body, dt):\n        return Wall(k=self.k).plant(body, dt)\n"
        "MINE = Mine()\n"
        "def scene(*, k: float = 1e3, duration: float = 0.3):\n    MINE.k = k\n"
        "    return replace(canonical(duration=duration), environment=MINE)\n")
    rows = [(i, {"k": k}, 0) for i, k in enumerate((1e3, 5e3, 1e4))]
    found = work(Job(str(tmp_path / "mine.py"), {}, rows, ("f_env_max",), "plain")).rows
    assert len({row["f_env_max"] for row in found}) == 3
