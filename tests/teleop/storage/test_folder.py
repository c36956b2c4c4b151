"""A run's folder is claimed by one process, and there whole or not at all."""

from __future__ import annotations

import os
import shutil
from contextlib import suppress
from pathlib import Path

import pytest

from teleop import Refused
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

    def test_that_is_dropped_takes_the_parents_that_it_made_and_nothing_that_another_process_made(
            self, tmp_path: Path) -> None:
        first, second = claim("a/b/first"), claim("a/b/second")
        second.drop()
        assert Path("a/b/first").is_dir()
        first.drop()
        assert list(tmp_path.iterdir()) == []
        Path("a").mkdir()
        ours = claim("a/b")
        shutil.rmtree("a/b")
        Path("a/b").mkdir()
        ours.drop()
        assert Path("a/b").is_dir(), "it has the name of ours, and is another"
        claim("a/c").drop()
        assert names(Path("a")) == ["b"]

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


def test_the_loser_of_two_that_started_at_once_deleted_the_record_of_the_winner(
        monkeypatch: pytest.MonkeyPatch) -> None:
    """Race of two starts: 270 of 1,500 pairs did. One is refused, or takes the next number."""
    make = Path.mkdir

    def mkdir(path: Path, *args: int) -> None:
        """Another process makes these, with a record in them, just before this one does."""
        if str(path) in ("x", "runs/x-1") and not path.exists():
            make(path, *args)
            (path / "record.bin").write_text("the winner's")
        make(path, *args)

    monkeypatch.setattr(Path, "mkdir", mkdir)
    with pytest.raises(Refused, match="x is there already"), new_folder("x"):
        pytest.fail("it was taken")
    assert names(Path("x")) == ["record.bin"]
    with suppress(KeyboardInterrupt), new_folder(None, "x") as new:
        assert new.path == Path("runs/x-2")
        raise KeyboardInterrupt
    assert [str(path) for path in sorted(Path("runs").glob("**/*"))] == ["runs/x-1", "runs/x-1/record.bin"]


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

    def test_leaves_nothing_when_it_goes_wrong_or_is_interrupted_between_two_files(
            self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        for trouble in (KeyboardInterrupt, ZeroDivisionError, Refused):
            with pytest.raises(trouble):
                self.fail_in(tmp_path / "a" / "b", trouble)
            assert not list(tmp_path.iterdir())
        with pytest.raises(Refused, match="No space left"), new_folder(tmp_path / "a"):
            raise OSError(28, "No space left on device")
        assert not list(tmp_path.iterdir())
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

    def test_never_takes_what_is_there_and_leaves_what_another_process_has_written_into_it(
            self, tmp_path: Path) -> None:
        (tmp_path / "folder").mkdir()
        (tmp_path / "file").touch()
        (tmp_path / "link").symlink_to("nowhere")
        for name in ("folder", "file", "link"):
            with pytest.raises(Refused, match="there already"), new_folder(tmp_path / name):
                pytest.fail("it was taken")
        with pytest.raises(Refused, match=r"another process has written theirs into .*run meanwhile"):
            self.fail_in(tmp_path / "run", None, theirs=tmp_path / "run" / "theirs")
        assert (names(tmp_path / "run"), names(tmp_path)) == (["theirs"], ["file", "folder", "link", "run"])


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
