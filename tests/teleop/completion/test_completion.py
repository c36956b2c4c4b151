"""`teleop completion`: what each shell makes of its script, at a real terminal, and that it has what the parser has."""

from __future__ import annotations

import fcntl
import os
import pty
import select
import subprocess
import termios
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from teleop.completion.script import KINDS, SHELLS, commands_of, script
from teleop.scene.catalogue import find, names
from teleop.terminal.commands import parser
from tests.programs import program

HANGS = 60.0  # s without a byte, after which a shell is taken to hang
START = {
    "bash": (["--norc", "-i"], "source {script}; teleop() {{ echo \"TYPED<$*>\"; }}; echo READ''Y"),
    "zsh": (["-f", "-i"], "autoload -U compinit; compinit -u -D; source {script}; "
            "teleop() {{ echo \"TYPED<$*>\" }}; echo READ''Y"),
    "fish": (["--no-config", "-i"],
             "source {script}; function teleop; echo \"TYPED<$argv>\"; end; echo READ''Y"),
}
EVERYWHERE = pytest.mark.parametrize("shell", SHELLS)


def written(folder: Path, shell: str) -> Path:
    """Write the script for `shell` into a file."""
    path = folder / f"completion.{shell}"
    path.write_text(script(shell, parser()))
    return path


def at_a_terminal(shell: str, folder: Path, keys: str) -> str:
    """The words that `teleop` gets of a person at a terminal of `shell` who types `keys` and a return."""
    options, setting_up = START[shell]
    command = [program(shell), *options]
    ours, theirs = pty.openpty()
    home = folder / "home"
    home.mkdir()
    process = subprocess.Popen(
        command, cwd=folder, stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True,
        preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),  # noqa: PLW1509 - without a terminal of its own it leaves
        env={"PATH": os.environ["PATH"], "HOME": str(home), "TERM": "xterm", "LC_ALL": "C.UTF-8", "PS1": "$ "},
    )
    os.close(theirs)
    said = b""

    def until(what: bytes) -> None:
        nonlocal said
        while what not in said:
            if not select.select([ours], [], [], HANGS)[0]:
                raise AssertionError(f"{shell} said no more than {said!r}")
            said += os.read(ours, 1 << 16)

    try:
        os.write(ours, setting_up.format(script=written(folder, shell)).encode() + b"\r")
        until(b"READY")
        os.write(ours, keys.encode() + b"\r")
        until(b"TYPED<")
        until(b">\r\n")
    finally:
        process.kill()
        process.wait()
        os.close(ours)
    return said.rpartition(b"TYPED<")[2].partition(b">")[0].decode()


@EVERYWHERE
@pytest.mark.parametrize(("keys", "words"), [
    ("teleop stab\tsoft_t\t--crit\tdelay", "stability soft_tissue --critical delay"),
    ("teleop run hard_w\t--set law=pf\t--set law.alp\t0.2 --set dela\t0.1",
     "run hard_wall --set law=pfra --set law.alpha=0.2 --set delay=0.1"),
    ("teleop demo --set play\tinte\t", "demo --set playout=integral"),
    ("teleop repor\trun\t--form\tpn\t", "report runs/swung-1 --format png"),
    ("teleop run my_s\t--set scale_x\t1", "run my_scene.py --set scale_x=1"),
    ("teleop sweep canonical --grid law=pfra,tdp\tdelay=0:1:3", "sweep canonical --grid law=pfra,tdpa delay=0:1:3"),
], ids=["commands, scenes, options", "laws and knobs", "values", "folders", "files", "several"])
def test_a_key_press_completes(shell: str, keys: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "runs" / "swung-1").mkdir(parents=True)
    (tmp_path / "my_scene.py").write_text("def scene(): ...")
    typed = at_a_terminal(shell, tmp_path, keys)
    assert " ".join(typed.split()) == words


@pytest.fixture
def complete(tmp_path: Path) -> Callable[..., list[str]]:
    """`complete(*words)`: what bash offers for the last word, its words split as bash splits them."""
    path = written(tmp_path, "bash")

    def ask(*words: str) -> list[str]:
        asked = subprocess.run(
            [program("bash"), "--norc", "-c", f"source {path}; COMP_WORDS=(teleop \"$@\"); COMP_CWORD=$#; _teleop; "
             "printf '%s\\n' \"${COMPREPLY[@]}\"", "bash", *words],
            cwd=tmp_path, check=True, capture_output=True, text=True)
        assert asked.stderr == ""
        return [line for line in asked.stdout.split("\n") if line]

    return ask


