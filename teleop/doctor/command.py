"""Command `teleop doctor`: what is installed here, the compiled kernels, and what this machine gives a live end.

The machine is measured by `teleop.doctor.probe`, and judged by stated thresholds.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from argparse import Namespace
from collections.abc import Iterable, Mapping
from importlib.metadata import PackageNotFoundError, packages_distributions, version
from pathlib import Path
from typing import Any, NamedTuple

from teleop.emit.compiler import find_compiler
from teleop.errors import enumerated, number_of
from teleop.protocol.guard import UNNAMED
from teleop.scene.library import ROOT
from teleop.sweeps.kernels.cache_folder import folder as kernels
from teleop.sweeps.kernels.cache_folder import open_to_others
from teleop.terminal.answer import Answer
from teleop.terminal.table import facts, si
from teleop.version import DISTRIBUTION, __version__

EXTRAS = {  # what to install for each
    "cryptography": "secure", "distributed": "cluster", "dynamixel-sdk": "dynamixel", "feetech-servo-sdk": "feetech",
    "matplotlib": "plot", "mcap": "log", "mujoco-core": "mujoco", "pyOpenSSL": "secure",
    "pylibfranka": "franka", "pylsl": "lsl", "python-can": "openarm", "scipy": "people", "websockets": "page",
}


def packages() -> dict[str, str | None]:
    """The versions of what the package needs and of what its extras need; None of one that is not there."""
    return {name: version_of(name) for name in ("numpy", "msgpack", *EXTRAS)}


def version_of(name: str) -> str | None:
    """The version of an installed distribution, None of one that is not """
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def kernel_files(folder: Path) -> list[Path]:
    """Files of compiled kernels in the folder, and what earlier versions kept there."""
    return [path for path in folder.rglob("teleop_kernel_*") if path.is_file()] if folder.is_dir() else []


def clear() -> int:
    """Remove every compiled kernel, and nothing else; returns how many there were."""
    held = kernel_files(kernels())
    for path in held:
        path.unlink(missing_ok=True)
    return sum(path.suffix in (".py", ".so") for path in held)


def other_packages(folders: Iterable[str] | None = None) -> list[str]:
    """Other packages called `teleop` that Python could import: distributions by name, and places on `folders`.

    `folders`: where Python looks; left out: `sys.path`.
    """
    names = [name for name in dict.fromkeys(packages_distributions().get("teleop", ())) if name != DISTRIBUTION]
    for folder in dict.fromkeys(sys.path if folders is None else folders):
        package = Path(folder or ".") / "teleop"
        for place, file in ((package, package / "__init__.py"), (package.with_suffix(".py"),) * 2):
            if file.is_file() and place.resolve() != ROOT / "teleop":
                names.append(str(place))
    return names


def judge_name(packages: list[str]) -> Finding:
    """Finding on other packages called `teleop`, as `other_packages` lists them."""
    if not packages:
        return Finding("name", True, "no other package called teleop is in the way")
    return Finding(
        "name", False, f"another package called teleop is here too, {enumerated(packages)}, and Python may import it "
        "in place of this one",
        f"type  python3 -m venv own && own/bin/pip install {DISTRIBUTION}  for an environment of its own")


def command(args: Namespace) -> Answer:
    """Answer with the findings; with --clear the kernels are removed first."""
    removed = clear() if args.clear else 0
    report = findings()
    answer = f"{number_of(removed, 'kernel')} removed\n{text(report)}" if args.clear else text(report)
    return Answer(answer, {**report, "removed": removed})


def findings() -> dict[str, Any]:
    """Versions, extras, the kernels on disk, and what was measured and judged, as JSON can hold them."""
    folder = kernels()
    files = kernel_files(folder)
    measured, policies = measure(), governors()
    rights = realtime(measured)
    clashes = other_packages()
    live = judge(measured, rights)
    late = any(one.name == "timer" and not one.good for one in live)
    judged = [judge_name(clashes), *live, governor(policies, not late)]
    return {
        "bilateral-teleop": __version__, "python": sys.version.split()[0], "platform": sys.platform,
        "packages": packages(),
        "compiler": find_compiler(),
        "kernels": {"folder": str(folder), "modules": sum(path.suffix in (".py", ".so") for path in files),
                    "bytes": sum(path.stat().st_size for path in files),
                    "not_kept": open_to_others(folder) if folder.exists() else None},
        "realtime": rights, "measured": measured, "others": clashes, "governors": policies,
        "rmem_max": rmem_max(),
        "findings": [one._asdict() for one in judged],
    }


def text(report: dict[str, Any]) -> str:
    """Text of the findings, a line each, and below what is not good what to type."""
    rows = [("bilateral-teleop", f"{report['bilateral-teleop']}, Python {report['python']} on {report['platform']}")]
    for name, installed in report["packages"].items():
        extra = EXTRAS.get(name)
        cure = "not installed" + (f": pip install 'bilateral-teleop[{extra}]'" if extra else "")
        rows.append((name, installed or cure))
    kernels = report["kernels"]
    faster = "none: install gcc or clang, and sweeps run some 100 times faster"
    rows.append(("C compiler", report["compiler"] or faster))
    rows.append(("kernels", f"{kernels['modules']} compiled, {kernels['bytes'] / 1e6:.3g} MB in {kernels['folder']}; "
                 "teleop doctor --clear removes them"))
    if kernels["not_kept"]:
        rows.append(("", f"they are not made use of: {kernels['not_kept']}"))
    rows += [row for one in report["findings"] for row in Finding(**one).rows]
    return facts(rows)


LATE_US = 500.0  # half a tick: of 99 ticks in 100 what is later leaves too little of it for the law
MOST_SKIPPED = 0.01  # share of the ticks, from which on a run has a note on them
TRIP_US = 1000.0  # a tick: of 99 round trips in 100 what is longer adds one to the delay of the link
HOLDS = round(UNNAMED.timeout * 1000)  # datagrams: of a longer stall the force is on its way to zero anyway
PATIENCE = 30.0  # s for a process that takes three
RMEM_MAX = Path("/proc/sys/net/core/rmem_max")
GOVERNORS = Path("/sys/devices/system/cpu")
PROBE = ("-m", "teleop.doctor.probe")


class Finding(NamedTuple):
    """Result of looking at one thing. `good`: None where there is nothing to judge."""

    name: str
    good: bool | None
    says: str
    cure: str | None = None  # what to type, where it is not good

    @property
    def rows(self) -> list[tuple[str, str]]:
        """Its rows of a table of facts."""
        mark = "" if self.good is None else "ok: " if self.good else "poor: "
        return [(self.name, mark + self.says), *([] if self.cure is None else [("", self.cure)])]


def measure() -> dict[str, Any]:
    """Measure this machine by the probe, in a process of its own; `error`, one line, if that did not come up."""
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    try:
        done = subprocess.run([sys.executable, "-P", *PROBE], check=False, capture_output=True, text=True,
                              timeout=PATIENCE, env={**os.environ, "PYTHONPATH": path})
        report = json.loads(done.stdout)
    except subprocess.TimeoutExpired:
        return {"error": f"its process took longer than {PATIENCE:g} s"}
    except (OSError, ValueError):
        return {"error": "its process did not come up"}
    return report if isinstance(report, dict) else {"error": "its process did not come up"}


def realtime(report: Mapping[str, Any]) -> dict[str, str | None]:
    """Rights to real-time scheduling that the system gives a live end, and what to type for the rest."""
    from teleop.live.process.realtime import Granted, cure

    unknown = f"no ({report.get('error')})"
    granted = Granted(report.get("scheduler", unknown), report.get("memory", unknown))
    lacking = not granted.whole and hasattr(os, "sched_setscheduler")
    return {"scheduler": granted.scheduler, "memory": granted.memory, "cure": cure(for_good=True) if lacking else None}


def judge(report: Mapping[str, Any], rights: Mapping[str, str | None]) -> list[Finding]:
    """Judge the measurements; the most important findings come first."""
    if "error" in report:
        return [Finding("live end", False, f"nothing could be measured, for {report['error']}",
                        f"type  python3 {' '.join(PROBE)}  to see why")]
    granted = Finding("real time", rights["cure"] is None,
                      f"a live end gets scheduler {rights['scheduler']}, memory {rights['memory']}", rights["cure"])
    return [timer(report, rights["cure"]), granted, *link(report["loopback"])]


def timer(report: Mapping[str, Any], cure: str | None) -> Finding:
    """Finding on the lateness of a live end's ticks; `cure`: what to type for real-time scheduling that it lacks."""
    ordinary, first = report["ordinary"], report["realtime"]
    best = first or ordinary
    says = f"{'with real-time scheduling' if first else 'of a tick each ms'} {_late(best)}"
    says += f"; without it {_late(ordinary)}" if first else ""
    if _in_time(best):
        return Finding("timer", True, says)
    if cure is None or first:
        cure = "close what else runs here, or start the ends with --spin, or with --rate 500"
    return Finding("timer", False, f"{says}; good are 99 % under {si(LATE_US / 1e6, 's')} and {MOST_SKIPPED:.0%} left "
                   "out at most", cure)


