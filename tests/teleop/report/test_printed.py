"""A page in a real browser: it prints on two sheets at most, and its browser has nothing to say against it."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

from teleop import Result, load_scene, run
from teleop.report.of_runs import RunView, of_one, of_several
from teleop.report.page import page
from tests.programs import BROWSERS, program

pytestmark = pytest.mark.live


def printed(html: bytes, at: Path) -> tuple[int, str]:
    """The sheets of a page that is printed, and what the browser's console says."""
    (at / "page.html").write_bytes(html)
    done = subprocess.run(
        [program(*BROWSERS), "--headless=new", "--no-sandbox", "--disable-gpu", f"--user-data-dir={at / 'profile'}",
         "--enable-logging=stderr", "--v=0", "--no-pdf-header-footer", f"--print-to-pdf={at / 'page.pdf'}",
         (at / "page.html").as_uri()], capture_output=True, text=True, check=True, timeout=120)
    console = "\n".join(line for line in done.stderr.splitlines() if "CONSOLE" in line)
    return len(re.findall(rb"/Type\s*/Page\b(?!s)", (at / "page.pdf").read_bytes())), console


def told(result: Result, name: str = "here") -> RunView:
    return RunView(name, result, result.summary(["teleop", "run", result.scene]))


def test_a_run_is_printed_on_two_sheets_at_most_and_six_on_three(tmp_path: Path) -> None:
    sheets, console = printed(page([of_one(told(run(load_scene("jittery_wan", duration=3.0))))]), tmp_path)
    assert 1 <= sheets <= 2
    assert console == ""
    results = [run(load_scene("hard_wall", duration=1.0, law=law)) for law in (
        "wave", "direct", "pp", "p_d", "iss", "tdpa")]
    sheets, console = printed(page([of_several([told(each, f"run-{i}") for i, each in enumerate(results)])]), tmp_path)
    assert 1 <= sheets <= 3
    assert console == ""
