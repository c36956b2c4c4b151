"""What `teleop doctor` does."""

from __future__ import annotations

import sys
from argparse import Namespace
from typing import Any

from teleop.doctor import installed, machine
from teleop.doctor.finding import Finding
from teleop.errors import number_of
from teleop.terminal.answer import Answer
from teleop.terminal.table import facts


def command(args: Namespace) -> Answer:
    """The findings; with --clear the kernels are removed first."""
    removed = installed.clear() if args.clear else 0
    found = findings()
    said = f"{number_of(removed, 'kernel')} removed\n{text(found)}" if args.clear else text(found)
    return Answer(said, {**found, "removed": removed})


def findings() -> dict[str, Any]:
    """Versions, extras, the kernels on disk, and what was measured and judged, as JSON can hold them."""
    from teleop.sweeps.kernels.cache_folder import open_to_others
    from teleop.version import __version__

    folder = installed.kernels()
    held = installed.kept(folder)
    told, found = machine.measured(), machine.governors()
    rights = machine.realtime(told)
    clashes = installed.others()
    live = machine.judged(told, rights)
    late = any(one.name == "timer" and not one.good for one in live)
    judged = [installed.clash(clashes), *live, machine.governor(found, not late)]
    return {
        "bilateral-teleop": __version__, "python": sys.version.split()[0], "platform": sys.platform,
        "packages": installed.packages(),
        "kernels": {"folder": str(folder), "modules": sum(path.suffix == ".py" for path in held),
                    "bytes": sum(path.stat().st_size for path in held),
                    "not_kept": open_to_others(folder) if folder.exists() else None},
        "realtime": rights, "measured": told, "others": clashes, "governors": found, "rmem_max": machine.rmem_max(),
        "findings": [one._asdict() for one in judged],
    }


def text(found: dict[str, Any]) -> str:
    """Text of the findings, a line each, and below what is not good what to type."""
    rows = [("bilateral-teleop", f"{found['bilateral-teleop']}, Python {found['python']} on {found['platform']}")]
    for name, there in found["packages"].items():
        extra = installed.EXTRAS.get(name)
        cure = "not installed" + (f": pip install 'bilateral-teleop[{extra}]'" if extra else "")
        rows.append((name, there or cure))
    held = found["kernels"]
    rows.append(("kernels", f"{held['modules']} compiled, {held['bytes'] / 1e6:.3g} MB in {held['folder']}; "
                 "teleop doctor --clear removes them"))
    if held["not_kept"]:
        rows.append(("", f"they are not made use of: {held['not_kept']}"))
    rows += [row for one in found["findings"] for row in Finding(**one).rows]
    return facts(rows)
