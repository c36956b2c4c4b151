"""Logs of `ping -D`: half the round trip each way, losses where the log has them, and the ways a log breaks."""

from pathlib import Path

import numpy as np
import pytest

from channel.ping_log import PingLog
from teleop.errors import Refused

MS = 1_000_000
LOG = """PING example.org (192.0.2.1) 56(84) bytes of data.
[1700000000.110000] 64 bytes from 192.0.2.1 (192.0.2.1): icmp_seq=1 ttl=57 time=10.0 ms
[1700000000.230000] 64 bytes from 192.0.2.1 (192.0.2.1): icmp_seq=2 ttl=57 time=30.0 ms
[1700000000.240000] 64 bytes from 192.0.2.1 (192.0.2.1): icmp_seq=2 ttl=57 time=40.0 ms (DUP!)
[1700000000.500000] no answer yet for icmp_seq=4
[1700000000.520000] 64 bytes from 192.0.2.1 (192.0.2.1): icmp_seq=5 ttl=57 time=20.0 ms
[1700000000.650000] From 192.0.2.254 icmp_seq=6 Destination Host Unreachable
[1700000000.800250] 64 bytes from 192.0.2.1 (192.0.2.1): icmp_seq=8 ttl=57 time=0.25 ms
[1700000000.860000] 64 bytes from 192.0.2.1 (192.0.2.1): icmp_seq=7 ttl=57 time=160 ms

--- example.org ping statistics ---
8 packets transmitted, 5 received, +1 duplicates, 37% packet loss, time 700ms
rtt min/avg/max/mdev = 0.250/44.050/160.000/58.942 ms
"""


def log_of(folder: Path, text: str, **knobs: float) -> PingLog:
    """The effect of a log with this text."""
    (folder / "ping.txt").write_text(text)
    return PingLog(str(folder / "ping.txt"), **knobs)


def probes_at(*seconds: float, first: int = 0, after: float = 0.02) -> str:
    """Replies to probes `first`, + 1, ... sent at these times, so many seconds later."""
    return "".join(f"[{1_700_000_000.0 + each + after:.6f}] 64 bytes from 192.0.2.1: icmp_seq={first + i} ttl=57 "
                   f"time={1e3 * after:.1f} ms\n" for i, each in enumerate(seconds))


def carried(effect: PingLog, sent: list[int]) -> dict[int, int]:
    """By packet when each arrives, ns, that was sent at these times, ns."""
    packet, time_ns, _ = effect.carry(None, np.arange(len(sent)), np.array(sent), 100)
    assert time_ns.tolist() == sorted(time_ns.tolist())
    return dict(zip(packet.tolist(), time_ns.tolist(), strict=True))


def test_each_packet_takes_half_of_the_newest_probe_in_either_direction(tmp_path: Path) -> None:
    """Probes 1, 2, 5, 7 and 8 were answered (7 after 8); 3, 4 and 6 were lost. They left 0.1 s apart."""
    effect = log_of(tmp_path, LOG)
    sent = [k * MS for k in (0, 50, 99, 100, 199, 250, 350, 400, 450, 510, 601, 705)]
    one_way = {packet: (time_ns - sent[packet]) / MS for packet, time_ns in carried(effect, sent).items()}
    assert one_way == {0: 5.0, 1: 5.0, 2: 5.0, 3: 15.0, 4: 15.0, 7: 10.0, 8: 10.0, 10: 80.0, 11: 0.125}
    there, back = (effect.arrivals(direction, 700, MS, 1, 100) for direction in (0, 1))
    assert np.array_equal(there.packet, back.packet)
    assert np.array_equal(there.time_ns, back.time_ns)


def test_it_repeats_after_its_last_probes_turn_and_start_skips(tmp_path: Path) -> None:
    """The log is 0.8 s long: 8 probes, 0.1 s apart."""
    sent = [800 * MS - 1, 800 * MS, 900 * MS]
    assert carried(log_of(tmp_path, LOG), sent) == {
        k: at + way for k, (at, way) in enumerate(zip(sent, (125_000, 5 * MS, 15 * MS), strict=True))}
    assert carried(log_of(tmp_path, LOG, start=0.1), [0]) == {0: 15 * MS}


