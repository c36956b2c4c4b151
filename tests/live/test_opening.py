"""Devices and robots by name, file or maker; the first mistakes of their authors; and what fails once it runs."""

from __future__ import annotations

import json
import subprocess
import sys
from fractions import Fraction
from functools import partial
from math import inf, nan
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from master.device import SimulatedMaster
from slave.robot import SimulatedSlave
from teleop import DeviceError, DeviceWatchdog, Reading, Refused, Result, Scene, end_main, load_scene, run
from teleop.__main__ import main
from teleop.live.devices.guarded_device import DEAD_NS, GuardedDevice, deadline_of
from teleop.live.devices.opening import find_device, open_device
from teleop.naming import DEVICE_KINDS
from teleop.protocol.endpoint import Endpoint, Stepped
from teleop.protocol.session import Session
from teleop.scene.catalogue import device_line
from teleop.scene.library import ROOT
from teleop.simulation.result import read_result
from tests.fakes import WELL, Body, always, raising, reading

SCENE = load_scene("hard_wall", duration=0.1)


class Robot(Body):
    """A device with nothing wrong, and each below with one mistake."""


class NoHold:
    read = Body.read


class OtherName(NoHold):
    set_force = Body.hold


class TakesNothing(Robot):
    def read(self) -> Reading:
        return Reading((0.0,), (0.0,))


class Waits(Robot):
    async def read(self, k: int) -> Reading:
        return Reading((0.0,), (0.0,))


class Watched(Robot):
    watchdog = "my_arm:zeroing"


class OfNoScene(Robot):
    def __init__(self) -> None:
        pass


@pytest.mark.parametrize(("make", "words"), [
    (Robot(None), ["and was given", 'end_main("s", Robot)']),
    (OfNoScene, ["OfNoScene is called as OfNoScene(scene), and cannot be", "written as OfNoScene()"]),
    (lambda _scene: None, ["gave None, which has no read(k)", "an object with read(k) and hold(force)"]),
    (lambda _scene: NoHold(), ["which has no hold(force)"]),
    (lambda _scene: OtherName(), ["which has no hold(force)"]),
    (lambda _scene: Robot, ["gave the class Robot"]),
    (TakesNothing, ["TakesNothing.read is called as read(k), and cannot be: too many positional arguments",
                    "written as read() -> "]),
    (Waits, ["Waits.read is a coroutine", "write def read(self, k), without async"]),
    (Watched, ["is a DeviceWatchdog, not 'my_arm:zeroing'", 'DeviceWatchdog(open="my_arm:zeroing")']),
    (raising(DeviceError("no such port")), ["the device cannot be opened: no such port"]),
    (raising(FileNotFoundError(2, "No such file or directory", "/dev/arm")), ["cannot be opened", "/dev/arm"]),
    (raising(DeviceError()), ["cannot be opened: DeviceError"]),
    (raising(ZeroDivisionError("by what")), ["call(scene), which makes the device, raised ZeroDivisionError: by what",
                                            "fakes.py:"]),
    (raising(SystemExit(0)), ["call(scene), which makes the device, raised SystemExit: 0"]),
    (partial(Robot, deadline=-1.0), ["a device's deadline must be above 0 s, not -1; write for example deadline=1"]),
    (raising(Refused("take a scene of one axis")), ["take a scene of one axis"]),
], ids=lambda each: each[0] if isinstance(each, list) else "")
def test_what_is_no_device_was_a_traceback_or_ended_a_session_that_had_begun(make: Any, words: list[str]) -> None:
    with pytest.raises(Refused) as refused:
        open_device(make, SCENE)
    for each in words:
        assert each in str(refused.value)


class Wrapped(Robot):
    read = None

    def __init__(self, scene: object) -> None:
        self.read = partial(Robot.read, self)
        self.watchdog = DeviceWatchdog(open="my_arm:zeroing")
        del scene


@pytest.mark.parametrize("make", [Robot, Wrapped, SimulatedSlave, lambda scene, port="/dev/arm": Robot((scene, port))],
                         ids=["a class", "a class around another", "a class of the package", "a function"])
def test_what_can_be_called_is_taken_as_it_is(make: Any) -> None:
    assert open_device(make, SCENE) is not None


