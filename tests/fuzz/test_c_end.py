"""A million hostile datagrams at either role of the end in C, watched for what C lets pass: `c_end.c` fires them.

The short form is a hundredth of it: `pytest -m fuzz tests/fuzz` is the whole.
"""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from tests.programs import program
from tests.scenarios.examples.compiled import compiled

SHORT, LONG = 10_000, 1_000_000
LAWS = {"pp": ["--set", "law=pp"], "wave": [], "fixed": ["--set", "playout=fixed:0.02:integral"]}


USUAL = (("slave", "wave"), ("master", "fixed"))  # each role; all six with -m full


@pytest.mark.parametrize(("role", "law", "datagrams"), [
    pytest.param(role, law, count, id=f"{role}-{law}-{name}", marks=marks)
    for role in ("slave", "master") for law in LAWS for count, name, marks in (
        (SHORT, "short", [] if (role, law) in USUAL else [pytest.mark.full]),
        (LONG, "million", [pytest.mark.fuzz, pytest.mark.timeout(3600)]))])
def test_clocks_and_echoes_of_a_datagram_overflowed(
    role: str, law: str, datagrams: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`sent_ns`, `@tick 0` and echo times of 64 bits were subtracted before they were looked at."""
    end = ("hard_wall", *LAWS[law], "--end", role[0])
    fuzzer = compiled("c_end", tmp_path, Path(__file__).with_name("c_end.c"), end=end)
    capsys.readouterr()
    words = [program(fuzzer), role, str(datagrams), "17"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr  # a sanitizer, or a force that was none
    counts = json.loads(done.stdout)
    print(f"\n{role}, {law}: {datagrams} datagrams, {counts}")
    met, received, rejected = (counts[name] for name in ("met", "received", "rejected"))
    assert met > datagrams / 4000, "sessions are begun"
    assert received > datagrams / 100, "messages are taken"
    assert rejected > datagrams / 100
    assert counts["driven"] > 0, "and a force acts"
