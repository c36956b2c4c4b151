"""Messages that an end may not act on: in an outage one way, after a standstill unnoticed, or too old."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from teleop import PFRA, Direct, Fixed, Hold, Playout, Scene, Watchdog, Wave, Zero, load_scene, run
from teleop.protocol.packet import Kind, peek
from teleop.simulation.source import rendered
from tests.fakes import usually
from tests.teleop.protocol.test_healing import LAWS, alike, check, running
from tests.teleop.protocol.virtual_clock import MS, PATIENT, Done, S, World, healing


def direct(**other: Any) -> Scene:
    return healing(LAWS["direct"], dt=0.002, cap=None, watchdog=Watchdog(timeout=0.1, ramp=0.05, settle=0.1), **other)


def pressing() -> World:
    """Two ends whose devices stand still 2 cm apart."""
    world = running(direct(), still=True)
    world.devices["m"].x = 0.02
    world.run(0.5)
    assert abs(world.done["s"][-1].force) > 1.0
    return world


def after(world: World, e: str, true: int) -> list[Done]:
    return [done for done in world.done[e] if done.true >= true]


def causes(world: World, e: str) -> list[str]:
    return [event.why for event in world.end(e).guard.events if event.what == "safe"]


def met(world: World) -> list[int]:
    return [world.end(e).session.met for e in "ms"]


@pytest.mark.parametrize(("cut", "away"), [("m", 1.1), ("s", 2.4), ("ms", 5.0)])
def test_an_outage_one_way_ends_in_no_slam(cut: str, away: float) -> None:
    """The slave's device stays, the hand goes on 5 cm meanwhile: 200 N/m times 5 cm would be 10 N at the release."""
    world = running(direct(), still=True)
    world.cut = set(cut)
    world.run(away - 0.3)
    world.devices["m"].x = 0.05
    world.run(0.3)
    began, world.cut = world.true, set()
    world.assert_both_play()
    for e in "ms":
        assert max(abs(done.force) for done in after(world, e, began)) < 1e-6
    assert met(world) == [2, 2], "released into another session alone"
    alike(world)


@usually("playout, delay, cut", [(playout, delay, cut)
         for playout in (Zero(), Fixed(0.45)) for delay in ((5, 5), (5, 200), (200, 5), (300, 300)) for cut in "ms"],
         (Zero(), (5, 5), "m"), (Zero(), (5, 200), "s"), (Fixed(0.45), (300, 300), "m"))
def test_an_end_that_the_other_no_longer_hears_lets_go_within_the_timeout_and_a_round_trip(
    playout: Any, delay: tuple[int, int], cut: str
) -> None:
    scene = replace(direct(), playout=playout)
    world = World(scene, still=True, delay={"m": delay[0] * MS, "s": delay[1] * MS}).assert_both_play(after=1.0)
    world.devices["m"].x = 0.02
    world.run(0.99)
    assert abs(world.done["s"][-1].force) > 1.0
    began, world.cut = world.true, {cut}
    world.run(0.99)
    dog = scene.watchdog
    assert dog is not None
    safe = next(done.true for done in after(world, cut, began) if done.safe)
    assert safe - began <= sum(delay) * MS + (dog.timeout + 2 * scene.dt) * S
    k = after(world, cut, began)[0].k
    assert next(event.why for event in world.end(cut).guard.events if event.k >= k).startswith("no answer")
    done = [done for done in after(world, cut, began) if done.true >= safe + (dog.ramp + scene.dt) * S]
    assert done
    assert {each.force for each in done} == {0.0}


@usually("every", [(1, 10), (10, 1), (10, 10), (3, 7)], (1, 10), (3, 7))
def test_ends_of_other_rates_let_go_when_they_are_not_heard_and_not_before(every: tuple[int, int]) -> None:
    world = running(direct(), every=dict(zip("ms", every, strict=True)), still=True).run(3.0)
    assert [world.end(e).guard.events for e in "ms"] == [[], []]
    world.cut = {"s"}
    world.run(0.1 + 0.04 + 2 * 0.002 * sum(every))
    assert world.end("s").guard.safe


