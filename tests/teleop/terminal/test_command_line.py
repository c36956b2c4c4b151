"""The command line as a user meets it: what it answers and what it leaves."""

from __future__ import annotations

import errno
import gc
import json
import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pytest

import teleop.simulation.result
import teleop.terminal.plotting
import teleop.terminal.run
from master.steered import SteeredMaster
from scenarios.__main__ import main as console_entry
from teleop import load_result, load_scene, run
from teleop.__main__ import main
from teleop.live.demo import EndOptions
from teleop.scene.library import ROOT
from teleop.storage.folder import claim
from teleop.terminal.commands import COMMANDS, parser
from tests.fakes import raising

SHORT = ("--set", "duration=0.2")
Typed = Callable[..., Any]


class TestARun:
    def test_writes_a_numbered_folder_with_what_was_typed_and_says_where(self, typed: Typed, tmp_path: Path) -> None:
        answer = typed("run", "canonical", *SHORT)
        assert (answer.code, answer.err) == (0, "")
        assert answer.out.endswith("written to runs/canonical-1\n")
        assert "plot" not in answer.out
        folder = tmp_path / "runs" / "canonical-1"
        assert sorted(path.name for path in folder.iterdir()) == ["summary.json", "trace.npz"]
        summary = json.loads((folder / "summary.json").read_text())
        assert summary["command"] == ["teleop", "run", "canonical", *SHORT]
        assert typed("report", str(folder)).out.startswith(answer.out.rpartition("written")[0])

    def test_with_json_is_one_object_and_a_format_draws_without_being_asked_twice(self, typed: Typed) -> None:
        pytest.importorskip("matplotlib")
        answer = typed("run", "canonical", *SHORT, "--format", " SVG", "--json")
        document = json.loads(answer.out)
        assert answer.err == ""
        assert document.pop("path") == "runs/canonical-1"
        assert document.pop("plots") == ["runs/canonical-1/plot.svg"]
        assert document == json.loads(Path("runs/canonical-1/summary.json").read_text())
        assert {path.name for path in Path("runs/canonical-1").iterdir()} == {"summary.json", "trace.npz", "plot.svg"}

    def test_is_the_run_that_python_makes_and_with_the_same_seed_leaves_the_same_bytes(self, typed: Typed) -> None:
        for out, seed in (("a", "5"), ("b", "5"), ("c", "2")):
            typed("run", "jittery_wan", *SHORT, "--seed", seed, "--out", out)
        a, b, c = (Path(out, "trace.npz").read_bytes() for out in "abc")
        assert a == b != c
        ours, stored = run(load_scene("jittery_wan", duration=0.2), seed=5), load_result("a")
        assert stored.trace.keys() == ours.trace.keys()
        for name, column in ours.trace.items():
            np.testing.assert_array_equal(stored.trace[name], column)

    def test_that_diverges_is_done_all_the_same_and_says_so(self, typed: Typed) -> None:
        answer = typed("run", "canonical", "--set", "law=direct", "--set", "law.K=1e6", "--out", "here")
        assert answer.code == 0
        assert "diverged at t = " in answer.out
        stored = load_result("here")
        assert stored.status == "diverged"
        assert "x_s" in stored.sentence
        assert 0 < len(stored.trace["t"]) == stored.ticks < 10_000

    def test_takes_the_last_of_two_settings_and_the_link_option_over_the_scenes(self, typed: Typed) -> None:
        for words, fwd, bwd in ((("--set", "delay=0.1", "--set", "delay=0.01"), 0.01, 0.01),
                                (("--link", "delay(0.02) ; delay(0.03)"), 0.02, 0.03)):
            typed("run", "canonical", *SHORT, *words, "--out", str(fwd))
            metrics = load_result(str(fwd)).metrics
            assert (metrics["T_fwd_max"], metrics["T_bwd_max"]) == pytest.approx((fwd, bwd))
        assert "packets" not in typed("run", "canonical", *SHORT, "--link", "none").out


