"""Command `teleop doctor`: what is installed here, the compiled kernels, and what this machine gives a live end."""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, packages_distributions, version
from pathlib import Path
from typing import Any

from teleop.doctor import machine
from teleop.doctor.machine import Finding
from teleop.errors import enumerated, number_of
from teleop.terminal.answer import Answer
from teleop.terminal.table import facts
from teleop.version import DISTRIBUTION

EXTRAS = {  # what to install for each
    "cryptography": "secure", "distributed": "cluster", "matplotlib": "plot", "mcap": "log",
    "mujoco-core": "mujoco", "numba": "batch", "pyOpenSSL": "secure", "scipy": "test", "websockets": "page",
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


def kernels() -> Path:
    """Folder of the compiled kernels."""
    from teleop.sweeps.kernels.compiled import folder

    return folder()


def kernel_files(folder: Path) -> list[Path]:
    """Files of compiled kernels in the folder, numba's among them."""
    return [path for path in folder.rglob("teleop_kernel_*") if path.is_file()] if folder.is_dir() else []


def clear() -> int:
    """Remove every compiled kernel, and nothing else; returns how many there were."""
    held = kernel_files(kernels())
    for path in held:
        path.unlink(missing_ok=True)
    return sum(path.suffix == ".py" for path in held)


def other_packages(folders: Iterable[str] | None = None) -> list[str]:
    """Other packages called `teleop` that Python could import: distributions by name, and places on `folders`.

    `folders`: where Python looks; left out: `sys.path`.
    """
    from teleop.scene.library import ROOT

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
    from teleop.sweeps.kernels.compiled import open_to_others
    from teleop.version import __version__

    folder = kernels()
    files = kernel_files(folder)
    measured, governors = machine.measure(), machine.governors()
    rights = machine.realtime(measured)
    clashes = other_packages()
    live = machine.judge(measured, rights)
    late = any(one.name == "timer" and not one.good for one in live)
    judged = [judge_name(clashes), *live, machine.governor(governors, not late)]
    return {
        "bilateral-teleop": __version__, "python": sys.version.split()[0], "platform": sys.platform,
        "packages": packages(),
        "kernels": {"folder": str(folder), "modules": sum(path.suffix == ".py" for path in files),
                    "bytes": sum(path.stat().st_size for path in files),
                    "not_kept": open_to_others(folder) if folder.exists() else None},
        "realtime": rights, "measured": measured, "others": clashes, "governors": governors,
        "rmem_max": machine.rmem_max(),
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
    rows.append(("kernels", f"{kernels['modules']} compiled, {kernels['bytes'] / 1e6:.3g} MB in {kernels['folder']}; "
                 "teleop doctor --clear removes them"))
    if kernels["not_kept"]:
        rows.append(("", f"they are not made use of: {kernels['not_kept']}"))
    rows += [row for one in report["findings"] for row in Finding(**one).rows]
    return facts(rows)
