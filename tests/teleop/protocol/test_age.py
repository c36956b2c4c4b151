"""The age of what is played: a delay that grows is no silence, and has to let go all the same."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from teleop import PFRA, Direct, Fixed, Hold, Playout, Scene, Watchdog, Wave, Zero, load_scene, run
from teleop.simulation.source import rendered
from tests.fakes import usually
from tests.teleop.protocol.virtual_clock import MS, S, World, healing

LAWS: dict[str, Any] = {"wave": Wave(), "direct": Direct(), "pfra": PFRA(alpha=0.2)}
DOG = Watchdog(timeout=0.2, age=0.3)
ZERO = Zero()


def growing(law: str = "direct", dog: Watchdog = DOG, playout: Playout = ZERO, **other: Any) -> Scene:
    """The forward delay grows from 50 ms to a second, and packets come all the while."""
    base = load_scene("canonical", law=LAWS[law], duration=2.0, energy=False, delay=0.05)
    later = replace(base, link=Ramp(), watchdog=dog, playout=playout)
    return replace(later, **other)


class Ramp:
    """A link whose packet k of a second takes 50 ms and half of the time that has passed."""

    def arrivals(self, direction: int, count: int, dt_ns: int, seed: int, size: int) -> Any:
        from channel.schedule import Arrivals

        k = np.arange(count, dtype=np.int64)
        took = 50 * MS + (k * dt_ns // 2 if direction == 0 else 0)
        return Arrivals(k, k * dt_ns + took)


@usually("law, playout", [(law, playout) for law in LAWS for playout in (Zero(), Hold())], ("direct", Zero()),
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
    old, free = run(growing("wave")), run(growing("wave", replace(DOG, age=None)))
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
    without = rendered(growing(dog=replace(DOG, age=None)))
    assert "c_dog_m.age" not in without
    assert "newest" not in without


# Live


def test_a_delay_that_grows_lets_both_live_ends_go_within_the_timeout_and_says_why() -> None:
    """To 4 s, at half a second a second: packets come all the while, and what they say is ever older."""
    dog = Watchdog(timeout=0.2, ramp=0.05)
    world = World(healing(LAWS["direct"], dt=0.005, watchdog=dog, cap=None), still=True).run(2.0)
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
        world = World(healing(LAWS["direct"], dt=0.005, watchdog=dog), still=True, every=rates, delay=way).run(8.0)
        for e in "ms":
            assert world.end(e).guard.safe is old
            assert (world.end(e).guard.old > 10) is old
