"""The page's server as a whole, before fakes: what is shown, who moves the hand, what is turned, and what is lost."""

from __future__ import annotations

import asyncio
import json
import os
import signal
from collections.abc import Callable
from errno import ENOSPC
from pathlib import Path
from typing import Any

import pytest

from teleop.errors import Refused
from teleop.live.page.controls import Controls
from teleop.live.page.session import Children, Start
from teleop.live.process.interrupt import Interrupt
from teleop.protocol.states import Cause
from tests.live.conftest import running
from tests.live.page.conftest import FAKE, Browser, Served
from tests.live.page.fake import MEETS
from tests.waiting import PATIENCE

pytestmark = pytest.mark.live
Serve = Callable[..., Served]


def test_a_page_is_told_what_it_shows_then_shown_the_rows_of_both_ends_and_what_has_passed(served: Serve) -> None:
    async def scenario(page: Served) -> None:
        async with page.open() as browser:
            hello = await browser.until("hello")
            assert (hello["scene"], hello["axes"], hello["law"]) == ("hard_wall", 1, "wave")
            assert {slider["name"]: slider["value"] for slider in hello["sliders"]} == {
                "delay": 0.05, "jitter": 0.0, "loss": 0.0, "k_e": 2e4, "scale": 1.0}
            assert {law["name"] for law in hello["laws"]} >= {"direct", "wave", "pfra"}
            seen = [await browser.until("rows") for _ in range(20)]
            rows = await browser.until("rows", lambda rows: rows["E"] is not None)
            assert (rows["xm"], rows["fm"], rows["fe"]) == ([0.0], [1.5], [0.5])
            assert rows["fm_lo"] == rows["fm_hi"] == [1.5]
            assert rows["E"] == pytest.approx(4.0)
            assert rows["age"] == pytest.approx([0.05, 0.05])
            assert rows["queue"] == pytest.approx([0.002, 0.002])
            status = await browser.until("status", lambda message: message["m"] and message["s"])
            assert status["lost"] is None
            assert status["m"]["rtt"] == 0.1
        async with page.open() as later:
            past = await later.until("past")
            assert [row["t"] for row in past["rows"]][:20] == [row["t"] for row in seen]

    served(scenario)


def test_the_pointer_moves_the_hand_and_lets_it_go_and_so_does_a_page_that_vanishes_in_mid_drag(served: Serve) -> None:
    async def scenario(page: Served, browser: Browser) -> None:
        await browser.say("hand", to=[0.02])
        await browser.until("rows", lambda rows: rows["xm"] == [0.02])
        await browser.say("hand", to=None)
        await page.until(lambda: page.orders("master")[-1] == {"order": "hand", "to": None})
        await browser.say("hand", to=[0.03])
        await page.until(lambda: page.orders("master")[-1] == {"order": "hand", "to": [0.03]})
        browser.socket.transport.abort()
        await page.until(lambda: page.orders("master")[-1] == {"order": "hand", "to": None})
        assert page.orders("master")[0] == {"order": "hand", "to": [0.02]}
        assert page.orders("slave") == []

    served(scenario)


def test_a_turn_tells_all_three_each_part_has_its_folder_and_again_begins_at_the_scenes_start(served: Serve) -> None:
    """A master is told where the slave is until the next session begins.

    A slave that coasted after a loop that shook was met where it had been: the wall was out of the hand's reach.
    """
    async def scenario(page: Served, browser: Browser) -> None:
        await browser.say("turn", law="pfra", jitter=0.02, k_e=5e3)
        hello = await browser.until("hello", lambda message: message["law"] == "pfra")
        assert hello["link"] == "delay(0.05) | uniform(0.02)"
        await page.until(lambda: page.all_orders("master")[-1]["order"] == "align")
        told = -1
        while told < (told := len(page.all_orders("master"))):  # it ends, or the test does
            await asyncio.sleep(MEETS)
        turn, *aligns = [order for order in page.all_orders("master") if "swing" not in order]
        assert {each["order"] for each in aligns} == {"align"}
        assert all(each["to"] == [0.0] for each in aligns)
        assert not [each for each in page.all_orders("slave") if each["order"] == "align"]
        assert turn["knobs"]["law"] == "pfra"
        assert turn["knobs"]["link"] == "delay(0.05) | uniform(0.02)"
        assert float(turn["knobs"]["k_e"]) == 5e3
        assert turn["align"] == [0.0]
        assert page.orders("slave")[0]["out"] == str(page.folder / "02" / "slave")
        await browser.say("again")
        await browser.told("Started again")
        again = page.orders("master")[-1]
        assert (again["order"], again["again"], again["align"]) == ("turn", True, None)

    index = served(scenario).index()
    assert [(part["folder"], part["why"]) for part in index["parts"]] == [
        ("01", "start"), ("02", "turn"), ("03", "again")]
    assert index["parts"][1]["k"] > 0
    assert index["parts"][1]["knobs"]["law"] == "pfra"