def test_ticks_that_the_other_end_left_out_and_long_links_are_no_deafness() -> None:
    world = running(direct(), jitter=10 * MS, loss=0.2)
    for _ in range(10):
        world.stand_still("m", 0.05)
        world.run(0.3)
    assert [world.end(e).guard.events for e in "ms"] == [[], []]
    far = World(healing(watchdog=Watchdog(timeout=0.5), dt=0.01), delay={"m": 300 * MS, "s": 300 * MS}).run(15.0)
    assert [far.end(e).guard.events for e in "ms"] == [[], []]


@usually("way", [0.3, 1.0, 2.0, 4.0], 1.0)
def test_links_of_seconds_are_met_and_released(way: float) -> None:
    dog = Watchdog(timeout=0.1, ramp=0.05, age=None)
    world = World(replace(direct(), watchdog=dog), delay={"m": round(way * S), "s": round(way * S)})
    alike(world.assert_both_play(20.0 + 20.0 * way, after=5.0 + 2.0 * way))


@pytest.mark.parametrize("who", ["m", "s"])
def test_messages_that_are_lost_from_the_beginning_of_a_session_release_nothing(who: str) -> None:
    """The exchange comes through and the messages do not, as over a channel whose scene has an outage."""
    world = World(direct(), still=True)
    world.drops = lambda e, data: e == who and peek(data)[0] in (Kind.FORTH, Kind.BACK)
    world.run(1.7)
    assert world.end("m").session.met == 1
    world.devices["m"].x = 0.05
    world.run(0.1)
    world.drops, began = lambda _e, _data: False, world.true
    world.assert_both_play()
    for e in "ms":
        assert max(abs(done.force) for done in after(world, e, began)) < 1e-6
    alike(world)


@pytest.mark.parametrize("who", ["m", "s"])
def test_in_another_session_nothing_is_released_before_the_other_end_hears_it(who: str) -> None:
    """The exchange comes through all the while, and of the messages only those of the other end."""
    world = running(direct(), still=True)
    world.drops, began = lambda e, data: e == who and peek(data)[0] in (Kind.FORTH, Kind.BACK), world.true
    world.run(5.0)
    assert world.end(who).session.met > 1
    gains = [done.gain for done in after(world, who, began)]
    assert all(b <= a for a, b in pairwise(gains)), "it let go once, and no session released it"
    assert gains[-1] == 0.0
    world.drops = lambda _e, _data: False
    world.assert_both_play()


@usually("is_told, who, away", [(is_told, who, away)
         for is_told in (True, False) for who in "ms" for away in (0.3, 0.9, 5.0)],
         (True, "m", 0.9), (False, "s", 0.3), (False, "m", 5.0))
def test_a_machine_that_was_suspended_acts_on_nothing_that_it_heard_before(
    is_told: bool, who: str, away: float
) -> None:
    """Its clock does not count the time: to it, what waited is new and the other end's messages come from ahead."""
    world = pressing()
    world.pause(who, True)
    world.run(away)
    world.step(who, -round(away * S))
    began = world.true
    world.pause(who, False)
    if is_told:
        world.end(who).stood_still(round(away * S))
    world.run(0.35)
    first = after(world, who, began)
    patience = 0.0 if is_told else 0.06  # a master that renews the session asks for it at every 50 ms
    assert first[0].safe or not is_told
    assert all(done.safe for done in first if done.true >= began + patience * S and done.met == 1)
    world.assert_both_play()
    assert met(world) == [2, 2]
    late = [done for done in after(world, who, began) if done.true >= began + (patience + 0.05) * S]
    assert max(abs(done.force) for done in late) < 1e-6, "what the hand did before is of the session before"
    assert not is_told or causes(world, who)[0].startswith("stood still"), causes(world, who)
    check(world)


@usually("who, lost", [("m", 0.2), ("s", 0.5), ("m", 0.9), ("s", 0.9)], ("m", 0.2), ("s", 0.9))
def test_messages_from_ahead_of_the_clock_say_within_some_ticks_that_it_stood_still(who: str, lost: float) -> None:
    """Nothing waits for it that would tell, as its network was away too, and no clock of it counted the time."""
    world = pressing()
    world.pause(who, True)
    world.run(lost)
    process = world.processes[who]
    assert process is not None
    process.queue.clear()
    world.step(who, -round(lost * S))
    world.pause(who, False)
    world.run(0.02)
    assert causes(world, who)[0].startswith("stood still"), causes(world, who)
    world.assert_both_play()
    assert met(world) == [2, 2]