def link(report: Mapping[str, Any]) -> list[Finding]:
    """Findings on datagrams over loopback, and on the receive buffer."""
    if "error" in report:
        return [Finding("loopback", False, f"no datagram could be sent from this machine to itself ({report['error']})",
                        "type  ip link set lo up  as root")]
    trip, buffer, lost = report["round_trip_us"], report["buffer"], report["lost"]
    stamps = "the kernel says when each came" if report["stamps"] else \
        "the kernel does not say when one came, so what is read late counts as late"
    took = f"half of the round trips under {_us(trip['p50'])}, 99 % under {_us(trip['p99'])}; " if trip else ""
    good = not lost and trip["p99"] < TRIP_US
    says = f"{lost or 'none'} of {report['sent']} round trips lost, {took}{stamps}"
    loopback = Finding("loopback", good, says if good else f"{says}; good are none lost, and 99 % under "
                       f"{_us(TRIP_US)}", None if good else "close what else runs here, and look with  sudo nft list "
                       "ruleset  for a rule that drops what goes over lo")
    holds, size = buffer["holds"], buffer["asked"]
    says = (f"holds {'all ' if holds == buffer['of'] else ''}{holds} datagrams, {si(holds / 1e3, 's')} of messages at "
            "1 kHz")
    if holds >= HOLDS:
        return [loopback, Finding("buffer", True, says)]
    return [loopback, Finding(
        "buffer", False, f"{says}; good are {HOLDS}, as long as an end is silent before it is safe",
        f"type  echo net.core.rmem_max={size} | sudo tee /etc/sysctl.d/teleop.conf && sudo sysctl --system")]


