"""Real-time scheduling is asked for, what came of it is said, and the run is there either way."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
from argparse import Namespace
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from teleop.live.devices import device_watchdog
from teleop.live.process import realtime
from teleop.live.process.interrupt import Interrupt
from teleop.live.process.realtime import GIVEN_BACK, Granted, RealTime, scheduling_of
from teleop.scene.library import ROOT
from tests.live.conftest import summary
from tests.waiting import until

pytestmark = pytest.mark.live
OTHER = os.SCHED_OTHER | os.SCHED_RESET_ON_FORK


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, int, int]]:
    """What the system is asked for, and grants, without this process being changed: thread, policy, priority."""
    made: list[tuple[int, int, int]] = []
    monkeypatch.setattr(os, "sched_setscheduler", lambda *call: made.append((*call[:2], call[2].sched_priority)))
    monkeypatch.setattr(realtime, "_lock", lambda: "locked")
    monkeypatch.setattr(realtime, "_limit_awake", lambda *_: None)
    return made


@pytest.fixture
def limited(monkeypatch: pytest.MonkeyPatch) -> Callable[[int], None]:
    """`limited(n)`: the system grants priorities up to n."""
    def to(most: int) -> None:
        def refuse(_thread: int, _policy: int, param: os.sched_param) -> None:
            if param.sched_priority > most:
                raise PermissionError(1, "Operation not permitted")

        monkeypatch.setattr(os, "sched_setscheduler", refuse)
        monkeypatch.setattr(realtime, "_own_limit", lambda: most)

    monkeypatch.setattr(realtime, "_lock", lambda: "locked")
    monkeypatch.setattr(realtime, "_limit_awake", lambda *_: None)
    return to


def own(*program: str) -> str:
    """What a Python program prints."""
    return subprocess.run([sys.executable, "-c", "\n".join(program)], env={"PYTHONPATH": str(ROOT)}, check=True,
                          text=True, capture_output=True).stdout


def test_what_is_refused_is_said_with_what_to_type(
    limited: Callable[[int], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    limited(0)
    granted = realtime.ask()
    assert granted == ("no (Operation not permitted)", "locked", None)
    monkeypatch.setattr(realtime, "_CONTAINER", ())
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    said = realtime.sentence({"scheduler": granted.scheduler, "memory": granted.memory})
    assert "scheduling: no (Operation not permitted); memory locked; type  sudo prlimit --pid $$ --rtprio=50" in said
    assert "\n" not in said
    assert "type" not in realtime.sentence({"scheduler": "SCHED_FIFO", "memory": "locked"})
    monkeypatch.delattr(os, "sched_setscheduler")
    assert realtime.ask().scheduler == "no (not on this system)"
    assert Granted("SCHED_FIFO, priority 40", "locked", 40).whole
    assert not Granted("SCHED_FIFO, priority 40", "no (Cannot allocate memory)", 40).whole


def test_what_to_type_is_what_helps_there(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(realtime, "_CONTAINER", (tmp_path,))
    assert "--ulimit rtprio=50" in realtime.cure()
    monkeypatch.setattr(realtime, "_CONTAINER", (tmp_path / "none",))
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    assert "CAP_SYS_NICE" in realtime.cure()
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    monkeypatch.setattr(realtime, "_LIMITS", tmp_path)
    assert f"sudo tee {tmp_path}/teleop.conf" in realtime.cure(for_good=True)
    monkeypatch.setattr(realtime, "_LIMITS", tmp_path / "none")
    assert "sudo prlimit" in realtime.cure(for_good=True)


def test_it_is_asked_for_unless_without_it_or_by_packets_given_back_when_the_block_ends_and_not_inherited(
    calls: list[Any]
) -> None:
    for args in (Namespace(realtime=False), Namespace(realtime=True, lockstep=True)):
        with scheduling_of(args, Interrupt()) as scheduling:
            assert (scheduling.report, scheduling.above) == (None, None)
    assert calls == []
    with RealTime(Interrupt()) as scheduling:
        assert scheduling.report == {"scheduler": "SCHED_FIFO, priority 40", "memory": "locked"}
        assert scheduling.above == 41
        assert calls == [(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, 40)]
    thread, policy, priority = calls[1]
    assert (policy, priority) == (OTHER, 0)
    assert thread
    assert len(calls) == 2
    device_watchdog._run_before_end(None)
    assert len(calls) == 2
    device_watchdog._run_before_end(41)
    assert calls[2] == (0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, 41), "the watchdog of a device runs before its end"


@pytest.mark.usefixtures("calls")
def test_a_process_with_millions_of_objects_is_not_killed_while_it_collects_them(
    monkeypatch: pytest.MonkeyPatch
) -> None:
    """A collection of three seconds does not sleep: it was over the limit of a thread that is scheduled first."""
    frozen: list[int] = []
    lock = realtime._lock
    monkeypatch.setattr(realtime, "_lock", lambda: (frozen.append(gc.get_freeze_count()), lock())[1])
    gc.unfreeze()
    try:
        with RealTime(Interrupt()):
            assert frozen[0] > len(gc.get_objects()), "nearly all is out of its sight before it is asked for"
    finally:
        gc.unfreeze()


def test_a_child_and_a_thread_of_a_live_process_are_scheduled_as_all_others() -> None:
    told = own("import os, threading, time", "from teleop.live.process.interrupt import Interrupt",
               "from teleop.live.process.realtime import RealTime",
               "with RealTime(Interrupt()) as scheduling:",
               "    seen = []",
               "    thread = threading.Thread(target=lambda: seen.append(os.sched_getscheduler(0)))",
               "    thread.start(); thread.join()",
               "    if (child := os.fork()) == 0: os._exit(os.sched_getscheduler(0))",
               "    print(*seen, os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))",
               "print(os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK)")
    assert told == f"{os.SCHED_OTHER} {os.SCHED_OTHER}\n{os.SCHED_OTHER}\n"


@pytest.fixture
def interrupt() -> Iterator[Interrupt]:
    with Interrupt() as entered:
        yield entered


def test_a_loop_that_never_sleeps_is_given_back_and_runs_on(interrupt: Interrupt, calls: list[Any]) -> None:
    with RealTime(interrupt) as scheduling:
        os.kill(os.getpid(), signal.SIGXCPU)
        assert interrupt.name is None
        assert calls[-1][1:] == (OTHER, 0)
        assert scheduling.report is not None
        assert scheduling.report["scheduler"].endswith(GIVEN_BACK)
        os.kill(os.getpid(), signal.SIGXCPU)
        assert interrupt.name == "SIGXCPU", "a limit on processor time is still one"


def test_without_real_time_scheduling_that_signal_ends_the_run(
    interrupt: Interrupt, limited: Callable[[int], None]
) -> None:
    limited(0)
    with RealTime(interrupt):
        os.kill(os.getpid(), signal.SIGXCPU)
        assert interrupt.name == "SIGXCPU"


def test_it_is_given_back_too_where_compiled_code_does_not_return_to_the_loop() -> None:
    """The handler in Python does not run meanwhile; the thread of the second signal does."""
    told = own("import ctypes, os, time", "from teleop.live.process.interrupt import Interrupt",
               "from teleop.live.leaving import LastResort",
               "with Interrupt() as interrupt, LastResort(interrupt):",
               "    given = []",
               "    interrupt.overrun = lambda: given.append(time.monotonic())",
               "    ctypes.CDLL(None).system(f'kill -XCPU {os.getpid()}; sleep 0.3'.encode())",
               "    print(bool(given) and time.monotonic() - given[0] > 0.1, interrupt.seen, interrupt.count)")
    assert told == "True 0 0\n"


@pytest.mark.skipif(not hasattr(os, "sched_setscheduler"), reason="no real-time scheduling on this system")
def test_a_loop_that_hangs_does_not_keep_a_core_for_ever() -> None:
    """Where the system grants it, for then it is the system that sends the signal."""
    told = own("import os, time", "from teleop.live.process import realtime",
               "from teleop.live.process.interrupt import Interrupt",
               "realtime.AWAKE_S = 0.1",
               "with Interrupt() as interrupt, realtime.RealTime(interrupt) as scheduling:",
               "    until = time.monotonic() + 30.0",
               "    while os.sched_getscheduler(0) & os.SCHED_FIFO and time.monotonic() < until: pass",
               "    got = scheduling.granted.priority is not None",
               "    back = 'given' in scheduling.report['scheduler']",
               "    print(os.sched_getscheduler(0) & os.SCHED_FIFO, got == back)")
    assert told == "0 True\n"


def test_a_limit_on_locked_memory_is_not_reached_later(monkeypatch: pytest.MonkeyPatch) -> None:
    """With every page to come locked too, memory would fail in the middle of a run."""
    asked_for: list[int] = []
    monkeypatch.setattr(realtime.ctypes, "CDLL", lambda *_, **__: Namespace(
        mlockall=lambda which: asked_for.append(which) or 0))
    for unbounded in (False, True):
        monkeypatch.setattr(realtime, "_without_bound", lambda bound=unbounded: bound)
        assert realtime._lock() == ("locked" if unbounded else "locked as it was at the start")
    assert asked_for == [1, 3]


def test_both_ends_are_scheduled_so_unless_told_not_to_if_the_system_grants_it_and_their_summaries_say_what_they_got(
    command: Callable[..., Any], tmp_path: Path
) -> None:
    scene = ["hard_wall", "--set", "duration=0.5", "--set", "link=none", "--json"]
    slave = command("slave", *scene, "--listen", "127.0.0.1:0", "--out", str(tmp_path / "s"))
    listening = slave.event("listening")
    scheduling = listening["realtime"]
    granted = scheduling["scheduler"].startswith("SCHED_FIFO")
    policy = os.sched_getscheduler(slave.process.pid) & ~os.SCHED_RESET_ON_FORK
    assert policy == (os.SCHED_FIFO if granted else os.SCHED_OTHER)
    tasks = Path(f"/proc/{slave.process.pid}/task")
    if granted:
        def before_it() -> list[int]:
            return [os.sched_getparam(int(task.name)).sched_priority for task in tasks.iterdir()]

        own_priority = int(scheduling["scheduler"].split()[-1])
        until(lambda: max(before_it()) > own_priority, "the thread of the second signal runs before the loop")
    master = command("master", *scene, "--no-realtime", "--peer", f"127.0.0.1:{listening['port']}", "--out",
                     str(tmp_path / "m"))
    assert master.end()[0] == slave.end()[0] == 0
    told = {name: summary(tmp_path / name[0])[name] for name in ("master", "slave")}
    assert "realtime" not in told["master"]
    assert set(told["slave"]["realtime"]) == {"scheduler", "memory"}


def test_the_channel_runs_after_the_ends_which_it_kept_waiting_while_it_waited_awake(
    limited: Callable[[int], None], calls: list[Any]
) -> None:
    """With one priority for all, the slave's ticks beside a busy loop on each core were late by 80 us, not by 20."""
    assert realtime.ask(realtime.RELAY_PRIORITY).priority == 39
    assert calls == [(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, 39)]
    limited(10)
    assert (realtime.ask().priority, realtime.ask(realtime.RELAY_PRIORITY).priority) == (9, 8)
    assert realtime.run_first(realtime.PRIORITY + 1) == 10, "a limit leaves room for what runs before the loop"
    limited(1)
    assert realtime.ask().priority == 1
