"""Live ends with devices that are not the scene's own: that sense, have switches, carry a weight, fail or hang."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from math import cos, nan, sin
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from master.device import SimulatedMaster
from scenarios.examples.device import Carriage
from teleop import PFRA, DeviceError, Direct, Reading, load_result, load_scene
from teleop.__main__ import main
from teleop.bench.watchdog import FORCE, Motor
from teleop.bench.watchdog import SCENE as CLAMPED
from teleop.live.in_process import run_stepped
from teleop.live.records.end_result import NAMES
from teleop.live.records.merge import merge, scene_of
from teleop.live.records.reader import OWN
from teleop.live.records.record import read_events
from teleop.live.replay.rerun import difference, read_end
from teleop.live.summary import UNWATCHED
from teleop.scene.library import ROOT
from tests.fakes import Body, always, reading, standing
from tests.live.conftest import Command, summary
from tests.waiting import until

pytestmark = pytest.mark.live


Make = Callable[..., Any]
SCENE = replace(load_scene("hard_wall", duration=0.4), link=None)


def run_with(pair: Make, scene: Any, **devices: Any) -> tuple[Any, tuple[Path, Path]]:
    """Two ends with these devices at m or s, whose run came to its end; the folders of both."""
    both = pair(scene, parts={e: {"device": devices[e]} if e in devices else {} for e in "ms"}).run()
    assert both.errors == {"m": None, "s": None}
    assert both.status() == {"m": "ok", "s": "ok"}
    return both, both.write()


def test_an_end_whose_device_fails_is_safe_and_comes_back_by_itself(pair: Make) -> None:
    scene = replace(SCENE, duration=0.8)
    inner = SimulatedMaster(scene)
    blind: dict[int, list[int]] = {200: [], 450: []}  # by the tick from which on it is: the ticks of its readings
    held: list[tuple[int, float]] = []

    def sick(k: int) -> Any:
        reading = inner.read(k)
        first = 450 if k >= 450 else 200
        if k < first or len(blind[first]) >= 10:
            return reading
        blind[first].append(k)
        return reading._replace(v=(nan,)) if first == 450 else DeviceError("the encoder is gone")

    def hold(force: tuple[float, ...]) -> tuple[float, ...]:
        held.append((device.at, force[0]))
        inner.hold(force)
        return force

    device = reading(sick, holds=hold)
    both, folders = run_with(pair, scene, m=device)
    events = both.shells["m"].endpoint.guard.events
    causes = [event.why for event in events if event.what == "safe"]
    assert any("the encoder is gone" in why for why in causes)
    assert any("not finite" in why for why in causes)
    assert len([event for event in events if event.what == "released"]) >= 2
    trace = merge(scene, *folders).trace
    for ticks in blind.values():
        forces = [force for k, force in held if ticks[0] - 1 <= k <= ticks[-1]]
        assert all(abs(b) < abs(a) or b == 0.0 for a, b in pairwise(forces)), "on its way to zero"
        assert not set(np.round(trace["t"] * 1e3).astype(int)) & {*ticks}, "a tick without a reading is left out whole"
    assert np.isfinite(trace["v_m"]).all()
    assert trace["g_m"][-1] == 1.0


def test_a_device_that_never_comes_back_and_takes_zero_ends_the_run_with_a_sentence_at_both_ends(pair: Make) -> None:
    scene, gone = replace(SCENE, duration=5.0), OSError("the bus is gone")
    device = Body(inner=SimulatedMaster(scene), reads=lambda k, now: always(gone if k >= 100 else now)(k, now))
    both = pair(scene, parts={"m": {"device": device}, "s": {}}).run()
    assert both.errors == {"m": None, "s": None}
    assert both.status() == {"m": "stopped", "s": "stopped"}
    assert all("the device fails: the bus is gone" in shell.outcome.sentence for shell in both.shells.values())
    assert device.held[-1] == (0.0,)


def test_a_device_that_reads_ints_and_float32_is_heard_by_the_other_end_and_that_it_has_no_deadline_is_told(
    pair: Make
) -> None:
    """The other end took its messages for malformed, dropped them all, and told of silence."""
    def coarse(_k: int, now: Reading) -> Any:
        x, v, f, *_ = now
        return Reading(tuple(map(np.float32, x)), tuple(np.float32(n) if n else 0 for n in v), f)

    both, folders = run_with(pair, SCENE, m=Body(inner=SimulatedMaster(SCENE), reads=coarse, deadline=None))
    slave = both.shells["s"].endpoint
    assert "malformed" not in slave.rejected
    assert slave.inbox.played > 0
    told = [json.loads((folder / "summary.json").read_text())["notes"] for folder in folders]
    assert [UNWATCHED in notes for notes in told] == [True, False]


# What a device senses


@pytest.mark.parametrize(("e", "column"), [("m", "f_h"), ("s", "f_env")])
def test_a_device_that_senses_7_N_was_recorded_with_the_force_of_the_scenes_own_hand_and_wall(
    e: str, column: str, pair: Make
) -> None:
    _, folders = run_with(pair, SCENE, **{e: standing(f=7.0)})
    own = folders["ms".index(e)]
    (own / "summary.json").unlink()  # as of a process that was killed
    whole = merge(SCENE, *folders)
    for result in (whole, load_result(own)):
        assert set(result.trace[column].tolist()) == {7.0}
        assert set(result.trace[f"x_{e}"].tolist()) == {0.5}
        assert set(result.trace[f"v_{e}"].tolist()) == {0.25}
        assert result.metrics[f"{column}_max"] == 7.0
    assert whole.metrics["f_err_rms"] > 0.0
    assert not any("force sensor" in note for note in whole.notes)
    if e == "s":  # `direct` reflects f_env as it is
        scene = replace(SCENE, law=Direct(K=0.0, B=0.0))
        felt = merge(scene, *run_with(pair, scene, s=standing(f=7.0))[1]).trace["f_m"]
        assert felt.max() == felt[-1] == 7.0


@pytest.mark.parametrize(("e", "column"), [("m", "f_h"), ("s", "f_env")])
def test_a_device_that_senses_nothing_has_no_force_and_the_table_the_document_and_the_plot_do_without(
    e: str, column: str, pair: Make, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    _, folders = run_with(pair, SCENE, **{e: standing()})
    whole = merge(SCENE, *folders)
    for result in (whole, load_result(folders["ms".index(e)])):
        assert column not in result.trace
        assert f"{column}_max" not in result.metrics
        assert any("the device has no force sensor, so there is no " + column in note for note in result.notes)
    assert ("f_err_rms" in whole.metrics) is (e == "m")
    assert {"f_h", "f_env"} - {column} <= set(whole.trace), "the other is the scene's own, and is worked out"
    monkeypatch.chdir(folders[0].parent)
    monkeypatch.setattr("teleop.report.command.scene_of", lambda *_, **__: SCENE)
    plot = ["--plot"] if e == "s" else []
    assert main(["report", "master", "slave", "--out", "both", *plot]) == 0
    out = capsys.readouterr().out
    assert f"{NAMES[e]}: the device has no force sensor" in out
    assert ("\nforce error" in out) is (e == "m")
    assert json.loads(Path("both/summary.json").read_text())["notes"] == list(load_result("both").notes)
    assert not plot or Path("both/plot.png").stat().st_size > 1000


@pytest.mark.parametrize(("e", "law", "says"), [
    ("s", Direct(), ["the law direct reads the force on the environment, f_env", "the slave's device senses none",
                     "reading has f=None", "--set law=wave at both ends"]),
    ("m", PFRA(), ["the law pfra reads the hand's force, f_h", "--set observer=200 at both ends"]),
])
def test_a_device_without_a_force_under_a_law_that_reads_it_was_a_type_error_in_the_middle_of_the_run(
    e: str, law: Any, says: list[str], pair: Make
) -> None:
    scene = replace(SCENE, law=law, observer=None)
    device = standing()
    both = pair(scene, parts={**{"m": {"peer_timeout": 0.5}, "s": {"peer_timeout": 0.5}}, e: {"device": device}}).run()
    own, other = both.shells[e], both.shells["sm"["ms".index(e)]]
    assert own.outcome.status == other.outcome.status == "refused"
    assert own.outcome.fault is None
    for words in says:
        assert words in own.outcome.sentence
    assert own.counts.ticks == other.counts.ticks == 0
    assert set(device.held) == {(0.0,)}


def test_devices_that_sense_nothing_run_with_the_observer_and_in_a_scene_with_friction(pair: Make) -> None:
    """The scene's own bodies tell their friction at every tick, so the record had a place for one: a TypeError."""
    scene = replace(SCENE, law=PFRA(), observer=200.0)
    trace = merge(scene, *run_with(pair, scene, m=standing())[1]).trace
    assert "f_h_hat" in trace
    assert "f_h" not in trace
    scene = replace(load_scene("stick_slip", duration=0.3), link=None)
    folders = run_with(pair, scene, m=standing(), s=standing())[1]
    assert not {"f_h", "f_env"} & set(merge(scene, *folders).trace)