def test_the_carriage_of_the_examples_in_a_scene_of_three_axes_was_a_traceback_and_an_end_of_neither_kind_is_a_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert end_main("slave", Robot, ["hard_wall"]) == 2
    assert "\"s\" for the slave's, not 'slave'" in capsys.readouterr().err
    done = subprocess.run(
        [sys.executable, str(ROOT / "scenarios" / "examples" / "device.py"), "recorded_reach", "--listen",
         "127.0.0.1:0"], cwd=tmp_path, env={"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr == ("teleop: the device cannot be opened: the carriage has one axis, the scene 3; take a scene "
                           "of one axis\n")
    assert list(tmp_path.iterdir()) == []


ARM = """
from teleop import Reading


class Arm:
    deadline = 0.1

    def __init__(self, scene, port="none"):
        self.port = port

    def read(self, k):
        return Reading((0.5,), (0.0,))

    def hold(self, force):
        pass
"""


def test_every_built_in_one_has_a_sentence_that_is_read_without_importing_it_and_is_listed_with_its_options(
    capsys: pytest.CaptureFixture[str]
) -> None:
    for e in "ms":
        for name, place in DEVICE_KINDS[e].built_in.items():
            line = device_line(e, name, place)
            assert line.endswith("."), name
            assert "plug-in" not in line, name
    assert main(["list", "csv"]) == 0
    told = capsys.readouterr().out
    assert "--device csv  A recorded motion of a master" in told
    assert "--robot csv   A recorded motion of a slave" in told


def test_a_built_in_robot_is_opened_by_its_name_and_a_file_of_ones_own_by_its_class_or_without_and_with_an_argument(
    tmp_path: Path
) -> None:
    assert isinstance(find_device("s", "simulated").open(SCENE), SimulatedSlave)
    file = tmp_path / "arm.py"
    file.write_text(ARM)
    assert find_device("m", str(file)).open(SCENE).read(0) == Reading((0.5,), (0.0,))
    assert find_device("m", f"{file}:Arm:/dev/ttyACM0").open(SCENE).port == "/dev/ttyACM0"
    assert find_device("s", f"{file}:Arm").open(SCENE).port == "none"


ONE = load_scene("hard_wall", duration=1.0, delay=0.01)
THREE = load_scene("recorded_reach", duration=1.0, delay=0.01)


def exported(scene: Scene, folder: Path) -> Result:
    """A run of `scene`, which is `run.csv` in the folder."""
    result = run(scene)
    (folder / "run").mkdir()
    result.write(folder / "run", [])
    assert main(["export", str(folder / "run"), "--csv", str(folder / "run.csv")]) == 0
    return result


@pytest.mark.parametrize(("scene", "e", "force"), [(ONE, "m", "f_h"), (ONE, "s", "f_env"), (THREE, "s", "f_env")])
def test_what_was_exported_is_read_again_to_the_bit_at_every_tick(
    scene: Scene, e: str, force: str, tmp_path: Path
) -> None:
    result = exported(scene, tmp_path)
    device = find_device(e, f"csv:{tmp_path / 'run.csv'}").open(scene)
    x, v, f = (result.trace[name].reshape(len(result.trace["t"]), -1) for name in (f"x_{e}", f"v_{e}", force))
    device.hold((5.0,) * x.shape[1])
    assert x.any()
    for k in range(len(x)):
        assert device.read(k) == Reading(tuple(x[k]), tuple(v[k]), tuple(f[k]))


def test_a_recorded_reach_has_the_slope_behind_each_row_for_its_velocity_and_rests_at_its_ends(tmp_path: Path) -> None:
    (tmp_path / "reach.csv").write_text("# by hand\nt, x\n0.010, 1\n0.020, 2\n0.040, 3\n")
    device = find_device("m", f"csv:{tmp_path / 'reach.csv'}").open(ONE)
    got = [(k, device.read(k).x[0], device.read(k).v[0]) for k in (0, 10, 15, 20, 30, 40, 41)]
    assert got == [(0, 1.0, 0.0), (10, 1.0, 0.0), (15, pytest.approx(1.5), pytest.approx(100.0)),
                   (20, 2.0, pytest.approx(100.0)), (30, pytest.approx(2.5), pytest.approx(50.0)),
                   (40, 3.0, pytest.approx(50.0)), (41, 3.0, 0.0)]
    assert device.read(15).f is None


NO_MOTIONS = [
    ("", ONE, "holds no motion"), ("t,x\n", ONE, "has names of columns and no row"),
    ("t,x,y\n0,1,2\n", ONE, "holds a motion along 2 axes, and the scene has 1 (x); take a scene of 2"),
    ("0,1,2\n", ONE, "holds a motion along 2 axes"),
    ("t,x_m,v_m\n0,1,2\n", THREE, "holds a motion along 1 axis, and the scene has 3 (x, y, z)"),
    ("t,x_s,v_s\n0,1,2\n", ONE, "has the slave's motion, x_s, and none of this end, x_m"),
    ("t,x_m_a,x_m_b,x_m_c\n0,1,2,3\n", THREE, "has the axes x_m_a, x_m_b, x_m_c, and the scene's are x_m_x"),
    ("time,x\n0,1\n", ONE, "has no column t, the time in s; it has time, x"),
    ("t,q\n0,1\n", ONE, "has no column x_m, nor x; it has t, q"),
    ("part,t,x_m\n1,0,1\n", ONE, "has several parts of a run"),
    ("t,x\n0,1\n0,2\n", ONE, "line 3: t = 0 s does not come after 0 s"),
    ("t,x\n0,1\n1,\n", ONE, "line 3 has nothing in its column x"), ("t,x\n0,1\n1\n", ONE, "line 3 has nothing"),
    ("t,x\n0,NaN\n", ONE, "line 2: x is 'NaN' and no finite number"), ("t,x\n0,far\n", ONE, "x is 'far'"),
    ("t,x_m_x,x_m_y,x_m_z,v_m_x\n0,1,2,3,4\n", THREE, "has v_m_x and no v_m_y and v_m_z"),
]


def test_a_file_that_is_no_such_motion_is_refused(tmp_path: Path) -> None:
    for text, scene, words in NO_MOTIONS:
        (tmp_path / "it.csv").write_text(text)
        with pytest.raises(Refused) as refused:
            find_device("m", f"csv:{tmp_path / 'it.csv'}").open(scene)
        assert words in str(refused.value)


def test_a_motion_in_rad_is_not_played_along_an_axis_in_m(tmp_path: Path) -> None:
    """Six joints were played as metres: what an export has beside it was not read."""
    joints = load_scene("leader_follower", duration=0.1)
    exported(joints, tmp_path)
    text = f"csv:{tmp_path / 'run.csv'}"
    assert find_device("m", text).open(joints).read(0).x == (0.0,) * 6
    with pytest.raises(Refused, match="has x_m_base in rad, and that axis of the scene is in m; take the scene"):
        find_device("m", text).open(load_scene("bench_top", axes=6, names=",".join(joints.axis_names)))
    (tmp_path / "run.csv-metadata.json").write_text("[1")
    find_device("m", text).open(load_scene("bench_top", axes=6, names=",".join(joints.axis_names)))


ROUGH = ["--set", "duration=0.3", "--link", "delay(0.02) | uniform(0.01) | bernoulli(0.1)", "--seed", "3"]


def ran(capsys: pytest.CaptureFixture[str], out: Path, *words: str) -> dict[str, Any]:
    """The summary that `teleop run` prints."""
    assert main(["run", *words, "--out", str(out), "--json"]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def test_with_the_simulated_ones_named_it_is_the_run_without_a_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plain = ran(capsys, tmp_path / "plain", "arm", *ROUGH)
    named = ran(capsys, tmp_path / "named", "arm", *ROUGH, "--device", "simulated", "--robot", "simulated")
    own = ("command", "run_time", "path")
    assert {k: v for k, v in named.items() if k not in own} == {k: v for k, v in plain.items() if k not in own}
    one, other = (read_result(tmp_path / name).trace for name in ("plain", "named"))
    assert list(one) == list(other)
    assert all(one[name].tobytes() == other[name].tobytes() for name in one)


def test_a_robot_in_mujoco_leaves_a_folder_as_every_run_does_and_one_of_no_file_is_refused_in_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("mujoco", reason="mujoco-core is not installed (extra mujoco)")
    summary = ran(capsys, tmp_path / "run", "arm", *ROUGH, "--robot", "mujoco")
    assert (summary["status"], summary["mode"], summary["robot"], summary["ticks"]) == ("ok", "virtual", "mujoco", 300)
    assert summary["notes"][0].startswith("pressed slowly before the run along +x")
    assert read_result(tmp_path / "run").trace["f_env"].shape == (300, 3)
    assert main(["report", str(tmp_path / "run"), "--html", str(tmp_path / "page.html")]) == 0
    assert "pressed slowly" in (tmp_path / "page.html").read_text()
    capsys.readouterr()
    assert main(["run", "arm", "--robot", "mujoco:none.xml", "--out", str(tmp_path / "out")]) == 2
    assert "there is no file none.xml; write --robot mujoco:FILE.xml" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


MS = 1_000_000
X = ((0.0,), (0.0,))
SWITCHED = Reading(*X, clutch=True)


@pytest.mark.parametrize("first", [WELL, WELL._replace(f=None), SWITCHED, Reading(*X)], ids=["f", "no f", "clutch", ""])
def test_what_cannot_be_read_or_is_not_finite_is_no_reading(first: Reading) -> None:
    """And neither is a reading in which a sensor or a switch comes or goes: it was a TypeError."""
    wrong: dict[Any, str] = {
        Reading((0.0,), (nan,), None): "", Reading((0.0,), (inf,), None): "", Reading((nan,), (0.0,), None): "",
        Reading((0.0,), (0.0,), (nan,)): "", Reading((0.0,), (0.0,), (-inf,)): "",
        Reading((0.0, nan), (0.0, 0.0), None): "", DeviceError("the encoder is gone"): "the encoder is gone",
        OSError(5, "Input/output error"): "Input/output error",
        first._replace(f=None if first.f else (0.3,)): "a device has a force sensor or none",
        first._replace(clutch=1): "clutch", first._replace(clutch=None if first.clutch else False): "clutch",
        first._replace(present=False): "present",
    }
    for bad, words in wrong.items():
        device = reading(first)
        guarded = GuardedDevice(device, 1)
        assert guarded.read(0, 0) == first
        device.reads = always(bad)
        assert guarded.read(1, MS) is None, bad
        assert words in str(guarded.trouble), bad
        device.reads = always(first)
        assert guarded.read(2, 2 * MS) == first, bad
        assert guarded.trouble is None


def test_huge_numbers_a_body_that_has_left_and_a_trusted_device_are_taken_as_they_are() -> None:
    """Finite numbers may have no finite sum; where a body is at infinity is for the run to judge."""
    huge, left = Reading((1.7e308,), (1.7e308,), (1.7e308,)), Reading((inf,), (0.0,), None)
    for far in (huge, left, WELL):
        guarded = GuardedDevice(reading(far), 1)
        assert guarded.read(0, 0) is far, "and costs no copy"
        assert guarded.read(1, MS) is far
        assert guarded.trouble is None
    blind = Reading((nan,), (nan,), None)
    assert GuardedDevice(reading(blind), 1, trusted=True).read(0, 0) is blind


def test_a_device_that_cannot_hold_is_in_trouble_until_it_can_and_one_that_never_had_a_force_is_asked_once() -> None:
    device = reading(holds=raising(DeviceError("the amplifier is off")))
    guarded = GuardedDevice(device, 1)
    guarded.hold((1.0, 2.0))
    assert guarded.read(1, MS) == WELL, "it can still be read"
    assert guarded.trouble == "the amplifier is off"
    device.holds = None
    guarded.let_go()
    assert device.held == [(0.0,)]
    assert guarded.read(2, 2 * MS) == WELL
    assert guarded.trouble is None
    guarded = GuardedDevice(reading(holds=raising(OSError("no such device"))), 1)
    assert not guarded.let_go()
    assert not guarded.forced


def test_a_device_that_fails_for_long_is_given_up_one_that_comes_back_is_not_and_a_bug_is_not_swallowed() -> None:
    device = reading()
    guarded = GuardedDevice(device, 1)
    guarded.read(0, 0)
    device.reads = always(OSError("gone"))
    first = 10 * DEAD_NS  # however long nobody asked it: before the first exchange an end may wait for hours
    guarded.read(1, first)
    assert not guarded.dead(first + DEAD_NS)
    guarded.read(2, first + DEAD_NS + 1)
    assert guarded.dead(first + DEAD_NS + 1)
    device.reads = always(WELL)
    guarded.read(3, first + DEAD_NS + 2)
    assert not guarded.dead(first + DEAD_NS + 2)
    with pytest.raises(ZeroDivisionError):
        GuardedDevice(reading(ZeroDivisionError()), 1).read(0, 0)


def test_numbers_of_any_real_type_are_read_as_floats_and_truths_of_numpys_as_truths() -> None:
    for number in (int, np.float32, np.float16, np.int16, np.float64, Fraction):
        for trusted in (False, True):
            device = reading(Reading((number(1),), (number(-2),), (number(3),)))
            found = GuardedDevice(device, 1, trusted=trusted).read(0, 0)
            assert found == Reading((1.0,), (-2.0,), (3.0,)), number
            assert {type(part[0]) for part in found if isinstance(part, tuple)} == {float}, number
    far = reading(Reading((10**400,), (0,), None))
    assert GuardedDevice(far, 1).read(0, 0) == Reading((inf,), (0.0,), None), "a body that has left"
    switched: Any = Reading(*X, clutch=np.bool_(True), present=np.bool_(False))
    found = GuardedDevice(reading(switched), 1).read(0, 0)
    assert found is not None
    assert (found.clutch, found.present, type(found.present)) == (True, False, bool)


@pytest.mark.parametrize("wrong", [True, np.bool_(True), "1.0", None, 1j, (1.0,), np.array([1.0]), b"1"], ids=repr)
def test_what_is_no_number_is_refused_at_first_and_no_reading_later(wrong: Any) -> None:
    well = (0.0,)
    for bad in (Reading((wrong,), well, None), Reading(well, (wrong,), None), Reading(well, well, (wrong,))):
        with pytest.raises(Refused, match=r"each a tuple with a number for each axis.*write for example"):
            GuardedDevice(reading(bad), 1).read(0, 0)
        device = reading()
        guarded = GuardedDevice(device, 1)
        assert guarded.read(0, 0) == WELL
        device.reads = always(bad)
        assert guarded.read(1, MS) is None
        assert "a number for each axis" in str(guarded.trouble)


def test_a_device_that_reads_something_else_is_told_so_at_once_and_how_to_write_it() -> None:
    cases: list[tuple[int, Any, str]] = [
        (1, Reading(0.0, 0.0, None), r"Reading\(\(x,\), \(v,\), None\)"),
        (1, ((0.0,), (0.0,), None), "tuple"), (1, None, "gave None"), (1, Reading((0.0,), (0.0, 0.0), None), "here 1"),
        (3, Reading((0.0,) * 3, (0.0,) * 3, (0.0,)), r"Reading\(\(x, x2, x3\), \(v, v2, v3\), "),
        (1, Reading(*X, clutch="open"), "clutch=True"),
    ]
    for axes, wrong, words in cases:
        with pytest.raises(Refused, match=words):
            GuardedDevice(reading(wrong), axes).read(0, 0)


def test_an_end_that_would_renew_the_force_too_seldom_for_its_device_is_refused_and_a_deadline_of_no_time() -> None:
    for dt, every, stepped, refused in ((1e-3, 1, False, False), (1e-3, 75, False, False), (1e-3, 80, False, True),
                                        (0.1, 1, False, True), (0.1, 1, True, False)):
        scene = load_scene("free_motion", dt=dt)
        simulated = SimulatedMaster(scene)
        session = Session(master=True, manifest={}, number=1, every=every)
        end = Endpoint(scene, "m", session, Stepped(None) if stepped else None)
        if refused:
            with pytest.raises(Refused, match=r"lapses after 0.15 s.*every 0.(08|1) s; tick at least every 0.075 s"):
                deadline_of(simulated, end)
        else:
            assert deadline_of(simulated, end) == (None if stepped else simulated.deadline)
    end = Endpoint(load_scene("free_motion"), "m", Session(master=True, manifest={}, number=1))
    device = reading()
    device.deadline = None
    assert deadline_of(device, end) is None
    device.deadline = 0.0
    with pytest.raises(Refused, match="deadline must be above 0"):
        deadline_of(device, end)
