"""Two ends of different rates: they follow as well as at one rate, and no wave gains energy on the way."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import pytest

from channel import Delay
from teleop import find_law, kind, seed_energy
from teleop.errors import Refused
from teleop.law import known_laws
from teleop.law.offers import claims_of
from teleop.laws.direct import Direct
from teleop.laws.wave import Wave
from teleop.live.options import ticks_of
from teleop.protocol.inbox import Heard, Inbox, Resampling
from teleop.scene.loading import load_scene
from teleop.scene.playout import Fixed, Hold, Integral, Playout, Zero
from teleop.simulation.structure import columns
from teleop.simulation.virtual import run
from tests.fakes import usually
from tests.teleop.protocol.virtual_clock import MS, World, healing

RATES = {"1000 and 500 Hz": (1, 2), "500 and 1000 Hz": (2, 1), "1000 and 250 Hz": (1, 4), "250 and 1000 Hz": (4, 1),
         "500 and 333 Hz": (2, 3), "333 and 500 Hz": (3, 2), "500 Hz both": (2, 2)}
LAWS: dict[str, Any] = {"wave": Wave(b=2.0, K=200.0, B=5.0), "direct": Direct(K=200.0, B=5.0)}
ROUGH: dict[str, Any] = {"jitter": 12 * MS, "loss": 0.1, "copies": 0.2}
SECONDS = 2.0
ZERO, INTEGRAL = Zero(), Integral()


def column(world: World, e: str, name: str) -> dict[int, float]:
    names = columns(world.scene, e)
    i = [each.removesuffix("@") for each in names].index(name)
    return {done.k: done.row[i] for done in world.done[e]}


def ran(law: str, every: tuple[int, int], seed: int = 1, playout: Playout = INTEGRAL, **link: Any) -> World:
    scene = healing(LAWS.get(law, law), dt=1e-3, duration=5.0, cap=None, playout=playout)
    world = World(scene, every=dict(zip("ms", every, strict=True)), delay={"m": 5 * MS, "s": 5 * MS}, seed=seed, **link)
    return world.run(SECONDS + 0.2)


def common(world: World, *names: str) -> list[np.ndarray[Any, Any]]:
    """Columns at the ticks that both ends ran."""
    ends = ["m" if name in ("x_m", "E_in_fwd", "E_out_bwd") else "s" for name in names]
    found = [column(world, e, name) for e, name in zip(ends, names, strict=True)]
    ks = sorted(set.intersection(*map(set, found)))
    return [np.array([each[k] for k in ks]) for each in found]


def error(xs: list[np.ndarray[Any, Any]]) -> float:
    """Root mean square of the master's position less the slave's, m."""
    return float(np.sqrt(np.mean((xs[0] - xs[1]) ** 2)))


@lru_cache
def of_virtual_time(law: str) -> float:
    """The error of both at 500 Hz, in virtual time."""
    trace = run(healing(LAWS[law], dt=2e-3, duration=SECONDS, cap=None, link=Delay(0.005))).trace
    return error([trace["x_m"], trace["x_s"]])


@usually("law, name", [(law, name) for law in LAWS for name in RATES],
         ("wave", "1000 and 500 Hz"), ("wave", "250 and 1000 Hz"), ("direct", "333 and 500 Hz"))
def test_two_rates_follow_as_well_as_one(name: str, law: str) -> None:
    world = ran(law, RATES[name])
    assert error(common(world, "x_m", "x_s")) == pytest.approx(of_virtual_time(law), rel=0.12)
    for e, every in zip("ms", RATES[name], strict=True):
        ticks = [done.k for done in world.done[e]]
        assert ticks == list(range(0, ticks[-1] + 1, every))
        assert world.end(e).guard.events == []
        assert world.end(e).session.peer_every == RATES[name][e == "m"]
        assert world.end(e).link.lost(RATES[name][e == "m"]) == 0
        assert max(abs(done.force) for done in world.done[e]) > 0.3


@usually("name, playout", [(name, playout) for name in RATES for playout in (INTEGRAL, Fixed(0.012, INTEGRAL))],
         ("1000 and 250 Hz", INTEGRAL), ("500 and 1000 Hz", INTEGRAL), ("500 and 333 Hz", Fixed(0.012, INTEGRAL)))
def test_no_wave_gains_energy_on_a_rough_link_between_two_rates(name: str, playout: Playout) -> None:
    world = ran("wave", RATES[name], seed=5, playout=playout, **ROUGH)
    into, out, back, home = common(world, "E_in_fwd", "E_out_fwd", "E_in_bwd", "E_out_bwd")
    assert (into - out + back - home).min() >= -1e-9
    assert (into - out).min() >= -1e-9
    assert (back - home).min() >= -1e-9
    assert out[-1] > 0.03, "and it is not nothing that came"
    for e, peer in zip("ms", reversed(RATES[name]), strict=True):
        end = world.end(e)
        assert (end.stamp_margin or 0.0) >= -1e-9
        assert 0.04 < end.link.loss(peer) < 0.2


@usually("name", RATES, "1000 and 250 Hz", "500 and 333 Hz")
def test_positions_are_followed_over_a_rough_link_and_where_the_last_one_is_held(name: str) -> None:
    world = ran("direct", RATES[name], **ROUGH)
    assert error(common(world, "x_m", "x_s")) < 1.5 * of_virtual_time("direct")
    assert not world.end("m").guard.safe
    world = ran("direct", RATES[name], playout=Hold())
    assert error(common(world, "x_m", "x_s")) == pytest.approx(of_virtual_time("direct"), rel=0.12)


# What a tick plays, by itself


class U(NamedTuple):
    x: float


def box(mine: int, theirs: int, playout: Playout = ZERO) -> tuple[Resampling, Inbox[Heard]]:
    """What an end plays at every `mine`-th tick, of a peer that sends at every `theirs`-th, and where it waits."""
    rates = Resampling(U, mine=mine)
    rates.begin(theirs)
    return rates, Inbox(playout, 1_000_000)


def played(end: tuple[Resampling, Inbox[Heard]], sent: list[float], theirs: int) -> list[float]:
    """Messages played of samples that were sent at every `theirs`-th tick and took one tick; nothing is 0."""
    rates, inbox = end
    out, last = [], -1
    for j in range((len(sent) - 1) * theirs + 1 + 3 * max(theirs, rates.mine)):
        n, due = divmod(j - 1, theirs)
        if due == 0 and 0 <= n < len(sent):
            inbox.add(n * theirs, j, Heard((U(sent[n]),), None))
        if j % rates.mine == 0:
            got = rates.take(inbox, last, j)
            last = j
            out.append(0.0 if got is None else got[1].rx[0][0])
    return out


def test_a_constant_sample_comes_out_as_it_went_in_and_a_peer_that_falls_silent_is_not_played_on_and_on() -> None:
    for mine, theirs in RATES.values():
        samples = played(box(mine, theirs), [2.0] * 60, theirs)
        steady = samples[4 : 60 * theirs // mine - 4]
        assert steady == pytest.approx([2.0] * len(steady)), (mine, theirs)
        waves = played(box(mine, theirs), [1.0], theirs)
        assert 0.0 < mine * sum(waves) <= 2 * max(mine, theirs)
        assert waves[-1] == 0.0


def test_a_rate_at_which_every_message_comes_too_late_or_waves_are_not_sent_by_their_integral_is_refused() -> None:
    dogged, late = load_scene("hard_wall", playout="integral"), load_scene("canonical", playout="integral")
    fixed = load_scene("burst_loss", playout="fixed:0.03")
    for scene, rate, said in (
            (dogged, 4.0, r"every 0.25 s, .* timeout is 0.2 s; write a higher --rate"), (late, 1.0, "timeout is 0.8 s"),
            (load_scene("canonical"), 500.0, r"by their integral; write --set playout=integral at both ends"),
            (fixed, 500.0, r"playout=fixed:0\.03:integral")):
        with pytest.raises(Refused, match=said):
            ticks_of(scene, rate, lockstep=False, spin=False)
    for scene, rate, every in (
            (dogged, 5.0, 200), (load_scene("burst_loss"), 500.0, 2), (load_scene("canonical"), 1000.0, 1),
            (load_scene("canonical", law="direct"), 500.0, 2)):
        assert ticks_of(scene, rate, lockstep=False, spin=False) == every


class Sent(NamedTuple):
    x: kind.Sample
    E: kind.Total


class Placed(NamedTuple):
    x: kind.Position


def test_a_sample_or_a_place_is_averaged_and_of_a_total_or_an_orientation_the_newest_is_played() -> None:
    """A sum of energy that is averaged would tell of less than what was put in, and fall behind.

    The mean of rotation vectors is the rotation vector of nothing that was sent.
    """
    for message, turning, heard in (
            (Sent, (), lambda k: (Sent(k, k),)), (Placed, (1,), lambda k: (Placed(k), Placed(k)))):
        rates, inbox = Resampling(message, mine=4, turning=frozenset(turning)), Inbox[Heard](Zero(), MS)
        rates.begin(1)
        for k in range(4):
            inbox.add(k, k + 1, Heard(heard(float(k)), None))
        got = rates.take(inbox, 0, 4)
        assert got is not None
        assert got[1].rx == ((Sent(1.5, 3.0),) if message is Sent else (Placed(1.5), Placed(3.0)))


# Laws that keep energy, over a rough link: what they keep came in by their ports. A sum of energy is a total, so the
# newest message has all of it.

KEEPERS = [name for name in known_laws() if "E_law" in claims_of(find_law(name)())]


def books(law: Any, every: tuple[int, int]) -> tuple[Any, Any, Any]:
    """What came in by the ports less what is kept, what is kept and the greatest work of a tick so far, and the work
    that went through, J, at the ticks that both ends ran."""
    world = ran(law, every, seed=4, playout=ZERO, **ROUGH)
    ports, kept = [[column(world, e, f"{ledger}_{e}") for e in "ms"] for ledger in ("E_port", "E_law")]
    ks = sorted(set.intersection(*map(set, ports)))
    m, s, H_m, H_s = (np.array([each[k] for k in ks]) for each in (*ports, *kept))
    work = np.abs(np.diff(m, prepend=0.0)) + np.abs(np.diff(s, prepend=0.0))
    return m - s + seed_energy(law, 1e-3) - H_m - H_s, H_m + H_s + np.maximum.accumulate(work), np.sum(work)


@usually("name, rates", [(name, rates)
         for name in KEEPERS for rates in ("1000 and 250 Hz", "250 and 1000 Hz", "333 and 500 Hz")],
         ("tdpa", "1000 and 250 Hz"), ("two_layer", "250 and 1000 Hz"))
def test_what_a_law_keeps_came_in_by_its_ports(rates: str, name: str) -> None:
    assert {"tdpa", "two_layer", "pspm"} <= set(KEEPERS)
    honest, left, through = books(find_law(name)(), RATES[rates])
    assert honest.min() >= -1e-9
    assert left.min() >= -1e-9
    assert through > 1e-3, "and it is not nothing that went through"
