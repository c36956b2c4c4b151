"""A wrong request is answered with one sentence and exit code 2, and leaves nothing behind."""

from __future__ import annotations

import errno
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

import pytest

import teleop.simulation.result
import teleop.terminal.plotting
import teleop.terminal.run

Typed = Callable[..., Any]
SHORT = ("--set", "duration=0.2")
KNOB_SCENE = """
from teleop import MassDamper, Scene, Wave

def scene(*, mass: float = 1.0, steps: int = 3, loud: bool = False) -> Scene:
    "A scene that a user wrote."
    body = MassDamper(mass=mass, damping=1.0)
    return Scene(law=Wave(), master=body, slave=body, duration=0.05)
"""

WRONG = {
    "unknown scene": (["hard_wal"], ["hard_wal", "did you mean hard_wall?"]),
    "unknown law": (["canonical", "--set", "law=wavee"], ["wavee", "did you mean wave or"]),
    "unknown knob": (["canonical", "--set", "dely=1"], ["dely", "delay"]),
    "unknown knob of the law": (["canonical", "--set", "law.bb=1"], ["bb", "did you mean b?"]),
    "unknown effect": (["canonical", "--link", "dely(1)"], ["dely", "did you mean delay?"]),
    "not a scene's name": (["../scenarios/canonical"], ["there is no scene"]),
    "no value": (["canonical", "--set", "delay"], ["delay", "--set delay=0.1"]),
    "two lines": (["canonical", "--set", "de\nlay"], ["de lay"]),
    "no name": (["canonical", "--set", "=1"], ["write for example"]),
    "wrong type": (["canonical", "--set", "delay=soon"], ["delay", "'soon'", "number"]),
    "not true or false": (["canonical", "--set", "energy=2"], ["energy", "true or false"]),
    "not whole": (["mine.py", "--set", "steps=1.5"], ["steps", "whole"]),
    "NaN": (["canonical", "--set", "delay=nan"], ["delay", "finite"]),
    "infinite": (["canonical", "--set", "k_e=inf"], ["k_e", "finite"]),
    "infinite in disguise": (["canonical", "--set", "k_e=1e999"], ["k_e", "finite"]),
    "negative mass": (["mine.py", "--set", "mass=-1"], ["mass", "above 0", "-1"]),
    "negative, under another name inside": (["canonical", "--set", "k_e=-5"], ["k_e", "-5", "at least 0"]),
    "a heart that beats faster than ticks": (["beating_heart", "--set", "rate=1e9"],
                                             ["1e+09 Hz", "half the tick rate, 500 Hz", "a smaller dt"]),
    "no time to relax in": (["relaxing_tissue", "--set", "tau=0"], ["tau must be above 0"]),
    "an exponent below one": (["rubber", "--set", "n=0.5"], ["n must be at least 1, not 0.5; write for example n=1"]),
    "an encoder without a step": (["virtual_wall", "--set", "step=0"], ["step must be above 0"]),
    "a force that is never renewed": (["virtual_wall", "--set", "every=0"], ["every must be at least 1"]),
    "a force before its reading": (["virtual_wall", "--set", "delay=-1"], ["delay must be at least 0"]),
    "a controller that drives": (["encoder_wall", "--set", "cap=-1"], ["cap must be at least 0"]),
    "a weight above one": (["virtual_coupling", "--set", "law.theta_f=2"], ["law.theta_f must be at most 1, not 2"]),
    "a tool that nothing moves": (["virtual_coupling", "--set", "law.mass=0", "--set", "law.theta_f=0"],
                                  ["mass=0", "write theta_f=1"]),
    "darkness below zero, called duration inside": (
        ["blackout", "--set", "dark_for=-1", "--set", "duration=1"], ["dark_for must be at least 0 s, not -1"]),
    "zero dt": (["canonical", "--set", "dt=0"], ["dt", "at least"]),
    "zero duration": (["canonical", "--set", "duration=0"], ["duration", "above 0"]),
    "zero rate": (["canonical", "--set", "law=pfra", "--set", "observer=0"], ["observer", "above 0"]),
    "a run without end": (["canonical", "--set", "duration=1e12"], ["ticks", "change duration or dt"]),
    "a run without end at all": (["canonical", "--set", "duration=1e300"], ["duration=1e+300 s", "change duration"]),
    "a unit behind the number": (["canonical", "--set", "delay=50ms"], ["a number of s", "'50ms'", "delay=0.05"]),
    "a word for a number of a law": (["canonical", "--set", "law.b=x"], ["law.b must be a number of N s/m", "law.b=2"]),
    "three numbers for one": (["canonical", "--set", "amplitude=1,2,3"], ["amplitude must be one number", "'1,2,3'"]),
    "no folder": (["canonical", "--out", ""], ["--out DIR must not be empty", "the new folder"]),
    "no link": (["canonical", "--link", ""], ["--link SPEC must not be empty", "none is no link"]),
    "another law's knob": (["canonical", "--set", "law.b=3", "--set", "law=pfra"],
                           ["law pfra has no knob 'b' (wave, wave_filter, "]),
    "the law's own number": (["canonical", "--set", "law.b=-1"], ["law.b must be above 0 N s/m, not -1", "law.b=1"]),
    "a playout delay that is no number": (["jittery_wan", "--set", "playout=fixed:abc"],
                                          ["'fixed:abc'", "write playout=fixed:0.1"]),
    "a playout delay below zero": (["jittery_wan", "--set", "playout=fixed:-1"], ["write playout=fixed:0.1"]),
    "a seed in digits of another script": (["canonical", "--seed", "٣"], ["seed", "'٣'"]),
    "an effect without brackets": (["canonical", "--link", "delay"], ["write for example delay(0.05)"]),
    "a file that wants to exit": (["exits.py"], ["exits.py stopped with SystemExit: 5"]),
    "a scene that wants to exit": (["leaves.py"], ["leaves.py stopped with SystemExit: 5"]),
    "types that only a checker sees": (["typed.py"], ["'Wave' is not defined", "TYPE_CHECKING"]),
    "a delay longer than memory": (["canonical", "--set", "delay=1e7"], ["delay", "3600"]),
    "a negative seed": (["canonical", "--seed", "-1"], ["seed", "2^64-1", "write --seed 1"]),
    "a seed too large": (["canonical", "--seed", str(2**64)], ["seed", "2^64-1"]),
    "a broken seed": (["canonical", "--seed", "1.5"], ["seed", "'1.5'"]),
    "an unknown option": (["canonical", "--sed", "1"], ["--sed", "--help"]),
    "a missing scene": ([], ["SCENE", "--help"]),
    "a scene that lacks a knob": (["lte"], ["up", "--set up=FILE --set down=FILE"]),
    "a recording that is not there": (["lte", "--set", "up=a", "--set", "down=a"], ["a", "recording"]),
    "no such file": (["nowhere.py"], ["nowhere.py", "canonical"]),
    "a broken file": (["broken.py"], ["broken.py", "SyntaxError"]),
    "a file without a scene": (["empty.py"], ["empty.py", "def scene"]),
    "a scene that is none": (["other.py"], ["other.py", "teleop.Scene"]),
    "a scene that stops": (["stops.py"], ["stops.py", "ZeroDivisionError"]),
    "a folder that is there": (["canonical", "--out", "taken"], ["taken", "--out"]),
    "a file in place of the folder": (["canonical", "--out", "mine.py"], ["mine.py", "--out"]),
    "a file on the way to the folder": (["canonical", "--out", "mine.py/a/b"], ["mine.py", "--out"]),
    "a name too long": (["canonical", "--out", f"new/{'x' * 300}"], ["too long", "--out"]),
}


