"""Faults and hostile numbers: whatever is raised or sent, no force at once, both ends stop, the record is whole."""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import Any

import pytest

from channel import LeftOut
from master.device import SimulatedMaster
from slave.robot import SimulatedSlave
from teleop import DeviceError, load_result, load_scene, run
from teleop.law.contract import Method
from teleop.live import leaving
from teleop.live.leaving import RETRY_NS
from teleop.live.records.end_result import UNRELEASED
from teleop.live.records.merge import merge
from teleop.live.records.reader import read_record
from teleop.live.records.record import read_events
from teleop.live.shell import TRACEBACK, fault_sentence
from teleop.protocol.endpoint import Endpoint
from teleop.scene.loading import live_knobs
from teleop.scene.scene import Scene, both_ends
from teleop.simulation.metrics import worked_out
from tests.fakes import Body, at_tick, raising
from tests.live.conftest import summary

pytestmark = pytest.mark.live


FULL = pytest.mark.full
Make = Callable[..., Any]
SCENE = replace(load_scene("canonical", duration=0.6, wall=0.005), link=None)
DEVICES: dict[str, Any] = {"m": SimulatedMaster, "s": SimulatedSlave}
AT = 200  # the tick of it


class PanicError(BaseException):
    """As a Rust extension raises it."""


class Probe(Body):
    """A device that acts at a tick, and then raises at a force that is not zero."""

    def __init__(self, e: str, act: Callable[[], object], raises: BaseException | None = None) -> None:
        super().__init__(inner=DEVICES[e](SCENE), reads=at_tick(AT, self.acts), holds=self.holding)
        self.act, self.raises = act, raises
        self.since: int | None = None  # how many forces it had been given when it acted

    def acts(self) -> None:
        self.since = len(self.held)
        self.act()

    def holding(self, force: tuple[float, ...]) -> tuple[float, ...]:
        if self.raises is not None and self.since is not None and any(force):
            raise self.raises.with_traceback(None)
        return force


def ended_of(both: Any, e: str, device: Probe, error: BaseException, part: str) -> None:
    """Both ends stopped, in order, and the device had no force from the moment of the error on."""
    own, other = both.shells[e], both.shells["sm"["ms".index(e)]]
    assert both.errors == {"m": None, "s": None}, "the loop itself has come to its end"
    assert both.status() == {"m": "stopped", "s": "stopped"}
    assert own.outcome.fault is error
    assert f"{part} raised {type(error).__name__}" in own.outcome.sentence
    assert f"the other end left: {own.outcome.sentence}" in other.outcome.sentence, "the truth"
    assert device.since is not None
    held = [force for force, in device.held]
    assert max(map(abs, held[: device.since])) > 0.1, "there was force"
    after = held[device.since :]
    assert after, "it was let go"
    assert not any(after), after
    folder = both.write()["ms".index(e)]
    assert summary(folder)["sentence"] == own.outcome.sentence
    assert len(read_record(folder)[1].ticks) == own.counts.ticks > 0
    assert merge(SCENE, *[both.out / name for name in ("master", "slave")]).status == "stopped"


ERRORS = [asyncio.CancelledError("by a library"), PanicError("index out of bounds"), KeyboardInterrupt(),
          SystemExit(0), GeneratorExit(), MemoryError(), ZeroDivisionError("float division by zero")]


@pytest.mark.parametrize(("error", "e", "seed"), [
    pytest.param(error, e, seed, id=f"{type(error).__name__} {e} {'stepped' if seed else 'by the clock'}",
                 marks=[] if (i + (e == "s") + (seed == 1)) % 4 == 0 or (i == 0 and e == "m") else FULL)
    for i, error in enumerate(ERRORS) for e in "ms" for seed in (None, 1)
])
def test_a_driver_that_raises_what_is_no_exception_to_catch_holds_no_force(
    error: BaseException, e: str, seed: int | None, pair: Make
) -> None:
    device = Probe(e, raising(error))
    both = pair(SCENE, seed=seed, parts={**{"m": {}, "s": {}}, e: {"device": device}}).run()
    ended_of(both, e, device, error, "the device, asked for a reading,")


