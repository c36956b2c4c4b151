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


def written(folder: Path, text: str) -> str:
    (folder / "ping.txt").write_text(text)
    return str(folder / "ping.txt")


def test_each_packet_takes_the_newest_probe(tmp_path: Path) -> None:
    """Probes 1, 2, 5, 7 and 8 were answered (7 after 8); 3, 4 and 6 were lost. They left 0.1 s apart."""
    effect = PingLog(written(tmp_path, LOG))
    sent = np.array([0, 50, 99, 100, 199, 250, 350, 400, 450, 510, 601, 705]) * MS
    packet, time_ns, _ = effect.carry(None, np.arange(12), sent, 100)
    one_way = {int(p): int(t - sent[p]) / MS for p, t in zip(packet, time_ns, strict=True)}
    assert one_way == {0: 5.0, 1: 5.0, 2: 5.0, 3: 15.0, 4: 15.0, 7: 10.0, 8: 10.0, 10: 80.0, 11: 0.125}
    assert time_ns.tolist() == sorted(time_ns.tolist())


def test_it_repeats_after_its_last_probes_turn_and_start_skips(tmp_path: Path) -> None:
    """The log is 0.8 s long: 8 probes, 0.1 s apart."""
    effect = PingLog(written(tmp_path, LOG))
    period = 800 * MS
    packet, time_ns, _ = effect.carry(None, np.arange(3), np.array([period - 1, period, period + 100 * MS]), 100)
    assert packet.tolist() == [0, 1, 2]
    assert (time_ns - [period - 1, period, period + 100 * MS]).tolist() == [125_000, 5 * MS, 15 * MS]
    later = PingLog(written(tmp_path, LOG), start=0.1)
    assert later.carry(None, np.arange(1), np.zeros(1, np.int64), 100)[1].tolist() == [15 * MS]


def test_both_directions_take_half(tmp_path: Path) -> None:
    effect = PingLog(written(tmp_path, LOG))
    there, back = (effect.arrivals(direction, 700, MS, 1, 100) for direction in (0, 1))
    assert np.array_equal(there.packet, back.packet)
    assert np.array_equal(there.time_ns, back.time_ns)


def test_sequence_numbers_wrap_after_16_bits(tmp_path: Path) -> None:
    log = "".join(f"[17000000{i:02d}.000000] 64 bytes from 192.0.2.1: icmp_seq={seq} ttl=57 time={i + 1}.0 ms\n"
                  for i, seq in enumerate([65534, 65535, 0, 1]))
    packet, time_ns, _ = PingLog(written(tmp_path, log)).carry(None, np.arange(4), np.arange(4) * 10**9, 100)
    assert packet.tolist() == [0, 1, 2, 3]
    assert ((time_ns - packet * 10**9) / MS).tolist() == [0.5, 1.0, 1.5, 2.0]


def test_losses_before_the_first_and_after_the_last_reply(tmp_path: Path) -> None:
    log = ("[1700000000.900000] no answer yet for icmp_seq=1\n"
           "[1700000001.010000] 64 bytes from 192.0.2.1: icmp_seq=2 ttl=57 time=10.0 ms\n"
           "[1700000003.010000] 64 bytes from 192.0.2.1: icmp_seq=4 ttl=57 time=10.0 ms\n"
           "[1700000004.900000] no answer yet for icmp_seq=5\n")
    packet, _, _ = PingLog(written(tmp_path, log)).carry(None, np.arange(6), np.arange(6) * 10**9, 100)
    assert packet.tolist() == [1, 3]  # 0, 2, 4 were lost; 5 is probe 1 again


def test_one_reply_is_a_constant_delay(tmp_path: Path) -> None:
    effect = PingLog(written(tmp_path, LOG.splitlines()[1]))
    _, time_ns = effect.arrivals(0, 3000, MS, 1, 100)
    assert time_ns.tolist() == [k * MS + 5 * MS for k in range(3000)]


def probes_at(*seconds: float) -> str:
    """Replies to probes 0, 1, 2, ... sent at these times, 20 ms later."""
    stamps = [f"{1_700_000_000.0 + each + 0.02:.6f}" for each in seconds]
    return "".join(f"[{stamp}] 64 bytes from 192.0.2.1: icmp_seq={i} ttl=57 time=20.0 ms\n"
                   for i, stamp in enumerate(stamps))


EVEN = [0.1 * i for i in range(40)]


def test_a_busy_computer_sends_a_little_late_and_that_is_no_step(tmp_path: Path) -> None:
    late = [t + (0.7 if i == 20 else 0.0) for i, t in enumerate(EVEN)]
    late[21:28] = [late[20] + 0.001 * i for i in range(1, 8)]  # ping makes up for what it missed
    PingLog(written(tmp_path, probes_at(*late)))


def test_an_outage_is_loss_and_no_gap(tmp_path: Path) -> None:
    lines = probes_at(*[0.1 * i for i in range(200)]).splitlines(keepends=True)
    log = PingLog(written(tmp_path, "".join([*lines[:20], *lines[180:]])))
    assert len(log.carry(None, np.arange(20_000), np.arange(20_000) * MS, 100)[0]) == pytest.approx(4000, abs=100)


@pytest.mark.parametrize(("times", "sentence"), [
    ([*EVEN[:20], *(t + 3600.0 for t in EVEN[20:])],
     r"line 21: probe 20 was sent 3.6e\+03 s after probe 19, and 1 interval .* takes 0.1 s: the clock was set, the"),
    ([*EVEN[:20], *(t + 2.5 for t in EVEN[20:])], "line 21: probe 20 was sent 2.6 s after probe 19"),
])
def test_a_clock_that_was_set_and_a_recording_that_stood_still(
        tmp_path: Path, times: list[float], sentence: str) -> None:
    with pytest.raises(Refused, match=sentence):
        PingLog(written(tmp_path, probes_at(*times)))


def test_numbers_that_jump_in_no_time_are_another_log(tmp_path: Path) -> None:
    lines = probes_at(*EVEN).splitlines(keepends=True)
    later = [line.replace(f"icmp_seq={i} ", f"icmp_seq={i + 100} ") for i, line in enumerate(lines)]
    with pytest.raises(Refused, match=r"line 21: probe 120 was sent 0.1 s after probe 19, and 101 intervals"):
        PingLog(written(tmp_path, "".join([*lines[:20], *later[20:]])))


@pytest.mark.parametrize(("text", "sentence"), [
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
    (LOG.partition("20000] 64 bytes from 192.0.2.1 (192.0.2.1): icmp_seq=5")[0],
     "line 6: .* is no line of a ping -D log"),
    (LOG.replace("000.230000", "000.050000"), "line 3: its time stamp lies before the one above"),
    (LOG + LOG.replace("1700000000", "1700000009"), "line 15: probe 1 is answered again.*two logs in one file"),
    (LOG.replace("time=10.0 ms", "time=9000000 ms"), "line 2: a round trip of 9000 s is longer than the 7200 s"),
])
def test_broken_logs(tmp_path: Path, text: str, sentence: str) -> None:
    with pytest.raises(Refused, match=sentence):
        PingLog(written(tmp_path, text))
