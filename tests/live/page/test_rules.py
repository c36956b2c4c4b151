"""The page without a clock or a socket: who drags, when to turn, when a loop shakes, and the robot from the side."""

from __future__ import annotations

import json
import os
import re
import stat
from importlib.util import find_spec
from math import cos, pi, sin
from pathlib import Path
from socket import socket

import numpy as np
import pytest

from teleop import Refused, load_scene
from teleop.live.page import command
from teleop.live.page.controls import (
    GROUPS,
    HOLDS,
    PATIENCE,
    PROCESSES,
    REST,
    Choice,
    Controls,
    Drag,
    LinkSettings,
    SwitchQueue,
)
from teleop.live.page.page import Page
from teleop.live.page.rows import Extremes, Shaking
from teleop.live.page.server import GARBAGE, HOST, LONGEST, MOST, SECONDS, Allowance, Garbage, hand_position, read
from teleop.live.page.session import PageParts, Start
from teleop.live.page.side_view import SideView
from teleop.live.process.interrupt import Interrupt
from teleop.scene.library import ROOT

FAST = Choice(law="pfra")


def test_of_two_pointers_the_one_that_moved_last_drags_and_one_that_says_nothing_lets_go_after_a_while() -> None:
    drag = Drag()
    drag.move("a", (0.1,), 0.0)
    drag.move("b", (0.2,), 0.1)
    drag.move("a", (0.1,), 0.2)  # still, and says so
    assert drag.target(0.2) == (0.2,)
    drag.move("a", (0.3,), 0.3)
    assert drag.target(0.3) == (0.3,)
    drag.let_go("a")
    assert drag.target(0.3) == (0.2,)
    assert drag.target(0.1 + HOLDS) == (0.2,)
    assert drag.target(0.1 + HOLDS + 0.01) is None


def test_what_a_page_says_beyond_its_share_is_dropped_told_once_and_after_some_seconds_the_page_floods() -> None:
    """One that says as much as it may is heard for ever; one that keeps quiet for a second begins anew."""
    allowed, told = Allowance(), 0
    assert all(allowed.takes(second + i / 1000) for second in range(20) for i in range(MOST))
    assert not allowed.floods
    for second in range(30, 30 + SECONDS + 1):
        assert not allowed.floods
        for i in range(2 * MOST):
            taken = allowed.takes(second + i / 1000)
            assert taken == (i < MOST)
            told += allowed.begins
    assert told == 1
    assert allowed.dropped == (SECONDS + 1) * MOST
    assert allowed.floods
    quiet, warnings = Allowance(), 0
    for second in (0, 1, 2, 3, 4, 6):
        for i in range(2 * MOST):
            warnings += not quiet.takes(second + i / 1000) and quiet.begins
    assert not quiet.floods
    assert warnings == 1, "a machine that stalled for a second warned twice"


GARBAGE_OF: tuple[tuple[str | bytes, str], ...] = (
    (b"\x00", "binary"), ("", "json"), ("[1", "json"), ("[]", "type"), ("{}", "type"), ('{"type": "quit"}', "type"),
    ('{"type": ["hand"]}', "type"), ('{"type": "hand"}', "hand"), ('{"type": "hand", "to": "up"}', "hand"),
    ('{"type": "hand", "to": [NaN]}', "json"), ('{"type": "hand", "to": [1e999]}', "json"),
    ('{"type": "hand", "to": [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]}', "hand"),
    ('{"type": "turn", "b": 3}', "turn"),
    ('{"type": "turn", "delay": "0.1"}', "turn"), ('{"type": "turn", "delay": true}', "turn"),
    ('{"type": "clutch", "open": 1}', "clutch"), ('{"type": "again", "now": true}', "again"),
    ("[" * 2000, "json"), ('{"type": "again", "type": "hand"}', "json"),
)


def test_what_is_no_message_is_garbage_with_a_sentence_told_once_of_each_kind_and_counted() -> None:
    for data, kind in GARBAGE_OF:
        with pytest.raises(Garbage) as caught:
            read(data)
        assert caught.value.kind == kind, data
        assert 10 < len(str(caught.value)) < LONGEST, data
    allowed = Allowance()
    assert [allowed.garbage(kind) for kind in ("json", "json", "type")] == [True, False, True]
    assert not allowed.talks_nonsense
    for _ in range(GARBAGE - 3):
        allowed.garbage("json")
    assert allowed.talks_nonsense
    # A hand goes to a number for each axis within reach.
    assert hand_position([1, -2.5], 2) == (1.0, -2.5)
    for to in ([0.0], [0.0, 11.0], [0.0, 0.0, 0.0]):
        with pytest.raises(Garbage):
            hand_position(to, 2)