def governor(counts: Mapping[str, int], in_time: bool) -> Finding:
    """Finding on the frequency governors; `counts`: the processors that each governor controls."""
    if not counts:
        return Finding("frequency", None, "this system does not say how its processors choose their frequency")
    shares = enumerated([f"{count} by {name}" for name, count in counts.items()], "and")
    if in_time or counts.keys() == {"performance"}:
        return Finding("frequency", True, f"processors choose it {shares}")
    return Finding("frequency", False, f"processors choose it {shares}, and ticks are late",
                   "type  sudo cpupower frequency-set -g performance")


def governors() -> dict[str, int]:
    """Count the processors of each frequency governor; none where that cannot be read."""
    counts: dict[str, int] = {}
    for path in sorted(GOVERNORS.glob("cpu[0-9]*/cpufreq/scaling_governor")):
        try:
            name = path.read_text().strip()
        except OSError:
            continue
        counts[name] = counts.get(name, 0) + 1
    return counts


def rmem_max() -> int | None:
    """The most bytes that the system gives a receive buffer, half of what it counts; None where it does not say."""
    try:
        return int(RMEM_MAX.read_text())
    except (OSError, ValueError):
        return None


def _in_time(ticks: Mapping[str, Any]) -> bool:
    late = ticks["late_us"]
    return bool(late) and late["p99"] < LATE_US and ticks["left_out"] <= MOST_SKIPPED * ticks["ticks"]


def _late(ticks: Mapping[str, Any]) -> str:
    late = ticks["late_us"]
    if not late:
        return f"nearly all of {ticks['ticks']} left out"
    return (f"half under {_us(late['p50'])} late, 99 % under {_us(late['p99'])}, at most {_us(late['p100'])}, "
            f"{ticks['left_out'] or 'none'} of {ticks['ticks']} left out")


def _us(value: float) -> str:
    return si(value / 1e6, "s")
