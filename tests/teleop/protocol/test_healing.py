"""Ends that are killed, started anew and paused, links that are cut: the pair is safe, and goes on by itself."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from teleop import PFRA, Cap, Device, Direct, Encoder, Fixed, Integral, Wave, Zero
from teleop.protocol.guard import DEADLINE, LAPSING, Event
from teleop.protocol.packet import Echo, Kind, Packet, encode
from teleop.simulation.structure import columns
from tests.fakes import usually
from tests.teleop.protocol.virtual_clock import DOG, MS, Done, World, healing

SCENE = healing()
LAWS: dict[str, Any] = {"wave": Wave(b=2.0, K=200.0, B=5.0), "direct": Direct(K=200.0, B=5.0), "pfra": PFRA(alpha=0.2)}


def running(scene: Any = SCENE, **other: Any) -> World:
    return World(scene, **other).assert_both_play(5.0, after=2.0)


def check(world: World) -> None:
    """What holds at every tick, whatever happened."""
    scene = world.scene
    assert scene.watchdog is not None
    timeout, slew = scene.watchdog.timeout, scene.cap.slew if scene.cap else float("inf")
    for e in "ms":
        heard = -10.0**9
        for before, now in pairwise([None, *world.done[e]]):
            if now.first:
                before, heard = None, now.k  # noqa: PLW2901 - another process
            passed = 1 if before is None else now.k - before.k
            lapsed = passed * scene.dt > LAPSING * DEADLINE  # and the device let go meanwhile
            step = now.force - (0.0 if before is None or lapsed else before.force)
            assert abs(step) <= slew * scene.dt * passed + 1e-9, f"{e} at tick {now.k}"
            heard = now.k if now.played >= 0 else heard
            silent = (now.k - heard) * scene.dt
            if silent > timeout + scene.dt:
                assert now.safe, f"{e} at tick {now.k}, silent for {silent} s"
            if (passed - 1) * scene.dt > timeout + scene.dt:
                assert now.safe, f"{e} at tick {now.k}, after a stall"
                assert before is None or now.gain < before.gain or now.gain == 0.0
            if before is not None and now.met != before.met:
                assert (now.safe, now.gain) == (True, 0.0)
            if now.safe and before is not None and before.safe and now.gain > before.gain:
                raise AssertionError(f"{e} at tick {now.k}: the gain rises before it is released")
        process = world.processes[e]
        if process is not None:
            assert (process.end.stamp_margin or 0.0) >= -1e-12
            assert process.end.force_failed is None
            assert not process.end.rejected["integrals"], "what an honest end sends adds up"


def alike(world: World) -> None:
    """Both are in one session, and play; and what holds at every tick."""
    one, other = world.end("m"), world.end("s")
    assert one.session.number == other.session.number
    assert world.both_play()
    uncertain = (one.session.rtt_ns or 0) // 2 // world.scene.dt_ns
    assert abs(world.done["m"][-1].k - world.done["s"][-1].k) <= max(4, uncertain), "of one grid"
    check(world)


@pytest.mark.parametrize("who", ["m", "s", "ms"])
def test_whoever_is_killed_and_started_anew_is_met_again(who: str) -> None:
    world = running()
    for _ in range(2):
        for e in who:
            world.kill(e)
        world.run(0.7)
        for e in {*"ms"} - {*who}:
            assert world.end(e).guard.safe
            assert world.done[e][-1].force == pytest.approx(0.0, abs=1e-12)
        for e in who:
            world.start(e)
        alike(world.assert_both_play())
        assert max(abs(done.force) for e in "ms" for done in world.done[e][-40:]) > 0.02


@usually("who, away", [(who, away) for away in (0.05, 0.3, 1.5, 12.0) for who in ("m", "s", "ms")],
         ("m", 0.05), ("s", 0.3), ("ms", 1.5), ("m", 1.5), ("s", 12.0))
def test_whoever_stood_still_goes_on(who: str, away: float) -> None:
    world = running()
    before = {e: len(world.done[e]) for e in "ms"}
    world.stand_still(who, away)
    world.run(0.1)
    if away > DOG.timeout + 0.05:
        for e in who:
            first = world.done[e][before[e]]
            assert first.safe, "safe before it puts out any force"
            if away > DOG.timeout + DOG.ramp + 0.05:
                assert (first.gain, first.force) == (0.0, 0.0)
            assert "stall" in next(event.why for event in world.end(e).guard.events if event.what == "safe")
    else:
        assert world.end("m").session.met == 1
    alike(world.assert_both_play())


def session(world: World, e: str) -> list[Done]:
    done = world.done[e]
    process = max(i for i, each in enumerate(done) if each.first)
    return [each for each in done[process:] if each.met == done[-1].met]


steps = st.tuples(
    st.sampled_from(["restart", "pause", "cut"]), st.sampled_from(["m", "s", "ms"]),
    st.sampled_from([0.0, 0.02, 0.2, 0.9, 1.3, 3.0]), st.sampled_from([0.0, 0.05, 0.6, 1.5]),
)


@settings(max_examples=25)
@given(st.lists(steps, min_size=1, max_size=4), st.integers(0, 2**20), st.booleans(),
       st.sampled_from([Zero(), Zero(), Fixed(0.03)]))
def test_whatever_happens_in_whatever_order_they_go_on(
    happens: list[Any], seed: int, rough: bool, playout: Any
) -> None:
    link = {"jitter": 30 * MS, "loss": 0.1, "copies": 0.1} if rough else {}
    world = World(healing(dt=0.02, playout=playout), seed=seed, **link).run(1.5)
    for what, who, away, then in happens:
        {"restart": world.restart, "pause": world.stand_still, "cut": world.cut_off}[what](who, away)
        world.run(then)
    world.assert_both_play(12.0, after=0.0)
    assert world.end("m").session.number == world.end("s").session.number
    check(world)


@usually("every", [(1, 2), (2, 1), (2, 3), (4, 4)], (2, 3))
def test_ends_of_two_rates_go_on_too(every: tuple[int, int]) -> None:
    world = running(healing(dt=0.005, playout=Integral()), every=dict(zip("ms", every, strict=True)))
    for who in ("m", "s", "ms"):
        world.restart(who, 0.7)
        world.assert_both_play()
    world.cut_off("ms", 2.0)
    world.assert_both_play()
    assert [world.end(e).session.met for e in "ms"] == [2, 2]
    for e, rate in zip("ms", every, strict=True):
        assert all(done.k % rate == 0 for done in world.done[e])
        assert (world.end(e).stamp_margin or 0.0) >= -1e-12


# What a resumed session is like


@usually("who, law", [(who, law) for who in "ms" for law in LAWS], ("m", "wave"), ("s", "direct"))
def test_devices_that_moved_apart_meanwhile_are_taken_up_where_they_are(who: str, law: str) -> None:
    world = running(healing(LAWS[law], cap=None), still=True)
    world.devices["s"].x = 0.05
    world.restart(who, 0.5)
    world.assert_both_play()
    column = {e: columns(world.scene, e).index(f"x_{e}@") for e in "ms"}
    for e, x in (("m", 0.0), ("s", 0.05)):
        last = world.done[e][-30:]
        assert {done.row[column[e]] for done in last} == {x}, "the record has the device's own positions"
        assert max(abs(done.force) for done in last) < 1e-6, "200 N/m times 5 cm would be 10 N"
    world.devices["m"].x, world.devices["m"].v = 0.01, 0.1
    world.run(0.3)
    assert abs(world.done["s"][-1].force) > 0.02, "and from here on it follows"


def test_with_an_encoder_the_clutch_is_a_whole_number_of_its_steps() -> None:
    coarse = Device(encoder=Encoder(step=0.004))
    world = running(healing(cap=None, device_m=coarse, device_s=coarse), still=True)
    world.kill("s")
    world.devices["s"].x, world.devices["m"].x = 0.0511, -0.0201
    world.restart("s", 0.5)
    world.assert_both_play(after=0.3)
    for e, q in (("m", -0.024), ("s", 0.048)):
        names = columns(world.scene, e)
        row = world.done[e][-1].row
        assert row[names.index(f"x_{e}@")] == pytest.approx(world.devices[e].x, abs=1e-15)
        assert row[names.index(f"q_{e}@")] == pytest.approx(q, abs=1e-12), "what the encoder reads there"
        assert abs(world.done[e][-1].force) < 1e-6


@pytest.mark.parametrize("timeout", [0.1, 3.0])
def test_force_begins_from_zero_and_comes_back_along_the_ramp(timeout: float) -> None:
    """Also where nobody was safe yet when the session was over."""
    world = running(healing(cap=None, watchdog=replace(DOG, timeout=timeout)))
    world.restart("s", 1.0)
    assert world.run(2.0 + timeout).both_play()
    for e in "ms":
        done = session(world, e)
        rising = [each.gain for each in done if 0.0 < each.gain < 1.0]
        assert done[0].gain == done[0].force == 0.0
        assert [b - a for a, b in pairwise(rising)] == pytest.approx([0.1] * (len(rising) - 1))
        assert len(rising) >= 9


def test_the_law_begins_from_rest_with_each_session_ledgers_too_and_events_tell_at_which_tick_of_the_grid() -> None:
    world = running()
    for e in "ms":
        assert (world.end(e).guard.events, world.end(e).session.met, dict(world.end(e).rejected)) == ([], 1, {})
    at = world.done["m"][-1].k
    world.restart("s", 0.5)
    world.assert_both_play()
    for e, names in (("m", ("E_in_fwd", "E_out_bwd")), ("s", ("E_in_bwd", "E_out_fwd"))):
        for name in names:
            column = columns(world.scene, e).index(name)
            assert session(world, e)[0].row[column] < 1e-3
            assert world.done[e][200].row[column] > 1e-2
    assert [world.end(e).session.met for e in "ms"] == [2, 1]
    events = world.end("m").guard.events
    assert [event.what for event in events] == ["safe", "session", "released"]
    assert "silence" in events[0].why
    assert at + 10 <= events[0].k <= at + 15
    assert events[1].k < events[2].k <= events[1].k + 20
    here = world.end("s").guard.events
    assert [event.what for event in here] == ["joined", "session", "safe", "released"]
    assert all(isinstance(event, Event) and event.k >= events[1].k for event in here)
    assert world.end("m").guard.entries == 1


@pytest.mark.parametrize(("who", "cap"), [("m", None), ("ms", Cap(f_max=20.0, slew=1.0))])
def test_an_end_that_stood_still_until_its_device_let_go_takes_hold_along_the_ramp(who: str, cap: Cap | None) -> None:
    """Shorter than its watchdog's patience: the device had lapsed, the gain was 1, and the force came back at once.

    What slew is counted from is the zero that the device has held, not the force that it was given last.
    """
    world = running(healing(LAWS["direct"], cap=cap, watchdog=replace(DOG, timeout=3.0)))
    while abs(world.done["s"][-1].force) < 0.2:
        world.run(0.01)
    ran = {e: len(world.done[e]) for e in who}
    world.stand_still(who, 0.17)
    world.run(1.0)
    for e in who:
        after = world.done[e][ran[e]:]
        assert (after[0].safe, after[0].gain, after[0].force) == (True, 0.0, 0.0)
        assert max(b.gain - a.gain for a, b in pairwise(after)) == pytest.approx(0.1)
        assert after[-1].gain == 1.0


def test_loss_is_counted_of_what_was_sent_in_a_session_and_not_of_the_time_between_them() -> None:
    world = running()
    for who in "ms":
        world.restart(who, 2.0)
        world.assert_both_play(after=0.0)
    world.cut_off("ms", 3.0)
    world.assert_both_play(after=1.0)
    for e in "ms":
        assert world.end(e).link.lost() <= 4
        assert world.end(e).link.reordered == 0


# Nobody else ends or moves it


@pytest.mark.parametrize("who", ["m", "s"])
def test_no_forged_word_of_another_session_or_manifest_ends_a_survivor(who: str) -> None:
    """Not while it runs, not while it waits, and not while it meets again; nor does an end with another manifest."""
    world = running()
    other = "s" if who == "m" else "m"
    strange = [
        encode(Packet(kind, number, 0, world.true, echo, payload))
        for number in (8, 0, 2**64 - 1)
        for echo in (None, Echo(0, 0))
        for kind, payload in ((Kind.BYE, "stop"), (Kind.REFUSE, "no"), (Kind.HELLO, {"scene": "another"}),
                              (Kind.WELCOME, {"scene": "another"}), (Kind.START, 5))
    ]
    hello = encode(Packet(Kind.HELLO, 8, 0, 0, None, {"scene": "another"}), 1200)
    world.start(other, scene=replace(SCENE, playout=Fixed(0.05)))
    for i in range(40):
        for data in (*strange, hello):
            world.put_in(who, data)
        world.run(0.05)
        if i == 20:
            assert world.end(other).session.failure is not None
            world.start(other)
    session = world.end(who).session
    assert (session.failure, session.farewell) == (None, None)
    for _ in range(10):
        for data in strange:
            world.put_in(who, data)
        world.run(0.3)
    check(world.assert_both_play())
