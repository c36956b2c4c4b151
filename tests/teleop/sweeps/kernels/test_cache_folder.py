"""The cache of compiled kernels holds libraries: what another user may have put there is never loaded."""

from __future__ import annotations

import os
import shutil
import stat
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from teleop.scene.library import ROOT
from teleop.sweeps.kernels import cache_folder
from teleop.sweeps.kernels.cache_folder import KernelsNotKept, made_private, open_to_others, tell_once
from tests.programs import COMPILERS, program

pytestmark = pytest.mark.skipif(not hasattr(os, "geteuid"), reason="files have no owner there")
KERNELS = "bilateral-teleop/kernels"


@pytest.fixture
def place() -> Iterator[Path]:
    """A folder that other users may enter, as they may not those of `tmp_path`."""
    folder = Path(tempfile.mkdtemp())
    folder.chmod(0o755)
    yield folder
    shutil.rmtree(folder)


def made(folder: Path) -> Path:
    """A cache folder with a kernel, as this package makes it."""
    made_private(folder / KERNELS)
    (folder / KERNELS / "teleop_kernel_c_1.so").write_text("")
    return folder / KERNELS


def of_another_user(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let `path` belong to a user who is neither this one nor root."""
    if os.geteuid() == 0:
        os.chown(path, 12345, -1, follow_symlinks=False)
    else:
        monkeypatch.setattr(os, "geteuid", lambda: 12345)


class TestAFolder:
    def test_of_ones_own_is_private_and_made_use_of_whatever_a_wide_umask_left_in_it_also_where_only_owners_remove(
        self, place: Path
    ) -> None:
        kernels = made(place / "cache")
        assert [stat.S_IMODE(each.stat().st_mode) for each in (kernels, kernels.parent)] == [0o700, 0o700]
        for folder, mode in ((kernels, 0o700), (place / "cache", 0o1777), (kernels, 0o775)):
            folder.chmod(mode)
            assert open_to_others(kernels, "teleop_kernel_") is None
        (kernels / "teleop_kernel_c_1.so").chmod(0o664)
        assert open_to_others(kernels, "teleop_kernel_") is None, "no other user may enter the folder above"

    def test_that_others_may_write_to_or_below_such_a_one_is_not(self, place: Path) -> None:
        kernels = made(place / "cache")
        for folder in (kernels.parent, place / "cache"):
            folder.chmod(0o755)
        for mode in (0o777, 0o775, 0o757, 0o1777):
            kernels.chmod(mode)
            assert f"others may write to {kernels} (mode {mode:o})" in str(open_to_others(kernels))
        kernels.chmod(0o755)
        (place / "cache").chmod(0o777)
        assert f"others may write to {place / 'cache'}" in str(open_to_others(kernels))

    @pytest.mark.parametrize("which", [".", "..", "teleop_kernel_c_1.so"])
    def test_of_another_user_or_with_a_file_of_theirs_is_not(
        self, which: str, place: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        kernels = made(place)
        of_another_user((kernels / which).resolve(), monkeypatch)
        assert "belongs to another user" in str(open_to_others(kernels, "teleop_kernel_"))

    def test_with_a_file_that_others_may_write_to_or_that_is_a_link_is_not(self, place: Path) -> None:
        kernels = made(place)
        for each in (kernels, kernels.parent):
            each.chmod(0o755)
        (kernels / "teleop_kernel_c_1.so").chmod(0o666)
        assert "others may write to" in str(open_to_others(kernels, "teleop_kernel_"))
        (kernels / "teleop_kernel_c_1.so").unlink()
        (kernels / "teleop_kernel_c_1.so").symlink_to("/etc/hostname")
        assert "is a link" in str(open_to_others(kernels, "teleop_kernel_"))

    def test_that_a_link_leads_to_is_looked_at_where_it_is_and_where_the_link_is(self, place: Path) -> None:
        made(place / "real")
        (place / "open").mkdir()
        (place / "open" / "cache").symlink_to(place / "real")
        through = place / "open" / "cache" / KERNELS
        assert open_to_others(through) is None
        (place / "open").chmod(0o777)
        assert f"others may write to {place / 'open'}" in str(open_to_others(through))
        (place / "open").chmod(0o755)
        (place / "real").chmod(0o777)
        assert f"others may write to {place / 'open' / 'cache'}" in str(open_to_others(through))
        assert f"others may write to {place / 'real'}" in str(open_to_others(place / "real" / KERNELS))


def test_that_kernels_are_not_kept_is_told_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache_folder, "_warned", set())
    with pytest.warns(KernelsNotKept, match="each process compiles its own: because"):
        tell_once("because")
    with warnings.catch_warnings(record=True) as told:
        tell_once("because")
    assert told == []


PAYLOAD = """
#include <stdio.h>
__attribute__((constructor)) static void load(void) {{ fclose(fopen("{path}", "w")); }}
"""


def payload(path: Path, library: Path) -> None:
    """Put a library that makes a file when it is loaded in the place of another."""
    library.unlink()  # one that is loaded is not written to
    subprocess.run([program(*COMPILERS), "-shared", "-fPIC", "-x", "c", "-", "-o", str(library)], check=True, text=True,
                   input=PAYLOAD.format(path=path))


SMALL = """
from dataclasses import replace
from scenarios.virtual_wall import scene as wall

def scene(*, k: float = 1e3):
    return replace(wall(k=k), energy=False, duration=0.05)
"""


SWEEPS = """
import os, sys
import teleop.sweeps.kernels.c_kernel
from teleop.__main__ import main
for out in map(str.strip, sys.stdin):
    if not os.fork():  # with all imported that takes long, and no kernel yet
        sys.stdout, sys.stderr = open(os.devnull, "w"), open(f"{out}.err", "w")
        code = main(["sweep", "small.py", "--grid", "k=1e3,2e3", "--metrics", "f_m_max", "--engine", "c",
                     "--json", "--out", out])
        sys.stderr.close()
        os._exit(code)
    print(os.wait()[1], flush=True)
"""


class TestASweep:
    @pytest.fixture
    def swept(self, place: Path) -> Iterator[Callable[..., str]]:
        """`swept(OUT)`: run a small sweep by compiled code, whose cache is `cache` there, and give its stderr."""
        program(*COMPILERS)
        (place / "small.py").write_text(SMALL)
        started: list[subprocess.Popen[str]] = []

        def sweep(out: str, **env: str) -> str:
            if not started:
                started.append(subprocess.Popen(
                    [sys.executable, "-c", SWEEPS], cwd=place, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                    env={**os.environ, "PYTHONPATH": str(ROOT), "XDG_CACHE_HOME": str(place / "cache"), **env}))
            stdin, stdout = started[0].stdin, started[0].stdout
            assert stdin is not None
            print(out, file=stdin, flush=True)
            assert stdout.readline() == "0\n"
            return (place / f"{out}.err").read_text()

        yield sweep
        for process in started:
            process.communicate()

    def test_loads_no_library_of_a_cache_that_others_may_write_to(self, swept: Callable[..., str], place: Path) -> None:
        assert swept("own") == ""
        library, = (place / "cache").rglob("*.so")
        payload(place / "loaded", library)
        swept("control")
        assert (place / "loaded").exists()  # so it goes with a cache that is trusted
        (place / "loaded").unlink()
        (place / "cache").chmod(0o777)
        err = swept("other")
        assert not (place / "loaded").exists()
        assert err.startswith("teleop: compiled kernels are not kept")
        assert err.count("\n") == 1
        rows = [sorted((place / out / "rows.jsonl").read_bytes().splitlines()) for out in ("own", "other")]
        assert rows[0] == rows[1]
