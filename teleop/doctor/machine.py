"""Findings on this machine: what it gives a live end, as `teleop.doctor.probe` measures it, by stated thresholds."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from teleop.errors import enumerated
from teleop.protocol.guard import UNNAMED
from teleop.terminal.table import si

LATE_US = 500.0  # half a tick: of 99 ticks in 100 what is later leaves too little of it for the law
LEFT_OUT = 0.01  # share of the ticks, from which on a run has a note on them
TRIP_US = 1000.0  # a tick: of 99 round trips in 100 what is longer adds one to the delay of the link
HOLDS = round(UNNAMED.timeout * 1000)  # datagrams: of a longer stall the force is on its way to zero anyway
PATIENCE = 30.0  # s for a process that takes three
RMEM_MAX = Path("/proc/sys/net/core/rmem_max")
GOVERNORS = Path("/sys/devices/system/cpu")
PROBE = ("-m", "teleop.doctor.probe")


class Finding(NamedTuple):
    """What was found of one thing. `good`: None where there is nothing to judge."""

    name: str
    good: bool | None
    says: str
    cure: str | None = None  # what to type, where it is not good

    @property
    def rows(self) -> list[tuple[str, str]]:
        """Its rows of a table of facts."""
        judged = "" if self.good is None else "ok: " if self.good else "poor: "
        return [(self.name, judged + self.says), *([] if self.cure is None else [("", self.cure)])]


def measured() -> dict[str, Any]:
    """What the probe has measured in a process of its own; of one that did not come up `error`, one line."""
    from teleop.scene.library import ROOT

    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    try:
        done = subprocess.run([sys.executable, "-P", *PROBE], check=False, capture_output=True, text=True,
                              timeout=PATIENCE, env={**os.environ, "PYTHONPATH": path})
        told = json.loads(done.stdout)
    except subprocess.TimeoutExpired:
        return {"error": f"its process took longer than {PATIENCE:g} s"}
    except (OSError, ValueError):
        return {"error": "its process did not come up"}
    return told if isinstance(told, dict) else {"error": "its process did not come up"}


def realtime(told: Mapping[str, Any]) -> dict[str, str | None]:
    """What the system gives a live end of real-time scheduling, and what to type for the rest."""
    from teleop.live.process.realtime import Granted, cure

    unknown = f"no ({told.get('error')})"
    granted = Granted(told.get("scheduler", unknown), told.get("memory", unknown))
    lacking = not granted.whole and hasattr(os, "sched_setscheduler")
    return {"scheduler": granted.scheduler, "memory": granted.memory, "cure": cure(for_good=True) if lacking else None}


def judged(told: Mapping[str, Any], rights: Mapping[str, str | None]) -> list[Finding]:
    """The findings of what was measured, in the order of what matters."""
    if "error" in told:
        return [Finding("live end", False, f"nothing could be measured, for {told['error']}",
                        f"type  python3 {' '.join(PROBE)}  to see why")]
    granted = Finding("real time", rights["cure"] is None,
                      f"a live end gets scheduler {rights['scheduler']}, memory {rights['memory']}", rights["cure"])
    return [timer(told, rights["cure"]), granted, *link(told["loopback"])]


def timer(told: Mapping[str, Any], cure: str | None) -> Finding:
    """How late a live end's ticks come, by what it is given; `cure`: of real-time scheduling that there is not."""
    ordinary, first = told["ordinary"], told["realtime"]
    best = first or ordinary
    says = f"{'with real-time scheduling' if first else 'of a tick each ms'} {_late(best)}"
    says += f"; without it {_late(ordinary)}" if first else ""
    if not best["precise"]:
        return Finding("timer", False, f"{says}; this system has no timerfd, so timers are rounded to whole ms",
                       "run live ends on Linux")
    if _in_time(best):
        return Finding("timer", True, says)
    if cure is None or first:
        cure = "close what else runs here, or start the ends with --spin, or with --rate 500"
    return Finding("timer", False, f"{says}; good are 99 % under {si(LATE_US / 1e6, 's')} and {LEFT_OUT:.0%} left out "
                   "at most", cure)


def link(told: Mapping[str, Any]) -> list[Finding]:
    """Datagrams over loopback, and the receive buffer."""
    if "error" in told:
        return [Finding("loopback", False, f"no datagram could be sent from this machine to itself ({told['error']})",
                        "type  ip link set lo up  as root")]
    trip, buffer, lost = told["round_trip_us"], told["buffer"], told["lost"]
    stamps = "the kernel says when each came" if told["stamps"] else \
        "the kernel does not say when one came, so what is read late counts as late"
    took = f"half of the round trips under {_us(trip['p50'])}, 99 % under {_us(trip['p99'])}; " if trip else ""
    good = not lost and trip["p99"] < TRIP_US
    says = f"{lost or 'none'} of {told['sent']} round trips lost, {took}{stamps}"
    loopback = Finding("loopback", good, says if good else f"{says}; good are none lost, and 99 % under "
                       f"{_us(TRIP_US)}", None if good else "close what else runs here, and look with  sudo nft list "
                       "ruleset  for a rule that drops what goes over lo")
    holds, asked = buffer["holds"], buffer["asked"]
    says = (f"holds {'all ' if holds == buffer['of'] else ''}{holds} datagrams, {si(holds / 1e3, 's')} of messages at "
            "1 kHz")
    if holds >= HOLDS:
        return [loopback, Finding("buffer", True, says)]
    return [loopback, Finding(
        "buffer", False, f"{says}; good are {HOLDS}, as long as an end is silent before it is safe",
        f"type  echo net.core.rmem_max={asked} | sudo tee /etc/sysctl.d/teleop.conf && sudo sysctl --system")]


def governor(found: Mapping[str, int], in_time: bool) -> Finding:
    """How the processors choose their frequency; `found`: how many do so by each governor."""
    if not found:
        return Finding("frequency", None, "this system does not say how its processors choose their frequency")
    told = enumerated([f"{count} by {name}" for name, count in found.items()], "and")
    if in_time or found.keys() == {"performance"}:
        return Finding("frequency", True, f"processors choose it {told}")
    return Finding("frequency", False, f"processors choose it {told}, and ticks are late",
                   "type  sudo cpupower frequency-set -g performance")


def governors() -> dict[str, int]:
    """How many processors have each frequency governor; none where that cannot be read."""
    found: dict[str, int] = {}
    for path in sorted(GOVERNORS.glob("cpu[0-9]*/cpufreq/scaling_governor")):
        try:
            name = path.read_text().strip()
        except OSError:
            continue
        found[name] = found.get(name, 0) + 1
    return found


def rmem_max() -> int | None:
    """The most bytes that the system gives a receive buffer, half of what it counts; None where it does not say."""
    try:
        return int(RMEM_MAX.read_text())
    except (OSError, ValueError):
        return None


def _in_time(told: Mapping[str, Any]) -> bool:
    return bool(told["late_us"]) and told["late_us"]["p99"] < LATE_US and told["left_out"] <= LEFT_OUT * told["ticks"]


def _late(told: Mapping[str, Any]) -> str:
    late = told["late_us"]
    if not late:
        return f"nearly all of {told['ticks']} left out"
    return (f"half under {_us(late['p50'])} late, 99 % under {_us(late['p99'])}, at most {_us(late['p100'])}, "
            f"{told['left_out'] or 'none'} of {told['ticks']} left out")


def _us(value: float) -> str:
    return si(value / 1e6, "s")