def test_a_master_was_answered_before_the_slaves_device_could_be_read(pair: Make) -> None:
    """Not until it was asked for the hundredth time, as a driver that starts up."""
    asked = iter(range(100))
    late = DeviceError("the encoders are not referenced yet")
    device = standing(reads=lambda k, now: always(now if next(asked, None) is None else late)(k, now))
    both, folders = run_with(pair, SCENE, s=device)
    for folder in folders:
        assert [event["why"] for event in read_events(folder) if "referenced" in event["why"]] == []
    slave = both.shells["s"]
    assert slave.counts.ticks + slave.counts.skipped == SCENE.ticks


def test_a_device_that_cannot_be_read_for_two_seconds_is_no_run(pair: Make) -> None:
    device = reading(lambda k: DeviceError(f"no answer to the question for tick {k}"))
    both = pair(SCENE, parts={"m": {"peer_timeout": 0.5}, "s": {"device": device}}).run()
    assert both.shells["s"].outcome.sentence == "the device cannot be read: no answer to the question for tick 0"
    assert both.status() == {"m": "refused", "s": "refused"}
    assert "no answer from" in both.shells["m"].outcome.sentence
    assert set(device.held) == {(0.0,)}


# Switches, and the device of the examples


def test_two_machines_of_ones_own_run_live_with_a_clutch_and_again_to_the_bit(pair: Make) -> None:
    """A hand swings a handle, whose thumb holds the clutch open from 0.3 to 0.6 s.

    Without a clock there is no force where the modulus is 0. Live, a tick after many that were left out may hold what
    the slew limit left of it.
    """
    def handle(k: int) -> Reading:
        t = 1e-3 * k
        return Reading((0.02 * sin(6.0 * t),), (0.12 * cos(6.0 * t),), clutch=300 <= k < 600, present=True)

    scene = load_scene("bench_top", law="pp", duration=0.9, needs_clutch=True, needs_present=True, closes_within=0.05)
    names = "f_m", "g_clutch_m", "clutch_m"
    stepped = run_stepped(scene, {"m": lambda _: reading(handle), "s": Carriage})
    _, folders = run_with(pair, scene, m=reading(handle), s=Carriage(scene))
    ends = [read_end(folder, scene) for folder in folders]
    assert [difference(end, scene) for end in ends] == [None, None]
    live, columns = ends[0].record, ends[0].header["columns"][len(OWN):]
    table = live.rows.table(0, len(live.ticks))  # a record that was read has rows
    for zero, ticks, f, g, clutch in (  # from the first of the ticks with a modulus of 0, or by the last
        (0, np.arange(scene.ticks), *[stepped.trace[name] for name in names]),
        (-1, np.asarray(live.ticks), *[table[:, columns.index(name)] for name in names]),
    ):
        inside = (ticks >= 300) & (ticks < 600)
        assert np.array_equal(clutch > 0.0, inside)
        opened = abs(f[inside & (g == 0.0)])
        assert (np.diff(opened) <= 0.0).all()
        assert opened[zero] == 0.0
        assert f[~inside & (ticks > 400)].any()
    told = [one for one in read_events(folders[0]) if one["what"] == "clutch"]
    assert [one["k"] >= at for one, at in zip(told, (300, 600), strict=True)] == [True, True]