def test_what_cannot_be_turned_to_is_refused_before_an_end_is_told_and_of_many_turns_the_last_one_is(
    served: Serve, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise Refused("this law asks for more than the scene has")

    async def scenario(page: Served, browser: Browser) -> None:
        for name, value, words in (
            ("law", "wavee", "did you mean wave"), ("law", "/tmp/mine.py", "no law"),
            ("law", "virtual_wall", "no law"), ("delay", -1.0, "delay must be at least 0 s"),
            ("loss", 2.0, "loss must be at most 0.5"),
        ):
            await browser.say("turn", **{name: value})
            assert (await browser.told(words))["level"] == "error"
        with monkeypatch.context() as without:
            without.setattr(Controls, "scene", refuse)
            await browser.say("turn", law="direct")
            await browser.told("asks for more")
        assert page.orders("master") == []
        for i in range(1, 101):
            await browser.say("turn", delay=i / 1000)
        hello = await browser.until("hello", lambda message: message["link"] == "delay(0.1)")
        assert hello["law"] == "wave"
        assert 1 <= len(page.orders("master")) < 10

    served(scenario)


def test_a_scale_is_ordered_without_a_switch_what_is_none_and_a_policy_refused_and_skipped_ticks_were_shown_as_loss(
    served: Serve
) -> None:
    async def scenario(page: Served) -> None:
        async with page.open() as browser, page.open() as other:
            await browser.until("rows")
            await browser.say("scale", to=2.0)
            await other.until("status", lambda status: status["scale"] == 2.0)
            await browser.say("scale", to=0.0)
            await browser.until("said", lambda message: "scale must be" in message["text"])
            assert (await browser.until("status"))["policy"] is None
            await browser.say("policy", takes=True)
            assert (await browser.told("this scene has no policy"))["level"] == "error"
            for end, loss, skipped in (("m", 0.013, 0.002), ("s", 0.002, 0.01)):
                page.page._live[end] = {"end": end, "loss": loss, "skipped": skipped}
            status = json.loads(page.page._status())
            assert status["loss"] == pytest.approx(0.003)  # of the slave's packets 1.3 % are missing, 1 % it skipped
            assert status["skipped"] == 0.01
        assert [each for each in page.all_orders("master") if each["order"] != "hand"] == [
            {"order": "scale", "to": 2.0}]
        assert page.all_orders("slave") == []

    served(scenario)


def test_at_twice_the_scale_the_hands_own_swing_was_told_to_be_unstable_for_it_took_the_slave_into_the_wall() -> None:
    controls = Controls("hard_wall", {})
    before = controls.swing
    controls.set_scale(2.0)
    assert before is not None
    assert controls.swing == before._replace(by=tuple([each / 2.0 for each in before.by]))
    with pytest.raises(Refused, match="at most 4"):
        controls.set_scale(5.0)


def test_the_clutch_is_open_while_it_is_held_and_a_turn_waits_for_it(served: Serve) -> None:
    async def scenario(page: Served, browser: Browser) -> None:
        await browser.say("clutch", open=True)
        await browser.until("status", lambda status: status["clutch"])
        await browser.say("turn", law="direct")
        await browser.say("clutch", open=False)
        await browser.until("hello", lambda message: message["law"] == "direct")
        for name in ("master", "slave"):
            orders = [(order["order"], order.get("open")) for order in page.orders(name)]
            assert orders == [("clutch", True), ("clutch", False), ("turn", None)]

    served(scenario)


def test_the_hand_swings_in_free_space_until_somebody_moves_it_and_again_when_it_is_started_again(
    served: Serve
) -> None:
    """A page began pressed against the wall and still, and the first drag pulled it out of there."""
    swing = {"order": "hand", "to": [0.0], "swing": [pytest.approx(0.018)]}

    async def scenario(page: Served, browser: Browser) -> None:
        def hands() -> list[dict[str, Any]]:
            return [order for order in page.all_orders("master") if order["order"] == "hand"]

        await page.until(lambda: hands() == [swing])
        await browser.say("turn", law="direct")
        await browser.told("Switched to direct")
        await page.until(lambda: hands() == [swing, swing])
        await browser.say("hand", to=[0.02])
        await browser.until("rows", lambda rows: rows["xm"] == [0.02])
        await browser.say("hand", to=None)
        await page.until(lambda: hands()[-1] == {"order": "hand", "to": None})
        await browser.say("again")
        await page.until(lambda: hands()[-1] == swing)

    served(scenario)


def test_while_nobody_steers_nothing_is_written_and_the_next_to_steer_begins_a_part(
    served: Serve, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And what is written, and what the disk has left, is told."""
    monkeypatch.setattr("teleop.live.page.page.IDLE", 0.5)

    async def scenario(page: Served) -> None:
        async with page.open() as browser:
            told = await browser.told("nothing more is written")
            assert told["level"] == "info"
            status = await browser.until("status", lambda status: status["idle"] and status["written"] > 0)
            assert 0 < status["free"] < 1e15
            await page.until((page.folder / "01" / "master" / "idle.bin").exists)
            size = (page.folder / "01" / "master" / "record.bin").stat().st_size
            t = (await browser.until("rows"))["t"]
            await browser.until("rows", lambda rows: rows["t"] > t + 0.5)  # it is shown all the same
            assert (page.folder / "01" / "master" / "record.bin").stat().st_size == size
            assert page.orders("master") == page.orders("slave") == [{"order": "idle"}]
            await browser.say("hand", to=[0.01])
            await browser.told("Switched to wave")
            await browser.until("status", lambda status: not status["idle"])
            await browser.until("rows", lambda rows: rows["part"] == "02" and rows["xm"] == [0.01])

    assert [part["why"] for part in served(scenario).index()["parts"]][:2] == ["start", "idle"]


def test_of_a_session_that_is_bounded_the_oldest_parts_are_removed_and_it_is_told(served: Serve) -> None:
    async def scenario(page: Served, browser: Browser) -> None:
        page.page._parts.keep = 4e5  # the fakes write 200 kB a second
        told = await browser.told("is removed")
        assert told["text"].startswith("Part 01 is removed: the parts had ")
        assert told["text"].endswith("and --keep is 400 kB")
        assert not (page.folder / "01").exists()
        await browser.until("rows")
        await page.until(lambda: len(page.index()["parts"]) >= 2, "it did not go on")

    assert served(scenario).index()["parts"][0]["folder"] > "01"


def kill(name: str, number: signal.Signals = signal.SIGKILL) -> None:
    """Send a signal to the child of this process that is `name`."""
    for pid, words in running(os.getpid()).items():
        if f"fake.py {name}" in words:
            os.kill(pid, number)
            return
    pytest.fail(f"there is no {name}")


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is lost soon after it was started is mended by itself too."""
    monkeypatch.setattr("teleop.live.page.page.SOON", 0.0)


def test_what_is_killed_comes_back_the_channel_in_a_turn_and_an_end_in_a_part_of_its_own(served: Serve) -> None:
    """After the channel the master is brought to the slave; after an end the law is what it was, and the hand holds.

    What is told while the three start anew reaches no master: it was taken for told, and the wall was let go of.
    """
    async def scenario(page: Served, browser: Browser) -> None:
        kill("channel")
        await browser.told("the channel is lost")
        await browser.told("the channel is back")
        await browser.told("Switched to")
        await browser.until("status", lambda status: status["lost"] is None)
        await browser.until("rows")
        [order] = page.orders("master")
        assert (order["order"], order["again"], order["align"]) == ("turn", False, [0.0])
        await browser.say("turn", law="direct")
        await browser.told("Switched to")
        await browser.say("hand", to=[0.05])
        await page.until(lambda: page.orders("master")[-1]["order"] == "hand")
        for name in ("master", "slave"):
            kill(name)
            await browser.told(f"the {name} is lost")
            told = len(page.orders("master"))
            hello = await browser.until("hello", lambda hello: hello["state"] != "lost")
            assert hello["law"] == "direct"
            await browser.told("are back")
            before = browser.got[-1]
            after = await browser.until("rows")
            assert after is not before
            async with asyncio.timeout(PATIENCE):
                while len(page.orders("master")) == told:
                    await browser.say("hand", to=[0.05])  # as a page does that holds it
                    await browser.until("status")
            assert page.orders("master")[told] == {"order": "hand", "to": [0.05]}

    parts = served(scenario).index()["parts"]
    assert [part["why"] for part in parts] == ["start", "turn", "turn", "lost", "lost"]
    assert parts[1]["knobs"] == parts[0]["knobs"]
    assert parts[4]["knobs"] == parts[3]["knobs"] == parts[2]["knobs"]


def test_a_law_is_judged_anew_after_a_turn_and_a_turn_is_no_warning_and_on_a_full_disk_refused(
    served: Serve, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The next law shook too, and nothing was said of it, since the one before had shaken."""
    def full(*_: object) -> None:
        raise OSError(ENOSPC, "No space left on device")

    async def scenario(page: Served, browser: Browser) -> None:
        for cause, why in ((Cause.ORDERED, "the session is over: a turn"),  # of which it hears from the other first
                           (Cause.SILENCE, "silence: no fresh packet for 0.2 s")):
            page.page._hear("master", {"event": "event", "end": "m", "k": 1, "what": "safe", "why": why,
                                       "cause": cause.name})
        await browser.told("silence")
        assert [message["text"] for message in browser.got if message["type"] == "said"] == [
            "Master: the force falls to zero, silence: no fresh packet for 0.2 s"]
        with monkeypatch.context() as disk:
            disk.setattr("teleop.live.page.session.write_document", full)
            await browser.say("turn", law="direct")
            assert "No space left" in (await browser.told("not switched"))["text"]
            assert (await browser.until("hello"))["law"] == "wave"
            await browser.until("rows")
        page.page._shaking.shakes = True
        page.page._shaking.sentence = lambda *_: None  # in place of the rule
        await browser.until("status", lambda status: status["shakes"])
        await browser.say("turn", law="pp")
        await browser.told("Switched to pp, 50 ms each way")
        await browser.until("status", lambda status: not status["shakes"])

    assert [part["folder"] for part in served(scenario).index()["parts"]] == ["01", "02"]


def test_an_end_that_stands_still_is_told_of_and_that_it_goes_on(served: Serve) -> None:
    async def scenario(_page: Served, browser: Browser) -> None:
        kill("slave", signal.SIGSTOP)
        try:
            await browser.told("the slave stands still")
            await browser.until("status", lambda status: status["lost"] == "the slave")
        finally:
            kill("slave", signal.SIGCONT)
        await browser.told("the slave goes on")

    served(scenario)
    with pytest.raises(pytest.fail.Exception, match="there is no master"):
        kill("master")  # in the end all have left


def test_what_is_lost_again_at_once_waits_for_a_person(served: Serve, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is lost soon after the first start does not wait: the channel that was killed then never came back."""
    monkeypatch.setattr("teleop.live.page.page.SOON", 1e9)

    async def scenario(_page: Served, browser: Browser) -> None:
        kill("slave")
        await browser.told("are back")
        await browser.until("rows")
        kill("slave")
        assert "press start again" in (await browser.told("the slave is lost"))["text"]
        await browser.until("status", lambda status: status["lost"] == "the slave")
        await browser.say("again")
        await browser.told("are back")
        await browser.until("rows")

    served(scenario)


FULL = [pytest.param(name, marks=pytest.mark.full) for name in ("master", "channel")]


@pytest.mark.parametrize("name", ["slave", *FULL])
def test_a_turn_that_one_of_the_three_refuses_leaves_them_as_they_were(
    served: Serve, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setenv(f"FAKE_{name.upper()}", "refuses")

    async def scenario(_page: Served, browser: Browser) -> None:
        await browser.say("turn", law="direct")
        assert "as they were" in (await browser.told("the fake does not like it"))["text"]
        assert (await browser.until("hello"))["law"] == "wave"
        await browser.told("are back")

    served(scenario)


def test_a_turn_that_nobody_answers_is_given_up(served: Serve, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FAKE_SLAVE", "deaf")
    monkeypatch.setattr("teleop.live.page.controls.PATIENCE", 0.3)

    async def scenario(_page: Served, browser: Browser) -> None:
        await browser.say("turn", law="direct")
        await browser.told("did not all switch in time")
        assert (await browser.until("hello"))["law"] == "wave"

    served(scenario)


def test_a_second_signal_while_the_ends_leave_reached_neither_of_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FAKE_MASTER", "lingers")
    monkeypatch.setattr("teleop.live.page.session.LEAVE", PATIENCE)

    async def scenario() -> int | None:
        is_up = asyncio.Event()
        children, interrupt = Children(Start("hard_wall", 0, program=FAKE), lambda name, _: (
            is_up.set() if name == "master" else None), print), Interrupt()
        await children.start({}, {"m": tmp_path / "01" / "master", "s": tmp_path / "01" / "slave"})
        await is_up.wait()
        slave, master = (children._alive[name].process for name in ("slave", "master"))
        interrupt.name, interrupt.count = "SIGINT", 1
        leaving = asyncio.create_task(children.leave(interrupt))
        await slave.wait()
        assert master.returncode is None
        interrupt.count = 2
        await leaving
        return master.returncode

    assert asyncio.run(scenario()) == 0, "it left, and was not killed"


def test_children_that_do_not_come_up_end_it_with_their_sentence(
    served: Serve, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FAKE_CHANNEL", "fails")

    async def scenario(page: Served) -> None:
        await page.until(lambda: False)

    with pytest.raises(Refused, match="the fake never comes up"):
        served(scenario)
