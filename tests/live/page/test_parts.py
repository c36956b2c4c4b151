"""The parts of a page: their index as they come, and their two ends put together when it is over."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from teleop import Refused, load_result, load_scene
from teleop.live.page.session import PagePart, PageParts, size_of
from tests.live.conftest import Pair

pytestmark = pytest.mark.live
KNOBS = {"duration": "0.2"}


@pytest.fixture
def parts(tmp_path: Path) -> PageParts:
    """Three parts: a whole one, one that only the master came to, one whose master's record is another file."""
    ends = Pair(load_scene("hard_wall", duration=0.2), tmp_path / "ends", seed=1).run()
    ran = dict(zip("ms", ends.write(), strict=True))
    made = PageParts(tmp_path, {"scene": "hard_wall", "seed": 0, "command": ["teleop"]})
    for why in ("start", "turn", "again"):
        folders = made.begin(KNOBS, 0, why)
        for e in "ms" if why != "turn" else "m":
            shutil.copytree(ran[e], folders[e])
    (tmp_path / "03" / "master" / "record.bin").write_text("another file\n")
    (tmp_path / "03" / "master" / "summary.json").unlink()
    return made


def test_the_index_has_each_part_with_its_knobs_as_it_begins(tmp_path: Path) -> None:
    parts = PageParts(tmp_path, {"scene": "hard_wall", "seed": 7, "command": ["teleop", "demo"]})
    assert parts.begin({"law": "wave"}, 0, "start") == {"m": tmp_path / "01" / "master", "s": tmp_path / "01" / "slave"}
    parts.begin({"law": "pp"}, 900, "turn")
    parts.correct_start(917)
    assert json.loads((tmp_path / "page.json").read_text()) == {
        "version": 1, "scene": "hard_wall", "seed": 7, "command": ["teleop", "demo"], "parts": [
            {"folder": "01", "knobs": {"law": "wave"}, "k": 0, "why": "start"},
            {"folder": "02", "knobs": {"law": "pp"}, "k": 917, "why": "turn"}]}
    assert not parts.recorded


def test_a_part_that_cannot_be_put_together_has_its_sentence_and_the_others_go_on(parts: PageParts) -> None:
    said: list[str] = []
    [result] = parts.merge_all("hard_wall", ["teleop"], said.append, lambda: False)
    assert parts.recorded
    assert result.path == parts.folder / "01"
    assert load_result(parts.folder / "01").ticks == result.ticks > 0
    assert len(said) == 2
    assert said[0].startswith("part 02: only the master")
    assert said[1].startswith("part 03: ")


def test_ctrl_c_meanwhile_leaves_the_rest_for_later(parts: PageParts) -> None:
    said: list[str] = []
    assert parts.merge_all("hard_wall", ["teleop"], said.append, lambda: True) == []
    [sentence] = said
    assert f"teleop report {parts.folder / '01'}" in sentence


def test_the_oldest_part_goes_first_and_no_name_is_given_twice(tmp_path: Path) -> None:
    parts = PageParts(tmp_path, {"scene": "hard_wall"}, keep=size_of("10MB"))
    for i in range(3):
        for folder in parts.begin({}, 100 * i, "turn").values():
            folder.mkdir(parents=True)
            (folder / "record.bin").write_bytes(bytes(1000 * (i + 1)))
    assert parts.sizes() == [2000, 4000, 6000]
    assert parts.drop_oldest() == "01"
    assert not (tmp_path / "01").exists()
    assert parts.begin({}, 300, "turn")["m"] == tmp_path / "04" / "master"
    assert [part["folder"] for part in json.loads((tmp_path / "page.json").read_text())["parts"]] == ["02", "03", "04"]
    shutil.rmtree(tmp_path / "02")
    assert parts.drop_oldest() == "02", "a part that a person removed kept all others from being removed"


def test_a_part_that_is_over_is_measured_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A hundred parts took 70 ms of each second, in which no picture came."""
    parts, measured = PageParts(tmp_path, {"scene": "hard_wall"}), list[str]()
    for i in range(20):
        parts.begin({}, 100 * i, "turn")["m"].mkdir(parents=True)
    size = PageParts._size

    def counted(self: PageParts, part: PagePart) -> int:
        measured.append(part.folder)
        return size(self, part)

    monkeypatch.setattr(PageParts, "_size", counted)
    for i in range(3):
        (parts.newest["m"] / "record.bin").write_bytes(bytes(1000 * (i + 1)))
        assert parts.sizes() == [0] * 19 + [1000 * (i + 1)], "the newest part grows"
    assert len(measured) == 18 + 3 * 2


def test_a_size_is_read_as_it_is_typed() -> None:
    assert [size_of(typed) for typed in ("2GB", "0.5 GB", "10MB", "20000kB")] == [2e9, 5e8, 1e7, 2e7]
    for typed in ("2", "GB", "2gb", "-1GB", "nanGB", "1e999GB", "9MB", ""):
        with pytest.raises(Refused, match="a size of at least 10 MB"):
            size_of(typed)