@pytest.mark.full
def test_the_device_of_the_examples_is_driven_against_its_stop(
    command: Callable[..., Command], tmp_path: Path
) -> None:
    scene = ["hard_wall", "--set", "duration=2", "--set", "law=direct", "--link", "none", "--json"]
    slave = command("scenarios.examples.device", *scene, "--listen", "127.0.0.1:0", "--out", "s")
    master = command("master", *scene, "--peer", f"127.0.0.1:{slave.port()}", "--out", "m")
    for end in (master, slave):
        code, out, err = end.end()
        assert code == 0, (out, err)
    assert summary(tmp_path / "s")["status"] == "ok"
    with np.load(tmp_path / "s" / "trace.npz") as trace:
        assert trace["x_s"].max() > 0.03, "it came to the stop"
        assert trace["f_env"].max() > 0.5, "which pushed back"


@pytest.mark.full
def test_the_slave_of_a_live_run_is_the_arm_in_mujoco(command: Callable[..., Command], tmp_path: Path) -> None:
    """It presses the wall of its model, the master feels it, and its folder tells how stiff that is."""
    pytest.importorskip("mujoco", reason="mujoco-core is not installed (extra mujoco)")
    own = ["arm", "--set", "duration=2.5", "--set", "delay=0.0", "--json"]
    slave = command("slave", *own, "--robot", "mujoco", "--listen", "127.0.0.1:0", "--out", "s")
    master = command("master", *own, "--peer", f"127.0.0.1:{slave.port()}", "--out", "m")
    assert [each.end()[0] for each in (master, slave)] == [0, 0]
    assert [note for note in summary(tmp_path / "s")["notes"] if note.startswith("pressed slowly before the run")]
    ran = load_result(tmp_path / "s").trace
    assert ran["f_env"][-1, 0] > 2.0
    assert ran["x_s"][-1, 0] == pytest.approx(0.03, abs=1e-3)
    both = merge(scene_of(tmp_path / "m"), tmp_path / "m", tmp_path / "s")
    assert both.status == "ok"
    assert both.trace["f_m"][-1, 0] == pytest.approx(both.trace["f_env"][-1, 0], rel=0.2)