def test_one_tick_one_row_and_one_knob_are_told_in_the_singular(typed: Typed) -> None:
    assert "ran to its end, 1 tick of 0.001 s" in typed("run", "canonical", "--set", "duration=0.001").out
    swept = typed("sweep", "canonical", "--set", "duration=0.001", "--grid", "k_e=1", "--metrics", "f_m_max")
    for words in ("1 row of k_e", "1 row, 1 knob, 1 metric: 1 ok\n"):
        assert words in swept.out


def test_show_prints_the_loop_of_a_scene_or_a_live_end_as_python_that_compiles(typed: Typed) -> None:
    out = typed("show", "tick", "hard_wall").out
    compile(out, "shown", "exec")
    assert out.startswith("def loop(numbers, law, dt, count")
    assert "f_cmd_m0 = cap(c_cap_m[0], f_cmd_m0, f_held_m)" in out
    out = typed("show", "tick", "hard_wall", "--set", "law=pfra", "--end", "m").out
    assert out.startswith("def live(numbers, law, dt")
    assert "observe(" in out


@pytest.mark.full
def test_a_report_draws_only_if_it_is_asked_to_and_can_write_and_names_the_file(
        typed: Typed, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")
    first = typed("run", "local", *SHORT, "--out", "here").out

    def forbidden(*_: object, **__: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    with monkeypatch.context() as without:
        without.setattr(teleop.terminal.plotting, "find_spec", lambda _: None)
        typed("report", "here", "--plot").assert_refused("pip install")
    with monkeypatch.context() as without:
        without.setattr(teleop.terminal.plotting, "replacing", forbidden)
        answer = typed("report", "here", "--plot")
        assert answer.code == 0
        assert answer.out.startswith(first)
        assert "no plot" in answer.out
    Path("here/report.html").write_text("another")
    assert not Path("here/plot.png").exists()
    assert typed("report", "here", "--plot").out == first + "plot: here/plot.png\npage: here/report-2.html\n"
    assert Path("here/plot.png").read_bytes().startswith(b"\x89PNG")


def test_a_demo_hands_on_what_was_typed_and_shows_the_result(typed: Typed, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []

    def demo(scene_name: str, knobs: dict[str, str], ends: EndOptions, **rest: Any) -> Any:
        asked.append((scene_name, knobs, ends, rest))
        folder = claim(rest["out"], rest["stem"]).path
        return replace(run(load_scene(scene_name, duration=0.05)), mode="lockstep", path=folder)

    monkeypatch.setattr("teleop.live.demo.demo", demo)
    words = ("demo", "--set", "k_e=5", "--link", "delay(0.1)", "--seed", "3", "--lockstep", "--robot", "csv:a.csv")
    answer = typed(*words)
    assert answer.code == 0
    assert "live in lockstep" in answer.out
    assert answer.out.endswith("written to runs/hard_wall-1\n")
    rest = {"seed": 3, "out": None, "stem": "hard_wall", "json": False, "command": ["teleop", *words], "realtime": True}
    assert not Path("runs/hard_wall-1/plot.png").exists()
    ends = EndOptions(lockstep=True, robot="csv:a.csv")
    assert asked == [("hard_wall", {"k_e": "5", "link": "delay(0.1)"}, ends, rest)]
    if find_spec("matplotlib"):
        assert typed("demo", "--plot").out.endswith("\nplot: runs/hard_wall-2/plot.png\n")


class TestTheFirstWords:
    def test_fit_a_small_terminal_and_are_three_things_to_try_of_which_the_third_comes_to_what_it_says(
            self, typed: Typed) -> None:
        answer = typed()
        assert (answer.code, answer.err) == (0, "")
        lines = answer.out.splitlines()
        assert len(lines) <= 20
        assert max(map(len, lines)) < 80
        assert "teleop --help" in lines[-1]
        tried = [line.split()[1:] for line in lines if line.startswith("  teleop ")]
        assert [words[0] for words in tried] == ["demo", "demo", "run"]
        for words in tried:
            assert parser().parse_args(words).scene
        for law, status in (("direct", "diverged"), ("wave", "ok")):
            assert run(load_scene("soft_tissue", law=law, delay="0.05")).status == status

    def test_help_names_every_command_which_builds_alone_the_options_that_all_together_give_it(
        self, capsys: pytest.CaptureFixture[str]
    ) -> None:
        with pytest.raises(SystemExit):
            main(["--help"])
        out = capsys.readouterr().out
        for name in COMMANDS:
            assert f"\n    {name}" in out
            texts = []
            for known in (parser(), parser(name)):
                with pytest.raises(SystemExit) as ended:
                    known.parse_args([name, "--help"])
                assert ended.value.code == 0
                texts.append(capsys.readouterr().out)
            assert texts[0] == texts[1], name
            assert f"usage: teleop {name}" in texts[0]

    def test_garbage_is_collected_from_the_command_on_and_after_a_refusal(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        (tmp_path / "tells.py").write_text("import gc\nprint('collects', gc.isenabled())\n"
                                           "from scenarios.canonical import scene\n")
        for words, code, out in ((["run", "tells.py", *SHORT], 0, "collects True\n"), (["no such command"], 2, "")):
            monkeypatch.chdir(tmp_path)
            monkeypatch.setattr(sys, "argv", ["teleop", *words])
            assert console_entry() == code
            assert capsys.readouterr().out.startswith(out)
            assert gc.isenabled()


class TestAWrongRequest:
    """What stands in the way is found before anything is computed, and leaves nothing behind."""

    @pytest.fixture(autouse=True)
    def nothing_left(self, tmp_path: Path) -> Iterator[None]:
        (tmp_path / "taken").mkdir()
        yield
        assert [path.name for path in tmp_path.rglob("*")] == ["taken"]

    def test_finds_the_folder_taken_or_forbidden_before_it_runs(
            self, typed: Typed, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(teleop.terminal.run, "run", raising(AssertionError("it was computed")))
        typed("run", "canonical", "--out", "taken").assert_refused("there already")
        monkeypatch.setattr(Path, "mkdir", raising(PermissionError(errno.EACCES, "Permission denied")))
        typed("run", "canonical", "--out", "new/run").assert_refused("Permission denied", "--out")

    def test_on_a_full_disk_or_interrupted_leaves_nothing_and_a_bug_keeps_its_traceback(
            self, typed: Typed, monkeypatch: pytest.MonkeyPatch) -> None:
        def full(file: BinaryIO, _: object) -> None:
            file.write(b"half of it")
            raise OSError(errno.ENOSPC, "No space left on device")

        monkeypatch.setattr(teleop.simulation.result, "write_arrays", full)
        answer = typed("run", "canonical", *SHORT, "--out", "new/folders/run")
        answer.assert_refused("No space left", "nothing was left", "--out")
        monkeypatch.setattr(teleop.terminal.run, "run", raising(KeyboardInterrupt()))
        answer = typed("run", "canonical")
        assert (answer.code, answer.out, answer.err.count("\n")) == (130, "", 1)
        assert "interrupted" in answer.err
        monkeypatch.setattr(teleop.terminal.run, "run", raising(KeyError("a bug")))
        with pytest.raises(KeyError):
            typed("run", "canonical")

    def test_without_matplotlib_a_plot_is_refused_before_it_runs(
            self, typed: Typed, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(teleop.terminal.plotting, "find_spec", lambda _: None)
        for words in (["run", "canonical"], ["demo"], ["sweep", "soft_tissue", "--grid", "k_e=1,2"],
                      ["precision", "hard_wall"], ["stability", "virtual_wall"], ["passivity", "virtual_wall"],
                      ["zwidth", "virtual_wall"], ["report", "taken"]):
            for option in (["--plot"], ["--format", "pdf,svg"]):
                typed(*words, *option).assert_refused("pip install 'bilateral-teleop[plot]'")


class TestAProcess:
    @pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
    def test_whose_reader_has_seen_enough_ends_quietly_and_one_whose_output_cannot_be_written_says_so(
            self, process: Any, ended: Any) -> None:
        started = process("-m", "scenarios", "list")
        started.stdout.close()
        assert started.stderr.read() == ""
        assert started.wait() == 0
        with open("/dev/full", "w") as full:
            ended(process("-m", "scenarios", "list", stdout=full)).assert_refused("No space left")

    def test_finds_its_own_house_whatever_lies_in_the_current_folder(self, process: Any, ended: Any,
            tmp_path: Path) -> None:
        """With `-c` the current folder comes first of all on the path, the hardest case there is."""
        trap = "raise SystemExit('shadowed')\n"
        for name in ("scenarios", "channel"):
            (tmp_path / name).mkdir()
            (tmp_path / name / "__init__.py").write_text(trap)
        for name in ("master", "slave", "canonical"):
            (tmp_path / f"{name}.py").write_text(trap)
        (tmp_path / "scenarios" / "canonical.py").write_text(trap)
        (tmp_path / "own.py").write_text((ROOT / "scenarios" / "canonical.py").read_text())
        code = "from teleop.__main__ import main; raise SystemExit(main())"
        for scene in ("canonical", "./own.py"):
            answer = ended(process("-c", code, "run", scene, *SHORT, "--json"))
            assert (answer.code, answer.err) == (0, "")
            assert not {"\x1b", "\r", "\b"} & set(answer.out)
            assert json.loads(answer.out)["status"] == "ok"


# `teleop run SCENE --hand FOLDER`: a person's own drag again, in virtual time


Typed = Callable[..., Any]


@pytest.fixture
def drag(typed: Typed, tmp_path: Path) -> Path:  # noqa: ARG001 - it is run in a folder of its own
    """The folder of a master whose hand was dragged into the wall within 0.8 s."""
    folder = tmp_path / "drag"
    folder.mkdir()
    device = SteeredMaster(load_scene("hard_wall"))
    device.record(folder)
    device.steer([0.05])
    device.read(800)
    device.record(None)
    return folder


def test_it_is_the_run_that_python_makes_and_says_whose_hand_it_was(typed: Typed, drag: Path) -> None:
    """Its report needs no folder of the drag, and a duration that is set stands."""
    answer = typed("run", "hard_wall", "--hand", "drag", "--set", "law=pfra", "--out", "here")
    assert (answer.code, answer.err) == (0, "")
    stored, ours = load_result("here"), run(load_scene("hard_wall", hand=drag, law="pfra"))
    assert stored.ticks == 800
    for name, column in ours.trace.items():
        np.testing.assert_array_equal(stored.trace[name], column)
    summary = json.loads(Path("here/summary.json").read_text())
    assert summary["parameters"]["hand"] == "drag"
    assert summary["parameters"]["duration"] == 0.8
    assert summary["command"][-2:] == ["--out", "here"]
    first = typed("run", "hard_wall", "--hand", str(drag), "--set", "duration=0.3", "--out", "short")
    assert "ran to its end" in first.out
    shutil.rmtree(drag)
    again = typed("report", "short", "--json")
    assert (again.code, again.err) == (0, "")
    assert json.loads(again.out)["ticks"] == 300


def test_what_is_no_drag_for_the_scene_is_refused_before_anything_is_written(typed: Typed, drag: Path) -> None:
    Path("alone.py").write_text(
        "from teleop import MassDamper, Scene, Wave\n\n\ndef scene(*, duration: float = 1.0) -> Scene:\n"
        "    return Scene(law=Wave(), master=MassDamper(mass=0.1), slave=MassDamper(mass=0.5), duration=duration)\n")
    for scene, sentence in (
            ("recorded_reach", "was recorded in 1 axis with dt=0.001 s, and the scene has 3 axes"),
            ("alone.py", "moves nothing in a scene without a hand")):
        typed("run", scene, "--hand", str(drag)).assert_refused(sentence)
        assert not Path("runs").exists()
