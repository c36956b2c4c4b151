"""The coverage-guided fuzzer, each target in a process of its own, for it takes the process over."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from teleop.scene.library import ROOT
from tests.fuzz import guided

FORMS = [pytest.param(1000, id="short"),
         pytest.param(200_000, id="long", marks=[pytest.mark.fuzz, pytest.mark.timeout(3600)])]


@pytest.mark.parametrize("runs", FORMS)
@pytest.mark.parametrize("target", guided.TARGETS)
def test_no_input_that_the_fuzzer_finds_raises(
    target: str, runs: int, others: list[bytes], request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    pytest.importorskip("atheris", reason="pip install 'bilateral-teleop[fuzz]'")
    recorded = request.getfixturevalue("recorded") if target == "link" else []
    corpus = tmp_path / "corpus"
    corpus.mkdir()
    for i, data in enumerate(guided.seeds(target, others, recorded)):
        (corpus / f"{i:03}").write_bytes(data)
    done = subprocess.run(
        [sys.executable, "-m", "tests.fuzz.guided", target, str(corpus), f"-runs={runs}", "-max_len=8000", "-seed=1",
         f"-artifact_prefix={tmp_path}/"],
        cwd=ROOT, capture_output=True, text=True, check=False, timeout=3600,
    )
    found = {path.name: path.read_bytes() for path in tmp_path.glob("*-*") if path.is_file()}
    assert done.returncode == 0, (found, done.stdout[-3000:], done.stderr[-3000:])
    told = re.findall(r"Done (\d+) runs in (\d+) second", done.stderr)
    print(f"\n{target}: {told}, {re.findall(r'cov: [0-9]+ ft: [0-9]+ corp: [0-9]+', done.stderr)[-1:]}")
    assert int(told[-1][0]) >= runs


def test_datagrams_are_cut_out_of_bytes_as_they_were_joined() -> None:
    several = [(1, 0, b""), (255, 3, b"abc"), (0, 1, bytes(300))]
    assert guided.cut(guided.joined(several)) == several
    assert guided.cut(b"\x01\x02\x00\xff12") == [(1, 2, b"12")]
