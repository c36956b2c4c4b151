"""The lock on a device: one end at a time, whoever else is on the machine, and in whatever network."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from teleop.errors import Refused
from teleop.live.devices import device_watchdog
from teleop.live.devices.device_watchdog import lock_folder, take_lock
from teleop.scene.library import ROOT
from tests.live.namespaces import machine

TAKES = """
import os, sys
from teleop.errors import Refused
from teleop.live.devices import device_watchdog
device_watchdog.WAIT_S = 0.1
try:
    device_watchdog.take_lock(sys.argv[1], os.getpid())
except Refused as refused:
    print(refused, flush=True)
else:
    print("taken", flush=True)
    sys.stdin.read()
"""
Start = Callable[..., subprocess.Popen[str]]


@pytest.fixture
def runtime(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of the user's own, named as the session's."""
    path = tmp_path / "runtime"
    path.mkdir(mode=0o700)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(path))
    monkeypatch.setattr(device_watchdog, "WAIT_S", 0.1)
    return path


@pytest.fixture
def process(runtime: Path) -> Iterator[Start]:
    """`process("arm")`: one that takes the lock on that device, and has said what came of it when this returns."""
    started: list[subprocess.Popen[str]] = []

    def start(device: str, popen: Callable[..., subprocess.Popen[str]] | None = None) -> subprocess.Popen[str]:
        words = [sys.executable, "-c", TAKES, device]
        how = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE,
               "env": {**os.environ, "PYTHONPATH": str(ROOT), "XDG_RUNTIME_DIR": str(runtime)}}
        if popen is None:
            started.append(subprocess.Popen([sys.executable, *words[1:]], text=True, **how))
        else:
            started.append(popen(*words, **how))
        return started[-1]

    yield start
    for one in started:
        one.kill()
        one.communicate()


def says(one: subprocess.Popen[str]) -> str:
    assert one.stdout is not None
    return one.stdout.readline().strip()


def test_a_device_is_taken_by_one_process_and_free_again_when_that_is_killed(process: Start) -> None:
    first = process("arm:/dev/ttyACM0")
    assert says(first) == "taken"
    assert says(process("arm:/dev/ttyACM1")) == "taken"
    assert says(process("arm:/dev/ttyACM0")) == (
        f"another end drives this device already (arm:/dev/ttyACM0), process {first.pid}; end that one first, for "
        f"example by kill {first.pid}")
    first.kill()
    first.wait()
    assert says(process("arm:/dev/ttyACM0")) == "taken"


@pytest.mark.live
def test_two_network_namespaces_did_not_exclude_each_other(process: Start) -> None:
    """Names of abstract sockets are of a network; a file is of the machine."""
    one = machine()
    try:
        other = machine(one)
        try:
            assert says(process("arm", one.start)) == "taken"
            assert says(process("arm", other.start)).startswith("another end drives this device already (arm)")
        finally:
            other.gone()
    finally:
        one.gone()


def test_the_file_is_in_a_folder_of_the_users_own_and_of_the_devices_name_and_a_link_there_is_not_followed(
    runtime: Path, tmp_path: Path
) -> None:
    held = take_lock("arm:/dev/../x y", 4711)
    assert held is not None
    (path,) = (runtime / "bilateral-teleop").iterdir()
    assert path.name.startswith("arm_dev_.._x_y-")
    assert path.read_text() == "4711\n"
    assert (path.stat().st_mode & 0o777, path.parent.stat().st_mode & 0o777) == (0o600, 0o700)
    os.close(held)
    path.unlink()
    path.symlink_to(tmp_path / "victim")
    with pytest.raises(Refused, match="cannot be opened"):
        take_lock("arm:/dev/../x y", 4711)
    assert not (tmp_path / "victim").exists()


@pytest.mark.parametrize("make", [
    lambda at: (at / "there").mkdir(mode=0o700) or (at / "bilateral-teleop").symlink_to(at / "there"),
    lambda at: (at / "bilateral-teleop").mkdir() or (at / "bilateral-teleop").chmod(0o770),
    lambda at: (at / "bilateral-teleop").write_text(""),
], ids=["a link", "open to others", "a file"])
def test_a_name_that_another_may_have_taken_first_is_refused(make: Callable[[Path], object], runtime: Path) -> None:
    make(runtime)
    with pytest.raises(Refused, match=r"is a link, of another user, or open to others; remove it .* XDG_RUNTIME_DIR"):
        take_lock("arm", 1)


def test_without_a_runtime_folder_of_ones_own_it_is_below_the_home_folder(
    runtime: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    import pwd

    class User:
        pw_dir = str(tmp_path / "home")

    monkeypatch.setattr(pwd, "getpwuid", lambda _number: User)
    runtime.chmod(0o777)
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    for value in (None, "", "relative", "/no/such/folder", str(runtime)):  # the last: open to others
        if value is not None:
            monkeypatch.setenv("XDG_RUNTIME_DIR", value)
        assert lock_folder() == tmp_path / "home" / ".cache" / "bilateral-teleop"
        assert lock_folder().stat().st_mode & 0o777 == 0o700
