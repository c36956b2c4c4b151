"""Floods of datagrams that are not ours: at an end the good ones all come through, at a channel the ends still meet."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.live.conftest import pair_of_keys, share_received, summary

pytestmark = pytest.mark.live


FLOOD = """
import socket, time
out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
words = [b"", b"GET / HTTP/1.1", b"BT\\x01\\x00" + bytes(96), bytes(1200)]
port, seconds = map(float, input().split())  # it is up before the run is
sent, end = 0, time.monotonic() + seconds
while time.monotonic() < end:
    for word in words * 8:
        out.sendto(word, ("127.0.0.1", int(port)))
    sent += 32
print(sent)
"""


@pytest.mark.parametrize("sealed", [
    False, pytest.param(True, marks=pytest.mark.full)], ids=["in the open", "sealed"])
def test_a_flood_from_a_wrong_address_costs_no_good_packet(
    sealed: bool, command: Callable[..., Any], tmp_path: Path
) -> None:
    """Tens of thousands a second. Datagrams of other senders are dropped by the system once the two have met."""
    scene = ["hard_wall", "--set", "duration=1.5", "--set", "link=none"]
    keys = pair_of_keys(tmp_path) if sealed else {"master": [], "slave": []}
    flood = subprocess.Popen([sys.executable, "-c", FLOOD], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    slave = command("slave", *scene, *keys["slave"], "--listen", "127.0.0.1:0", "--json",
                    "--out", str(tmp_path / "s"))
    port = slave.port()
    master = command("master", *scene, *keys["master"], "--peer", f"127.0.0.1:{port}", "--json",
                     "--out", str(tmp_path / "m"))
    slave.event("live")
    thrown = int(flood.communicate(f"{port} 0.8\n")[0])
    assert master.end()[0] == slave.end()[0] == 0
    told = summary(tmp_path / "s")
    assert told["status"] == "ok"
    assert thrown > 1000, "of tens of thousands on a machine that has nothing else to do"
    assert share_received(tmp_path / "m", tmp_path / "s") > 0.95
    assert sum(told["packets"]["fwd"]["rejected"].values()) < 0.01 * thrown