def test_one_turn_at_a_time_and_of_what_is_asked_meanwhile_the_newest() -> None:
    switches = SwitchQueue(Choice())
    switches.ask(FAST)
    first = switches.next(1.0)
    assert first is not None
    assert first.choice == FAST
    for k_e in (1.0, 2.0, 3.0):
        switches.ask(switches.wanted._replace(k_e=k_e))
    assert switches.next(1.1) is None
    assert [switches.take_answer(name, 1.2) for name in sorted(PROCESSES)] == [None, None, first]
    assert switches.next(1.2 + REST / 2) is None
    second = switches.next(1.2 + 2 * REST)
    assert second is not None
    assert second.choice == FAST._replace(k_e=3.0)


def test_that_it_is_to_begin_again_is_not_lost_over_a_slider_and_what_is_taken_back_is_no_turn() -> None:
    switches = SwitchQueue(Choice())
    switches.ask(FAST)
    switches.ask(Choice())
    assert switches.next(1.0) is None
    switches.ask(switches.wanted, again=True)
    switches.ask(FAST)
    turn = switches.next(1.0)
    assert turn is not None
    assert turn.again
    assert turn.choice == FAST


def test_a_turn_without_all_answers_is_late_and_given_up_for_what_was_before() -> None:
    switches = SwitchQueue(Choice())
    switches.ask(FAST)
    switches.next(1.0)
    switches.take_answer("channel", 1.1)
    assert not switches.late(1.0 + PATIENCE)
    assert switches.late(1.1 + PATIENCE)
    switches.give_up()
    assert switches.choice == Choice()


def seconds(shaking: Shaking, *swings: tuple[float, float], start: int = 0) -> list[str]:
    """Sixty messages a second, each swing (N) held for one; what is said."""
    said = []
    for i, (low, high) in enumerate(swings):
        for j in range(60):
            forces = {"m": Extremes((low,), (high,)), "s": Extremes((0.0,), (0.0,))}
            said.append(shaking.sentence(start + i + j / 60, forces))
    return [each for each in said if each is not None]


def test_a_force_at_its_cap_again_and_again_is_told_of_and_that_it_is_over_but_not_what_a_person_does() -> None:
    shaking = Shaking([20.0])
    [first, last] = seconds(shaking, *[(0.0, 20.0)] * 5, *[(3.0, 4.0)] * 5)
    assert first.startswith("unstable: ")
    assert "cap" in first
    assert last == "stable again"
    shaking, said = Shaking([20.0]), []
    for i in range(8):
        shaking.note_motion()
        said += seconds(shaking, (-20.0, 20.0), start=i)
    assert said == []


def test_a_slow_swing_between_the_caps_and_one_that_grows_without_a_cap_are_told_of_and_no_others() -> None:
    """Direct reflection over half a second each way swung for ten seconds, and the page said nothing."""
    for slow in ([(0.0, 20.0), (0.0, 0.0)], [(0.0, 20.0), (20.0, 20.0), (0.0, 20.0), (0.0, 0.0)]):
        said = seconds(Shaking([20.0]), *slow * 6, *[(1.0, 1.0)] * 8)
        assert [each.partition(":")[0] for each in said] == ["unstable", "stable again"]
    [grows] = seconds(Shaking([None]), *[(-a, a) for a in (0.3, 0.5, 1.0, 2.0, 4.0, 8.0)])
    assert "more each second" in grows
    for swings in (
        [(3.5, 3.5)] * 8,  # a wall that is pressed
        [(-5.0, 5.0)] * 8,  # a swing that stays, off the cap
        [(20.0, 20.0)] * 8,  # pressed as hard as the cap lets it
        [(-a, a) for a in (0.01, 0.02, 0.04, 0.08, 0.16, 0.3)],  # grows, but is nothing yet
    ):
        assert seconds(Shaking([20.0]), *swings) == [], swings


def test_a_law_takes_its_own_numbers_and_the_scenes_own_law_those_that_were_typed() -> None:
    controls = Controls("hard_wall", {"law.b": "7", "delay": "0.1"})
    other = controls.chosen(Choice(), {"law": "pfra"})
    assert "law.b" not in controls.knobs(other)
    back = controls.chosen(other, {"law": "wave"})
    assert controls.knobs(back)["law.b"] == "7"
    assert controls.scene(back).law.b == 7.0


