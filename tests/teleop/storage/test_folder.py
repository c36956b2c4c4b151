"""A run's folder is claimed by one process, and there whole or not at all."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from teleop import Refused
from teleop.scene.library import ROOT
from teleop.storage.folder import PART, claim, is_being_written, new_folder, numbered


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


class TestAClaim:
    def test_takes_a_name_that_is_free_or_the_first_number_that_is(self, tmp_path: Path) -> None:
        assert next(numbered(tmp_path / "not yet", "run")) == tmp_path / "not yet" / "run-1"
        assert [str(claim(None, "x").path) for _ in range(3)] == ["runs/x-1", "runs/x-2", "runs/x-3"]
        shutil.rmtree("runs/x-2")
        numbers = numbered(Path("runs"), "x")
        assert [next(numbers).name for _ in range(2)] == ["x-2", "x-4"]
        assert claim("x").path == Path("x")
        for name, sentence in (("x", "x is there already; give another folder with --out, or remove it"),
                               ("a\0b", "cannot write to"), ("\udc80\ud800", "cannot write to")):
            with pytest.raises(Refused, match=sentence):
                claim(name)

    def test_that_is_dropped_takes_the_parents_that_it_made_with_it_and_no_others(self, tmp_path: Path) -> None:
        first, second = claim("a/b/first"), claim("a/b/second")
        second.drop()
        assert Path("a/b/first").is_dir()
        first.drop()
        assert list(tmp_path.iterdir()) == []
        Path("a").mkdir()
        claim("a/b").drop()
        assert Path("a").is_dir()

    def test_that_is_dropped_leaves_a_folder_of_that_name_that_another_process_made_since(self) -> None:
        ours = claim("x")
        shutil.rmtree("x")
        Path("x").mkdir()
        Path("x/record.bin").write_text("theirs")
        ours.drop()
        assert Path("x/record.bin").read_text() == "theirs"

    def test_comes_through_while_others_remove_its_parents(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """A run that is refused removes the `runs` that it made, just when another one wants to write there."""
        make, removed = Path.mkdir, []

        def mkdir(path: Path, *args: int) -> None:
            if path == Path("runs/x-1") and len(removed) < 3:
                removed.append(path)
                Path("runs").rmdir()
            make(path, *args)

        monkeypatch.setattr(Path, "mkdir", mkdir)
        assert claim(None, "x").path == Path("runs/x-1")


class TestTwoAtOnce:
    """The loser of two that started at once on one name deleted the winner's record: 270 of 1,500."""

    @staticmethod
    def beaten(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
        """Have another process make `name`, with a record in it, just before this one does."""
        make = Path.mkdir

        def mkdir(path: Path, *args: int) -> None:
            if path == Path(name) and not path.exists():
                make(path, *args)
                (path / "record.bin").write_text("the winner's")
            make(path, *args)

        monkeypatch.setattr(Path, "mkdir", mkdir)

    def test_the_loser_is_refused_or_takes_the_next_number_and_leaves_the_record_of_the_winner(
            self, monkeypatch: pytest.MonkeyPatch) -> None:
        with monkeypatch.context() as patch:
            self.beaten(patch, "x")
            with pytest.raises(Refused, match="x is there already"), new_folder("x"):
                pytest.fail("it was taken")
        assert names(Path("x")) == ["record.bin"]
        self.beaten(monkeypatch, "runs/x-1")
        with suppress(KeyboardInterrupt), new_folder(None, "x") as new:
            assert new.path == Path("runs/x-2")
            raise KeyboardInterrupt
        assert [str(path) for path in sorted(Path("runs").glob("**/*"))] == ["runs/x-1", "runs/x-1/record.bin"]

    CHILD = """
import sys
from teleop.errors import Refused
from teleop.storage.folder import claim, new_folder
from teleop.live.records.record import fresh_folder

for turn in sys.stdin:  # all start at the same line
    how, name = turn.split()
    out = None if how == "numbered" else name
    try:
        if how == "claim":
            made = claim(out)
            (made.path / "of").write_text(sys.argv[1])
            made.close()
        else:
            with fresh_folder(out, name) if how == "live" else new_folder(out, name) as made:
                (getattr(made, "inside", made.path) / "of").write_text(sys.argv[1])
                how == "live" and made.keep()
        answer = str(made.path)
    except Refused as refused:
        answer = "refused" if "is there already" in str(refused) else str(refused)
    print(answer, flush=True)
"""

    def test_of_many_processes_one_gets_the_name_and_no_record_is_lost(self) -> None:
        turns = [(how, f"{how}{i}") for i in range(15) for how in ("claim", "live", "new")]
        turns += [("numbered", "x")] * 10
        children = [subprocess.Popen(
            [sys.executable, "-c", self.CHILD, str(i)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
            env={**os.environ, "PYTHONPATH": str(ROOT)}) for i in range(6)]
        try:
            for turn in turns:
                self.take(children, *turn)
        finally:
            for child in children:
                child.kill()
                child.communicate()
        assert sorted(path.name for path in Path("runs").iterdir()) == sorted(f"x-{i + 1}" for i in range(60))
        assert list(Path().glob(f"**/{PART}")) == []

    @staticmethod
    def take(children: list[subprocess.Popen[str]], how: str, name: str) -> None:
        for child in children:
            assert child.stdin is not None
            child.stdin.write(f"{how} {name}\n")
            child.stdin.flush()
        answers = [child.stdout.readline().strip() for child in children if child.stdout is not None]
        if how == "numbered":
            assert len({*answers}) == len(children), answers
            assert [(Path(path) / "of").read_text() for path in answers] == [str(i) for i in range(len(children))]
        else:
            assert sorted(answers) == sorted([name, *["refused"] * (len(children) - 1)])
            assert (Path(name) / "of").read_text() == str(answers.index(name))


class TestANewFolder:
    @staticmethod
    def fail_in(folder: Path, trouble: type[BaseException] | None, theirs: Path | None = None) -> None:
        """Write into the new folder while others make `theirs`, then come to grief."""
        with new_folder(folder) as new:
            (new.inside / "file").write_text("x")
            if theirs is not None:
                theirs.mkdir(parents=True)
            if trouble is not None:
                raise trouble

    def test_is_whole_when_all_is_written_with_its_summary_after_all_else(
            self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        moved, rename, folder = [], Path.rename, tmp_path / "a" / "b"
        monkeypatch.setattr(Path, "rename", lambda path, to: (moved.append(path.name), rename(path, to))[1])
        with new_folder(folder) as new:
            assert new.path == folder
            for name in ("summary.json", "trace.npz", "a.png"):
                (new.inside / name).write_text("x")
            assert names(folder) == [PART]
            with pytest.raises(Refused, match=r"there already, not whole: another process writes it, or was killed"):
                claim(folder)
        assert names(folder) == sorted(moved) == ["a.png", "summary.json", "trace.npz"]
        assert moved[-1] == "summary.json"
        assert names(folder.parent) == ["b"]

    def test_leaves_nothing_when_it_goes_wrong(self, tmp_path: Path) -> None:
        for trouble in (KeyboardInterrupt, ZeroDivisionError, Refused):
            with pytest.raises(trouble):
                self.fail_in(tmp_path / "a" / "b", trouble)
            assert not list(tmp_path.iterdir())
        with pytest.raises(Refused, match="No space left"), new_folder(tmp_path / "a"):
            raise OSError(28, "No space left on device")
        assert not list(tmp_path.iterdir())

    def test_leaves_nothing_when_it_is_interrupted_between_two_files(self, tmp_path: Path,
            monkeypatch: pytest.MonkeyPatch) -> None:
        rename, count = Path.rename, []

        def interrupted(path: Path, to: Path) -> Path:
            count.append(path)
            if len(count) == 2:
                raise KeyboardInterrupt
            return rename(path, to)

        monkeypatch.setattr(Path, "rename", interrupted)
        with suppress(KeyboardInterrupt), new_folder(tmp_path / "a") as new:
            for name in ("one", "two", "three"):
                (new.inside / name).write_text("x")
        assert len(count) == 2
        assert not list(tmp_path.iterdir())

    def test_leaves_the_parents_that_were_there_or_that_others_use(self, tmp_path: Path) -> None:
        (tmp_path / "a").mkdir()
        with pytest.raises(KeyboardInterrupt):
            self.fail_in(tmp_path / "a" / "b" / "c", KeyboardInterrupt, theirs=tmp_path / "a" / "b" / "another")
        assert (tmp_path / "a" / "b" / "another").is_dir()
        with pytest.raises(KeyboardInterrupt):
            self.fail_in(tmp_path / "a" / "d" / "e", KeyboardInterrupt)
        assert names(tmp_path / "a") == ["b"]

    def test_never_takes_what_is_there(self, tmp_path: Path) -> None:
        (tmp_path / "folder").mkdir()
        (tmp_path / "file").touch()
        (tmp_path / "link").symlink_to("nowhere")
        for name in ("folder", "file", "link"):
            with pytest.raises(Refused, match="there already"), new_folder(tmp_path / name):
                pytest.fail("it was taken")
        assert names(tmp_path) == ["file", "folder", "link"]

    def test_leaves_what_another_process_has_written_into_it(self, tmp_path: Path) -> None:
        folder = tmp_path / "run"
        with pytest.raises(Refused, match=r"another process has written theirs into .*run meanwhile"):
            self.fail_in(folder, None, theirs=folder / "theirs")
        assert (names(folder), names(tmp_path)) == (["theirs"], ["run"])


def test_a_claim_holds_on_to_its_folder_until_it_is_closed() -> None:
    """Otherwise the next folder may get the same number of the file system, and would be taken for this one."""
    ours = claim("x")
    was = Path("x").stat().st_ino
    shutil.rmtree("x")
    for i in range(20):
        Path(f"y{i}").mkdir()
        assert Path(f"y{i}").stat().st_ino != was
    ours.close()


def test_who_asks_whether_a_folder_is_being_written_leaves_no_file_open() -> None:
    """It would hold a lock too: whoever claims the folder then would not be seen to write."""

    def next_file() -> int:
        file = os.open(".", os.O_RDONLY)
        os.close(file)
        return file

    claimed = claim("x")
    before = next_file()
    assert is_being_written(Path("x"))
    claimed.close()
    free = next_file()
    assert not is_being_written(Path("x"))
    assert (next_file(), free) == (free, min(free, before))