WEIGHTY = """
from dataclasses import replace
from scenarios.bench_top import scene as bench


def scene(*, duration: float = 60.0):
    home = (0.0, 1.0472, -2.0944)
    of = bench(axes=3, units="rad", names="turn,lift,bend", duration=duration, f_max=1.0, m_s=0.02, b_s=0.1, m_m=0.02)
    return replace(of, start_m=home, start_s=home)
"""


def test_in_a_silence_the_arm_stays_where_it_is_and_after_a_stop_its_weight_is_lowered(
    command: Callable[..., Command], tmp_path: Path
) -> None:
    """The master is killed; a second and more later the slave is stopped, its law's force long gone."""
    pytest.importorskip("mujoco", reason="mujoco-core is not installed (extra mujoco)")
    (tmp_path / "weighty.py").write_text(WEIGHTY)
    arm = ROOT / "slave" / "arm.xml"
    slave = command("slave", "weighty.py", "--robot", f"compensated:{arm}?ramp=0.05 | mujoco:{arm}?gravcomp=0",
                    "--listen", "127.0.0.1:0", "--json", "--out", str(tmp_path / "s"))
    master = command("master", "weighty.py", "--peer", f"127.0.0.1:{slave.port()}", "--out", str(tmp_path / "m"))
    slave.live(lambda numbers: numbers["gain"] == 1.0)
    master.signal(signal.SIGKILL)
    began = slave.live(lambda numbers: numbers["gain"] == 0.0)["k"]
    slave.live(lambda numbers: numbers["k"] > began + 1000)  # it falls in a tenth of that
    slave.signal(signal.SIGINT)
    code, _, err = slave.end()
    assert code == 0, err
    assert summary(tmp_path / "s")["status"] == "stopped"
    events = read_events(tmp_path / "s")
    assert any(each["what"] == "safe" for each in events)
    (zero,) = (each["why"] for each in events if each["what"] == "zero")
    lowered = zero.partition("and the arm's weight lowered in ")[2]
    assert 0.04 < float(lowered.removesuffix(" s")) < 2.0, zero  # along its ramp, however late ticks were
    trace: Any = load_result(tmp_path / "s").trace
    settled = trace["t"] > 0.5
    way = trace["x_s"][settled]
    assert abs(way - way[0]).max() < 0.05  # it falls by more than that in 0.1 s
    assert way[0][1] > 0.97


