"""Two ends with keys: sealed, each letting in the other and nobody else; and without keys not beyond this machine."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.live.conftest import pair_of_keys, share_received, summary

pytest.importorskip("OpenSSL")
from teleop.protocol.secure.keys import keygen  # (with the extra alone)

pytestmark = pytest.mark.live
SCENE = ["hard_wall", "--set", "duration=0.5", "--json"]


@pytest.mark.parametrize(("called", "channels"), [
    ("127.0.0.2", 1), *[pytest.param(*each, marks=pytest.mark.full) for each in (("127.0.0.2", 0), ("0.0.0.0", 0))]])
def test_two_ends_with_keys_run_sealed_also_if_the_slave_answers_from_another_address_of_its_host(
    called: str, channels: int, command: Callable[..., Any], tmp_path: Path
) -> None:
    """A slave on 0.0.0.0 does, if it is called by another address than the system would choose for an answer."""
    keys, scene = pair_of_keys(tmp_path), [*SCENE, "--link", "none"]
    slave = command("slave", *scene, "--listen", "0.0.0.0:0", *keys["slave"], "--out", str(tmp_path / "s"))
    to = f"{called}:{slave.port()}"
    for _ in range(channels):
        to = f"127.0.0.1:{command('channel', *scene, '--listen', '127.0.0.1:0', '--peer', to).port()}"
    master = command("master", *scene, "--peer", to, *keys["master"], "--out", str(tmp_path / "m"))
    for end in (master, slave):
        code, out, err = end.end()
        assert code == 0, (out, err)
    for name, folder in (("master", "m"), ("slave", "s")):
        told = summary(tmp_path / folder)
        assert told["status"] == "ok"
        assert told[name]["sealed"] is True
        assert told[name]["associations"] == 1
        assert not told["packets"]["bwd" if name == "master" else "fwd"]["rejected"]
        assert keys[name][1] in " ".join(told["command"])  # the file's name, and nothing of what is in it
        assert "PRIVATE" not in (tmp_path / folder / "summary.json").read_text()
    assert share_received(tmp_path / "m", tmp_path / "s") > 0.8
    assert share_received(tmp_path / "s", tmp_path / "m") > 0.8


@pytest.mark.parametrize("wrong", ["master", pytest.param("slave", marks=pytest.mark.full)])
def test_an_end_with_another_key_is_not_let_in(wrong: str, command: Callable[..., Any], tmp_path: Path) -> None:
    """The stranger knows the fingerprint that it should have, and has not the key to it."""
    keys = pair_of_keys(tmp_path)
    keys[wrong][1] = str(keygen(tmp_path / "stranger")[0])
    slave = command("slave", *SCENE, "--listen", "127.0.0.1:0", *keys["slave"], "--wait", "2", "--out",
                    str(tmp_path / "s"))
    master = command("master", *SCENE, "--peer", f"127.0.0.1:{slave.port()}", *keys["master"], "--wait", "2", "--out",
                     str(tmp_path / "m"))
    for end in (master, slave):
        end.refused("in 2 s")
    assert not (tmp_path / "s").exists()
    assert not (tmp_path / "m").exists()


def test_what_goes_in_the_open_all_the_same_says_so_loudly(command: Callable[..., Any], tmp_path: Path) -> None:
    slave = command("slave", *SCENE, "--link", "none", "--listen", "0.0.0.0:0", "--insecure",
                    "--out", str(tmp_path / "s"))
    master = command("master", *SCENE, "--link", "none", "--peer", f"127.0.0.1:{slave.port()}",
                     "--out", str(tmp_path / "m"))
    assert master.end()[0] == 0
    code, _, err = slave.end()
    assert code == 0
    assert "INSECURE" in err
    assert any("--insecure" in note for note in summary(tmp_path / "s")["notes"])
    assert not any("--insecure" in note for note in summary(tmp_path / "m")["notes"])
