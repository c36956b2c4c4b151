"""A flood of datagrams that are not ours, from elsewhere and as fast as they go: the good ones all come through."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.live.conftest import pair_of_keys, summary

pytestmark = pytest.mark.live

FLOOD = """
import socket, sys, time
port, seconds = int(sys.argv[1]), float(sys.argv[2])
out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
words = [b"", b"GET / HTTP/1.1", b"BT\\x01\\x00" + bytes(96), bytes(1200)]
sent, end = 0, time.monotonic() + seconds
while time.monotonic() < end:
    for word in words * 8:
        out.sendto(word, ("127.0.0.1", port))
    sent += 32
print(sent)
"""


@pytest.mark.parametrize("sealed", [False, True], ids=["in the open", "sealed"])
def test_a_flood_from_a_wrong_address_costs_no_good_packet(
    sealed: bool, command: Callable[..., Any], tmp_path: Path
) -> None:
    """Tens of thousands a second. Strangers' datagrams are dropped by the system once the two have met."""
    scene = ["hard_wall", "--set", "duration=3", "--set", "link=none"]
    keys = pair_of_keys(tmp_path) if sealed else {"master": [], "slave": []}
    slave = command("slave", *scene, *keys["slave"], "--listen", "127.0.0.1:0", "--json",
                    "--out", str(tmp_path / "s"))
    port = slave.port()
    master = command("master", *scene, *keys["master"], "--peer", f"127.0.0.1:{port}", "--json",
                     "--out", str(tmp_path / "m"))
    slave.event("live")
    flood = subprocess.run([sys.executable, "-c", FLOOD, str(port), "1.5"], check=True, capture_output=True, text=True)
    assert master.end()[0] == slave.end()[0] == 0
    thrown = int(flood.stdout)
    told = summary(tmp_path / "s")
    assert told["status"] == "ok"
    packets = told["packets"]["forth"]
    assert thrown > 10_000
    assert packets["received"] >= 0.99 * packets["sent"]
    assert sum(packets["rejected"].values()) < 0.01 * thrown
