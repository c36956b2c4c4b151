"""Orders to running ends: a turn, the clutch, a policy that takes over; one run tells of all turns."""

from __future__ import annotations

import os
import signal
import time
from contextlib import suppress
from itertools import count, pairwise
from pathlib import Path
from threading import Event, Thread
from typing import Any

import numpy as np
import pytest

from master.hand_record import HandRecording
from teleop import PolicyWriter, Refused
from teleop.__main__ import main
from teleop.live.orders import OF_THE_RELAY, SHAPES, Orders
from teleop.live.policy_page import NAME, PolicyPage
from teleop.live.records.merge import load_result, merge, scene_of
from teleop.live.records.reader import FILE, IDLE, GrowingRecord
from teleop.live.records.record import read_events
from teleop.protocol.policy import SAYS, PolicyWord
from teleop.stages.authority import Standing
from tests.live.ordered import Ordered
from tests.waiting import until

pytestmark = pytest.mark.live
KNOBS = {"duration": "86400", "clutch_ramp": "0.05"}
ENDS = {"m": "master", "s": "slave"}


class Story:
    """What was ordered of one run, and the folders of its parts by what they were turned to."""

    def __init__(self, out: Path) -> None:
        self.parts: dict[str, Path] = {"start": out / "01"}
        self.clutch: dict[str, int] = {}
        run = self.run = Ordered("hard_wall", out, KNOBS)
        try:
            run.happens("ms", "met")
            run.live("s", lambda event: event["f"] > 1.0)  # the hand presses the wall
            since = run.now()
            self.wall = run.live("s", lambda event: event["f"] > 1.0)["x"]
            self.parts["pp"] = run.turn(align=self.wall, law="wave_position", link="delay(0.02) | uniform(0.01)")
            run.happens("ms", "released", since)
            self.pressed = run.live("m", lambda event: event["f"] > 1.0)
            self.rescale(run)
            run.order("m", order="hand", to=[-0.02])
            self.moved = run.live("m", lambda event: event["x"] < -0.005)
            self.halves(run)
            self.pause(run)
            self.refuse(run)
            self.idle(run)
            since = run.now()
            run.turn(law="wave")
            run.turn(law="p_d")
            self.parts["newest"] = run.turn(again=True, law="wave", k_e="500")
            run.happens("ms", "turned", since)
            run.event("m", lambda event: event["event"] == "turned" and event["out"].startswith(
                str(self.parts["newest"])), since["m"])
            since = run.now()
            run.happens("ms", "released", since)
        finally:
            run.close()

    def rescale(self, run: Ordered) -> None:
        """The scale is changed while the hand presses the wall, and what is none is refused."""
        since = run.now()
        run.order("m", order="scale", to=2.0)
        run.happens("m", "scale", since)
        run.live("m", lambda event: event["k"] > self.pressed["k"] + 800)  # it takes half a second
        self.met_by_scale = [each for e in "ms" for each in run.events[e][since[e]:] if each.get("what") == "met"]
        since = run.now()
        run.order("m", order="scale", to=0.0)
        run.order("s", order="scale", to=0.5)
        run.event("m", lambda event: "to hold the slave open the clutch" in event.get("sentence", ""), since["m"])
        run.event("s", lambda event: "a scale is set at a master" in event.get("sentence", ""), since["s"])

    def halves(self, run: Ordered) -> None:
        """One end is turned, and the other well after it."""
        since = run.now()
        self.parts["halves"] = run.turn("cm", law="pd_d")
        run.happens("m", "turned", since)
        self.alone = [each for each in run.events["m"][since["m"]:] if each.get("what") == "met"]
        run.turn("s", law="pd_d")
        run.happens("ms", "released", since)

    def pause(self, run: Ordered) -> None:
        """The clutch is opened, and closed again."""
        since = run.now()
        run.order("ms", order="clutch", open=True)
        run.happens("ms", "safe", since)
        since = run.now()
        for e in "ms":
            self.clutch[f"open {e}"] = run.event(e, lambda event: event["event"] == "live", since[e])["k"]
            quiet = run.event(e, lambda event, e=e: event["event"] == "live" and (  # a lambda
                event["k"] > self.clutch[f"open {e}"] + 200), since[e])
            self.clutch[f"close {e}"] = quiet["k"]
            assert quiet["f"] == 0.0
        self.met_while_open = [each for e in "ms" for each in run.events[e][since[e]:] if each.get("what") == "met"]
        run.order("ms", order="clutch", open=False)
        run.happens("ms", "released", since)

    def idle(self, run: Ordered) -> None:
        """The records end while the run goes on, until the turn that follows."""
        run.order("ms", order="idle")
        folder = self.idled = self.parts["halves"]
        until(lambda: all((folder / end / IDLE).is_file() for end in ENDS.values()), "an end writes on")
        self.sizes = {end: (folder / end / FILE).stat().st_size for end in ENDS.values()}
        since = run.now()
        self.idle_from = {e: run.event(e, lambda event: event["event"] == "live", since[e])["k"] for e in "ms"}
        followers = [GrowingRecord(folder / end, IDLE) for end in ENDS.values()]
        self.followed = [0, 0]
        for i, one in enumerate(followers):
            until(lambda i=i, one=one: self._follow(i, one) > 100, "no row can be followed")
            one.close()

    def _follow(self, i: int, one: GrowingRecord) -> int:
        self.followed[i] += len(one.read())
        return self.followed[i]

    def refuse(self, run: Ordered) -> None:
        """Orders that cannot be carried out, and lines that are none."""
        since = run.now()
        run.order("ms", order="turn", knobs={**KNOBS, "law": "no_such_law"}, out="nowhere")
        run.order("ms", order="turn", knobs={**KNOBS, "dt": "0.002"}, out="nowhere")
        run.order("c", order="turn", knobs={"law": "no_such_law"})
        run.order("m", '{"order": "fly"}')
        run.order("s", "what is this")
        run.happens("c", "refused", since)
        for e in "ms":
            run.event(e, lambda event: "no_such_law" in event.get("sentence", ""), since[e])
            run.event(e, lambda event: "a turn keeps the tick" in event.get("sentence", ""), since[e])
        run.happens("ms", "released", since)  # the ends go on with what they had
        since = run.now()
        run.order("s", order="turn", knobs={**KNOBS, "k_e": "1e308"}, out="nowhere")  # which its device refuses
        run.event("s", lambda event: "no finite step" in event.get("sentence", ""), since["s"])
        run.happens("ms", "released", since)


