"""Links that were recorded: live runs, delivery traces, logs of `ping -D`; and what is no such recording."""

from __future__ import annotations

import json
import os
import shutil
from collections import deque
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from channel import Mahimahi, PingLog, Recorded, describe, parse_link
from channel.schedule import TwoWay
from teleop import Refused, load_scene, run, sweep
from teleop.analysis.models.linear import refuse_nonlinear_parts
from teleop.simulation.plan import link_plans
from tests.channel.conftest import MS, live_run

FWD = [(0, 20 * MS + 1, 21), (1, 20 * MS + 2, 21), (3, 24 * MS, 24), (3, 25 * MS, 25), (2, 26 * MS, 26)]
BWD = [(k, k * MS + 7 * MS, k + 7) for k in range(0, 90, 2)]


def arrivals(effect: TwoWay, direction: int, count: int, dt_ns: int = MS) -> list[tuple[int, int]]:
    found = effect.arrivals(direction, count, dt_ns, 1, 100)
    return [*zip(found.packet.tolist(), found.time_ns.tolist(), strict=True)]


def test_the_arrivals_are_those_of_the_run_to_the_nanosecond_in_both_directions_and_in_time_under_another_tick(
    tmp_path: Path
) -> None:
    link = Recorded(str(live_run(tmp_path / "run", FWD, BWD, ticks=100)))
    apart = Recorded(str(tmp_path / "run" / "master"), str(tmp_path / "run" / "slave"))
    for direction, count, came in ((0, 70, FWD), (1, 90, BWD)):
        assert arrivals(link, direction, count) == [(packet, time_ns) for packet, time_ns, _ in came]
    assert arrivals(apart, 1, 90) == arrivals(link, 1, 90)
    assert arrivals(link, 1, 20, MS // 2) == [(k, k * MS // 2 + 7 * MS) for k in range(20) if k % 4 < 2]
    assert arrivals(link, 0, 3, 2 * MS) == [(0, 20 * MS + 1), (1, 26 * MS)]
    # behind a delay, in one direction alone: the third millisecond's message came twice, none from the fourth on
    behind = parse_link(f"delay(0.003) | recorded({str(tmp_path / 'run')!r}) ; delay(0.01)")
    assert arrivals(behind, 0, 3) == [(0, 24 * MS), (0, 25 * MS)]
    assert len(arrivals(behind, 1, 3)) == 3


def test_a_message_that_was_read_too_late_arrives_at_the_tick_that_took_it_and_one_that_came_early_when_it_enters(
    tmp_path: Path
) -> None:
    """An end that stalled, or that takes in a flood bit by bit, takes what came at a later tick.

    A message comes before the tick of its number where the other end's clock is ahead, by half a round trip at most.
    """
    link = Recorded(str(live_run(tmp_path / "run", [(0, 20 * MS, 30)], BWD, ticks=100)))
    assert arrivals(link, 0, 50) == [(0, 29 * MS + 1)]
    fwd = link_plans(load_scene("hard_wall", duration=0.05, link=link), 0).fwd
    assert fwd is not None
    assert np.flatnonzero(fwd.played_at >= 0).tolist() == [30]
    early = Recorded(str(live_run(tmp_path / "early", [(5, 4 * MS, 5)], BWD, ticks=100)))
    assert arrivals(early, 0, 50) == [(5, 5 * MS)]


def test_a_longer_scene_begins_the_record_again_and_what_was_under_way_at_its_end_is_no_loss(tmp_path: Path) -> None:
    """In a scene as long as the run it is under way still; for a longer one it has the fate of the first messages.

    A link that was dead to the end of the run is dead as long.
    """
    came = [(k, k * MS + 40 * MS - 9, k + 40) for k in range(60) if k != 2]  # a run of 100 ticks
    link = Recorded(str(live_run(tmp_path / "run", came, BWD, ticks=100)))
    found = arrivals(link, 0, 200)
    assert [packet for packet, _ in found] == [k for k in range(200) if k not in (2, 62, 102, 162)]
    assert [at for at in found if at[0] < 60] == [(packet, time_ns) for packet, time_ns, _ in came]
    assert all(time_ns > 99 * MS for packet, time_ns in found if packet >= 60)
    fwd = link_plans(load_scene("free_motion", duration=0.1, link=link), 0).fwd
    assert fwd is not None
    assert (fwd.received, fwd.lost, fwd.in_flight) == (59, 2, 39)
    assert [at for at in found if 100 <= at[0] < 160] == [(k + 100, at + 100 * MS) for k, at, _ in came]
    came = [(k, k * MS + 10 * MS, k + 10) for k in range(20)]
    for folder, arrived, packets in (("dying", came, [*range(20), *range(89, 120)]), ("dead", [], [])):
        dark = Recorded(str(live_run(tmp_path / folder, arrived, BWD, ticks=100)))
        assert [packet for packet, _ in arrivals(dark, 0, 120)] == packets


def test_its_text_has_the_digest_so_that_another_run_under_the_same_path_is_another_link(tmp_path: Path) -> None:
    folder = live_run(tmp_path / "run", FWD, BWD, ticks=100)
    link = Recorded(str(folder))
    text = describe(link)
    assert text == f"recorded(path={str(folder)!r}, digest={link.digest!r})"
    assert parse_link(text) == link
    assert len(link.digest) == 12
    shown = load_scene("hard_wall", link=f"recorded({str(folder)!r})").knobs["link"]
    assert shown == text
    assert load_scene("hard_wall", link="delay( 0.05 )").knobs["link"] == "delay( 0.05 )"
    other = Recorded(str(live_run(tmp_path / "other", FWD[1:], BWD, ticks=100)))
    assert other.digest != link.digest
    (folder / "slave" / "arrivals.bin").write_bytes((tmp_path / "other" / "slave" / "arrivals.bin").read_bytes())
    with pytest.raises(Refused, match=f"has the digest {other.digest}, not '{link.digest}': its run was another"):
        parse_link(text)


def test_in_a_sweep_a_row_is_the_run_and_another_recording_is_another_sweep(tmp_path: Path) -> None:
    folder = live_run(tmp_path / "run", [(k, k * MS + 9 * MS, k + 9) for k in range(0, 80, 3)], BWD, ticks=100)
    fixed = {"duration": 0.1, "link": f"recorded({str(folder)!r})"}
    table = sweep("free_motion", {"x_limit": [1.0, 2.0]}, fixed=fixed, engine="plain", out=tmp_path / "sweep")
    alone = run(load_scene("free_motion", **fixed)).metrics["x_err_rms"]
    assert [*table["x_err_rms"]] == [alone, alone]
    assert alone != run(load_scene("free_motion", duration=0.1)).metrics["x_err_rms"]
    shutil.rmtree(folder)
    live_run(folder, FWD, BWD, ticks=100)
    with pytest.raises(Refused, match="holds another sweep"):
        sweep("free_motion", {"x_limit": [1.0, 2.0]}, fixed=fixed, engine="plain", out=tmp_path / "sweep")


def test_stability_over_the_link_of_a_live_run_names_the_link_and_not_only_fields_that_nobody_wrote(
    tmp_path: Path
) -> None:
    folder = live_run(tmp_path / "run", FWD, BWD, ticks=100, left_out={"m": {7}})
    with pytest.raises(Refused, match=r"ticks are left out.*in place of a recorded link give --link 'delay\(0.05\)'"):
        refuse_nonlinear_parts(load_scene("free_motion", link=f"recorded('{folder}')"))


def spoiled(path: Path, **keys: object) -> None:
    first, rows = path.read_bytes().split(b"\n", 1)
    path.write_bytes(json.dumps({**json.loads(first), **keys}).encode() + b"\n" + rows)


def met(folder: Path, session: str) -> None:
    (folder / "events.jsonl").write_text(json.dumps({"k": 0, "what": "met", "why": f"session {session}"}) + "\n")


BROKEN: list[tuple[Callable[[Path], object], str]] = [
    (lambda at: Recorded(str(at / "master")), "is the folder of one end, which has the arrivals of one direction"),
    (lambda at: Recorded(str(at.parent)), "is no folder of a live run"),
    (lambda at: Recorded(str(at / "nowhere")), "is no folder of a live run"),
    (lambda at: Recorded(str(at / "slave"), str(at / "master")), "give the master's folder first"),
    (lambda at: Recorded(str(at), left_out=1), "left_out must be True or False"),
    (lambda at: Recorded(str(at), digest="0"), "has the digest .*, not '0'"),
    (lambda at: ((at / "slave" / "arrivals.bin").unlink(), Recorded(str(at))), "holds no arrivals.bin to run again"),
    (lambda at: (spoiled(at / "slave" / "arrivals.bin", version=9), Recorded(str(at))), "is of version 9"),
    (lambda at: (spoiled(at / "slave" / "arrivals.bin", dt_ns=5000), Recorded(str(at))), "holds no ticks with the arr"),
    (lambda at: (met(at / "master", "a"), met(at / "slave", "b"), Recorded(str(at))), "not the two ends of one run"),
    (lambda at: (spoiled(at / "slave" / "record.bin", scene="x"), Recorded(str(at))), "not the two ends of one run"),
    (lambda at: (spoiled(at / "master" / "record.bin", mode="lockstep"), Recorded(str(at))), "by packets .* --link"),
]


def test_what_is_no_live_run_is_refused_in_one_sentence(tmp_path: Path) -> None:
    sound = live_run(tmp_path / "sound" / "run", FWD, BWD, ticks=100)
    for i, (spoil, sentence) in enumerate(BROKEN):
        folder = shutil.copytree(sound, tmp_path / str(i) / "run")
        with pytest.raises(Refused, match=sentence) as refused:
            spoil(folder)
        assert "\n" not in str(refused.value), i


# Delivery traces, against a queue simulated packet by packet


def simulated(trace: list[int], sent_ns: list[int], each: int, queue: int, start_ms: int) -> dict[int, int]:
    """A drop-tail queue served opportunity by opportunity; an opportunity carries what entered before it."""
    waiting: deque[int] = deque()
    left: dict[int, int] = {}
    coming = ((again * trace[-1] + ms - start_ms) * MS for again in range(10**6) for ms in trace)
    at = next(coming)
    for packet, now in enumerate([*sent_ns, 2**62]):  # behind the last one nothing waits any more
        while at <= now and (packet < len(sent_ns) or waiting):
            for _ in range(min(each, len(waiting))):
                left[waiting.popleft()] = at
            at = next(coming)
        if len(waiting) < queue:
            waiting.append(packet)
    return left


@settings(max_examples=50)
@given(trace=st.lists(st.integers(0, 30), min_size=1, max_size=20).map(sorted).filter(lambda t: t[-1] > 0),
       gaps=st.lists(st.integers(0, 5_000_000), min_size=1, max_size=60), size=st.sampled_from([100, 400, 700, 1500]),
       queue=st.integers(1, 9), start_ms=st.integers(0, 50))
def test_a_trace_is_a_queue_simulated_packet_by_packet(
    tmp_path_factory: pytest.TempPathFactory, trace: list[int], gaps: list[int], size: int, queue: int, start_ms: int
) -> None:
    path = tmp_path_factory.getbasetemp() / "trace"
    path.write_text("\n".join(map(str, trace)))
    effect = Mahimahi(str(path), queue=queue, start=start_ms / 1000)
    sent = np.cumsum(np.array(gaps, np.int64))
    packet, time_ns, _ = effect.carry(0, np.arange(len(sent)), sent, size)
    expected = simulated(trace, sent.tolist(), 1500 // size, queue, start_ms)
    assert dict(zip(packet.tolist(), time_ns.tolist(), strict=True)) == expected


def test_the_file_of_a_trace_is_part_of_the_effect_but_not_of_its_text(tmp_path: Path) -> None:
    file = tmp_path / "t"
    file.write_text("1\n2\n")
    one, same = Mahimahi(str(file)), Mahimahi(str(file))
    file.write_text("1\n3\n")
    assert one == same != Mahimahi(str(file))
    assert repr(one) == f"Mahimahi(path={str(file)!r}, queue=2000, start=0.0)"


def test_a_broken_trace_is_refused_with_its_line(tmp_path: Path) -> None:
    file = tmp_path / "t"
    for content, sentence in (
        (b"", "t is empty"), (b"\n \n", "t is empty"), (b"1\n2\n1\n", "t, line 3: 1 ms comes after 2 ms.*sort -n"),
        (b"1\n2\nx", "t, line 3: 'x' is no whole number of ms.*delete it if the file was cut off"),
        (b"1\n-2\n", "line 2: '-2' is no whole number"), (b"1\n2.5\n", "line 2: '2.5' is no whole number"),
        (b"1\n" + b"9" * 30, "line 2"), (b"0\n0\n", "line 2: the recording ends at 0 ms"),
        (b"1\n2\n\xff\xfe\x00", "line 3: this is not text"), ("1\n\u0663\n".encode(), "line 2"),
    ):
        file.write_bytes(content)
        with pytest.raises(Refused, match=sentence):
            Mahimahi(str(file))


@pytest.mark.skipif("TELEOP_LTE" not in os.environ, reason="set TELEOP_LTE to the folder of the LTE recordings")
@pytest.mark.parametrize("way", ["up", "down"])
def test_an_lte_recording_carries_a_control_loop(way: str) -> None:
    """Packets of 100 bytes at 1 kHz lose almost nothing over the whole recording, at a few ms of median delay.

    Taken as one packet per opportunity the same recording would lose half and be seconds late.
    """
    effect, count = Mahimahi(f"{os.environ['TELEOP_LTE']}/Verizon-LTE-short.{way}"), 140_000
    packet, time_ns = effect.arrivals(0, count, MS, 1, 100)
    delay = (time_ns - packet * MS) / 1e9
    assert len(packet) > 0.999 * count
    assert np.median(delay) < 0.01
    assert delay.max() < 2.0
    wasteful, late_ns = effect.arrivals(0, count, MS, 1, 1500)
    assert len(wasteful) < 0.6 * count
    assert np.median(late_ns - wasteful * MS) > 1.5e9


# Logs of `ping -D`: half the round trip each way, losses where the log has them


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


def test_each_packet_takes_half_of_the_newest_probe_in_either_direction_from_start_on_and_again(tmp_path: Path) -> None:
    """Probes 1, 2, 5, 7 and 8 were answered (7 after 8); 3, 4 and 6 were lost. They left 0.1 s apart, within 0.8 s."""
    effect = log_of(tmp_path, LOG)
    sent = [k * MS for k in (0, 50, 99, 100, 199, 250, 350, 400, 450, 510, 601, 705)]
    one_way = {packet: (time_ns - sent[packet]) / MS for packet, time_ns in carried(effect, sent).items()}
    assert one_way == {0: 5.0, 1: 5.0, 2: 5.0, 3: 15.0, 4: 15.0, 7: 10.0, 8: 10.0, 10: 80.0, 11: 0.125}
    there, back = (effect.arrivals(direction, 700, MS, 1, 100) for direction in (0, 1))
    assert np.array_equal(there.packet, back.packet)
    assert np.array_equal(there.time_ns, back.time_ns)
    sent = [800 * MS - 1, 800 * MS, 900 * MS]
    assert carried(effect, sent) == {
        k: at + way for k, (at, way) in enumerate(zip(sent, (125_000, 5 * MS, 15 * MS), strict=True))}
    assert carried(log_of(tmp_path, LOG, start=0.1), [0]) == {0: 15 * MS}


def test_losses_before_the_first_reply_and_after_the_last_count_and_sequence_numbers_wrap_after_16_bits(
    tmp_path: Path
) -> None:
    """One reply is a constant delay."""
    log = ("[1700000000.900000] no answer yet for icmp_seq=1\n" + probes_at(1.0, first=2) + probes_at(3.0, first=4)
           + "[1700000004.900000] no answer yet for icmp_seq=5\n")
    # 0, 2, 4 were lost; 5 is probe 1 again
    assert list(carried(log_of(tmp_path, log), [k * 10**9 for k in range(6)])) == [1, 3]
    log = "".join(probes_at(float(i), first=seq, after=(i + 1) / 1e3) for i, seq in enumerate([65534, 65535, 0, 1]))
    assert carried(log_of(tmp_path, log), [k * 10**9 for k in range(4)]) == {
        k: k * 10**9 + (k + 1) * MS // 2 for k in range(4)}
    _, time_ns = log_of(tmp_path, LOG.splitlines()[1]).arrivals(0, 3000, MS, 1, 100)
    assert time_ns.tolist() == [k * MS + 5 * MS for k in range(3000)]


EVEN = [0.1 * i for i in range(40)]


def test_a_busy_computer_that_sends_a_little_late_is_no_step_and_an_outage_is_loss_and_no_gap(tmp_path: Path) -> None:
    late = [t + (0.7 if i == 20 else 0.0) for i, t in enumerate(EVEN)]
    late[21:28] = [late[20] + 0.001 * i for i in range(1, 8)]  # ping makes up for what it missed
    log_of(tmp_path, probes_at(*late))
    lines = probes_at(*[0.1 * i for i in range(200)]).splitlines(keepends=True)
    log = log_of(tmp_path, "".join([*lines[:20], *lines[180:]]))
    assert len(carried(log, [k * MS for k in range(20_000)])) == pytest.approx(4000, abs=100)


REPLY = "20000] 64 bytes from 192.0.2.1 (192.0.2.1): icmp_seq=5"
BROKEN_LOGS = [
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


def test_a_broken_log_is_refused_with_its_line(tmp_path: Path) -> None:
    for text, sentence in BROKEN_LOGS:
        with pytest.raises(Refused, match=sentence):
            log_of(tmp_path, text)