def test_sequence_numbers_wrap_after_16_bits(tmp_path: Path) -> None:
    log = "".join(probes_at(float(i), first=seq, after=(i + 1) / 1e3) for i, seq in enumerate([65534, 65535, 0, 1]))
    assert carried(log_of(tmp_path, log), [k * 10**9 for k in range(4)]) == {
        k: k * 10**9 + (k + 1) * MS // 2 for k in range(4)}


def test_losses_before_the_first_and_after_the_last_reply(tmp_path: Path) -> None:
    log = ("[1700000000.900000] no answer yet for icmp_seq=1\n" + probes_at(1.0, first=2) + probes_at(3.0, first=4)
           + "[1700000004.900000] no answer yet for icmp_seq=5\n")
    # 0, 2, 4 were lost; 5 is probe 1 again
    assert list(carried(log_of(tmp_path, log), [k * 10**9 for k in range(6)])) == [1, 3]


def test_one_reply_is_a_constant_delay(tmp_path: Path) -> None:
    _, time_ns = log_of(tmp_path, LOG.splitlines()[1]).arrivals(0, 3000, MS, 1, 100)
    assert time_ns.tolist() == [k * MS + 5 * MS for k in range(3000)]


EVEN = [0.1 * i for i in range(40)]


def test_a_busy_computer_sends_a_little_late_and_that_is_no_step(tmp_path: Path) -> None:
    late = [t + (0.7 if i == 20 else 0.0) for i, t in enumerate(EVEN)]
    late[21:28] = [late[20] + 0.001 * i for i in range(1, 8)]  # ping makes up for what it missed
    log_of(tmp_path, probes_at(*late))


def test_an_outage_is_loss_and_no_gap(tmp_path: Path) -> None:
    lines = probes_at(*[0.1 * i for i in range(200)]).splitlines(keepends=True)
    log = log_of(tmp_path, "".join([*lines[:20], *lines[180:]]))
    assert len(carried(log, [k * MS for k in range(20_000)])) == pytest.approx(4000, abs=100)


REPLY = "20000] 64 bytes from 192.0.2.1 (192.0.2.1): icmp_seq=5"
BROKEN = [
    ("", "is empty"),
    (LOG + "see you tomorrow\n", r"line 14: 'see you tomorrow' is no line of a ping -D log; delete it"),
    (LOG.replace("PING", "Warning: time of day goes back (-3000us), taking countermeasures.\nPING"),
     "line 1: ping says that the clock was set back"),
    ("PING example.org\n\n--- example.org ping statistics ---\n", "holds no reply.*ping -D -i 0.01 HOST"),
    ("[1700000000.1] no answer yet for icmp_seq=1\n", "holds no reply"),
    ("64 bytes from 192.0.2.1: icmp_seq=1 ttl=57 time=10.0 ms\n", "line 1: this line has no time stamp; .*ping -D"),
    (LOG[:-480] + "\n", "ping.txt, line [0-9]+: "),
    (LOG.partition("time=20.0")[0], r"line 6: the reply .* has no time=\.\.\. ms"),
    (LOG.partition("icmp_seq=5")[0], "line 6: .* is no line of a ping -D log"),
    (LOG.partition(REPLY)[0], "line 6: .* is no line of a ping -D log"),
    (LOG.replace("000.230000", "000.050000"), "line 3: its time stamp lies before the one above"),
    (LOG + LOG.replace("1700000000", "1700000009"), "line 15: probe 1 is answered again.*two logs in one file"),
    (LOG.replace("time=10.0 ms", "time=9000000 ms"), "line 2: a round trip of 9000 s is longer than the 7200 s"),
    (probes_at(*EVEN[:20], *(t + 3600.0 for t in EVEN[20:])),  # a clock that was set
     r"line 21: probe 20 was sent 3.6e\+03 s after probe 19, and 1 interval .* takes 0.1 s: the clock was set, the"),
    (probes_at(*EVEN[:20], *(t + 2.5 for t in EVEN[20:])), "line 21: probe 20 was sent 2.6 s after probe 19"),
    (probes_at(*EVEN[:20]) + probes_at(*EVEN[20:], first=120),  # numbers that jump in no time: another log
     r"line 21: probe 120 was sent 0.1 s after probe 19, and 101 intervals"),
]


@pytest.mark.parametrize(("text", "sentence"), BROKEN, ids=range(len(BROKEN)))
def test_a_broken_log_is_refused_with_its_line(tmp_path: Path, text: str, sentence: str) -> None:
    with pytest.raises(Refused, match=sentence):
        log_of(tmp_path, text)