@pytest.fixture(scope="module")
def story(tmp_path_factory: pytest.TempPathFactory) -> Story:
    return Story(tmp_path_factory.mktemp("turned"))


def _column(folder: Path, name: str) -> tuple[Any, Any]:
    trace = load_result(folder).trace
    return np.rint(np.asarray(trace["t"]) * 1e3).astype(int), np.asarray(trace[name])


@pytest.mark.full
def test_an_end_that_is_told_to_be_idle_ends_its_record_and_the_next_turn_begins_another(story: Story) -> None:
    for e, end in ENDS.items():
        assert (story.idled / end / FILE).stat().st_size == story.sizes[end]
        assert not (story.idled / end / IDLE).exists(), "it is gone with the turn"
        ticks = _column(story.idled / end, "t")[0]
        assert ticks[-1] < story.idle_from[e]
        assert np.isfinite(_column(story.idled / end, f"x_{e}")[1]).all()
    assert main(["replay", str(story.idled / "master")]) == 0, "what is there is whole"


def test_each_turn_has_a_record_of_its_own_and_says_what_it_was_turned_to(story: Story) -> None:
    for name, law in (("start", "Wave("), ("pp", "WavePosition("), ("halves", "PdD"), ("newest", "Wave(")):
        for end in ("master", "slave"):
            scene = scene_of(story.parts[name] / end)
            assert str(scene.law).lower().replace("_", "").startswith(law.lower()), name
    assert scene_of(story.parts["newest"] / "slave").knobs["k_e"] == 500.0
    last = [each for each in read_events(story.parts["start"] / "master") if each["what"] == "turned"]
    assert "law=wave_position" in last[0]["why"]


def test_the_parts_follow_each_other_on_one_grid_of_ticks_and_what_begins_again_begins_where_the_scene_does(
    story: Story
) -> None:
    for e, end in ENDS.items():
        spans = [_column(folder / end, "t")[0] for folder in sorted(story.run.out.iterdir()) if (folder / end).is_dir()]
        for before, after in pairwise(spans):
            assert before[-1] < after[0]
        assert _column(story.parts["newest"] / end, f"x_{e}")[1][0] == 0.0


