"""`teleop completion`: what each shell completes at a real terminal, and what the parser's arguments are offered."""

from __future__ import annotations

import fcntl
import json
import os
import pty
import select
import subprocess
import sys
import termios
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from teleop.completion import COMPLETERS, FOLDERS
from teleop.scene.catalogue import find, names
from teleop.terminal.commands import parser
from teleop.terminal.options import commands_of
from tests.programs import program

pytest.importorskip("argcomplete")

HANGS = 60.0  # s without a byte, after which a shell is taken to hang
START = {
    "bash": (["--norc", "-i"], "source {script}; echo READ''Y"),
    "zsh": (["-f", "-i"], "autoload -U compinit; compinit -u -D; source {script}; echo READ''Y"),
    "fish": (["--no-config", "-i"], "source {script}; echo READ''Y"),
}
COMMAND = """#!/bin/sh
[ -n "$_ARGCOMPLETE" ] && exec {python} -m teleop "$@"
echo "TYPED<$*>"
"""


def at_a_terminal(shell: str, script: str, folder: Path, keys: str) -> str:
    """Return the words that `teleop` gets of a person at a terminal of `shell` who types `keys` and a return."""
    options, setting_up = START[shell]
    interactive = [program(shell), *options]
    (folder / "script").write_text(script)
    (folder / "bin").mkdir()
    command = folder / "bin" / "teleop"
    command.write_text(COMMAND.format(python=sys.executable))
    command.chmod(0o755)
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        interactive, cwd=folder, stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True,
        preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),  # noqa: PLW1509 - without a terminal of its own it leaves
        env={"PATH": f"{folder / 'bin'}:{os.environ['PATH']}", "HOME": str(folder / "bin"), "TERM": "xterm",
             "LC_ALL": "C.UTF-8", "PS1": "$ ", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )
    os.close(theirs)
    printed = b""

    def until(what: bytes) -> None:
        nonlocal printed
        while what not in printed:
            if not select.select([ours], [], [], HANGS)[0]:
                raise AssertionError(f"{shell} printed no more than {printed!r}")
            printed += os.read(ours, 1 << 16)

    try:
        os.write(ours, setting_up.format(script=folder / "script").encode() + b"\r")
        until(b"READY")
        os.write(ours, keys.encode() + b"\r")
        until(b"TYPED<")
        until(b">\r\n")
    finally:
        process.kill()
        process.wait()
        os.close(ours)
    return printed.rpartition(b"TYPED<")[2].partition(b">")[0].decode()


LAWS = ("teleop run hard_w\t--set law=pf\t --set law.alp\t0.2", "run hard_wall --set law=pfra --set law.alpha=0.2")
SCENES = ("teleop stab\tsoft_t\t--crit\tdelay", "stability soft_tissue --critical delay")
FILES = ("teleop run my_s\t--set scale_x\t1", "run my_scene.py --set scale_x=1")


@pytest.mark.parametrize(("shell", "keys", "words"), [
    pytest.param(shell, *line, id=f"{shell}-{line[1]}", marks=[pytest.mark.full] * (shell != "bash"))
    for shell in FOLDERS for line in (LAWS, SCENES, FILES)])
def test_a_key_press_completes(shell: str, keys: str, words: str, typed: Callable[..., Any], tmp_path: Path) -> None:
    (tmp_path / "my_scene.py").write_text("def scene(): ...")
    answer = typed("completion", shell)
    assert answer.code == 0
    assert FOLDERS[shell].split(",")[0] in answer.out
    line = at_a_terminal(shell, answer.out, tmp_path, keys)
    assert " ".join(line.split()) == words


ASKED = """
import json, os, sys
from teleop.__main__ import main
from teleop.scene.catalogue import names
names()
for line in map(json.loads, sys.stdin):
    if not (child := os.fork()):
        os.environ.update(COMP_LINE=line, COMP_POINT=str(len(line)))
        main([])  # which ends the process
    assert os.waitpid(child, 0)[1] == 0
    print(json.dumps(open("offered").read()), flush=True)
"""


