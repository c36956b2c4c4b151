"""Machines of their own in one: network namespaces, and cables (`veth`) between them.

They need root, or a system that lets users have namespaces of their own, and the programs of iproute2 and util-linux;
elsewhere the test is skipped with the reason.
"""

from __future__ import annotations

import os
import subprocess
from dataclasses import dataclass
from typing import Any

import pytest

from tests.programs import program

HOLD = ("sh", "-c", "echo up; exec cat")  # keeps a namespace until its standard input ends, as when the test is killed


@dataclass(frozen=True)
class Machine:
    """A network of its own, kept by a process."""

    holder: subprocess.Popen[str]

    def start(self, *words: str, **how: Any) -> subprocess.Popen[str]:
        """Start a command on this machine: the process becomes it, so that its signals reach it."""
        return subprocess.Popen([program("nsenter"), *self._enter, *words], text=True, **how)

    def run(self, *words: str, **how: Any) -> subprocess.CompletedProcess[str]:
        """Run a command on this machine to its end."""
        return subprocess.run([program("nsenter"), *self._enter, *words], text=True, check=False, **how)

    @property
    def _enter(self) -> list[str]:
        users = [] if os.geteuid() == 0 else ["--user", "--preserve-credentials"]
        return ["--target", str(self.holder.pid), "--net", *users, "--"]

    def ip(self, words: str) -> None:
        """Run `ip WORDS` here."""
        done = self.run(program("ip"), *words.split(), capture_output=True)
        if done.returncode != 0:
            pytest.skip(f"no network namespaces: `ip {words}` failed: {done.stderr.strip()}")

    def moves_to(self, address: str, cable: str = "cable") -> None:
        """Its end of a cable has this address, and no other."""
        self.ip(f"address flush dev {cable}")
        self.ip(f"address add {address}/24 dev {cable}")

    def counted(self, name: str) -> int:
        """A counter of IP in /proc/net/snmp, as `FragCreates`: fragments that were sent."""
        done = self.run("cat", "/proc/net/snmp", capture_output=True)
        names, numbers = (line.split() for line in done.stdout.splitlines() if line.startswith("Ip:"))
        return int(dict(zip(names, numbers, strict=True))[name])

    def gone(self) -> None:
        """Nothing keeps it any more: the system takes it away when the last process on it has ended."""
        self.holder.communicate()


def machine(beside: Machine | None = None) -> Machine:
    """Make a machine; one made `beside` another can be joined to that one."""
    users = [] if beside is not None or os.geteuid() == 0 else ["--user", "--map-root-user"]
    words = [program("unshare"), "--net", *users, "--", *HOLD]
    pipes: dict[str, Any] = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    holder = subprocess.Popen(words, text=True, **pipes) if beside is None else beside.start(*words, **pipes)
    assert holder.stdout is not None
    if holder.stdout.readline() != "up\n":
        pytest.skip(f"no network namespaces: `{' '.join(words)}` ended: {holder.communicate()[1].strip()}")
    return Machine(holder)


def join(one: Machine, other: Machine, addresses: tuple[str, str], cable: str = "cable") -> None:
    """Lay a cable between two machines, with these addresses."""
    one.ip(f"link add {cable} type veth peer name {cable} netns {other.holder.pid}")
    for each, address in zip((one, other), addresses, strict=True):
        each.moves_to(address, cable)
        each.ip("link set lo up")
        each.ip(f"link set {cable} up")