@pytest.mark.parametrize("error", ERRORS[:2], ids=lambda error: type(error).__name__)
def test_a_driver_that_raises_when_it_is_given_a_force_is_given_none(error: BaseException, pair: Make) -> None:
    device = Probe("s", lambda: None, error)
    both = pair(SCENE, parts={"m": {}, "s": {"device": device}}).run()
    ended_of(both, "s", device, error, "the device, given a force,")


@pytest.mark.parametrize(("error", "e"), [(ERRORS[0], "m"), (ERRORS[3], "s"), *[
    pytest.param(error, e, marks=FULL) for error, e in ((ERRORS[0], "s"), (ERRORS[1], "m"), (ERRORS[2], "s"))]],
    ids=lambda each: each if isinstance(each, str) else type(each).__name__)
def test_a_law_that_raises_what_is_no_exception_to_catch_holds_no_force(
    error: BaseException, e: str, pair: Make
) -> None:
    class Law:
        send = staticmethod(lambda _told: raising(error)())

    device = Probe(e, lambda: setattr(both.shells[e].endpoint._law, "_started", Law))
    both = pair(SCENE, parts={**{"m": {}, "s": {}}, e: {"device": device}})
    answer = Method(SCENE.law, "master" if e == "m" else "slave")
    ended_of(both.run(), e, device, error, f"the answer of {answer.label}{answer.first_line()}")


def test_a_record_or_a_live_line_that_raises_ends_the_run_without_force(pair: Make) -> None:
    error: BaseException = PanicError()

    class Rows(bytearray):
        def __iadd__(self, other: Any) -> Any:
            raise error

    device = Probe("m", lambda: setattr(both.shells["m"].recorder, "_rows", Rows()))
    both = pair(SCENE, parts={"m": {"device": device}, "s": {}})
    both.run()
    own = both.shells["m"]
    assert (own.outcome.fault, own.outcome.status, both.shells["s"].outcome.status) == (error, "stopped", "stopped")
    assert "the record raised PanicError" in own.outcome.sentence
    assert device.held[-1] == (0.0,)
    error = SystemExit(3)
    device = Probe("m", lambda: None)
    both = pair(SCENE, parts={"m": {"device": device, "say": lambda _numbers: raising(error)()}, "s": {}}).run()
    assert both.shells["m"].outcome.fault is error
    assert "the live line raised SystemExit: 3" in both.shells["m"].outcome.sentence
    assert "the live line raised SystemExit: 3" in both.shells["s"].outcome.sentence
    assert device.held[-1] == (0.0,)


