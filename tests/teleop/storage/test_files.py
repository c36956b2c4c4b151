"""Files that a user names or a folder holds: what is no file is told from one before it is opened."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from pathlib import Path

import pytest

from channel import Mahimahi, PingLog
from master.recording import Recording
from teleop import Refused, load_scene
from teleop.protocol.manifest import fingerprint
from teleop.scene.library import beside
from teleop.storage.files import MOST, is_part, open_regular, read_bytes, replacing
from teleop.sweeps.cluster import digest_of
from teleop.sweeps.matrix import read_matrix

READERS: dict[str, Callable[[str], object]] = {
    "a delivery trace": Mahimahi, "a ping log": PingLog, "a hand's motion": lambda path: Recording(path=path),
    "a matrix": read_matrix, "a scene's file": load_scene, "a file that both ends compare":
    lambda path: fingerprint(Path(path)),
}


def endless(at: Path) -> None:
    with at.open("wb") as file:
        file.truncate(1 << 40)  # of zeros; it takes no room on the disk


KINDS: dict[str, tuple[Callable[[Path], object], str]] = {
    "a pipe that nothing writes into": (os.mkfifo, "it is a pipe, not a file"),
    "a device without an end": (lambda at: at.symlink_to("/dev/zero"), "it is a device, not a file"),
    "a folder": (Path.mkdir, "it is a folder, not a file"),
    "a socket": (lambda at: socket.socket(socket.AF_UNIX).bind(str(at)), "it is a socket, not a file"),
    "a file of a terabyte": (endless, "larger than 64 MB"),
}


@pytest.mark.timeout(60)
@pytest.mark.parametrize("kind", KINDS)
def test_a_recording_that_never_ends_holds_up_no_command(kind: str, tmp_path: Path) -> None:
    make, sentence = KINDS[kind]
    make(tmp_path / "s.py")
    for name, reader in READERS.items():
        with pytest.raises(Refused, match=sentence) as refused:
            reader(str(tmp_path / "s.py"))
        assert "s.py" in str(refused.value), name


@pytest.mark.timeout(20)
def test_a_pipe_beside_a_scene_is_no_module_that_it_imports(tmp_path: Path) -> None:
    (tmp_path / "scene.py").write_text("import near\n")
    os.mkfifo(tmp_path / "near.py")
    assert beside(tmp_path / "scene.py") == {}
    assert digest_of(str(tmp_path / "near.py")) is None


def test_a_file_that_grows_while_it_is_read_is_bounded_too(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(bytes(100))
    found = os.stat(tmp_path / "file")
    empty = os.stat_result((*found[:6], 0, *found[7:]))
    monkeypatch.setattr(os, "fstat", lambda _: empty)  # as it was before
    assert read_bytes(tmp_path / "file", most=100) == bytes(100)
    with pytest.raises(OSError, match="larger than 0 kB"):
        read_bytes(tmp_path / "file", most=99)


def test_a_link_is_followed_where_a_user_named_it_and_not_where_a_folder_holds_it(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"content")
    (tmp_path / "link").symlink_to("file")
    assert read_bytes(tmp_path / "link") == b"content"
    with pytest.raises(OSError, match="it is a link, not a file"):
        read_bytes(tmp_path / "link", links=False)
    with pytest.raises(OSError, match="No such file"):
        open_regular(tmp_path / "none")
    assert MOST == 64 << 20


class TestReplacing:
    def test_puts_a_file_in_the_place_of_a_link_also_at_its_own_unfinished_name_and_leaves_its_target_alone(
            self, tmp_path: Path) -> None:
        (tmp_path / "target").write_bytes(b"precious")
        for name in ("name", *[f".name.{os.getpid()}-{attempt}.part" for attempt in range(3)]):
            (tmp_path / name).symlink_to("target")
        with replacing(tmp_path / "name", settle=True) as file:
            file.write(b"new")
        assert (tmp_path / "target").read_bytes() == b"precious"
        assert not (tmp_path / "name").is_symlink()
        assert (tmp_path / "name").read_bytes() == b"new"

    def test_leaves_the_old_file_and_nothing_else_where_it_fails(self, tmp_path: Path) -> None:
        (tmp_path / "name").write_bytes(b"old")
        half: list[Path] = []

        def fail() -> None:
            with replacing(tmp_path / "name") as file:
                file.write(b"half")
                half.extend(each for each in tmp_path.iterdir() if is_part(each, "name"))
                raise RuntimeError

        with pytest.raises(RuntimeError):
            fail()
        assert len(half) == 1
        assert [path.name for path in tmp_path.iterdir()] == ["name"]
        assert (tmp_path / "name").read_bytes() == b"old"
