"""Recordings made up on the spot, and every built-in effect at knobs that make it do something."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

from channel import (
    Bernoulli,
    Blackout,
    Delay,
    Duplicate,
    Effect,
    GammaJitter,
    GilbertElliott,
    InOrder,
    Mahimahi,
    NormalJitter,
    PingLog,
    Recorded,
    UniformJitter,
)
from teleop.live.records.record import RecordWriter
from teleop.scene.loading import load_scene
from teleop.simulation.structure import columns

MS = 1_000_000


def live_run(
    folder: Path, fwd: Iterable[tuple[int, int, int]], bwd: Iterable[tuple[int, int, int]], *, ticks: int = 1000,
    left_out: dict[str, set[int]] | None = None, **other: Any
) -> Path:
    """A demo's folder whose ends ran these ticks and got these (packet, time in ns, tick): `fwd` came to the slave."""
    scene = load_scene("hard_wall", duration=ticks / 1000)
    for e, name, came in (("m", "master", bwd), ("s", "slave", fwd)):
        (folder / name).mkdir(parents=True)
        about = {"scene": "hard_wall", "knobs": {"duration": str(ticks / 1000)}, "seed": 0, "mode": "live", **other}
        writer = RecordWriter(scene, e, folder / name, about)
        writer.begin("bodies")
        row = (0.0,) * len(columns(scene, e, False))
        for arrival in came:
            writer.inputs.arrived(1, *arrival)
            writer.inputs.flush()
        for k in range(ticks):
            if k not in (left_out or {}).get(e, ()):
                writer.add(k, 0, -1, row)
        writer.close()
    return folder


@pytest.fixture(scope="session")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with `trace` (a delivery trace of 500 ms), `ping` (200 probes, 10 ms apart, every 20th lost) and `live`.

    That is a live run of 300 ms, in which every seventh message is lost and every fifth comes twice, out of order.
    """
    folder = tmp_path_factory.mktemp("recordings")
    times = [ms for ms in range(1, 501) if ms % 7 < 3 and not 200 < ms < 260] + [500, 500]
    (folder / "trace").write_text("".join(f"{ms}\n" for ms in times))
    replies = [f"[{1700000000 + seq * 0.01 + rtt / 1e3:.6f}] 64 bytes from 192.0.2.1: icmp_seq={seq} ttl=57 "
               f"time={rtt} ms" for seq in range(1, 201) for rtt in [20 + 37 * seq % 11 + 0.5] if seq % 20]
    (folder / "ping").write_text("PING 192.0.2.1 (192.0.2.1) 56(84) bytes of data.\n" + "\n".join(sorted(replies)))
    delays = {k: (20 + 7 * k % 13) * MS - k for k in range(300) if k % 7}
    came = [(k, k * MS + delay, k + -(-delay // MS)) for k, delay in delays.items()]
    again = [(k, at + MS, tick + 1) for k, at, tick in came if k % 5 == 0]
    live_run(folder / "live", came + again, came[::2], ticks=300)
    return folder


@pytest.fixture(scope="session")
def every_effect(recordings: Path) -> list[Effect]:
    """All built-in effects, some at more than one setting."""
    return [
        Delay(0.05), Delay(0.0), UniformJitter(0.02), UniformJitter(7e-9), NormalJitter(0.01, 0.005),
        GammaJitter(0.01, 2.0), GammaJitter(0.01, 0.3), InOrder(), Bernoulli(0.1), Bernoulli(0.0), Bernoulli(1.0),
        GilbertElliott(0.02, 0.2), GilbertElliott(0.9, 0.7, loss_good=0.1, loss_bad=0.6),
        GilbertElliott(0.0005, 0.001), Duplicate(0.2), Duplicate(0.2, after=0.003), Blackout(0.3, 0.1),
        Blackout(0.05, 0.01, every=0.033), PingLog(str(recordings / "ping"), start=0.4),
        Mahimahi(str(recordings / "trace")), Mahimahi(str(recordings / "trace"), queue=3, start=0.1),
        Recorded(str(recordings / "live")),
    ]
