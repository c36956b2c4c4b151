"""What is installed here: versions, extras, compiled kernels, and another project's package called `teleop`."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, packages_distributions, version
from pathlib import Path

from teleop.doctor.finding import Finding
from teleop.errors import enumerated
from teleop.version import DISTRIBUTION

EXTRAS = {  # what to install for each
    "cryptography": "secure", "distributed": "cluster", "matplotlib": "plot", "mcap": "log",
    "mujoco-core": "mujoco", "numba": "batch", "pyOpenSSL": "secure", "scipy": "test", "websockets": "page",
}


def packages() -> dict[str, str | None]:
    """The versions of what the package needs and of what its extras need; None of one that is not there."""
    return {name: version_of(name) for name in ("numpy", "msgpack", *EXTRAS)}


def version_of(name: str) -> str | None:
    """The version of an installed distribution, None of one that is not installed."""
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def kernels() -> Path:
    """Folder of the compiled kernels."""
    from teleop.sweeps.kernels.compiled import folder

    return folder()


def kept(folder: Path) -> list[Path]:
    """Files of compiled kernels in the folder, those of numba among them."""
    return [path for path in folder.rglob("teleop_kernel_*") if path.is_file()] if folder.is_dir() else []


def clear() -> int:
    """Remove every compiled kernel, and nothing else; returns how many there were."""
    held = kept(kernels())
    for path in held:
        path.unlink(missing_ok=True)
    return sum(path.suffix == ".py" for path in held)


def others(folders: Iterable[str] | None = None) -> list[str]:
    """Other packages called `teleop` that Python could import: distributions by name, and places on `folders`.

    `folders`: where Python looks; left out: `sys.path`.
    """
    from teleop.scene.library import ROOT

    told = [name for name in dict.fromkeys(packages_distributions().get("teleop", ())) if name != DISTRIBUTION]
    for folder in dict.fromkeys(sys.path if folders is None else folders):
        package = Path(folder or ".") / "teleop"
        for place, file in ((package, package / "__init__.py"), (package.with_suffix(".py"),) * 2):
            if file.is_file() and place.resolve() != ROOT / "teleop":
                told.append(str(place))
    return told


def clash(found: list[str]) -> Finding:
    """What `others` comes to."""
    if not found:
        return Finding("name", True, "no other package called teleop is in the way")
    return Finding(
        "name", False, f"another package called teleop is here too, {enumerated(found)}, and Python may import it in "
        "place of this one",
        f"type  python3 -m venv own && own/bin/pip install {DISTRIBUTION}  for an environment of its own")
