"""The examples do what they say: each runs as it stands, is short, and imports public names only."""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import scenarios.examples
from channel import check_effect
from scenarios.examples.effect import RoamingGap
from scenarios.examples.law import SmoothReflection
from scenarios.examples.stage import AlphaBeta
from teleop import BackwardDifference, Device, check_law, load_scene
from tests.engines.engines import one_lane_after_the_other
from tests.fakes import usually
from tests.teleop.stages.velocity.test_estimators import conforms

FOLDER = Path(scenarios.examples.__file__ or "").parent
EXAMPLES = sorted(path for path in FOLDER.glob("*.py") if path.name != "__init__.py")
HARD: Any = load_scene("hard_wall").law  # has the gains that are found
PRINTS = {
    "effect": r"(?: *\d+ ms a second: ok, .*\n){3}",
    "gains": rf"(?:b .* off it\n){{9}}chosen: law\.b={HARD.b:g} law\.K={HARD.K:g} law\.B={HARD.B:g}\n",
    "handover": r"law +taking .*\n(?:\w+ +0\.00\d\d +0\.00\d\d +1\.\d\d +0\.0\d{3} +0\.\d{3}\n){2}",
    "law": r"(?:.* Hz: ok, .*\n){2}.* Hz: diverged, .*\n",
    "metric": r"(?:\w+ +\d+ N/m: +[\d.]+ N within 10 ms, the hand did +[\d.]+ J\n){4}",
    "scene": r"(?: *\d+ % lost: ok, .* least E_link 0\.000 J\n){3}",
    "stage": r"(?:\w+ +[\d.]+ mm/s rms\n){3}",
}
"""What each prints; `device` is an end of a live run, and is tried in tests/live."""


def imported(path: Path) -> set[str]:
    """The modules that a file imports from."""
    nodes = list(ast.walk(ast.parse(path.read_text())))
    whole = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    return whole | {node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)}


def test_there_is_an_example_of_each_kind() -> None:
    assert {path.stem for path in EXAMPLES} == {*PRINTS, "device"}


def test_an_example_is_short_and_imports_public_names_only() -> None:
    public = {"teleop", "master", "slave", "channel"}
    for path in EXAMPLES:
        assert len(path.read_text().splitlines()) <= 60, path
        assert {name for name in imported(path) if name.partition(".")[0] in public} <= public, path


@usually("name", PRINTS, *(name for name in PRINTS if name != "gains"))  # which takes nine seconds
def test_an_example_runs_as_it_stands(name: str, tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, FOLDER / f"{name}.py"], cwd=tmp_path, capture_output=True, text=True,
                          check=False)
    assert done.returncode == 0, done.stderr
    assert re.fullmatch(PRINTS[name], done.stdout), done.stdout


def test_the_notebook_runs_from_a_run_to_a_figure(capsys: pytest.CaptureFixture[str],
                                                  monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")
    monkeypatch.setenv("MPLBACKEND", "Agg")
    cells = json.loads((FOLDER / "first.ipynb").read_text())["cells"]
    names: dict[str, Any] = {}
    for cell in cells:
        assert not cell.get("outputs"), "it is stored without results, which would go stale"
        if cell["cell_type"] == "code":
            exec("".join(cell["source"]), names)
    assert {line.get_label() for line in names["axes"].lines} >= set(names["LAWS"])
    names["plt"].close("all")
    assert "<th>status</th><td>ok: " in names["result"]._repr_html_()
    assert re.fullmatch(r"\{'ok': \d+, 'diverged': \d+\}\n", capsys.readouterr().out)


def test_law_and_effect_keep_what_every_law_and_effect_promises() -> None:
    check_law(SmoothReflection(), compiled=False)  # the script above tries the engines
    check_effect(RoamingGap(1.0, 0.1))


def test_the_estimator_keeps_the_contract_of_estimators_and_has_lanes() -> None:
    conforms(AlphaBeta())
    estimators: tuple[Any, ...] = AlphaBeta(), BackwardDifference()
    for each in estimators:
        of = replace(load_scene("canonical"), device_m=Device(velocity=each))
        assert one_lane_after_the_other(of) == {"move_wall"}
