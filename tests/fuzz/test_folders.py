"""Whatever stands in a folder that others have sent, `teleop report` ends in a table or in one sentence.

Folders of runs, live ends, pages, sweeps, comparisons and studies are changed by bytes, by the structure of their
JSON, rows and arrays, and by what stands in place of a file. Every case ends with exit code 0 and a table, or 2 and a
sentence; in bounded memory; nothing outside of the folder is touched, and no code of the folder is run. A few dozen
cases always, hundreds with `-m full`, many with `-m fuzz`.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from teleop import load_scene, run, sweep
from teleop.__main__ import main
from teleop.live.records.merge import merge
from teleop.scene.library import ROOT
from tests.live.conftest import Pair

EACH = 25  # cases of a slice; the long form has thousands
LONG = 10_000
COMPARED = """
seeds = 1
[[link]]
name = "10 ms"
link = "delay(0.01)"
[[environment]]
name = "free"
scene = "free_motion"
set = {duration = 0.1}
[[environment]]
name = "wall"
scene = "hard_wall"
set = {duration = 0.1}
"""
EVIL = "from pathlib import Path\nPath('ran').touch()\nfrom scenarios.hard_wall import scene\n"


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Sound folders of every kind below `sound`, files that must stay as they are in `outside`, and code beside."""
    at = tmp_path_factory.mktemp("folders")
    sound = at / "sound"
    run(load_scene("jittery_wan", duration=0.1), seed=3).save(sound / "run")
    run(load_scene("recorded_reach", duration=0.1)).save(sound / "axes")
    run(load_scene("canonical", **{"law": "direct", "law.K": 1e9})).save(sound / "diverged")
    axes = {"law": ["wave", "direct"], "delay": [0.0, 0.05], "k_e": [1e2, 1e3]}
    sweep("soft_tissue", axes, fixed={"duration": 0.05}, seeds=2, engine="plain", out=sound / "sweep")
    pair = Pair(load_scene("hard_wall", duration=0.2), sound / "ends", seed=1).run()
    folders = pair.write()
    merge(pair.scene, *folders).write(sound / "ends")
    killed = sound / "killed"
    for name in ("master", "slave"):
        (killed / name).mkdir(parents=True)
        (killed / name / "record.bin").write_bytes((sound / "ends" / name / "record.bin").read_bytes())
    for e, name in (("m", "master"), ("s", "slave")):
        assert pair.shells[e].counts.ticks
        (killed / name / "events.jsonl").write_text(json.dumps({"k": 3, "what": "safe", "why": "silence"}) + "\n")
    (sound / "end").mkdir()
    (sound / "end" / "record.bin").write_bytes((sound / "ends" / "slave" / "record.bin").read_bytes())
    for part, law in (("01", "wave"), ("02", "direct")):
        run(load_scene("hard_wall", duration=0.1, law=law)).save(sound / "page" / part)
    parts = [{"folder": part, "knobs": {}, "k": 0, "why": "turn"} for part in ("01", "02")]
    (sound / "page" / "page.json").write_text(json.dumps({"version": 1, "scene": "hard_wall", "parts": parts}))
    (at / "small.toml").write_text(COMPARED)
    for words in (["compare", str(at / "small.toml"), "--laws", "wave,direct", "--workers", "1", "--out", "comparison"],
                  ["tune", "wave", "--scene", "hard_wall", "--budget", "4", "--out", "tune"],
                  ["zwidth", "virtual_wall", "--range-k", "1000:1200", "--range-b", "1:1.2", "--out", "zwidth"]):
        assert main([*words[:-1], str(sound / words[-1])]) == 0
    (at / "outside").mkdir()
    for name in ("precious", "summary.json", "trace.npz", "record.bin", "rows.jsonl", "sweep.json"):
        (at / "outside" / name).write_text("precious")
    for name in ("evil.py", "secret"):
        (at / name).write_text(EVIL)
    return at


def opened(place: Path, first: int, count: int, draw_each: int, tmp_path: Path) -> list[str]:
    """What came of the cases `first` .. in a process of their own."""
    own = tmp_path / "place"
    own.mkdir()
    shutil.copytree(place, own, dirs_exist_ok=True)
    code = "import sys; from tests.fuzz.folders import serve; serve(sys.argv[1], *map(int, sys.argv[2:]))"
    done = subprocess.run(
        [sys.executable, "-c", code, str(own), str(first), str(count), str(draw_each)],
        capture_output=True, text=True, check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT)})
    lines = done.stdout.splitlines()
    assert lines, done.stderr
    assert lines.pop() == "done", (lines[-3:], done.stderr[-2000:], done.returncode)
    return lines


def test_a_sound_folder_of_every_kind_is_opened(place: Path, tmp_path: Path) -> None:
    for sound in (place / "sound").iterdir():
        shutil.copytree(sound, tmp_path / sound.name)
        assert main(["report", str(tmp_path / sound.name), "--json"]) == 0, sound.name


@pytest.mark.full
@pytest.mark.parametrize("part", range(4))
def test_every_changed_folder_ends_in_a_table_or_in_one_sentence(part: int, place: Path, tmp_path: Path) -> None:
    assert opened(place, part * EACH, EACH, 15, tmp_path) == []


@pytest.mark.fuzz
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("part", range(4))
def test_thousands_of_changed_folders_end_in_a_table_or_in_one_sentence(part: int, place: Path, tmp_path: Path) -> None:
    assert opened(place, 10_000 + part * LONG, LONG, 40, tmp_path) == []