def test_the_page_turned_back_to_the_scenes_law_without_its_gains_and_showed_none() -> None:
    controls = Controls("hard_wall", {"law": "pfra"})
    first = Choice()
    shown = controls.hello(first, controls.scene(first))
    assert shown["gains"].startswith("pfra(alpha=0, ")
    assert len(shown["notes"]) == 1
    assert "not tuned for scene hard_wall" in shown["notes"][0]
    back = controls.chosen(first, {"law": "wave"})
    shown = controls.hello(back, controls.scene(back))
    assert (shown["gains"], shown["notes"]) == ("wave(b=20, K=1000, B=20)", [])


def test_the_scenes_own_link_stays_until_a_slider_of_it_is_moved() -> None:
    controls = Controls("jittery_wan", {})
    assert "link" not in controls.knobs(controls.chosen(Choice(), {"k_e": 1e3}))
    assert LinkSettings().text == "delay(0.0)", "without what is nothing"
    moved = controls.chosen(Choice(), {"loss": 0.1})
    assert moved.link is not None
    assert controls.knobs(moved)["link"] == "delay(0.04) | uniform(0.02) | bernoulli(0.1)"
    controls.scene(moved)


def test_the_token_is_on_no_command_line_when_the_browser_is_opened(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """All users of the machine see those."""
    started: list[list[str]] = []
    monkeypatch.setattr(command.subprocess, "Popen", lambda words, **_: started.append(words))
    command._listening("secret", way := tmp_path / "way.html", 8123)
    assert "http://127.0.0.1:8123/?token=secret" in way.read_text()
    assert "http://127.0.0.1:8123/?token=secret" in capsys.readouterr().err
    [words] = started
    assert words[-1] == way.as_uri()
    assert "secret" not in " ".join(words)


def test_a_hand_that_would_come_to_rest_swings_in_free_space_and_one_that_goes_on_does_not() -> None:
    """`hard_wall` reaches into its wall and stays there: the page began pressed and still."""
    for name in ("hard_wall", "soft_tissue", "arm", "leader_follower", "pose"):
        controls = Controls(name, {})
        if name == "pose":  # the wall at 40 mm was shown on an axis of 19 m, for the tool switches by 7.6 rad
            spans = controls.hello(Choice(), controls.first)["spans"]
            assert 0.06 <= max(spans[:3]) <= 0.2
            assert max(spans[3:]) > 10.0
        swing, walls = controls.swing, controls.hello(Choice(), controls.first).get("walls")
        if swing is None:
            continue
        for i, (about, by) in enumerate(zip(swing.about, swing.by, strict=True)):
            wall = None if walls is None else walls[i]
            assert 0.0 < by < 0.2 * controls.spans[i], name
            assert wall is None or by < 0.9 * abs(wall - about), f"{name}: short of the wall"
    assert Controls("hard_wall", {}).swing == ((0.0,), pytest.approx((0.018,)))
    assert Controls("hard_wall", {"wall": "-0.02"}).swing == ((0.0,), pytest.approx((0.012,)))
    assert Controls("canonical", {}).swing is None, "its own swing goes on"


def test_the_laws_are_in_the_groups_that_the_first_page_has() -> None:
    rows, group = {}, ""
    for line in (ROOT / "README.md").read_text().partition("### The laws")[2].partition("\n*")[0].splitlines():
        if (head := re.fullmatch(r"\| \| \*\*(.*)\*\* \|", line)) is not None:
            group = head[1]
        elif names := re.findall(r"`(\w+)`", line.split("|")[1] if line.startswith("| `") else ""):
            rows.update(dict.fromkeys(names, group.capitalize()))
    assert len(rows) == 17
    laws = Controls("hard_wall", {}).laws
    assert {law["name"]: law["group"] for law in laws} == {name: rows[name] for name in rows
                                                           if name in {law["name"] for law in laws}}
    assert len(laws) >= 16
    assert [law["group"] for law in laws] == sorted((law["group"] for law in laws), key=GROUPS.index)


def test_a_choice_is_told_in_words() -> None:
    """It was told as `turned: law direct, delay(0.15)`."""
    controls = Controls("hard_wall", {})
    for choice, words in (
        (Choice(law="direct", link=LinkSettings(0.15)), "direct, 150 ms each way"),
        (Choice(link=LinkSettings(0.05, 0.02, 0.01), k_e=500.0),
         "wave, 50 ms each way, up to 20 ms of jitter, 1 % of the packets dropped, stiffness 500 N/m"),
    ):
        assert controls.words(choice, controls.scene(choice)) == words
    bursts = Controls("burst_loss", {})
    assert "gilbert_elliott(" in bursts.words(Choice(), bursts.first), "a link of other effects is told as it is typed"


def test_a_robots_own_model_brings_its_surroundings_and_so_has_no_wall_of_the_scene_and_no_stiffness() -> None:
    hellos = [(controls := Controls("arm", {}, robot)).hello(Choice(), controls.first)
              for robot in (None, "mujoco", "mujoco:mine.xml")]
    assert [hello["wall"] for hello in hellos] == [0.03, 0.03, None]
    assert ["k_e" in [slider["name"] for slider in hello["sliders"]] for hello in hellos] == [True, False, False]


def test_a_page_that_is_started_again_has_the_port_and_the_token_of_the_last_one_for_a_day(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A browser that showed the page before it was started again had to be shown the new address."""
    tmp_path.chmod(0o700)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    port, token = command.page_address(None)
    assert (port, len(token)) == (0, 22)
    with socket() as free:
        free.bind((HOST, 0))
        port = free.getsockname()[1]
        command.begin_page("secret", None, port)
        assert command.page_address(None) != (port, "secret"), "the port is taken"
    file, = tmp_path.rglob("page.json")
    assert [stat.S_IMODE(each.stat().st_mode) for each in (file.parent, file)] == [0o700, 0o600]
    assert command.page_address(None) == command.page_address(port) == (port, "secret")
    assert command.page_address(port + 1)[1] != "secret"
    os.utime(file, (0.0, 0.0))
    assert command.page_address(None)[1] != "secret"
    for damaged in ("", "{", '{"port": 0, "token": "secret"}', '{"port": 80}', "x" * 5000):
        file.write_text(damaged)
        assert command.page_address(None)[0] == 0, damaged


def test_the_page_runs_before_other_work_where_the_system_allows_it_and_gives_that_back(
    monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside a busy machine its rows came eight times in a second."""
    asked: list[int] = []

    def allow(_kind: int, _who: int, priority: int) -> None:
        asked.append(priority)

    def refuse(_kind: int, _who: int, priority: int) -> None:
        if priority < before:
            raise PermissionError(1, "Operation not permitted")

    before = os.getpriority(os.PRIO_PROCESS, 0)
    for system, wanted, given in ((allow, True, [before - 10, before]), (refuse, True, []), (allow, False, [])):
        asked.clear()
        monkeypatch.setattr(os, "setpriority", system)
        with command.before_others(wanted=wanted):
            pass
        assert asked == given


mujoco = pytest.mark.skipif(find_spec("mujoco") is None, reason="the extra `mujoco` is not installed")
SHAPES = """<mujoco><default><geom contype="0" conaffinity="0" mass="0.01"/></default><worldbody>
  <geom type="plane" size="1 1 0.1"/><geom type="box" pos="0.5 0 0.1" size="0.1 0.2 0.05"/>
  <body pos="0 0 0.5"><joint name="base" axis="0 0 1"/><geom type="sphere" size="0.04"/>
  <body><joint name="shoulder" axis="0 -1 0"/><geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/>
  <body pos="0.3 0 0"><joint name="elbow" axis="0 -1 0"/><geom type="box" pos="0.1 0 0" size="0.1 0.01 0.02"/>
  <body pos="0.2 0 0"><joint name="forearm" axis="1 0 0"/><geom type="cylinder" size="0.03 0.05"/>
  <body><joint name="wrist" axis="0 -1 0"/><geom type="ellipsoid" size="0.05 0.01 0.02"/>
  <body><joint name="flange" axis="1 0 0"/><geom type="sphere" size="0.01"/>
  </body></body></body></body></body></body>
</worldbody></mujoco>"""


@mujoco
def test_the_end_of_a_jointed_arm_is_where_its_angles_put_it_and_the_masters_picture_beside_it(tmp_path: Path) -> None:
    file = tmp_path / "six.xml"
    file.write_text(SHAPES)
    view = SideView(load_scene("leader_follower"), f"mujoco:{file}")
    model = view.shapes
    assert [shape["radius"] for shape in model["shapes"]] == [0.04, 0.02, 0.0, 0.0, 0.0, 0.01]
    assert len(model["world"]) == 1, "the box; a plane has no end"
    assert np.ptp(model["world"][0]["points"], axis=0) == pytest.approx([0.2, 0.1])
    rng = np.random.default_rng(3)
    for _ in range(20):
        m, s = rng.uniform(-1.5, 1.5, (2, 6))
        slave, master = view.poses(tuple(m), tuple(s))
        for q, poses in ((s, slave), (m, master)):
            out = 0.3 * cos(q[1]) + 0.2 * cos(q[1] + q[2])
            at = [cos(q[0]) * out, 0.5 + 0.3 * sin(q[1]) + 0.2 * sin(q[1] + q[2])]
            assert poses[-1][6:] == pytest.approx(at, abs=2e-5)
            turned = np.array(poses[2][:6]).reshape(2, 3)  # the box of the forearm
            assert turned @ [1.0, 0.0, 0.0] == pytest.approx(
                [cos(q[0]) * cos(q[1] + q[2]), sin(q[1] + q[2])], abs=2e-5)


@mujoco
def test_the_view_is_of_the_pose_that_the_model_begins_in() -> None:
    """It was of the pose in which a page was opened or a law switched, so each browser had a view of its own."""
    view, controls = SideView(load_scene("arm"), "mujoco"), Controls("arm", {}, "mujoco")
    page = Page(controls, PageParts(Path(), {}), Start("arm", 0), Interrupt(), lambda: 0.0, view)
    before = json.loads(page._hello())["arm"]
    view.poses((0.0, 0.0, 0.0), (0.1, 0.1, 0.1))
    assert json.loads(page._hello())["arm"] == before


@mujoco
def test_the_joints_of_an_arm_whose_end_is_coupled_are_found_for_every_position() -> None:
    """The tip's picture is where the end effector was told to be, from the bundled arm's own numbers."""
    view = SideView(load_scene("arm"), "mujoco")
    t = np.linspace(0.0, 2.0 * pi, 60)
    for x, y, z in np.stack([0.03 * np.sin(t), 0.05 * np.cos(t), -0.04 * np.sin(2.0 * t)], axis=1):
        [poses] = view.poses((0.0, 0.0, 0.0), (x, y, z))
        assert poses[-1][6:] == pytest.approx([0.25 + x, 0.3 + z], abs=1e-4)
    reach = [view.poses((), (10.0, 0.0, 0.0))[0][-1][6:] for _ in range(3)][-1]
    assert 0.45 < np.hypot(reach[0], reach[1] - 0.3) < 0.501, "stretched out towards it, and no further"


@mujoco
def test_outlines_hold_their_shapes(tmp_path: Path) -> None:
    """A cylinder's and an ellipsoid's points lie on them; a mesh's are vertices of it, the furthest ones."""
    file = tmp_path / "six.xml"
    file.write_text(SHAPES)
    shapes = SideView(load_scene("leader_follower"), f"mujoco:{file}").shapes["shapes"]
    x, y, z = np.array(shapes[3]["points"]).T
    assert np.hypot(x, y) == pytest.approx(np.full(len(x), 0.03), abs=1e-4)
    assert set(np.round(np.abs(z), 5)) == {0.05}
    x, y, z = np.array(shapes[4]["points"]).T
    assert (x / 0.05) ** 2 + (y / 0.01) ** 2 + (z / 0.02) ** 2 == pytest.approx(np.ones(len(x)), abs=2e-3)
    corners = "  ".join(f"{a} {b} {c}" for a in (0, 1) for b in (0, 2) for c in (0, 3))
    asset = f'<asset><mesh name="m" vertex="{corners}"/></asset><worldbody>'
    with_mesh = SHAPES.replace('type="sphere" size="0.01"', 'type="mesh" mesh="m"')
    file.write_text(with_mesh.replace("<worldbody>", asset, 1))
    points = SideView(load_scene("leader_follower"), f"mujoco:{file}").shapes["shapes"][-1]["points"]
    assert len(points) == 8
    assert sorted(np.ptp(points, axis=0)) == pytest.approx([1.0, 2.0, 3.0], abs=1e-4)


@mujoco
def test_a_model_without_the_scenes_joints_is_refused_before_anything_starts() -> None:
    with pytest.raises(Refused, match="no joints of"):
        SideView(load_scene("leader_follower"), "mujoco")