class TestWhatBashOffers:
    def test_for_nothing_every_command(self, complete: Callable[..., list[str]]) -> None:
        assert complete("") == [*commands_of(parser())]

    def test_for_a_command_all_its_options(self, complete: Callable[..., list[str]]) -> None:
        for name, each in commands_of(parser()).items():
            known = [option for action in each._actions for option in action.option_strings if option.startswith("--")]
            assert complete(name, "--") == known

    def test_for_a_scene_its_name(self, complete: Callable[..., list[str]]) -> None:
        assert complete("run", "") == [*names()["scenes"]]

    @pytest.mark.parametrize("scene", ["hard_wall", "rubber", "virtual_wall"])
    def test_for_a_knob_those_of_the_scene_and_of_its_law(
        self, complete: Callable[..., list[str]], scene: str
    ) -> None:
        offered = complete("run", scene, "--set", "")
        own = next(one for one in find(scene) if one.kind == "scene").knobs
        assert [f"{knob}=" for knob in own] == offered[:len(own)]
        assert "playout=" in offered
        assert any(knob.startswith("law.") for knob in offered)

    def test_for_a_knob_of_the_law_that_was_typed_before(self, complete: Callable[..., list[str]]) -> None:
        offered = complete("run", "hard_wall", "--set", "law", "=", "tdpa", "--set", "law.")
        law = next(one for one in find("tdpa") if one.kind == "law").knobs
        assert offered == [f"law.{knob}=" for knob in law]

    def test_for_the_scene_of_an_option_its_knobs_too(self, complete: Callable[..., list[str]]) -> None:
        assert complete("tune", "wave", "--scene", "hard_wall", "--set", "k_") == ["k_e="]
        assert complete("tune", "wave", "--scene=hard_wall", "--set", "k_") == ["k_e="]

    def test_for_a_command_with_a_scene_of_its_own_that_scenes_knobs(
        self, complete: Callable[..., list[str]]
    ) -> None:
        assert complete("demo", "--set", "k_") == ["k_e="]

    def test_nothing_for_a_number(self, complete: Callable[..., list[str]]) -> None:
        assert complete("run", "hard_wall", "--seed", "") == []

    def test_that_a_value_was_typed_in_one_word_with_its_option(self, complete: Callable[..., list[str]]) -> None:
        assert complete("run", "hard_wall", "--format", "=", "pd") == ["pdf"]
        assert complete("run", "hard_wall", "--set", "=", "law", "=", "tdp") == ["tdpa"]

    def test_names_behind_a_comma(self, complete: Callable[..., list[str]]) -> None:
        assert complete("sweep", "canonical", "--metrics", "f_m_max,x_err_r") == ["f_m_max,x_err_rms"]
        assert complete("compare", "--laws", "wave,dir") == ["wave,direct"]

    def test_runs_first_and_folders_elsewhere(self, complete: Callable[..., list[str]], tmp_path: Path) -> None:
        (tmp_path / "runs" / "canonical-1").mkdir(parents=True)
        (tmp_path / "elsewhere").mkdir()
        assert complete("report", "") == ["runs/canonical-1"]
        assert complete("report", "else") == ["elsewhere"]

    def test_for_a_device_or_a_robot_those_there_are(self, complete: Callable[..., list[str]]) -> None:
        assert complete("run", "arm", "--robot", "mu") == ["mujoco"]
        assert complete("demo", "--device", "ha") == ["haply"]
        assert complete("check", "robot", "mu") == ["mujoco"]

    def test_kinds_and_names_of_what_can_be_listed(self, complete: Callable[..., list[str]]) -> None:
        assert {"metrics", "hard_wall", "wave", "bernoulli"} <= {*complete("list", "")}


@EVERYWHERE
def test_the_script_is_printed_whole_and_says_where_it_belongs(typed: Callable[..., Any], shell: str) -> None:
    answer = typed("completion", shell)
    assert answer.code == 0
    assert answer.out == script(shell, parser())
    assert "# To have it: " in answer.out


def test_another_shell_is_refused_with_those_there_are(typed: Callable[..., Any]) -> None:
    typed("completion", "tcsh").assert_refused("there is no shell 'tcsh'")


def test_every_kind_that_is_named_is_one_of_an_argument() -> None:
    """What is left of an option that is gone would stand there for ever."""
    told = {word for name, each in commands_of(parser()).items() for action in each._actions
            for word in (*action.option_strings, str(action.metavar), f"{name} {action.metavar}")}
    assert KINDS.keys() - told <= {"RUN"}


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_words_that_a_shell_would_read_as_orders_are_only_words(shell: str, tmp_path: Path) -> None:
    added = parser()
    commands_of(added)["run"].add_argument("--odd", metavar="N", help="it's `touch ran` $(touch ran) \"so\"")
    path = tmp_path / "odd.sh"
    path.write_text(script(shell, added))
    ask = f"source {path} 2>/dev/null; _teleop_complete --odd run hard_wall"
    answer = subprocess.run([program(shell), "-c", ask], cwd=tmp_path, check=True, capture_output=True, text=True)
    assert answer.stdout == "--odd\tit's `touch ran` $(touch ran) \"so\"\n"
    assert [each.name for each in tmp_path.iterdir()] == ["odd.sh"]
