"""The bench of floods throws what it says at whom it says, and passes the good packets on."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from teleop.bench import flood
from teleop.bench.__main__ import BENCHES
from teleop.bench.timing import compiled

pytestmark = [
    pytest.mark.live,
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the forwarder is written for Linux"),
]


def test_a_flood_through_the_forwarder_is_seen_as_from_the_peer_and_leaves_the_run_whole(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A gentle one: 2000 a second at the slave, none at the master."""
    assert "flood" in BENCHES
    between = compiled("between", tmp_path)
    if between is None:
        pytest.skip("no C compiler here")
    monkeypatch.setattr(flood, "SCENE", ("hard_wall", "--link", "none", "--set", "duration=1"))
    run = flood.measured(flood.Flood(own_slave=2000), between, tmp_path)
    assert run.status == "ok"
    assert 0 < run.thrown < 2500
    assert all(0.0 < used <= 1.0 for used in run.used)
    assert run.gain <= 1.0
    told = {end: json.loads((tmp_path / end / "summary.json").read_text()) for end in ("master", "slave")}
    assert told["master"]["packets"]["bwd"]["rejected"] == {}
    found = told["slave"]["packets"]["fwd"]["rejected"]
    assert "checksum" in found, "what only looks like ours has to be opened"
    assert told["slave"]["slave"]["dropped_by_system"] > sum(found.values()), "the rest is dropped by the kernel"


def test_rows_say_what_was_asked_beside_what_was_measured() -> None:
    """The bound is of the calm run: twice it, or 0.2 ms more."""
    calm = flood.FloodRun(p99=(50.0, 300.0), used=(1.0, 1.0), gain=1.0, status="ok", thrown=0.0)
    under = flood.FloodRun(p99=(60.0, 700.0), used=(0.5, 0.25), gain=0.5, status="stopped", thrown=10.0)
    rows = flood._rows("in the open", {"calm": [calm], **{what: [under] for what in flood.FLOODS}})
    text = "\n".join("|".join(row) for row in rows)
    assert len(rows) == 2 * (1 + len(flood.FLOODS))
    assert text.count("asked: at most 250 / 600") == 2
    assert "50.00 / 25.00 %; 0.5|asked: at least 0 / 99 / 1; thrown were 10 a second" in text
    assert "watchdog, stopped" in text
