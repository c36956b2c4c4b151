"""A run's folder is there whole or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest

from teleop import Refused
from teleop.folder import new_folder, numbered


class TestNumbered:
    def test_is_the_first_number_that_is_free(self, tmp_path: Path) -> None:
        assert numbered(tmp_path / "not yet", "run") == tmp_path / "not yet" / "run-1"
        for taken in ("run-1", "run-3", "other-2"):
            (tmp_path / taken).mkdir()
        assert numbered(tmp_path, "run") == tmp_path / "run-2"

    def test_leaves_a_run_that_is_just_being_written_its_number(self, tmp_path: Path) -> None:
        with new_folder(tmp_path / "run-1"):
            assert numbered(tmp_path, "run") == tmp_path / "run-2"
            with new_folder(numbered(tmp_path, "run")):
                assert numbered(tmp_path, "run") == tmp_path / "run-3"
        assert sorted(path.name for path in tmp_path.iterdir()) == ["run-1", "run-2"]


class TestNewFolder:
    @staticmethod
    def fail_in(folder: Path, trouble: type[BaseException] | None, theirs: Path | None = None) -> None:
        """Write into the new folder while others make `theirs`, then come to grief."""
        with new_folder(folder) as inside:
            (inside / "file").write_text("x")
            if theirs is not None:
                theirs.mkdir(parents=True)
            if trouble is not None:
                raise trouble

    def test_appears_when_all_is_written(self, tmp_path: Path) -> None:
        folder = tmp_path / "a" / "b"
        with new_folder(folder) as inside:
            (inside / "file").write_text("x")
            assert not folder.exists()
        assert [path.name for path in folder.iterdir()] == ["file"]
        assert [path.name for path in folder.parent.iterdir()] == ["b"]

    @pytest.mark.parametrize("trouble", [KeyboardInterrupt, ZeroDivisionError, Refused])
    def test_leaves_nothing_when_it_goes_wrong(self, tmp_path: Path, trouble: type[BaseException]) -> None:
        with pytest.raises(trouble):
            self.fail_in(tmp_path / "a" / "b", trouble)
        assert not list(tmp_path.iterdir())

    def test_leaves_the_parents_that_were_there_or_that_others_use(self, tmp_path: Path) -> None:
        (tmp_path / "a").mkdir()
        with pytest.raises(KeyboardInterrupt):
            self.fail_in(tmp_path / "a" / "b" / "c", KeyboardInterrupt, theirs=tmp_path / "a" / "b" / "another")
        assert (tmp_path / "a" / "b" / "another").is_dir()
        with pytest.raises(KeyboardInterrupt):
            self.fail_in(tmp_path / "a" / "d" / "e", KeyboardInterrupt)
        assert [path.name for path in (tmp_path / "a").iterdir()] == ["b"]

    def test_turns_what_the_system_refuses_into_a_sentence(self, tmp_path: Path) -> None:
        with pytest.raises(Refused, match="No space left"), new_folder(tmp_path / "a"):
            raise OSError(28, "No space left on device")

    @pytest.mark.parametrize("kind", ["folder", "file", "dangling link"])
    def test_never_takes_what_is_there(self, tmp_path: Path, kind: str) -> None:
        there = tmp_path / "there"
        make = {"folder": there.mkdir, "file": there.touch, "dangling link": lambda: there.symlink_to("nowhere")}
        make[kind]()
        with pytest.raises(Refused, match="there already"), new_folder(there):
            pytest.fail("it was taken")
        assert [path.name for path in tmp_path.iterdir()] == ["there"]

    def test_does_not_replace_what_came_meanwhile(self, tmp_path: Path) -> None:
        folder = tmp_path / "run"
        with pytest.raises(Refused, match="could not write"):
            self.fail_in(folder, None, theirs=folder / "theirs")
        assert [path.name for path in folder.iterdir()] == ["theirs"]
        assert [path.name for path in tmp_path.iterdir()] == ["run"]
