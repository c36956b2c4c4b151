"""A run whose ticks pass 2**32, of which a packet carries the last 32 bits: it plays as one that does not."""

from __future__ import annotations

from typing import Any

from master.device import SimulatedMaster
from slave.robot import SimulatedSlave
from teleop import PFRA, Fixed, Scene, Watchdog, Wave, Zero
from teleop.protocol.endpoint import Endpoint
from teleop.protocol.packet import Echo, encode
from tests.begun import begin
from tests.fakes import usually
from tests.teleop.protocol.ends import MS, START, met, packet_in, scene

COUNT = 420
WRAP = 2**32 - 200
WATCH = Watchdog(timeout=0.05, ramp=0.02, settle=0.05)


class Joined:
    """Two ends that join a run at tick `base`, and play `COUNT` ticks of it."""

    def __init__(self, given: Scene, base: int, forged: bool = False) -> None:
        self.ends: dict[str, Endpoint] = met(given)
        self.rows: dict[str, list[tuple[float, ...]]] = {"m": [], "s": []}
        self.played: dict[str, list[int]] = {"m": [], "s": []}
        sent: dict[str, list[bytes]] = {"m": [], "s": []}
        devices: dict[str, Any] = {"m": SimulatedMaster(given), "s": SimulatedSlave(given)}
        for end in self.ends.values():
            begin(end.session, START - base * MS, START)
            end.join(base)
            self.width = end.format.width
        for k in range(COUNT):
            now = START + k * MS
            for e, other in ("ms", "sm"):
                late = 10 if k % 7 else 14
                for i in {k - late, k - 10} if k < 250 or k > 320 else ():
                    if i >= 0:
                        self.ends[e].receive(sent[other][i], now)
                if forged and k > 30:
                    for data in (sent[other][min(k - 20, 220)], sent[other][0], *self.strange(sent[other][-1])):
                        self.ends[e].receive(data, now)
            for e, end in self.ends.items():
                out = end.tick(base + k, now, devices[e].read(k))
                devices[e].hold(out.force)
                assert out.datagram is not None
                sent[e].append(out.datagram)
                self.rows[e].append(out.row)
                self.played[e].append(out.played - base if out.played >= 0 else -1)

    def strange(self, honest: bytes) -> list[bytes]:
        """The newest message under numbers that are far off."""
        packet = packet_in(honest, self.width)
        seqs = [(packet.seq + off) % 2**32 for off in (5000, 2**31 - 1, 2**31, 2**31 + 1, -(2**30) - 50)]
        return [encode(packet._replace(seq=seq, echo=Echo(0, 0))) for seq in seqs]


def given(law: Any, playout: Any) -> Scene:
    return scene(law, playout=playout, watchdog=WATCH, link=None, duration=1.0)


@usually("law, playout", [(law, playout) for law in (Wave(), PFRA(alpha=0.2)) for playout in (Zero(), Fixed(0.012))],
         (Wave(), Zero()), (PFRA(alpha=0.2), Fixed(0.012)))
def test_a_run_past_2_32_is_the_run_before_it(law: Any, playout: Any) -> None:
    plain, wrapped = Joined(given(law, playout), 10_000), Joined(given(law, playout), WRAP)
    assert wrapped.rows == plain.rows
    assert wrapped.played == plain.played
    for e in "ms":
        one, other = plain.ends[e], wrapped.ends[e]
        assert max(plain.played[e][205:]) > 205
        assert (one.received, one.link.lost(), one.link.reordered) == (
            other.received, other.link.lost(), other.link.reordered)
        assert (one.link.way.least, one.link.way.most, one.link.rtt.most) == (
            other.link.way.least, other.link.way.most, other.link.rtt.most)
        assert one.guard.entries == other.guard.entries == 2  # it joined, and the link was dark for 70 ticks
        assert [event.k - 10_000 for event in one.guard.events] == [event.k - WRAP for event in other.guard.events]


@usually("base", [10_000, WRAP], WRAP)
def test_replays_and_numbers_that_are_far_off_change_nothing_there(base: int) -> None:
    """Packets are numbered from 0 again on the wire and grow on inside."""
    plain, forged = Joined(given(Wave(), Zero()), base), Joined(given(Wave(), Zero()), base, forged=True)
    assert forged.rows == plain.rows
    assert forged.played == plain.played
    for e in "ms":
        rejected = forged.ends[e].rejected
        assert set(rejected) == {"early", "old"}
        assert rejected["early"] == 3 * (COUNT - 31)
        assert forged.ends[e].link.lost() == plain.ends[e].link.lost()
        inbox: Any = plain.ends[e].inbox
        assert inbox.refused == 0
        assert inbox.received > 300
        assert inbox._window.newest > base + 200
