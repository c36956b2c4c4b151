"""Machines of their own in one: network namespaces, and cables (`veth`) between them.

They need root, or a system that lets users have namespaces of their own, and the programs `TOOLS`. Where there are none
`NoNamespaces` says why.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from dataclasses import dataclass

TOOLS = ("ip", "unshare", "nsenter")  # of iproute2 and util-linux
HOLD = ("sh", "-c", "echo up; exec cat")  # keeps a namespace until its standard input ends, as when the test is killed


class NoNamespaces(Exception):
    """This system gives none; says why."""


@dataclass(frozen=True)
class Machine:
    """A network of its own, kept by a process."""

    holder: subprocess.Popen[str]

    def inside(self, *words: str) -> list[str]:
        """A command on this machine: what is started becomes it, so that its signals reach it."""
        own = [] if os.geteuid() == 0 else ["--user", "--preserve-credentials"]
        return ["nsenter", "--target", str(self.holder.pid), "--net", *own, "--", *words]

    def ip(self, words: str) -> None:
        """`ip WORDS` here. Raises `NoNamespaces` if it fails."""
        done = subprocess.run(self.inside("ip", *words.split()), capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise NoNamespaces(f"`ip {words}` failed: {done.stderr.strip()}")

    def moves_to(self, address: str, cable: str = "cable") -> None:
        """Its end of a cable has this address, and no other."""
        self.ip(f"address flush dev {cable}")
        self.ip(f"address add {address}/24 dev {cable}")

    def counted(self, name: str) -> int:
        """A counter of IP in /proc/net/snmp, as `FragCreates`: fragments that were sent."""
        done = subprocess.run(self.inside("cat", "/proc/net/snmp"), capture_output=True, text=True, check=True)
        names, numbers = (line.split() for line in done.stdout.splitlines() if line.startswith("Ip:"))
        return int(dict(zip(names, numbers, strict=True))[name])

    def gone(self) -> None:
        """Nothing keeps it any more: the system takes it away when the last process on it has ended."""
        self.holder.communicate()


def machine(beside: Machine | None = None) -> Machine:
    """A new one; `beside` another, it can be joined to that one. Raises `NoNamespaces`."""
    if missing := [tool for tool in TOOLS if shutil.which(tool) is None]:
        raise NoNamespaces(f"there is no program {', '.join(missing)}")
    own = [] if os.geteuid() == 0 else ["--user", "--map-root-user"]
    alone = ("unshare", "--net", *own, "--", *HOLD)
    words = list(alone) if beside is None else beside.inside("unshare", "--net", "--", *HOLD)
    holder = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert holder.stdout is not None
    if holder.stdout.readline() != "up\n":
        raise NoNamespaces(f"`{' '.join(words)}` ended: {holder.communicate()[1].strip()}")
    return Machine(holder)


def join(one: Machine, other: Machine, addresses: tuple[str, str], cable: str = "cable") -> None:
    """A cable between two, with these addresses. Raises `NoNamespaces`."""
    one.ip(f"link add {cable} type veth peer name {cable} netns {other.holder.pid}")
    for each, address in zip((one, other), addresses, strict=True):
        each.moves_to(address, cable)
        each.ip("link set lo up")
        each.ip(f"link set {cable} up")
