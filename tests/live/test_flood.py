"""Floods of datagrams that are not ours: at an end the good ones all come through, at a channel the ends still meet."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from teleop.scene.library import ROOT
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


HELLOS = """
import random, socket, sys, time
sys.path.insert(0, sys.argv[1])
from teleop.protocol.manifest import manifest_of
from teleop.protocol.packet import Kind, Packet, encode
from teleop.scene import load_scene
from tests.channel.site import hello
port, rate, sealed, dice = int(sys.argv[2]), int(sys.argv[3]), sys.argv[4] == "sealed", random.Random(1)
scene = load_scene("canonical", duration="0.5", link="delay(0.05)", playout="integral")
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


@pytest.mark.parametrize(("how", "rate"), [
    ("sealed", 2000), ("in the open", 2000),
    *[pytest.param(how, 200, marks=pytest.mark.full) for how in ("sealed", "in the open")]])
def test_hellos_without_a_cookie_take_no_turn_at_a_relay(
    rate: int, how: str, command: Callable[..., Any], tmp_path: Path
) -> None:
    """So many a second, over 0.1 s of round trip, before the master comes and while it meets the slave."""
    keys = pair_of_keys(tmp_path) if how == "sealed" else {"master": [], "slave": []}
    scene = ["canonical", "--set", "duration=0.5", "--link", "delay(0.05)", "--json"]
    slave = command("slave", *scene, "--listen", "127.0.0.1:0", "--out", str(tmp_path / "s"), *keys["slave"])
    channel = command("channel", *scene, "--listen", "127.0.0.1:0", "--peer", f"127.0.0.1:{slave.port()}")
    port = channel.port()
    with subprocess.Popen([sys.executable, "-c", HELLOS, str(ROOT), str(port), str(rate), how],
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