def test_a_master_that_is_brought_to_the_slave_feels_the_wall_again_and_its_hand_goes_where_it_is_ordered_to(
    story: Story
) -> None:
    begun = [each["k"] for each in read_events(story.parts["pp"] / "master") if each["what"] == "session"][-1]
    ticks, x = _column(story.parts["pp"] / "master", "x_m")
    assert abs(x[np.searchsorted(ticks, begun)] - story.wall) < 2e-3  # the slave goes on a little meanwhile
    assert story.pressed["f"] > 1.0
    assert story.moved["x"] < -0.005


def test_what_the_hand_did_is_written_down_from_the_first_tick_of_each_part_to_the_last(story: Story) -> None:
    for folder in sorted(story.run.out.iterdir()):
        if (folder / "master" / "record.bin").is_file():
            data = (folder / "master" / "hand.bin").read_bytes()
            rows = np.frombuffer(data[data.index(b"\n") + 1:], dtype="<f8").reshape(-1, 2)
            ticks = _column(folder / "master", "t")[0]
            assert rows[0, 0] <= ticks[0]
            assert rows[-1, 0] >= ticks[-1]
            np.testing.assert_array_equal(np.diff(rows[:, 0]), 1.0)
    assert HandRecording(str(story.parts["pp"])).ticks > 100


def test_the_force_is_zero_at_a_turn_and_no_step_is_more_than_the_slew_limit(story: Story) -> None:
    for e, end in ENDS.items():
        last = 0.0
        for folder in sorted(story.run.out.iterdir()):
            ticks, force = _column(folder / end, f"f_{e}")
            if folder.name != "01":
                assert last == force[0] == 0.0
            steps = np.abs(np.diff(force)) / np.diff(ticks)  # N a tick, ticks that were left out counted
            assert steps.max(initial=0.0) <= 2.0 + 1e-9  # 2000 N/s
            ended = folder.name not in (f"{story.run.part:02}", story.idled.name)  # at a turn
            last = force[-1] if ended else 0.0


def test_the_law_of_every_part_is_replayed_to_the_bit_and_its_two_records_make_one_run(story: Story) -> None:
    for name in ("start", "pp", "halves", "newest"):
        master, slave = (story.parts[name] / end for end in ENDS.values())
        assert main(["replay", str(master), str(slave)]) == 0, name
        result = merge(scene_of(master), master, slave)
        assert result.status == "ok" if name != "newest" else "stopped"
        assert len(result.trace["t"]) > 100
        assert name != "pp" or "was turned to" in result.sentence


def test_a_scale_is_changed_without_a_session_gradually_and_stays_with_the_next_law(story: Story) -> None:
    assert story.met_by_scale == []
    _, scale = _column(story.parts["pp"] / "master", "scale_m")
    assert scale[0] == 1.0
    assert scale[-1] == 2.0
    assert np.diff(np.log2(scale)).max() <= 0.01 * 1.5, "half a second, but for skipped ticks"
    _, after = _column(story.parts["halves"] / "master", "scale_m")
    assert set(after.tolist()) == {2.0}


def test_no_session_begins_before_both_are_turned_and_no_force_while_the_clutch_is_open_and_positions_count_anew_then(
    story: Story
) -> None:
    assert story.alone == []
    assert story.met_while_open == []
    for e, end in ENDS.items():
        ticks, force = _column(story.parts["halves"] / end, f"f_{e}")
        # the ramp takes 50 ticks
        inside = (ticks > story.clutch[f"open {e}"] + 60) & (ticks < story.clutch[f"close {e}"])
        assert np.count_nonzero(inside) > 10
        assert not force[inside].any()
        begun = [each["k"] for each in read_events(story.parts["halves"] / end) if each["what"] == "session"]
        assert any(k > story.clutch[f"close {e}"] for k in begun)


def test_a_master_whose_orders_end_leaves_in_order(story: Story) -> None:
    for who in "ms":
        done = story.run.event(who, lambda event: event["event"] == "done")
        assert done["summary"]["status"] == "stopped"
    assert story.run.processes["m"].returncode == 0
    assert "gave it orders" in story.run.event("m", lambda event: event["event"] == "done")["summary"]["sentence"]


