"""A device of one's own, as `scenarios/examples/device.py` has it: an end of a live run like any other."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from teleop import DeviceError, Reading, load_result, load_scene
from teleop.__main__ import main
from teleop.laws.direct import Direct
from teleop.laws.pfra import PFRA
from teleop.live.records.end_result import NAMES
from teleop.live.records.merge import merge
from teleop.live.records.record import read_events
from tests.live.conftest import summary

pytestmark = pytest.mark.live


def test_the_device_of_the_examples_is_driven_against_its_stop(command: Callable[..., Any], tmp_path: Path) -> None:
    scene = ["hard_wall", "--set", "duration=3", "--set", "law=direct", "--link", "none", "--json"]
    slave = command("scenarios.examples.device", *scene, "--listen", "127.0.0.1:0", "--out", str(tmp_path / "s"))
    near = f"127.0.0.1:{slave.port()}"
    master = command("master", *scene, "--peer", near, "--out", str(tmp_path / "m"))
    for end in (master, slave):
        code, out, err = end.end()
        assert code == 0, (out, err)
    assert summary(tmp_path / "s")["status"] == "ok"
    trace = np.load(tmp_path / "s" / "trace.npz")
    assert trace["x_s"].max() > 0.03, "it came to the stop"
    assert trace["f_env"].max() > 0.5, "which pushed back"


# What a device senses

SCENE = replace(load_scene("hard_wall", duration=0.4), link=None)


class Standing:
    """A device that nothing moves, at x = 0.5 m with 0.25 m/s as it says, and with a force sensor or without one."""

    deadline = 0.15

    def __init__(self, *force: float | None) -> None:
        self.reading = Reading((0.5,), (0.25,), None if force[0] is None else force)  # type: ignore[arg-type]
        self.held: list[tuple[float, ...]] = []

    def read(self, k: int) -> Reading:
        return self.reading

    def hold(self, force: tuple[float, ...]) -> None:
        self.held.append(force)


def ends_of(both: Any) -> tuple[Path, Path]:
    assert both.errors == {"m": None, "s": None}
    assert both.status() == {"m": "ok", "s": "ok"}
    folders: tuple[Path, Path] = both.write()
    return folders


@pytest.mark.parametrize(("e", "column"), [("m", "f_h"), ("s", "f_env")])
def test_a_device_that_senses_7_N_was_recorded_with_the_force_of_the_scenes_own_hand_and_wall(
    e: str, column: str, pair: Callable[..., Any]
) -> None:
    both = pair(SCENE, parts={**{"m": {}, "s": {}}, e: {"device": Standing(7.0)}}).run()
    folders = ends_of(both)
    own = folders["ms".index(e)]
    (own / "summary.json").unlink()  # as of a process that was killed
    for result in (merge(SCENE, *folders), load_result(own)):
        assert set(result.trace[column].tolist()) == {7.0}
        assert set(result.trace[f"x_{e}"].tolist()) == {0.5}
        assert set(result.trace[f"v_{e}"].tolist()) == {0.25}
        assert result.metrics[f"{column}_max"] == 7.0
    both_of_them = merge(SCENE, *folders)
    assert both_of_them.metrics["f_err_rms"] > 0.0
    assert not any("force sensor" in note for note in both_of_them.notes)


@pytest.mark.parametrize(("e", "column"), [("m", "f_h"), ("s", "f_env")])
def test_a_device_that_senses_nothing_has_no_force_and_the_table_the_document_and_the_plot_do_without(
    e: str, column: str, pair: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    both = pair(SCENE, parts={**{"m": {}, "s": {}}, e: {"device": Standing(None)}}).run()
    folders = ends_of(both)
    whole = merge(SCENE, *folders)
    for result in (whole, load_result(folders["ms".index(e)])):
        assert column not in result.trace
        assert f"{column}_max" not in result.metrics
        assert any("the device has no force sensor, so there is no " + column in note for note in result.notes)
    assert ("f_err_rms" in whole.metrics) is (e == "m")
    assert {"f_h", "f_env"} - {column} <= set(whole.trace), "the other is the scene's own, and is worked out"
    monkeypatch.chdir(folders[0].parent)
    monkeypatch.setattr("teleop.report.command.scene_of", lambda *_, **__: SCENE)
    assert main(["report", "master", "slave", "--out", "both", "--plot"]) == 0
    out = capsys.readouterr().out
    assert f"{NAMES[e]}: the device has no force sensor" in out
    assert ("\nforce error" in out) is (e == "m")
    assert json.loads(Path("both/summary.json").read_text())["notes"] == list(load_result("both").notes)
    assert Path("both/plot.png").stat().st_size > 1000


def test_the_force_that_a_device_senses_is_what_the_law_reads(pair: Callable[..., Any]) -> None:
    """`direct` reflects f_env as it is."""
    scene = replace(SCENE, law=Direct(K=0.0, B=0.0))
    folders = ends_of(pair(scene, parts={"m": {}, "s": {"device": Standing(7.0)}}).run())
    felt = merge(scene, *folders).trace["f_m"]
    assert felt.max() == felt[-1] == 7.0


@pytest.mark.parametrize(("e", "law", "says"), [
    ("s", Direct(), ["the law direct reads the force on the environment, f_env", "the slave's device senses none",
                     "reading has f=None", "--set law=wave at both ends"]),
    ("m", PFRA(), ["the law pfra reads the hand's force, f_h", "--set observer=200 at both ends"]),
])
def test_a_device_without_a_force_under_a_law_that_reads_it_was_a_type_error_in_the_middle_of_the_run(
    e: str, law: Any, says: list[str], pair: Callable[..., Any]
) -> None:
    scene = replace(SCENE, law=law, observer=None)
    device = Standing(None)
    both = pair(scene, parts={**{"m": {"peer_timeout": 0.5}, "s": {"peer_timeout": 0.5}}, e: {"device": device}}).run()
    own, other = both.shells[e], both.shells["sm"["ms".index(e)]]
    assert own.outcome.status == other.outcome.status == "refused"
    assert own.outcome.fault is None
    for words in says:
        assert words in own.outcome.sentence
    assert own.counts.ticks == other.counts.ticks == 0
    assert set(device.held) == {(0.0,)}


def test_a_master_without_a_force_sensor_runs_with_the_observer_under_a_law_that_reads_f_h(
    pair: Callable[..., Any]
) -> None:
    scene = replace(SCENE, law=PFRA(), observer=200.0)
    folders = ends_of(pair(scene, parts={"m": {"device": Standing(None)}, "s": {}}).run())
    trace = merge(scene, *folders).trace
    assert "f_h_hat" in trace
    assert "f_h" not in trace


def test_a_scene_with_friction_takes_a_device_that_senses_nothing(pair: Callable[..., Any]) -> None:
    """Its own bodies tell their force at every tick, so the record had a place for one: another TypeError."""
    scene = replace(load_scene("stick_slip", duration=0.3), link=None)
    folders = ends_of(pair(scene, parts={e: {"device": Standing(None)} for e in "ms"}).run())
    assert not {"f_h", "f_env"} & set(merge(scene, *folders).trace)


class Late(Standing):
    """Cannot be read until it was asked for the hundredth time, as a driver that starts up."""

    asked = 0

    def read(self, k: int) -> Reading:
        self.asked += 1
        if self.asked < 100:
            raise DeviceError("the encoders are not referenced yet")
        return super().read(k)


def test_a_master_was_answered_before_the_slaves_device_could_be_read(pair: Callable[..., Any]) -> None:
    device = Late(None)
    both = pair(SCENE, parts={"m": {}, "s": {"device": device}}).run()
    for folder in ends_of(both):
        assert [event["why"] for event in read_events(folder) if "referenced" in event["why"]] == []
    slave = both.shells["s"]
    assert slave.counts.ticks + slave.counts.skipped == SCENE.ticks


def test_a_device_that_cannot_be_read_for_two_seconds_is_no_run(pair: Callable[..., Any]) -> None:
    class Gone(Standing):
        def read(self, k: int) -> Reading:
            raise DeviceError(f"no answer to the question for tick {k}")

    device = Gone(None)
    both = pair(SCENE, parts={"m": {"peer_timeout": 0.5}, "s": {"device": device}}).run()
    assert both.shells["s"].outcome.sentence == "the device cannot be read: no answer to the question for tick 0"
    assert both.status() == {"m": "refused", "s": "refused"}
    assert "no answer from" in both.shells["m"].outcome.sentence
    assert set(device.held) == {(0.0,)}


def test_what_an_end_says_of_a_law_that_reads_no_force_of_its_device_is_one_sentence_with_exit_code_2(
    command: Callable[..., Any], tmp_path: Path
) -> None:
    (tmp_path / "numb.py").write_text("""
from teleop import Reading, end_main


class Numb:
    deadline = 0.15

    def __init__(self, scene):
        pass

    def read(self, k):
        return Reading((0.0,), (0.0,), None)

    def hold(self, force):
        pass


raise SystemExit(end_main("s", Numb))
""")
    end = command("numb", "hard_wall", "--set", "law=direct", "--listen", "127.0.0.1:0", "--quiet")
    end.refused("the slave's device senses none", "--set law=wave")
    assert not list(tmp_path.glob("runs/*"))