SLOW, OUT, STUCK = 2, 3, 4  # orders to the stand-in: 50 ms in read, unplugged, and in read for ever
STAND_IN = f"""
import time
from pathlib import Path

from teleop import DeviceError, Reading
from teleop.bench.watchdog import Motor


class Arm:
    def __init__(self, scene, path):
        self.motor = Motor(Path(path))

    def read(self, k):
        order = self.motor.order
        if order == {OUT}:
            raise DeviceError("the cable is out")
        time.sleep({{{SLOW}: 0.05, {STUCK}: 1e6}}.get(order, 0.0))
        return Reading((0.0,), (0.0,), (0.0,))

    def hold(self, force):
        self.motor.hold(force[0])

    def close(self):
        raise KeyError("port")
"""


@pytest.fixture
def site(command: Callable[..., Command], tmp_path: Path) -> Callable[..., tuple[Command, Motor]]:
    """A slave with the stand-in for its robot, that pushes."""
    def make(*options: str) -> tuple[Command, Motor]:
        (tmp_path / "arm.py").write_text(STAND_IN)
        motor = Motor(tmp_path / "motor")
        slave = command("slave", *CLAMPED, "--robot", f"arm.py:Arm:{tmp_path / 'motor'}", "--listen", "127.0.0.1:0",
                        "--json", "--out", str(tmp_path / "s"), *options)
        command("master", *CLAMPED, "--peer", f"127.0.0.1:{slave.port()}", "--json", "--out", str(tmp_path / "m"))
        until(lambda: abs(motor.force) > FORCE, "no force came about")
        return slave, motor
    return make


def test_one_that_is_slow_and_then_unplugged_is_safe_says_so_and_comes_back(
    site: Callable[..., Any], tmp_path: Path
) -> None:
    slave, motor = site()
    motor.order = SLOW
    before = motor.holds
    until(lambda: motor.holds > before + 8, "it does not go on")
    motor.order = 0
    until(lambda: abs(motor.force) > FORCE, "no force any more")
    motor.order = OUT
    until(lambda: motor.force == 0.0, "the force stays on while nothing is read")
    motor.order = 0
    until(lambda: abs(motor.force) > FORCE, "the force did not come back")
    slave.signal(signal.SIGTERM)
    code, _, err = slave.end()
    assert code == 1
    assert "the run is over and its folder is whole, and the device did not close: KeyError: 'port'" in err
    assert motor.force == 0.0
    told = summary(tmp_path / "s")
    assert told["slave"]["skipped"] > 8 * 30, "of 50 ticks that each reading took"
    assert any("went by while the device was read, for up to" in note for note in told["notes"])
    whats = [(event["what"], event["why"]) for event in read_events(tmp_path / "s")]
    out = next(i for i, (what, why) in enumerate(whats) if what == "safe" and "the cable is out" in why)
    assert "released" in [what for what, _ in whats[out:]]


def test_one_that_hangs_for_ever_is_set_to_zero_by_the_watchdog_that_was_asked_for(site: Callable[..., Any]) -> None:
    slave, motor = site("--watchdog")
    motor.order = STUCK
    until(lambda: motor.force == 0.0, "the watchdog does not let go")
    slave.signal(signal.SIGINT)  # of two that are the same the system may hand over one
    slave.signal(signal.SIGTERM)
    code, _, err = slave.end()
    assert code != 0
    assert "no heartbeat of the end that drives the device" in err
    assert "its force was set to zero" in err