def standing() -> int:
    """A clock that stands still: orders are bounded by their number alone."""
    return 0


def _taken(lines: bytes, shapes: dict[str, Any] = SHAPES) -> list[dict[str, Any]]:
    reads, writes = os.pipe()
    got: list[dict[str, Any]] = []
    orders = Orders(shapes, got.append, reads)
    try:
        orders.read(standing)  # there is nothing yet
        for i in range(0, len(lines), 7):  # in pieces, as a pipe may give them
            os.write(writes, lines[i : i + 7])
            orders.read(standing)
        assert not orders.over
        os.close(writes)
        orders.read(standing)
        assert orders.over
    finally:
        os.close(reads)
    return got


def test_orders_come_whole_however_the_pipe_cuts_them_and_a_line_that_is_none_is_refused_in_a_sentence(
    capsys: pytest.CaptureFixture[str]
) -> None:
    lines = b'{"order": "hand", "to": [0.01]}\n{"order": "hand", "to": null}\n{"order": "clutch", "open": true}\n'
    assert [each["order"] for each in _taken(lines)] == ["hand", "hand", "clutch"]
    of_the_relay = b'{"order": "turn", "knobs": {"delay": "0.1"}}\n'
    assert _taken(of_the_relay, OF_THE_RELAY)[0]["knobs"] == {"delay": "0.1"}, "without a folder"
    for line in (
        b"{", b"[]", b"null", b'{"order": 3}', b'{"order": "hand"}', b'{"order": "hand", "to": ["x"]}',
        b'{"order": "hand", "to": [NaN]}', b'{"order": "turn", "knobs": {}, "out": 7}',
        b'{"order": "clutch", "open": 1}', b"\xff\xfe", b"[" * 5000, b"x" * 200_000,
    ):
        read = _taken(line + b'\n{"order": "clutch", "open": false}\n')
        assert read[-1] == {"order": "clutch", "open": False}, line[:50]
        said = capsys.readouterr().out.splitlines()
        assert said, line[:50]
        assert all('"refused"' in each for each in said), line[:50]


@pytest.mark.parametrize(("flood", "calls"), [
    (b"\n" * 65_536, 2), (b'{"order": "clutch", "open": false}\n' * 1800, 120), (b"x\n" * 32_000, 2001),
], ids=["64 kB of newlines", "1800 orders", "32,000 lines that are none"])
def test_a_flood_of_lines_held_the_force_unrenewed(
    flood: bytes, calls: int, capsys: pytest.CaptureFixture[str],
) -> None:
    """For 0.5 to 2.3 s. At a tick 16 lines or pieces are taken, or one where the time is up; none is lost."""
    last = b'{"order": "clutch", "open": true}\n'
    for clock, most in ((standing, 16), (count(0, 10**9).__next__, 1)):
        reads, writes = os.pipe()
        os.set_blocking(writes, False)
        got: list[dict[str, Any]] = []
        orders, sent, ticks = Orders(SHAPES, got.append, reads), flood + last, 0
        while not orders.over:
            if sent:
                with suppress(BlockingIOError):
                    sent = sent[os.write(writes, sent):]
                if not sent:
                    os.close(writes)
            before = len(got)
            orders.read(clock)
            assert len(got) - before <= most
            ticks += 1
        os.close(reads)
        assert got[-1] == {"order": "clutch", "open": True}
        assert ticks >= calls * 16 // most // 2
    assert all('"refused"' in line for line in capsys.readouterr().out.splitlines())


LATE, LEAP = SAYS[Standing.LATE], "of the policy refused: farther than 0.9"


def test_a_page_hands_over_each_action_once_and_the_switch_as_it_was_left(tmp_path: Path) -> None:
    with PolicyPage(tmp_path, 2) as page:
        assert page.read() is None
        writer = PolicyWriter(tmp_path)
        writer.send((0.1, -0.2))
        assert page.read() == PolicyWord(None, (0.1, -0.2))
        assert page.read() is None
        writer.switch(on=True)
        assert page.read() == PolicyWord(True, None)
        writer.send((0.3, 0.4))
        writer.switch(on=False)
        assert page.read() == PolicyWord(False, (0.3, 0.4))
        for action in ((0.1,), (float("nan"), 0.0), "ab"):
            with pytest.raises(Refused):
                writer.send(action)
        assert page.read() is None
        writer._words[0] += 1  # somebody is writing
        assert page.read() is None
        writer.close()
    assert not (tmp_path / NAME).exists()
    with pytest.raises(Refused, match="no folder of a master that runs"):
        PolicyWriter(tmp_path)


