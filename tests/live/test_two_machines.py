"""Two machines with a network between them: addresses that change, cables that are pulled, packets that are cut.

Each machine is a network namespace; where the system gives none, these tests are skipped with its reason.
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from teleop.scene.library import ROOT
from tests.live.conftest import OWN, Command, pair_of_keys, summary
from tests.live.namespaces import Machine, join, machine
from tests.waiting import until

pytestmark = pytest.mark.live
SLAVE, MASTER = "10.0.0.8", "10.0.0.9"
LONG = """
from dataclasses import replace

from teleop import Scene, load_scene


def scene() -> Scene:
    return replace(load_scene("hard_wall", duration=600.0, link="none"), packet_size=1200)
"""


@pytest.fixture
def machines() -> Iterator[list[Machine]]:
    """Three machines; no cable yet."""
    made: list[Machine] = []
    try:
        made.append(machine())
        made += [machine(made[0]), machine(made[0])]
        yield made
    finally:
        for one in made:
            one.gone()


@pytest.fixture
def two(machines: list[Machine]) -> dict[str, Machine]:
    """The slave's machine and the master's, with a cable between them."""
    join(machines[0], machines[1], (SLAVE, MASTER))
    return {"slave": machines[0], "master": machines[1]}


@pytest.fixture
def on(tmp_path: Path) -> Iterator[Callable[..., Command]]:
    """`on(machine, "python", "-m", ...)`: a process there, in the test's own folder, and gone when the test is over."""
    started: list[subprocess.Popen[str]] = []

    def start(where: Machine, *words: str, cwd: Path = tmp_path, **more: str) -> Command:
        started.append(where.start(
            *words, cwd=cwd, env={**OWN, **more}, stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE))
        return Command(started[-1])

    yield start
    for one in started:
        with suppress(ProcessLookupError):
            one.kill()
        one.communicate()


def ends(
    on: Callable[..., Command], two: dict[str, Machine], tmp_path: Path, keys: dict[str, list[str]],
    scene: tuple[str, ...] = ("hard_wall", "--set", "duration=600", "--link", "none"),
) -> dict[str, Command]:
    """A slave and a master that have met, and hold force."""
    words = {"slave": ["--listen", "0.0.0.0:9001"], "master": ["--peer", f"{SLAVE}:9001"]}
    both = {}
    for name in ("slave", "master"):
        both[name] = on(two[name], sys.executable, "-m", name, *scene, *words[name], *keys[name], "--json",
                        "--out", str(tmp_path / name[0]))
        both[name].port()
    for end in both.values():
        end.live(lambda numbers: numbers["gain"] == 1.0 and numbers["delay"] is not None)
    return both


def stopped(both: dict[str, Command], tmp_path: Path) -> dict[str, dict[str, Any]]:
    """Stop both; their summaries."""
    both["master"].signal(signal.SIGTERM)
    for end in both.values():
        code, out, err = end.end()
        assert code == 0, (out, err)
    return {name: summary(tmp_path / name[0]) for name in both}


def events(tmp_path: Path, name: str, what: str) -> list[dict[str, Any]]:
    lines = (tmp_path / name[0] / "events.jsonl").read_text().splitlines()
    return [event for event in map(json.loads, lines) if event["what"] == what]


def is_longer(path: Path, size: int) -> bool:
    return path.exists() and path.stat().st_size > size


def goes_on(both: dict[str, Command], ticks: int) -> None:
    """Both hold all of the force, so many ticks from now or later."""
    for end in both.values():
        later = end.live(lambda _numbers: True)["k"] + ticks
        while end.live(lambda numbers: numbers["gain"] == 1.0)["k"] <= later:
            pass


def test_what_the_first_page_says_to_type_at_two_machines_runs_there(
    on: Callable[..., Command], two: dict[str, Machine], tmp_path: Path
) -> None:
    """Word for word but for pip, which needs a network of its own; the slave's machine has the page's address."""
    pytest.importorskip("OpenSSL")
    text = (ROOT / "README.md").read_text().partition("## Two machines")[2].partition("\n## ")[0]
    blocks = re.findall(r"```sh\n(.*?)```", text, re.DOTALL)
    typed = {name: [line for line in block.splitlines() if "bin/pip" not in line]
             for name, block in zip(("slave", "master"), blocks, strict=True)}
    assert f"--peer {SLAVE}:" in typed["master"][-1]
    for name in typed:
        (tmp_path / name).mkdir()
        (tmp_path / name / ".venv").symlink_to(sys.prefix)
        assert (tmp_path / name / ".venv" / "bin" / "teleop").exists(), "the package is not installed"
    known = {}
    for name, whose in (("slave", "SLAVES"), ("master", "MASTERS")):
        code, out, err = on(two[name], "bash", "-c", typed[name][0], cwd=tmp_path / name).end()
        assert code == 0, err
        known[whose] = out.split("--peer-fingerprint")[1].strip()
    both = {name: on(two[name], "bash", "-c", f"exec {lines[1]}", cwd=tmp_path / name, **known)
            for name, lines in typed.items()}
    folders = {name: tmp_path / name / "runs" / f"hard_wall-{name}-1" for name in both}
    for folder in folders.values():
        until(partial(is_longer, folder / "record.bin", 200_000), f"nothing came of {folder}")
    for end in both.values():
        end.signal(signal.SIGTERM)
    for name, end in both.items():
        code, out, err = end.end()
        assert code == 0, (out, err)
        told = summary(folders[name])
        assert told[name]["sealed"] is True
        assert told["packets"]["fwd" if name == "slave" else "bwd"]["received"] > 200


