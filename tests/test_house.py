"""The rules of the house that a machine can keep: style, types, layers, light imports, true pages."""

from __future__ import annotations

import doctest
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("teleop", "master", "slave", "channel", "scenarios")


def run(*command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


def test_ruff_finds_nothing() -> None:
    done = run(sys.executable, "-m", "ruff", "check", ".")
    assert done.returncode == 0, done.stdout


def test_mypy_strict_finds_nothing() -> None:
    done = run(sys.executable, "-m", "mypy")
    assert done.returncode == 0, done.stdout


def test_layers_and_the_ban_on_hidden_clocks_are_kept() -> None:
    lint = Path(sys.executable).with_name("lint-imports")
    done = run(str(lint), "--no-cache")
    assert done.returncode == 0, done.stdout


def test_importing_teleop_loads_neither_numpy_nor_asyncio() -> None:
    done = run(sys.executable, "-c", "import teleop, sys; print(*sys.modules)")
    assert done.returncode == 0
    assert not {"numpy", "asyncio", "msgpack", "argparse"} & set(done.stdout.split())


@pytest.mark.parametrize("package", ["master", "slave", "channel", "scenarios.local"])
def test_a_package_beside_the_other_teleop_says_so_in_one_sentence(package: str, tmp_path: Path) -> None:
    (tmp_path / "teleop").mkdir()
    (tmp_path / "teleop" / "__init__.py").write_text("")
    code = f"import sys; sys.path[:0] = [{str(tmp_path)!r}, {str(ROOT)!r}]; import {package}"
    done = run(sys.executable, "-c", code)
    assert done.returncode == 1
    assert "ImportError" in done.stderr
    assert "bilateral-teleop" in done.stderr.splitlines()[-1]


def test_the_command_beside_the_other_teleop_ends_with_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "teleop").mkdir()
    (tmp_path / "teleop" / "__init__.py").write_text("")
    paths = [str(tmp_path), str(ROOT)]
    code = f"import sys; sys.path[:0] = {paths!r}; from scenarios.__main__ import main; sys.exit(main())"
    done = run(sys.executable, "-c", code)
    assert done.returncode == 2
    assert done.stderr.startswith("teleop: ")
    assert len(done.stderr.splitlines()) == 1


def test_no_file_is_longer_than_the_house_allows() -> None:
    lengths = {
        path.relative_to(ROOT): len(path.read_text().splitlines())
        for package in PACKAGES for path in (ROOT / package).rglob("*.py")
    }
    assert {str(path): n for path, n in lengths.items() if n > 500} == {}


def test_every_public_module_class_and_function_has_a_docstring() -> None:
    import ast

    bare = []
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            tree = ast.parse(path.read_text())
            nodes: list[ast.AST] = [tree, *tree.body]
            for node in nodes:
                if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name.startswith("_"):
                    continue
                documented = isinstance(node, ast.Module | ast.FunctionDef | ast.ClassDef)
                # NamedTuples of numbers say what each number is beside the number.
                fields_only = isinstance(node, ast.ClassDef) and all(isinstance(n, ast.AnnAssign) for n in node.body)
                if documented and not fields_only and ast.get_docstring(node) is None:  # type: ignore[arg-type]
                    bare.append(f"{path.relative_to(ROOT)}: {getattr(node, 'name', 'module')}")
    assert bare == []


def modules() -> list[str]:
    paths = [path for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
    named = [".".join(path.relative_to(ROOT).with_suffix("").parts) for path in paths if ">>>" in path.read_text()]
    return sorted(name.removesuffix(".__init__") for name in named)


@pytest.mark.parametrize("module", modules())
def test_the_examples_in_the_docstrings_are_true(module: str) -> None:
    failed, tried = doctest.testmod(import_module(module))
    assert tried > 0
    assert failed == 0


def test_tests_mirror_the_folders() -> None:
    for path in (ROOT / "tests").iterdir():
        if path.is_dir() and not path.name.startswith("_"):
            assert path.name in (*PACKAGES, "live", "bench", "fuzz", "plugin", "device_plugin"), path