@pytest.fixture
def complete(tmp_path: Path) -> Iterator[Callable[[str], list[str]]]:
    """`complete(line)`: what a shell is offered at the end of a line, by a copy of one process for each."""
    process = subprocess.Popen(
        [sys.executable, "-c", ASKED], cwd=tmp_path, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        env={**os.environ, "_ARGCOMPLETE": "1", "_ARGCOMPLETE_IFS": "\n", "_ARGCOMPLETE_STDOUT_FILENAME": "offered",
             "_ARGCOMPLETE_COMP_WORDBREAKS": "\"'><;|&(", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))})
    assert process.stdin is not None
    assert process.stdout is not None
    to, back = process.stdin, process.stdout

    def ask(line: str) -> list[str]:
        to.write(json.dumps(f"teleop {line}") + "\n")
        to.flush()
        return [word.strip() for word in json.loads(back.readline()).split("\n") if word.strip()]

    yield ask
    process.communicate()
    assert process.returncode == 0


def test_what_is_offered(complete: Callable[[str], list[str]], tmp_path: Path) -> None:
    (tmp_path / "runs" / "canonical-1").mkdir(parents=True)
    assert set(commands_of(parser())) <= {*complete("")}
    assert {*names()["scenes"]} <= {*complete("run ")}
    scene = next(one for one in find("hard_wall") if one.kind == "scene").knobs
    assert {*(f"{knob}=" for knob in scene), "playout=", "law.b="} <= {*complete("run hard_wall --set ")}
    law = next(one for one in find("tdpa") if one.kind == "law").knobs
    assert complete("run hard_wall --set law=tdpa --set law.") == [f"law.{knob}=" for knob in law]
    for line, words in {
        "tune wave --scene hard_wall --set k_": ["k_e="], "demo --set k_": ["k_e="], "run hard_wall --seed ": [],
        "run hard_wall --format pd": ["pdf"], "run hard_wall --set law=tdp": ["law=tdpa"],
        "demo --set playout=inte": ["playout=integral"], "sweep canonical --grid law=pfra,tdp": ["law=pfra,tdpa"],
        "sweep canonical --metrics f_m_max,x_err_r": ["f_m_max,x_err_rms"], "compare --laws wave,dir": ["wave,direct"],
        "report runs/": ["runs/canonical-1"], "run arm --robot muj": ["mujoco"], "demo --device hap": ["haply"],
        "check robot muj": ["mujoco"],
    }.items():
        assert complete(line) == words, line
    assert {"metrics", "hard_wall", "wave", "bernoulli"} <= {*complete("list ")}


@pytest.fixture
def no_programs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A PATH with nothing on it."""
    monkeypatch.setenv("PATH", str(tmp_path))


def test_a_path_was_not_completed_on_a_machine_without_bash(
    no_programs: None, complete: Callable[[str], list[str]], tmp_path: Path  # noqa: ARG001 - before `complete`
) -> None:
    """It ended with "the system refused: No such file or directory: 'bash'"."""
    (tmp_path / "mine" / "inner").mkdir(parents=True)
    (tmp_path / "mine" / "scene.py").write_text("")
    (tmp_path / "mine" / ".hidden").write_text("")
    assert complete("run mi") == ["mine/"]
    assert complete("run mine/") == ["mine/inner/", "mine/scene.py"]
    assert complete("run mine/.h") == ["mine/.hidden"]
    assert complete("report mine/") == ["mine/inner/"]
    assert complete("run nowhere/") == []


def test_every_completer_is_that_of_an_argument() -> None:
    """A completer of an option that is gone would stand there for ever."""
    parsers = commands_of(parser())
    parsers |= {f"{name} {action}": each for name, of in parsers.items() for action, each in commands_of(of).items()}
    words = {word for name, each in parsers.items() for action in each._actions
             for word in (*action.option_strings, str(action.metavar), f"{name} {action.metavar}")}
    assert COMPLETERS.keys() - words <= {"RUN"}