def test_a_slave_that_is_told_that_its_session_is_over_lets_go_along_the_ramp_and_is_then_taken_up() -> None:
    world = pressing()
    began = world.true
    world.end("m").session.end("the session is over: as a test has it")
    world.run(0.05)
    world.assert_both_play(1.0)
    for e in "ms":
        gains = [done.gain for done in after(world, e, began) if done.met == 1]
        assert gains[-1] == 0.0
        assert max(a - b for a, b in pairwise([1.0, *gains])) <= 0.002 / 0.05 + 1e-9, "no new session cuts it off"
    check(world)


@usually("playout, every", [(playout, every)
         for playout in (Zero(), Fixed(0.05)) for every in ((1, 1), (16, 1), (1, 16), (12, 15))],
         (Zero(), (16, 1)), (Fixed(0.05), (1, 16)), (Zero(), (12, 15)))
def test_silence_is_as_long_whatever_rate_the_other_end_has(playout: Any, every: tuple[int, int]) -> None:
    """A slow peer's message stands for many ticks, and none of them is a sign that the peer is still there."""
    for e, other in ("ms", "sm"):
        world = World(replace(direct(), playout=playout), every=dict(zip("ms", every, strict=True)), still=True)
        world.run(3.0)
        assert world.both_play()
        began = world.done[other][-1].true  # of its last message
        world.kill(other)
        world.run(0.5)
        safe = next(done.true for done in after(world, e, began) if done.safe)
        delay = 0.05 if isinstance(playout, Fixed) else 0.02
        own = every["ms".index(e)] * 0.002
        assert (safe - began) / S <= delay + 0.1 + 2 * own + 0.004


@usually("playout, who", [(playout, who) for playout in (Zero(), Fixed(0.055)) for who in "ms"],
         (Fixed(0.055), "m"))
def test_a_session_that_began_while_one_way_was_slow_does_not_set_the_grids_apart_for_good(
    playout: Any, who: str
) -> None:
    """Half of 1.5 s, by which one way was slower in the exchange, stayed: with fixed playout all came late then."""
    world = running(replace(direct(), playout=playout), delay={"m": 5 * MS, "s": 5 * MS})
    world.delay[who] += 1500 * MS
    world.run(6.0)
    assert world.end("m").session.met == 2
    world.delay[who] -= 1500 * MS
    alike(world.assert_both_play(2 * PATIENT))


# The age of what is played: a delay that grows is no silence, and has to let go all the same


PLAIN: dict[str, Any] = {"wave": Wave(), "direct": Direct(), "pfra": PFRA(alpha=0.2)}
OF_AGE = Watchdog(timeout=0.2, age=0.3)
ZERO = Zero()


def growing(law: str = "direct", dog: Watchdog = OF_AGE, playout: Playout = ZERO, **other: Any) -> Scene:
    """The forward delay grows from 50 ms to a second, and packets come all the while."""
    base = load_scene("canonical", law=PLAIN[law], duration=2.0, energy=False, delay=0.05)
    later = replace(base, link=Ramp(), watchdog=dog, playout=playout)
    return replace(later, **other)


