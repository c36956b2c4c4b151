"""The example for pandas on the page does what it says, typed as it stands there."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from teleop.__main__ import main
from teleop.scene.library import ROOT

PAGE = (ROOT / "teleop" / "export" / "README.md").read_text()


def test_the_example_for_pandas_runs_as_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pandas", reason="needs the extra `test`")
    monkeypatch.chdir(tmp_path)
    shell, = re.findall(r"## pandas\n\n```sh\n(.*?)```", PAGE, re.DOTALL)
    for line in shell.splitlines():
        assert main(line.split()[1:]) == 0
    code, = re.findall(r"```py\n(.*?)```", PAGE, re.DOTALL)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "mean" in done.stdout
    ratio = float(done.stdout.rpartition(":")[2])
    assert 0.8 < ratio < 1.2  # waves: what is felt is what is touched, at rest
