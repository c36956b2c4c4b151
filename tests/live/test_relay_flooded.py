"""Hellos of unknown hosts at a channel, from 64 ports: the master meets its slave all the same."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from teleop.scene.library import ROOT
from tests.live.conftest import pair_of_keys, summary

pytestmark = pytest.mark.live

FLOOD = """
import random, socket, sys, time
sys.path.insert(0, sys.argv[1])
from teleop.protocol.manifest import manifest_of
from teleop.protocol.packet import Kind, Packet, encode
from teleop.scene import load_scene
from tests.channel.site import hello
port, rate, sealed, dice = int(sys.argv[2]), int(sys.argv[3]), sys.argv[4] == "sealed", random.Random(1)
scene = load_scene("canonical", duration="1", link="delay(0.05)", playout="integral")
manifest = {**manifest_of(scene), "mode": "live"}
socks = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(64)]
sent, began = 0, time.monotonic()
print("here", flush=True)
while True:
    while sent < (time.monotonic() - began) * rate:
        if sealed:
            data = hello(dice.getrandbits(40), random=dice.randbytes(32))
        else:
            data = encode(Packet(Kind.HELLO, dice.getrandbits(60), 0, 0, None, manifest), 1300)
        socks[sent % 64].sendto(data, ("127.0.0.1", port))
        sent += 1
    time.sleep(0.001)
"""


@pytest.mark.parametrize("rate", [200, 2000])
@pytest.mark.parametrize("how", ["sealed", "in the open"])
def test_hellos_without_a_cookie_take_no_turn_at_a_relay(
    rate: int, how: str, command: Callable[..., Any], tmp_path: Path
) -> None:
    """So many a second, over 0.1 s of round trip, before the master comes and while it meets the slave."""
    keys = pair_of_keys(tmp_path) if how == "sealed" else {"master": [], "slave": []}
    scene = ["canonical", "--set", "duration=1", "--link", "delay(0.05)", "--json"]
    slave = command("slave", *scene, "--listen", "127.0.0.1:0", "--out", str(tmp_path / "s"), *keys["slave"])
    channel = command("channel", *scene, "--listen", "127.0.0.1:0", "--peer", f"127.0.0.1:{slave.port()}")
    port = channel.port()
    with subprocess.Popen([sys.executable, "-c", FLOOD, str(ROOT), str(port), str(rate), how],
                          stdout=subprocess.PIPE) as flood:
        try:
            assert flood.stdout is not None
            assert flood.stdout.readline() == b"here\n"
            master = command("master", *scene, "--peer", f"127.0.0.1:{port}", "--wait", "30", "--out",
                             str(tmp_path / "m"), *keys["master"])
            master.event("live")
            assert [one.end()[0] for one in (master, slave)] == [0, 0]
        finally:
            flood.kill()
    assert summary(tmp_path / "m")["status"] == "ok"
    channel.process.terminate()
    told = json.loads(channel.end()[1].splitlines()[-1])["summary"]
    assert told["foreign"] > 0 or how != "sealed"
