"""Versions that are installed and compiled kernels that are kept: `teleop doctor`."""

from __future__ import annotations

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


def findings() -> dict[str, Any]:
    """Versions, extras and the kernels on disk, as JSON can hold them."""
    from teleop.version import __version__

    held = _kept(kernels())
    from teleop.sweeps.kernels.cache_folder import open_to_others

    return {
        "bilateral-teleop": __version__, "python": sys.version.split()[0], "platform": sys.platform,
        "packages": {name: _version(name) for name in ("numpy", "msgpack", *EXTRAS)},
        "kernels": {"folder": str(kernels()), "modules": sum(path.suffix == ".py" for path in held),
                    "bytes": sum(path.stat().st_size for path in held),
                    "not_kept": open_to_others(kernels()) if kernels().exists() else None},
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
