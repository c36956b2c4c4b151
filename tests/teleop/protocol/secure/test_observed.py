"""An observer whose copy of every datagram comes first, from an address of its own: who draws the answers, in virtual
time."""

from __future__ import annotations

from collections.abc import Callable

from tests.fakes import usually
from tests.teleop.protocol.secure.conftest import AWAY, FORTH, HOME, MS, SLAVE, World

Make = Callable[..., World]


def assert_at_home(two: World, since: int, until: int, least: float = 1.0) -> None:
    """Nothing was drawn elsewhere, and as much of what was sent in this time came as the link lets through."""
    assert (two.master.address, two.slave.address) == (SLAVE, HOME)
    for end in (0, 1):
        assert two.share(end, since, until) >= least


@usually("seed", range(5), 0, 1)
def test_an_observer_whose_copies_come_first_draws_nothing_to_itself_before_the_meeting_or_during_a_run(
    world: Make, seed: int
) -> None:
    """There was no session for as long as it copied."""
    two = world(seed=seed, copies=True).run(3000)
    assert two.master.associations == two.slave.associations == 1
    assert_at_home(two, 500, 2900)
    two = world("delay(0.02) | uniform(0.02) | bernoulli(0.1)", seed).run(1000)
    two.copies = True
    two.run(3000)
    assert two.master.associations == two.slave.associations == 1
    assert_at_home(two, 500, 3900, 0.85)


@usually("seed", range(5), 0)
def test_nor_after_an_outage_of_1_4_s(world: Make, seed: int) -> None:
    """It never healed."""
    two = world("delay(0.02) | uniform(0.02) | blackout(2.0, 1.4)", seed, copies=True).run(6000)
    assert_at_home(two, 3500, 5900, 0.99)


@usually("who, seed", [(who, seed) for who in ("master", "slave") for seed in range(3)], ("master", 0), ("slave", 1))
def test_nor_after_an_end_was_killed_and_started_again(world: Make, who: str, seed: int) -> None:
    two = world(seed=seed, copies=True).run(1000)
    back = two.restart(who, 1500)
    two.run(6000)
    assert_at_home(two, back + 3500, back + 5900)


@usually("delay, seed, copies", [(delay, seed, copies)
         for delay in (0.02, 0.3) for seed in range(5) for copies in (False, True)],
         (0.02, 0, True), (0.02, 1, False), (0.3, 2, True))
def test_a_peer_that_moves_to_another_network_is_followed(world: Make, delay: float, seed: int, copies: bool) -> None:
    """Within half a second and three round trips, be there an observer or not."""
    two = world(f"delay({delay}) | uniform(0.02) | bernoulli(0.1)", seed, copies=copies).run(4000)
    assert two.slave.associations >= 1
    two.from_ = AWAY
    moved = two.now // MS
    two.run(6000)
    assert (two.master.address, two.slave.address) == (SLAVE, AWAY)
    within = round(500 + 3 * 1000 * 2 * (delay + 0.02))
    assert two.share(0, moved + within, moved + 5000) > 0.85


@usually("seed", range(3), 0)
def test_an_observer_that_relays_changes_no_address_as_long_as_the_old_one_answers(world: Make, seed: int) -> None:
    two = world(seed=seed).run(1000)
    two.copies = two.relays = True
    two.run(3000)
    assert_at_home(two, 500, 3900)


@usually("seed", range(3), 0)
def test_what_is_drawn_by_one_that_relayed_the_meeting_comes_back_when_it_relays_no_more(
    world: Make, seed: int
) -> None:
    """As long as it relays it is on the path: it sees when something is sent, and can drop it."""
    two = world(seed=seed, copies=True)
    two.relays = True
    two.run(3000)
    for end in (0, 1):
        assert two.share(end, 1000, 2900) > 0.99
    two.relays = False
    two.run(4000)
    assert_at_home(two, 4500, 6900)


def test_challenges_are_few_and_none_without_another_address(world: Make) -> None:
    two = world().run(2000)
    assert set(two.to[1]) == {HOME}
    assert two.to[1][HOME] < 520
    two.copies = True
    two.run(5000)
    assert 5 < two.to[1][FORTH] < 100
