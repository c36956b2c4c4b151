"""Delivery traces: against a queue simulated packet by packet, and on real LTE recordings."""

import os
from collections import deque
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from channel.mahimahi import Mahimahi
from teleop.errors import Refused

MS = 1_000_000


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


def test_an_opportunity_carries_fifteen_packets_of_100_bytes_and_the_trace_repeats(tmp_path: Path) -> None:
    (tmp_path / "t").write_text("10\n20\n")
    packet, time_ns, _ = Mahimahi(str(tmp_path / "t")).carry(0, np.arange(40), np.zeros(40, np.int64), 100)
    assert packet.tolist() == list(range(40))
    assert time_ns.tolist() == [10 * MS] * 15 + [20 * MS] * 15 + [30 * MS] * 10


def test_the_file_is_part_of_the_effect_but_not_of_its_text(tmp_path: Path) -> None:
    file = tmp_path / "t"
    file.write_text("1\n2\n")
    one, same = Mahimahi(str(file)), Mahimahi(str(file))
    file.write_text("1\n3\n")
    assert one == same != Mahimahi(str(file))
    assert repr(one) == f"Mahimahi(path={str(file)!r}, queue=2000, start=0.0)"


def test_broken_files_are_refused_with_their_line(tmp_path: Path) -> None:
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