class Rolling:
    """A policy at 60 Hz in a thread of its own, until `stop`; it goes to `to`, and is silent while that is None."""

    def __init__(self, folder: Path) -> None:
        self.writer, self.to, self._over = PolicyWriter(folder), (0.0, 0.0, 0.0), Event()
        self.silent = False
        self._thread = Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._over.wait(1.0 / 60.0):
            if not self.silent:
                self.writer.send(self.to)

    def stop(self) -> None:
        self._over.set()
        self._thread.join()
        self.writer.close()


def says(run: Ordered, sentence: str, since: int) -> dict[str, Any]:
    """The master's event with this sentence in it."""
    return run.event("m", lambda event: sentence in str(event.get("why", "")), since)


def by_orders(run: Ordered) -> None:
    """The switch and an action by orders, and what is refused."""
    since = run.now()["m"]
    run.order("m", order="policy", takes=False)
    says(run, SAYS[Standing.OPERATOR], since)
    run.order("m", order="policy", takes=True, to=[0.25, -0.25, 0.0])
    says(run, SAYS[Standing.POLICY], since)
    run.order("m", order="policy", to=[0.1])
    run.event("m", lambda event: "an action has one number for each of 3 axes" in str(event.get("sentence")), since)
    run.order("s", order="policy", takes=True)
    run.event("s", lambda event: "orders `policy` are for the master" in str(event.get("sentence")))


def test_a_policy_takes_three_joints_over_and_its_whole_run_can_be_run_again(tmp_path: Path) -> None:
    run = Ordered("handover", tmp_path, {"duration": "86400", "axes": "3", "takes": "none", "law": "wave"})
    try:
        run.happens("ms", "met")
        run.order("m", order="hand", to=None)  # it lets go
        policy = Rolling(tmp_path / "01")
        # Authority, silence, a leap and an outage of the link, while another process sends the actions.
        since = run.now()["m"]
        policy.writer.switch(on=True)
        says(run, SAYS[Standing.POLICY], since)
        for x in np.linspace(0.0, 0.3, 10):
            policy.to = (float(x), float(-x), 0.0)
            time.sleep(0.05)
        run.live("m", lambda event: event["x"] > 0.2)
        since = run.now()["m"]
        policy.silent = True
        says(run, LATE, since)
        policy.silent = False
        says(run, SAYS[Standing.POLICY], since)
        since = max(i for i, event in enumerate(run.events["m"]) if SAYS[Standing.POLICY] in str(event.get("why", "")))
        policy.to = (2.0, 0.0, 0.0)
        says(run, LEAP, since)
        says(run, LATE, since)
        policy.to = (0.3, -0.3, 0.0)
        says(run, SAYS[Standing.POLICY], since)
        since = run.now()["m"]
        run.processes["c"].send_signal(signal.SIGSTOP)  # the link is gone, with authority at the policy
        try:
            says(run, SAYS[Standing.PAUSED], since)
        finally:
            run.processes["c"].send_signal(signal.SIGCONT)
        since = run.now()["m"]
        says(run, SAYS[Standing.POLICY], since)
        by_orders(run)
        since = run.now()["m"]
        policy.stop()
        says(run, LATE, since)
    finally:
        run.close()
    for end in ("master", "slave"):
        assert main(["replay", str(tmp_path / "01" / end)]) == 0
    master = tmp_path / "01" / "master"
    trace = merge(scene_of(master), master, tmp_path / "01" / "slave").trace
    had = trace["policy_m"] == Standing.POLICY
    assert had.sum() > 200
    assert trace["f_policy_m"].shape[1] == 3
    assert np.abs(trace["f_policy_m"][trace["authority_m"] == 0.0]).max() == 0.0
    assert np.abs(np.diff(trace["f_policy_m"], axis=0)).max() < 0.05
    assert trace["E_policy_m"][-1] > 1e-3