def test_without_a_watchdog_the_last_resort_lets_go_of_one_that_hangs_at_the_second_signal(
    site: Callable[..., Any], tmp_path: Path
) -> None:
    def stands_still() -> bool:
        before = motor.holds
        time.sleep(0.1)
        return motor.holds == before

    slave, motor = site()
    motor.order = STUCK
    until(stands_still, "it does not hang")
    slave.signal(signal.SIGINT)  # of two that are the same the system may hand over one
    slave.signal(signal.SIGTERM)
    code, _, err = slave.end()
    assert code == 1
    assert "the device has neither a deadline nor a watchdog" in err, "said at its start"
    assert "its device was set to zero force" in err
    assert motor.force == 0.0
    why = load_result(tmp_path / "s").sentence
    assert "asked for a reading, does not return; this is made from its record" in why, "it was \"without a word\""


Service = tuple[subprocess.Popen[str], str]
SERVICE = ROOT / "tests" / "master" / "inverse_stand_in.py"


@pytest.fixture
def service() -> Iterator[Callable[..., Service]]:
    """`service("vector")`: the process of a stand-in of the Inverse service, and its address."""
    pytest.importorskip("websockets", reason="the extra `haply` is not installed")
    started: list[subprocess.Popen[str]] = []

    def start(word: str, port: str = "0") -> Service:
        process = subprocess.Popen([sys.executable, SERVICE, word, port], cwd=ROOT,
                                   env={**os.environ, "PYTHONPATH": str(ROOT)}, stdout=subprocess.PIPE, text=True)
        started.append(process)
        assert process.stdout is not None
        return process, process.stdout.readline().strip()

    yield start
    for one in started:
        one.kill()
        one.communicate()


def with_inverse3(command: Callable[..., Command], url: str, duration: float) -> tuple[Command, Command]:
    """A slave, and a master that drives the Inverse3 at `url`."""
    knobs = "--set", f"duration={duration:g}", "--rate", "250", "--json"
    slave = command("slave", "hard_wall", *knobs, "--listen", "127.0.0.1:0", "--out", "slave")
    master = command("master", "hard_wall", *knobs, "--peer", f"127.0.0.1:{slave.port()}", "--out", "master",
                     "--device", f"haply:{url}?axes=y&origin=0,-0.12,0.15")
    return slave, master


def pushes(service: subprocess.Popen[str], shows: Callable[[float], bool]) -> None:
    """Read on until the stand-in says of its motors' force (N) what `shows`."""
    assert service.stdout is not None
    while not shows(float(service.stdout.readline().split()[1])):
        pass


def test_a_run_with_an_inverse3_by_name(
    service: Callable[..., Service], command: Callable[..., Command], tmp_path: Path
) -> None:
    there, url = service("values")
    slave, master = with_inverse3(command, url, 1.5)
    pushes(there, lambda force: force >= 0.1)  # the hand feels the slave
    for end in (master, slave):
        code, _, err = end.end()
        assert code == 0, err
        assert "holds its last force" not in err  # it has a watchdog
    pushes(there, lambda force: force == 0.0)
    result = load_result(tmp_path / "master")
    assert np.ptp(result.trace["x_m"]) > 0.01  # m: the hand moved, and was read
    assert summary(tmp_path / "master")["status"] == "ok"


def test_a_service_that_is_started_again_in_a_run_is_found_again_and_let_go_of_by_a_master_that_is_killed(
    service: Callable[..., Service], command: Callable[..., Command], tmp_path: Path
) -> None:
    there, url = service("vector")
    _, master = with_inverse3(command, url, 600.0)
    pushes(there, lambda force: force >= 0.1)
    there.kill()
    there.wait()
    there, _ = service("vector", url.rpartition(":")[2])
    pushes(there, lambda force: force >= 0.1)  # by the ramp
    master.signal(signal.SIGKILL)
    pushes(there, lambda force: force == 0.0)
    events = [event for event in read_events(tmp_path / "master") if event["what"] in ("safe", "released")]
    lost = next(i for i, event in enumerate(events) if event["what"] == "safe" and "Inverse service" in event["why"])
    # On a busy machine the link may fall silent in between, too.
    assert "released" in [event["what"] for event in events[:lost]]
    assert "released" in [event["what"] for event in events[lost:]]