def test_a_handler_of_signals_that_raises_while_an_end_leaves_keeps_it_from_no_step(
    pair: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A driver's handler may raise at any line, so also between two steps."""
    both = pair(SCENE)
    own, error = both.shells["m"], KeyboardInterrupt("of a driver")
    guarded, raised = own.guarded, list[BaseException]()

    def interrupted(callback: Callable[[], object]) -> None:
        if callback == own.recorder.close and not raised:
            raised.append(error)
            raise error
        guarded(callback)

    monkeypatch.setattr(own, "guarded", interrupted)
    both.run()
    assert both.errors == {"m": None, "s": None}
    assert (own.outcome.fault, raised) == (error, [error])
    assert "KeyboardInterrupt: of a driver" in both.write()[0].joinpath("summary.json").read_text()
    assert both.status() == {"m": "stopped", "s": "ok"}


# The last zero


def stuck(times: int, raises: BaseException) -> tuple[Body, list[int]]:
    """A device that takes no zero force so and so many times, and how often it was tried."""
    tried = [0]

    def hold(force: tuple[float, ...]) -> tuple[float, ...]:
        if not any(force) and any(device.force):
            tried[0] += 1
            if tried[0] <= times:
                raise raises
        return force

    device = Body(inner=SimulatedMaster(SCENE), holds=hold)
    return device, tried


@pytest.mark.parametrize("raises", [DeviceError("the bus is busy"), OSError(5, "Input/output error"), SystemExit(1)],
                         ids=lambda error: type(error).__name__)
def test_a_last_zero_that_fails_is_tried_again(raises: BaseException, pair: Make) -> None:
    device, tried = stuck(10, raises)
    both = pair(SCENE, parts={"m": {"device": device}, "s": {}}).run()
    assert both.status() == {"m": "ok", "s": "ok"}
    assert device.held[-1] == (0.0,)
    assert tried == [11]


def test_a_force_that_stays_on_is_said_and_is_not_ok(pair: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    """It was exit 0, status ok, and the force on."""
    monkeypatch.setattr(leaving, "RETRY_NS", RETRY_NS // 5)
    device, tried = stuck(10**9, DeviceError("the amplifier does not answer"))
    both = pair(SCENE, parts={"m": {"device": device}, "s": {}}).run()
    own = both.shells["m"]
    assert own.outcome.status == UNRELEASED
    assert "THE FORCE MAY STILL BE ON" in own.outcome.sentence
    assert "the amplifier does not answer" in own.outcome.sentence
    assert own.outcome.sentence.startswith("ran to its end")
    assert tried[0] >= 3
    folders = both.write()
    zero = [event["why"] for event in read_events(folders[0]) if event["what"] == "zero"]
    assert zero == ["the device does not take zero force: the amplifier does not answer"]
    whole = merge(SCENE, *folders)
    assert (whole.status, whole.sentence) == (UNRELEASED, own.outcome.sentence)


# As a process

LAW = """
from dataclasses import replace
from teleop.laws.wave import Wave
from teleop.scene import Scene, load_scene
class Broken(Wave):
    def {where}(self, *given):
        import inspect, sys
        if "--listen" in sys.argv and any(frame.function == "tick" for frame in inspect.stack()):
            raise IndexError("of a law")
        return super().{where}(*given)
def scene(*, duration: float = 5.0) -> Scene:
    '''A law with an error in it.'''
    return replace(load_scene("canonical", duration=duration), law=Broken(b=2.0, K=500.0, B=20.0))
"""


@pytest.mark.parametrize("where", ["slave_start", pytest.param("slave", marks=FULL)])
def test_of_a_law_that_raises_at_its_first_tick_there_is_a_traceback(where: str, command: Make, tmp_path: Path) -> None:
    """There had been no tick, so the folder was gone, and with it the line of the law that was wrong.

    It raises at the slave alone: the master begins the slave's half too, and might leave first.
    """
    (tmp_path / "broken.py").write_text(LAW.format(where=where))
    slave = command("slave", "broken.py", "--listen", "127.0.0.1:0", "--json", "--out", "s")
    master = command("master", "broken.py", "--peer", f"127.0.0.1:{slave.port()}", "--json")
    code, _, err = slave.end()
    assert (code, err.count("\n")) == (1, 1), err
    assert f"Broken.{where} (broken.py:9) raised IndexError: of a law; mend that line; its traceback is in " in err
    assert "broken.py" in (tmp_path / "s" / TRACEBACK).read_text()
    assert f"Broken.{where} (broken.py:9) raised IndexError" in str(master.end())


def test_a_fault_whose_own_text_cannot_be_had_has_a_sentence() -> None:
    class Nameless(Exception):
        def __str__(self) -> str:
            raise self

    assert fault_sentence(Nameless()) == "the live loop raised Nameless"
    with pytest.raises(AttributeError) as caught:
        Endpoint.tick(None, 0, 0, None)
    assert fault_sentence(caught.value).startswith("the law raised AttributeError: ")


MISTAKEN = '''
from dataclasses import dataclass
from teleop import Scene, load_scene
from teleop.laws.direct import Direct, Forth

@dataclass(frozen=True, kw_only=True)
class Mine(Direct):
    def master(self, s, at, rx):
        if at.x > 0.005:
            return {answer}  # the tenth line
        return 0.0, Forth(at.x, at.v), s

def scene(*, duration: float = 0.5) -> Scene:
    """A law with a mistake in it."""
    return load_scene("canonical", duration=duration, law=Mine())
'''


@pytest.mark.parametrize(("answer", "said", "stepping"), [
    ("rx.f_env / 0.0, Forth(at.x, at.v), s", "Mine.master (mine.py:10) raised ZeroDivisionError: ", []),
    ('"much", Forth(at.x, at.v), s', "the answer of Mine.master (mine.py:8) raised TypeError: ", ["--lockstep"]),
])
def test_a_mistake_in_the_middle_of_a_run_is_told_with_its_line_and_holds_no_force(
    answer: str, said: str, stepping: list[str], tmp_path: Path
) -> None:
    (tmp_path / "mine.py").write_text(MISTAKEN.format(answer=answer))
    command = [sys.executable, "-m", "teleop", "demo", "mine.py", "--out", "d", *stepping]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 2, done.stderr
    assert said in done.stderr
    assert "Traceback" not in done.stderr
    ends: list[dict[str, Any]] = [json.loads((tmp_path / "d" / end / "summary.json").read_text())
                                  for end in ("master", "slave")]
    assert all(said in end["sentence"] for end in ends)
    assert all(end["status"] == "stopped" for end in ends)


SIZES = [("hard_wall", "m", 1e308), ("rubber", "s", 1e160), *[pytest.param(*each, marks=pytest.mark.full) for each in (
    ("hard_wall", "s", 1e308), ("rubber", "m", 1e308), ("hard_wall", "m", 1e160))]]


def hostile(shell: Any, size: float) -> None:
    """From tick 100 on, have this end send `size` in every number of its messages, and as the energy that it put in."""
    end = shell.endpoint
    honest = end._datagram

    def datagram(k: int, now: int, tx: tuple[Any, ...], sent: tuple[Any, ...] | None, row: Any) -> bytes | None:
        if k > 100:
            value = size if k // 20 % 2 else -size
            tx = tuple(type(message)(*[value] * len(message)) for message in tx)
            if sent is not None:  # what its waves have come to
                sent = tuple(type(one)(one.T, value, size) for one in sent)
            row = tuple(size if i == end.places.E_in else number for i, number in enumerate(row))
        data: bytes | None = honest(k, now, tx, sent, row)
        return data

    end._datagram = datagram


def strict(folder: Path) -> dict[str, Any]:
    """Its summary, no number in which is anything that JSON does not know."""
    def unknown(word: str) -> None:
        raise AssertionError(f"{word} is no JSON")

    told: dict[str, Any] = json.loads((folder / "summary.json").read_text(), parse_constant=unknown)
    return told


@pytest.mark.parametrize(("name", "e", "size"), SIZES)
def test_a_peer_that_sends_waves_of_1e308_leaves_a_summary_and_no_traceback_and_is_made_whole_if_it_was_killed(
    name: str, e: str, size: float, pair: Callable[..., Any], tmp_path: Path
) -> None:
    scene: Scene = replace(load_scene(name, duration=0.3, law="wave"), link=None)
    both = pair(scene)
    hostile(both.shells[e], size)
    both.run()
    assert both.errors == {"m": None, "s": None}
    folders = both.write()
    merged = merge(scene, *folders)
    merged.save(tmp_path / "merged")
    for folder in (*folders, tmp_path / "merged"):
        told = strict(folder)
        assert told["status"] in ("ok", "stopped", "diverged")
        assert load_result(folder).sentence == told["sentence"]
    victim = strict(both.out / ("slave" if e == "m" else "master"))
    assert victim["slave" if e == "m" else "master"]["stamp_margin"] == "-inf" or size < 1e200
    # Where a tick was left out at the last moment, both may end before anything has overflowed.
    lost = sorted(name for name, value in worked_out(scene, merged.trace).items() if not isfinite(value))
    notes = [note for note in merged.notes if note.startswith("not finite, and so left out of the metrics")]
    assert notes == [f"not finite, and so left out of the metrics: {', '.join(lost)}"] * bool(lost)
    for folder in folders:
        header, _, rows = (folder / "record.bin").read_bytes().partition(b"\n")
        about = {**json.loads(header), "scene": name, "knobs": {"duration": "0.3", "link": "none", "law": "wave"}}
        (folder / "record.bin").write_bytes(json.dumps(about).encode() + b"\n" + rows)
        (folder / "summary.json").unlink()
        (folder / "trace.npz").unlink()
        assert "without a word" in load_result(folder).sentence
        strict(folder)


def test_a_pressed_wall_keeps_its_force_with_half_of_the_ticks_left_out() -> None:
    """With zeros in the gaps the force was 0.0 N at 44 % of ticks left out."""
    scene = both_ends(load_scene("hard_wall", **live_knobs("hard_wall", {"duration": "4"})))
    pressed = run(load_scene("hard_wall", duration=4.0)).metrics["f_m_end"]
    assert pressed > 2.0
    for share in (0.1, 0.44):
        trace = run(replace(scene, left_out_m=LeftOut(share), left_out_s=LeftOut(share))).trace
        for name in ("f_m", "f_s"):
            assert trace[name][-100:].mean() > 0.8 * pressed, (share, name)