class Ramp:
    """A link whose packet k of a second takes 50 ms and half of the time that has passed."""

    def arrivals(self, direction: int, count: int, dt_ns: int, seed: int, size: int) -> Any:
        from channel.schedule import Arrivals

        k = np.arange(count, dtype=np.int64)
        took = 50 * MS + (k * dt_ns // 2 if direction == 0 else 0)
        return Arrivals(k, k * dt_ns + took)


@usually("law, playout", [(law, playout) for law in PLAIN for playout in (Zero(), Hold())], ("direct", Zero()),
         ("wave", Hold()))
def test_a_delay_that_grows_beyond_the_age_lets_go_although_packets_come_all_the_while(
    law: str, playout: Playout
) -> None:
    result = run(growing(law, playout=playout))
    seq, gain = result.trace["seq_s"], result.trace["g_s"]
    k = np.arange(len(seq))
    fresh = (seq >= 0) & (k - seq <= 300)
    last = int(np.flatnonzero(fresh)[-1])
    assert 400 < last < 1500
    assert (np.diff(np.flatnonzero(seq >= 0)) < 10).all(), "there is no silence"
    assert (gain[: last + 201] == 1.0).all()
    assert (gain[last + 201 + 51 :] == 0.0).all()
    assert (result.trace["f_s"][last + 201 + 51 :] == 0.0).all()
    assert (result.trace["g_m"] == 1.0).all(), "what comes to the master is young"
    (note,) = [note for note in result.notes if "age" in note]
    assert "the slave played them" in note
    assert "watchdog=Watchdog(age=" in note


def test_the_law_gets_an_old_message_all_the_same() -> None:
    """What lets go is the ramp: a message that was kept from the law as well would be a second way, and a jump."""
    old, free = run(growing("wave")), run(growing("wave", replace(OF_AGE, age=None)))
    assert (old.trace["seq_s"] == free.trace["seq_s"]).all()
    gone = int(np.flatnonzero(old.trace["g_s"] < 1.0)[0])
    for name in ("f_s", "x_s", "x_m"):
        assert (old.trace[name][:gone] == free.trace[name][:gone]).all()
    steps = np.abs(np.diff(old.trace["f_s"][gone - 1 :]))
    assert steps.max() <= np.abs(free.trace["f_s"]).max() / 50 + np.abs(np.diff(free.trace["f_s"])).max()
    assert not [note for note in free.notes if "watchdog" in note]


def test_a_fixed_playout_longer_than_the_age_holds_no_force_and_says_so_and_a_scene_without_one_does_not_pay() -> None:
    result = run(growing(playout=Fixed(0.4), link=load_scene("canonical").link))
    assert (result.trace["f_s"][252:] == 0.0).all()
    assert len([note for note in result.notes if "age of 0.3 s" in note]) == 2
    assert "c_dog_m.age" in rendered(growing())
    without = rendered(growing(dog=replace(OF_AGE, age=None)))
    assert "c_dog_m.age" not in without
    assert "newest" not in without


# Live


def test_a_delay_that_grows_lets_both_live_ends_go_within_the_timeout_and_says_why() -> None:
    """To 4 s, at half a second a second: packets come all the while, and what they say is ever older."""
    dog = Watchdog(timeout=0.2, ramp=0.05)
    world = World(healing(Direct(), dt=0.005, watchdog=dog, cap=None), still=True).run(2.0)
    world.devices["m"].x = 0.02
    world.run(0.5)
    while world.delay["m"] < 4 * S:
        world.delay["m"] += 10 * MS
        world.run(0.02)
    world.run(1.0)
    done = world.done["s"]
    old = next(i for i, one in enumerate(done) if one.played >= 0 and (one.k - one.played) * 0.005 > 2.5)
    assert abs(done[old - 1].force) > 1.0
    late = [one for one in done if one.true > done[old].true + (0.2 + 0.05 + 0.02) * S]
    assert len(late) > 100
    assert sum(one.played >= 0 for one in late) > 50, "there is no silence"
    assert {one.force for one in late} == {0.0}
    why = [event.why for event in world.end("s").guard.events if event.what == "safe"]
    assert why[0].startswith("age: messages come more than 2.5 s")
    assert world.end("s").guard.old > 50


@usually("every", [(1, 1), (1, 8), (8, 1), (4, 6)], (1, 8))
def test_the_age_is_the_same_whatever_rates_the_ends_have(every: tuple[int, int]) -> None:
    for delay, old in ((200, False), (400, True)):
        dog = Watchdog(timeout=0.2, age=0.3)
        rates, way = dict(zip("ms", every, strict=True)), {"m": delay * MS, "s": delay * MS}
        world = World(healing(Direct(), dt=0.005, watchdog=dog), still=True, every=rates, delay=way).run(8.0)
        for e in "ms":
            assert world.end(e).guard.safe is old
            assert (world.end(e).guard.old > 10) is old
