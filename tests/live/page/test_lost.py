"""What is lost is told, started anew and told again; a turn that fails leaves the three as they were. Fakes again."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import Callable
from errno import ENOSPC
from pathlib import Path

import pytest

from teleop.errors import Refused
from teleop.live.page.session import Children, Start
from teleop.live.process.interrupt import Interrupt
from teleop.protocol.states import Cause
from tests.live.page.conftest import FAKE, Served
from tests.waiting import PATIENCE

pytestmark = pytest.mark.live
Serve = Callable[..., Served]


def kill(name: str, number: signal.Signals = signal.SIGKILL) -> None:
    """Send a signal to the child of this process that is `name`."""
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            words = (folder / "cmdline").read_bytes().split(b"\0")
            parent = int((folder / "stat").read_text().rsplit(")", 1)[1].split()[1])
        except OSError:  # it has just ended
            continue
        if f"fake.py {name}".encode() in b" ".join(words) and parent == os.getpid():
            os.kill(int(folder.name), number)
            return
    pytest.fail(f"there is no {name}")


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is lost soon after it was started is mended by itself too."""
    monkeypatch.setattr("teleop.live.page.page.SOON", 0.0)


def test_what_is_killed_comes_back_the_channel_in_a_turn_and_an_end_in_a_part_of_its_own(served: Serve) -> None:
    """After the channel the master is brought to the slave; after an end the law is what it was."""
    async def scenario(page: Served) -> None:
        async with page.open() as browser:
            await browser.until("rows")
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
            for name in ("master", "slave"):
                kill(name)
                await browser.told(f"the {name} is lost")
                hello = await browser.until("hello", lambda hello: hello["state"] != "lost")
                assert hello["law"] == "direct"
                await browser.told("are back")
                before = browser.got[-1]
                after = await browser.until("rows")
                assert after is not before

    parts = served(scenario).index()["parts"]
    assert [part["why"] for part in parts] == ["start", "turn", "turn", "lost", "lost"]
    assert parts[1]["knobs"] == parts[0]["knobs"]
    assert parts[4]["knobs"] == parts[3]["knobs"] == parts[2]["knobs"]


def test_a_hand_that_is_held_holds_again_after_an_end_was_lost(served: Serve) -> None:
    """What is told while the three start anew reaches no master: it was taken for told, and the wall was let go of."""
    async def scenario(page: Served) -> None:
        async with page.open() as browser:
            await browser.until("rows")
            await browser.say("hand", to=[0.05])
            await page.until(lambda: page.orders("master"))
            kill("slave")
            await browser.told("the slave is lost")
            told = len(page.orders("master"))
            async with asyncio.timeout(PATIENCE):
                while len(page.orders("master")) == told:
                    await browser.say("hand", to=[0.05])  # as a page does that holds it
                    await browser.until("status")
            assert page.orders("master")[told] == {"order": "hand", "to": [0.05]}

    assert len(served(scenario).index()["parts"]) == 2


def test_a_law_is_judged_anew_after_a_turn_and_a_turn_is_no_warning_and_on_a_full_disk_refused(
    served: Serve, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The next law shook too, and nothing was said of it, since the one before had shaken."""
    def full(*_: object) -> None:
        raise OSError(ENOSPC, "No space left on device")

    async def scenario(page: Served) -> None:
        async with page.open() as browser:
            await browser.until("rows")
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
            page.page._shaking.sentence = lambda *_: None  # type: ignore[method-assign]  # in place of the rule
            await browser.until("status", lambda status: status["shakes"])
            await browser.say("turn", law="pp")
            await browser.told("Switched to pp, 50 ms each way")
            await browser.until("status", lambda status: not status["shakes"])

    assert [part["folder"] for part in served(scenario).index()["parts"]] == ["01", "02"]


def test_an_end_that_stands_still_is_told_of_and_that_it_goes_on(served: Serve) -> None:
    async def scenario(page: Served) -> None:
        async with page.open() as browser:
            await browser.until("rows")
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

    async def scenario(page: Served) -> None:
        async with page.open() as browser:
            await browser.until("rows")
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

    async def scenario(page: Served) -> None:
        async with page.open() as browser:
            await browser.until("rows")
            await browser.say("turn", law="direct")
            assert "as they were" in (await browser.told("the fake does not like it"))["text"]
            assert (await browser.until("hello"))["law"] == "wave"
            await browser.told("are back")

    served(scenario)


def test_a_turn_that_nobody_answers_is_given_up(served: Serve, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FAKE_SLAVE", "deaf")
    monkeypatch.setattr("teleop.live.page.controls.PATIENCE", 0.3)

    async def scenario(page: Served) -> None:
        async with page.open() as browser:
            await browser.until("rows")
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