def left_in(folder: Path) -> list[Path]:
    return sorted(folder.rglob("*"))


class TestAWrongRequest:
    @pytest.fixture(autouse=True)
    def files(self, tmp_path: Path) -> None:
        (tmp_path / "mine.py").write_text(KNOB_SCENE)
        (tmp_path / "broken.py").write_text("def scene(:\n")
        (tmp_path / "empty.py").write_text("")
        (tmp_path / "other.py").write_text("def scene():\n    return 3\n")
        (tmp_path / "stops.py").write_text("def scene():\n    return 1 / 0\n")
        (tmp_path / "exits.py").write_text("import sys\nsys.exit(5)\n")
        (tmp_path / "leaves.py").write_text("def scene():\n    raise SystemExit(5)\n")
        (tmp_path / "typed.py").write_text(
            "from __future__ import annotations\nfrom typing import TYPE_CHECKING\nif TYPE_CHECKING:\n"
            "    from teleop.laws.wave import Wave\ndef scene(*, law: Wave): ...\n"
        )
        (tmp_path / "taken").mkdir()

    @pytest.mark.parametrize("what", WRONG)
    def test_is_refused_in_one_sentence_and_leaves_nothing(
        self, typed: Typed, tmp_path: Path, what: str
    ) -> None:
        arguments, words = WRONG[what]
        before = left_in(tmp_path)
        typed("run", *arguments).assert_refused(*words)
        assert [path for path in left_in(tmp_path) if "__pycache__" not in path.parts] == before

    def test_finds_the_folder_taken_before_it_runs(
        self, typed: Typed, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(teleop.terminal.run, "run", lambda *_, **__: pytest.fail("it was computed"))
        typed("run", "canonical", "--out", "taken").assert_refused("there already")

    def test_finds_the_folder_forbidden_before_it_runs(
        self, typed: Typed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        before = left_in(tmp_path)

        def forbidden(*_: object, **__: object) -> None:
            raise PermissionError(errno.EACCES, "Permission denied")

        monkeypatch.setattr(teleop.terminal.run, "run", lambda *_, **__: pytest.fail("it was computed"))
        monkeypatch.setattr(Path, "mkdir", forbidden)
        typed("run", "canonical", "--out", "new/run").assert_refused("Permission denied", "--out")
        assert left_in(tmp_path) == before

    def test_on_a_full_disk_leaves_nothing(
        self, typed: Typed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        before = left_in(tmp_path)

        def full(file: BinaryIO, _: object) -> None:
            file.write(b"half of it")
            raise OSError(errno.ENOSPC, "No space left on device")

        monkeypatch.setattr(teleop.simulation.result, "write_arrays", full)
        answer = typed("run", "canonical", *SHORT, "--out", "new/folders/run")
        answer.assert_refused("No space left", "nothing was left", "--out")
        assert left_in(tmp_path) == before

    def test_interrupted_leaves_nothing(
        self, typed: Typed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        before = left_in(tmp_path)

        def interrupted(*_: object, **__: object) -> None:
            raise KeyboardInterrupt

        monkeypatch.setattr(teleop.terminal.run, "run", interrupted)
        answer = typed("run", "canonical")
        assert (answer.code, answer.out) == (130, "")
        assert answer.err.count("\n") == 1
        assert "interrupted" in answer.err
        assert left_in(tmp_path) == before

    @pytest.mark.parametrize("option", [["--plot"], ["--format", "pdf,svg"]])
    @pytest.mark.parametrize("words", [
        ["run", "canonical"], ["demo"], ["sweep", "soft_tissue", "--grid", "k_e=1,2"], ["precision", "hard_wall"],
        ["stability", "virtual_wall"],
        ["passivity", "virtual_wall"], ["zwidth", "virtual_wall"], ["report", "taken"],
    ], ids=lambda words: words[0])
    def test_without_matplotlib_a_plot_is_refused_before_it_runs(
        self, typed: Typed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], option: list[str]
    ) -> None:
        before = left_in(tmp_path)
        monkeypatch.setattr(teleop.terminal.plotting, "find_spec", lambda _: None)
        typed(*words, *option).assert_refused("pip install 'bilateral-teleop[plot]'")
        assert left_in(tmp_path) == before

    @pytest.mark.parametrize("format", ["jpg", "png,", "", "png;pdf"])
    def test_of_a_format_that_is_none_is_refused_by_name(self, typed: Typed, format: str) -> None:
        typed("run", "canonical", "--format", format).assert_refused("png, pdf, svg", "for example pdf,svg")

    @pytest.mark.parametrize("arguments", [["rnu"], ["report"], ["report", "nowhere"], ["report", "taken"],
                                           ["report", "mine.py"], ["list", "delai"], ["list", "a", "b"]])
    def test_of_another_command_is_refused_too(self, typed: Typed, arguments: list[str]) -> None:
        typed(*arguments).assert_refused()

    @pytest.mark.parametrize(("arguments", "words"), [
        (["show", "tick", "canonical", "--end", "q"], "there is no --end 'q'; there are: m, s"),
        (["runn"], "there is no command 'runn'; did you mean run?"),
        (["list", "nope"], "there is no scene, law, effect or estimator 'nope'; there are: "),
        (["list", ""], "NAME must not be empty: it is a scene"),
        (["stability", "hard_wall", "--bodies", "rk4:2"],
         "teleop stability has no option --bodies, an option of teleop run; see teleop stability --help"),
        (["list", "hard_wall", "--rate", "5"], "an option of teleop demo; see teleop list --help"),
        (["list", "hard_wall", "--out", "x"], "an option of teleop run, teleop demo, teleop sweep, "),
        (["run", "canonical", "--sed=3"], "teleop run has no option --sed; did you mean --seed"),
        (["run", "canonical", "--delay", "3"], "has no option --delay; there are: --bodies"),
        (["run", "canonical", "--delay", "3"], "(a knob is given by --set delay=VALUE)"),
        (["run", "canonical", "twice"], "teleop run does not take the argument 'twice'; see teleop run --help"),
        (["--jsn"], "teleop has no option --jsn"),
    ])
    def test_is_answered_with_the_nearest_or_with_all_there_is(
        self, typed: Typed, arguments: list[str], words: str
    ) -> None:
        typed(*arguments).assert_refused(words)

    def test_that_is_a_bug_keeps_its_traceback(
        self, typed: Typed, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(teleop.terminal.run, "run", lambda *_, **__: {}["a bug"])
        with pytest.raises(KeyError):
            typed("run", "canonical")
