"""The pages are true: what they say can be typed, runs, links to, names and draws."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import pytest

from teleop import load_scene
from teleop.scene.library import built_in_scenes
from teleop.terminal.commands import parser
from teleop.terminal.options import knobs_from

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = ("teleop", "master", "slave", "channel", "scenarios", "tests")
PAGES = sorted([*ROOT.glob("*.md"), *(page for folder in FOLDERS for page in (ROOT / folder).rglob("*.md"))])
LONGEST = 220  # lines of the first page: the rest is in the folders
PRINTS = {
    "README.md": (r"(?:.* s: ok with .*\n){3}",),
    "teleop/laws/README.md": (r"0\.0[0-4]\d+\n",),  # m of error: the law follows, it does not run away
    "teleop/simulation/README.md": (r"(?:.* s: ok with .*\n){3}",),
    "scenarios/README.md": ("", r"31\.79 mm, 1\.658 mm, -17\.6 mJ\n"),
    "teleop/sweeps/README.md": (r"[\d.e-]+ \{'ok': 12\}\n",),
}
"""What the Python of each page prints, a pattern for each block."""


def name(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(), re.DOTALL)


def typed(page: Path, program: str) -> Iterator[list[str]]:
    """The words behind each call of `program` in a page's blocks of shell."""
    for block in blocks(page, "sh"):
        for line in block.splitlines():
            for part in re.split(r"\s&&\s", line):
                words = shlex.split(part, comments=True)
                if words and words[0].endswith(program):
                    yield words[1:]


def test_the_first_page_is_short() -> None:
    assert len((ROOT / "README.md").read_text().splitlines()) <= LONGEST


def test_the_first_page_moves_and_is_light_enough_for_a_phone() -> None:
    picture = ROOT / ".figures" / "page.webp"
    assert f"]({picture.relative_to(ROOT)})" in (ROOT / "README.md").read_text().partition("## ")[0]
    data = picture.read_bytes()
    assert len(data) < 300_000
    assert data[8:12] == b"WEBP"
    assert data.count(b"ANMF") > 1  # frames


def test_no_frame_of_the_moving_picture_shows_a_safe_state() -> None:
    """Two of its frames showed one: words in the page's red, which nothing else on it has."""
    images = pytest.importorskip("PIL.Image")
    np = pytest.importorskip("numpy")
    with images.open(ROOT / ".figures" / "page.webp") as film:
        for i in range(film.n_frames):
            film.seek(i)
            red, green, blue = np.moveaxis(np.asarray(film.convert("RGB")).astype(int), -1, 0)
            assert ((red > 130) & (green < 70) & (blue < 70))[red.shape[0] * 3 // 4:].sum() < 30, i
        assert i > 30


def test_every_command_of_a_page_can_be_typed() -> None:
    command_line, scenes = parser(), built_in_scenes()
    for page in PAGES:
        for words in typed(page, "bin/teleop"):
            arguments = command_line.parse_args(words)
            scene = getattr(arguments, "scene", None)
            if isinstance(scene, str) and not scene.endswith(".py"):
                assert scene in scenes, (page, words)
                if not any(there_later in " ".join(words) for there_later in ("law_mine.py", "recorded(", "FILE")):
                    load_scene(scene, **knobs_from(arguments))


def test_the_first_page_shows_every_kind_of_answer() -> None:
    shown = {words[0] for words in typed(ROOT / "README.md", "bin/teleop")}
    assert shown >= {"demo", "run", "report", "sweep", "precision", "stability", "passivity", "zwidth"}


def test_every_module_and_test_that_a_page_starts_exists() -> None:
    for page in PAGES:
        for words in typed(page, "bin/python"):
            if words[0] == "-m" and words[1] != "pip":
                module = ROOT.joinpath(*words[1].split("."))
                assert module.with_suffix(".py").is_file() or (module / "__main__.py").is_file(), words
            elif words[0].endswith(".py"):
                assert (ROOT / words[0]).is_file(), words
        for words in typed(page, "bin/pytest"):
            for word in words:
                assert not word.startswith("tests/") or (ROOT / word.partition("::")[0]).exists(), words


@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "python")], ids=name)
def test_the_python_of_a_page_runs(page: Path) -> None:
    told = PRINTS[name(page)]
    for block, pattern in zip(blocks(page, "python"), told, strict=True):
        done = subprocess.run([sys.executable, "-c", block], cwd=ROOT, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        assert re.fullmatch(pattern, done.stdout), done.stdout


def test_the_law_of_the_page_on_laws_goes_where_the_page_says(tmp_path: Path) -> None:
    text, = blocks(ROOT / "teleop" / "laws" / "README.md", "python")
    (tmp_path / "law_mine.py").write_text(text)
    assert load_scene("hard_wall", law=str(tmp_path / "law_mine.py"), **{"law.K": "150"}).law.K == 150.0


def test_what_a_page_links_to_and_the_files_and_rooms_that_its_tables_name_are_there() -> None:
    """A name in a table counts from the page's folder, or from the root."""
    for page in PAGES:
        text = page.read_text()
        for target in re.findall(r"\]\(([^)\s]+)\)", text):
            path, _, heading = target.partition("#")
            linked = page if not path else (page.parent / path)
            assert linked.exists(), (page, target)
            if heading:
                lines = re.findall(r"^#+ (.*)$", linked.read_text(), re.MULTILINE)
                assert heading in {re.sub(r"[^\w -]", "", line).strip().lower().replace(" ", "-")
                                   for line in lines}, (page, target)
        for line in text.splitlines() if page.name == "README.md" else ():
            if line.startswith("| "):
                for named in re.findall(r"`([\w./]+(?:\.py|\.toml|\.csv|/))`", line):
                    assert (page.parent / named).exists() or (ROOT / named).exists(), (page, named)


def test_every_top_folder_says_what_it_is() -> None:
    assert all((ROOT / folder / "README.md").is_file() for folder in FOLDERS)


def test_every_line_of_the_table_of_attackers_names_tests_that_exist() -> None:
    lines = [line for line in (ROOT / "SECURITY.md").read_text().splitlines() if line.startswith("| ")]
    rows = [cells for cells in ([cell.strip() for cell in line.strip("|").split("|")] for line in lines)
            if cells[-1] != "tests"]
    assert len(rows) > 20
    for row in rows:
        named = re.findall(r"`([^`]+)`", row[-1])
        assert named, row[0]
        assert all((ROOT / "tests" / name).exists() for name in named), row


def rooms() -> Any:
    """The module that draws the map of the rooms."""
    spec = spec_from_file_location("rooms", ROOT / ".figures" / "rooms.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_map_has_every_room_once() -> None:
    drawn = [room for floor in rooms().FLOORS for room in floor if room]
    assert len(drawn) == len(set(drawn))
    assert set(drawn) >= rooms().rooms()


@pytest.mark.house
def test_the_map_of_the_rooms_is_what_the_imports_say() -> None:
    assert rooms().drawn() == rooms().PICTURE.read_text(), "the imports have changed: python .figures/rooms.py"


def test_every_file_that_the_design_names_is_there() -> None:
    text = (ROOT / "teleop" / "DESIGN.md").read_text()
    named = re.findall(r"`((?:teleop|channel|master|slave|scenarios|tests)/[\w./]+)`", text)
    assert len(named) > 20
    assert [path for path in named if not (ROOT / path).exists()] == []
