"""Versions that are installed, compiled kernels that are kept, real-time scheduling: `teleop doctor`."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from argparse import Namespace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from teleop.errors import number_of
from teleop.terminal.answer import Answer
from teleop.terminal.table import facts

EXTRAS = {  # what to install for each
    "cryptography": "secure", "distributed": "cluster", "matplotlib": "plot", "numba": "batch", "pyOpenSSL": "secure",
    "scipy": "test",
}


def kernels() -> Path:
    """Folder of the compiled kernels."""
    from teleop.sweeps.kernels.compiled import folder

    return folder()


_ASK = """
import json
import teleop.live.end
from teleop.live.process.realtime import ask
scheduler, memory, _ = ask()
print(json.dumps({"scheduler": scheduler, "memory": memory}))
"""


def real_time() -> dict[str, str | None]:
    """What the system gives a live end, as a process of its own is given it now, and what to type for the rest."""
    from teleop.live.process.realtime import Granted, cure
    from teleop.scene.library import ROOT

    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    done = subprocess.run([sys.executable, "-P", "-c", _ASK], check=False, capture_output=True, text=True,
                          env={**os.environ, "PYTHONPATH": path})
    try:
        granted = Granted(**json.loads(done.stdout))
    except (ValueError, TypeError):
        granted = Granted("no (its process did not come up)", "no (its process did not come up)")
    lacking = not granted.whole and hasattr(os, "sched_setscheduler")
    return {"scheduler": granted.scheduler, "memory": granted.memory, "cure": cure(for_good=True) if lacking else None}


def findings() -> dict[str, Any]:
    """Versions, extras, the kernels on disk and what there is of real-time scheduling, as JSON can hold them."""
    from teleop.version import __version__

    held = _kept(kernels())
    from teleop.sweeps.kernels.cache_folder import open_to_others

    return {
        "bilateral-teleop": __version__, "python": sys.version.split()[0], "platform": sys.platform,
        "packages": {name: _version(name) for name in ("numpy", "msgpack", *EXTRAS)},
        "kernels": {"folder": str(kernels()), "modules": sum(path.suffix == ".py" for path in held),
                    "bytes": sum(path.stat().st_size for path in held),
                    "not_kept": open_to_others(kernels()) if kernels().exists() else None},
        "realtime": real_time(),
    }


def clear() -> int:
    """Remove every compiled kernel, and nothing else; returns how many there were."""
    held = _kept(kernels())
    for path in held:
        path.unlink(missing_ok=True)
    return sum(path.suffix == ".py" for path in held)


def text(found: dict[str, Any]) -> str:
    """Text of the findings, a line each."""
    rows = [("bilateral-teleop", f"{found['bilateral-teleop']}, Python {found['python']} on {found['platform']}")]
    for name, there in found["packages"].items():
        cure = f"not installed: pip install 'bilateral-teleop[{EXTRAS[name]}]'" if name in EXTRAS else "not installed"
        rows.append((name, there or cure))
    held = found["kernels"]
    rows.append(("kernels", f"{held['modules']} compiled, {held['bytes'] / 1e6:.3g} MB in {held['folder']}; "
                 "teleop doctor --clear removes them"))
    if held["not_kept"]:
        rows.append(("", f"they are not made use of: {held['not_kept']}"))
    got = found["realtime"]
    rows.append(("real time", f"a live end gets scheduler {got['scheduler']}, memory {got['memory']}"))
    if got["cure"]:
        rows.append(("", got["cure"]))
    return facts(rows)


def command(args: Namespace) -> Answer:
    """Answer of `teleop doctor`: the findings; with --clear the kernels are removed first."""
    removed = clear() if args.clear else 0
    found = findings()
    said = f"{number_of(removed, 'kernel')} removed\n{text(found)}" if args.clear else text(found)
    return Answer(said, {**found, "removed": removed})


def _kept(folder: Path) -> list[Path]:
    """Files of compiled kernels in the folder, those of numba among them."""
    return [path for path in folder.rglob("teleop_kernel_*") if path.is_file()] if folder.is_dir() else []


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