def test_a_sealed_session_goes_on_when_the_address_of_either_machine_changes(
    on: Callable[..., Command], two: dict[str, Machine], tmp_path: Path
) -> None:
    """A socket kept the address that its machine no longer had, and sent nothing for a second: that was the session."""
    both = ends(on, two, tmp_path, pair_of_keys(tmp_path))
    for name, address in (("master", "10.0.0.19"), ("slave", "10.0.0.18")):
        two[name].moves_to(address)
        goes_on(both, 700)  # followed within half a second and three round trips
    told = stopped(both, tmp_path)
    for name in both:
        assert told[name][name]["associations"] == 1
        assert len(events(tmp_path, name, "met")) == 1, "the same session"
        assert len(events(tmp_path, name, "safe")) == 2, "once for each of the two moves"
        assert told[name][name]["unsent"] < 100


def test_a_cable_that_is_pulled_for_a_second_leaves_no_force_and_the_run_goes_on(
    on: Callable[..., Command], two: dict[str, Machine], tmp_path: Path
) -> None:
    """In the open, and with packets of 1,200 bytes on a network that passes 576: the system cuts them."""
    for one in two.values():
        one.ip("link set cable mtu 576")
    (tmp_path / "long.py").write_text(LONG)
    both = ends(on, two, tmp_path, {name: ["--insecure"] for name in two}, (str(tmp_path / "long.py"),))
    two["slave"].ip("link set cable down")
    pulled = {name: end.live(lambda numbers: numbers["gain"] == 0.0)["k"] for name, end in both.items()}
    time.sleep(1.0)
    plugged = {name: end.live(lambda _numbers: True)["k"] for name, end in both.items()}
    two["slave"].ip("link set cable up")
    for end in both.values():
        end.live(lambda numbers: numbers["gain"] == 1.0)
    told = stopped(both, tmp_path)
    for name, e in (("slave", "s"), ("master", "m")):
        assert told[name]["status"] == "stopped"
        trace = np.load(tmp_path / e / "trace.npz")
        without = (trace["t"] > pulled[name] * 1e-3) & (trace["t"] < plugged[name] * 1e-3)
        assert without.sum() > 100
        assert not trace[f"f_{e}"][without].any()
        assert two[name].counted("FragCreates") > 1000, "two or three of a packet"
        received = told[name]["packets"]["fwd" if name == "slave" else "bwd"]["received"]
        assert received > 200, "of both sessions, 1,200 bytes each"
        assert two[name].counted("ReasmOKs") >= received


def test_what_is_too_long_for_a_router_is_cut_there_though_nobody_says_so(machines: list[Machine]) -> None:
    """One that may not be cut is dropped, and the sender learns that by a message which firewalls drop."""
    near, far, router = machines
    join(near, router, ("10.0.1.2", "10.0.1.1"), "left")
    join(far, router, ("10.0.2.2", "10.0.2.1"), "right")
    near.ip("route add default via 10.0.1.1")
    far.ip("route add default via 10.0.2.1")
    far.ip("link set right mtu 576")
    router.ip("link set right mtu 576")
    router.ip("rule add iif lo unreachable")  # it says nothing of its own
    router.run("sh", "-c", "echo 1 > /proc/sys/net/ipv4/ip_forward").check_returncode()
    hears = far.start(
        sys.executable, "-c", "import socket\nsock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)\n"
        "sock.bind(('', 9))\nprint(flush=True)\nprint(len(sock.recv(2000)), flush=True)", stdout=subprocess.PIPE)
    assert hears.stdout is not None
    hears.stdout.readline()
    try:
        near.run(
            sys.executable, "-c", "from teleop.live.net.wire import Wire, bind_towards\n"
            "peer = ('10.0.2.2', 9)\nwire = Wire(bind_towards(peer), peer)\nwire.keep_to_peer()\n"
            "for size in (1200, 100):\n    wire.send(bytes(size))",
            env={**os.environ, "PYTHONPATH": str(ROOT)}).check_returncode()
        assert hears.stdout.readline() == "1200\n"
    finally:
        hears.kill()
        hears.communicate()
