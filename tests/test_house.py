"""The rules of the house that a machine can keep: style, types, layers, light imports, true pages."""

from __future__ import annotations

import ast
import doctest
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

pytestmark = pytest.mark.house
ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("teleop", "master", "slave", "channel", "scenarios")


def run(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, *words], cwd=ROOT, capture_output=True, text=True, check=False)


def test_ruff_finds_nothing() -> None:
    done = run("-m", "ruff", "check", ".")
    assert done.returncode == 0, done.stdout


def test_mypy_strict_finds_nothing() -> None:
    done = run("-m", "mypy")
    assert done.returncode == 0, done.stdout


def test_layers_and_the_ban_on_hidden_clocks_are_kept() -> None:
    lint = Path(sys.executable).with_name("lint-imports")
    done = run(str(lint), "--no-cache")
    assert done.returncode == 0, done.stdout


def test_importing_teleop_loads_neither_numpy_nor_asyncio() -> None:
    done = run("-c", "import teleop, sys; print(*sys.modules)")
    assert done.returncode == 0
    assert not {"numpy", "asyncio", "msgpack", "argparse"} & set(done.stdout.split())


@pytest.mark.parametrize("package", ["master", "slave", "channel", "scenarios.local"])
def test_a_package_beside_the_other_teleop_says_so_in_one_sentence(package: str, tmp_path: Path) -> None:
    (tmp_path / "teleop").mkdir()
    (tmp_path / "teleop" / "__init__.py").write_text("")
    code = f"import sys; sys.path[:0] = [{str(tmp_path)!r}, {str(ROOT)!r}]; import {package}"
    done = run("-c", code)
    assert done.returncode == 1
    assert "ImportError" in done.stderr
    assert "bilateral-teleop" in done.stderr.splitlines()[-1]


def test_the_command_beside_the_other_teleop_ends_with_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "teleop").mkdir()
    (tmp_path / "teleop" / "__init__.py").write_text("")
    paths = [str(tmp_path), str(ROOT)]
    code = f"import sys; sys.path[:0] = {paths!r}; from scenarios.__main__ import main; sys.exit(main())"
    done = run("-c", code)
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
                if documented and not fields_only and ast.get_docstring(node) is None:
                    bare.append(f"{path.relative_to(ROOT)}: {getattr(node, 'name', 'module')}")
    assert bare == []


WEAK_FIRST = {"what", "how", "where", "is", "are", "does", "do", "of", "that", "those", "these", "all", "one", "who",
              "which", "whether", "has", "may"}  # words of a docstring
VAGUE = {"told", "said", "came", "given", "kept", "asked", "there", "own", "found", "other", "more", "it"}  # names
PARTICIPLE = re.compile(
    r"_?(told|said|came|asked|met|held|given|kept|found|made|shown|known|gone|heard|felt|left|taken|put|read_as|called"
    r"|counted|typed|written|drawn|opened|closed|ended|named|listed|plain|one|each)|.*_(told|said|came|asked|met|given|kept)")
LIMITS = {"docstring": 0, "function": 2, "variable": 0, "class": 0, "sentence": 0}


def words() -> dict[str, list[str]]:
    """Find where the packages break the rules of words."""
    hits: dict[str, list[str]] = {name: [] for name in LIMITS}
    classes: dict[str, list[str]] = {}
    for path in sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py")):
        text = path.read_text()
        for node in ast.walk(ast.parse(text)):
            place = f"{path.relative_to(ROOT)}:{getattr(node, 'lineno', 1)}"
            is_function = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef | ast.Module):
                first = re.match(r"\w*", ast.get_docstring(node) or "")
                hits["docstring"] += [place] * (first is not None and first[0].lower() in WEAK_FIRST)
            if is_function and PARTICIPLE.fullmatch(node.name):
                hits["function"].append(place)
            if isinstance(node, ast.ClassDef) and node.name not in ("Forth", "Back"):  # each law has its own two
                classes.setdefault(node.name, []).append(place)
            stores = isinstance(getattr(node, "ctx", None), ast.Store)
            name = getattr(node, "id", getattr(node, "attr", "")) if stores else getattr(node, "arg", None) or ""
            hits["variable"] += [place] * (name.strip("_") in VAGUE and not isinstance(node, ast.keyword))
            if isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "startswith" and node.args:
                start = getattr(node.args[0], "value", None)
                hits["sentence"] += [place] * (isinstance(start, str) and " " in start.strip())
    hits["class"] = [f"{name}: {places}" for name, places in classes.items() if len(places) > 1]
    return hits


def test_words_of_the_house_only_get_better() -> None:
    """Each limit is what was reached: lower it where a count has fallen, raise none."""
    over = {name: places for name, places in words().items() if len(places) > LIMITS[name]}
    assert over == {}


def modules() -> list[str]:
    paths = [path for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
    named = [".".join(path.relative_to(ROOT).with_suffix("").parts) for path in paths if ">>>" in path.read_text()]
    return sorted(name.removesuffix(".__init__") for name in named)


@pytest.mark.parametrize("module", modules())
def test_the_examples_in_the_docstrings_are_true(module: str) -> None:
    failed, tried = doctest.testmod(import_module(module))
    assert tried > 0
    assert failed == 0


STARTERS = re.compile(
    r"subprocess\.(run|Popen|call|check_\w+|get\w+)|asyncio\.create_subprocess_\w+|pty\.spawn|shutil\.which"
    r"|os\.(system|popen|exec\w+|spawn\w+|posix_spawnp?)")


def undeclared(source: str) -> list[int]:
    """Find the lines that look for or start a program which is neither this Python nor `program(...)`."""
    tree = ast.parse(source)
    values: dict[str, list[ast.expr]] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            values.setdefault(node.targets[0].id, []).append(node.value)

    def declared(word: ast.expr, names: frozenset[str] = frozenset()) -> bool:
        if isinstance(word, ast.List | ast.Tuple):
            return bool(word.elts) and declared(word.elts[0], names)
        if isinstance(word, ast.Starred | ast.BinOp):
            return declared(word.value if isinstance(word, ast.Starred) else word.left, names)
        if isinstance(word, ast.Name) and word.id in values and word.id not in names:
            return all(declared(value, names | {word.id}) for value in values[word.id])
        return ast.unparse(word.func if isinstance(word, ast.Call) else word) in ("sys.executable", "program")

    lines = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and STARTERS.fullmatch(ast.unparse(node.func)):
            lines += [node.lineno] if not any(map(declared, node.args[:1])) else []
        elif isinstance(node, ast.ImportFrom):
            lines += [node.lineno for part in node.names if STARTERS.fullmatch(f"{node.module}.{part.name}")]
        elif isinstance(node, ast.Import):
            lines += [node.lineno for part in node.names if part.asname and STARTERS.match(f"{part.name}.run")]
        elif isinstance(node, ast.Assign) and STARTERS.fullmatch(ast.unparse(node.value)):
            lines.append(node.lineno)
    return lines


def test_tests_start_no_program_that_a_fresh_machine_may_lack() -> None:
    """The suite passed only where zsh and fish had been installed by hand."""
    found = {str(path.relative_to(ROOT)): lines for path in (ROOT / "tests").rglob("*.py")
             if path.name != "programs.py" and (lines := undeclared(path.read_text()))}
    assert found == {}, "start it by tests.programs.program(NAME), which skips the test where it is missing"
    for wrong in ("subprocess.run(['zsh'])", "subprocess.Popen(words)", "shell = 'fish'\nsubprocess.run([shell])",
                  "shutil.which('cc')", "from subprocess import run", "asyncio.create_subprocess_exec('sh')",
                  "words = [sys.executable]\nwords = ['sh']\nos.execvp(words)", "os.system('true')",
                  "import subprocess as sp\nsp.run(['zsh'])", "start = subprocess.Popen\nstart(['zsh'])"):
        assert undeclared(wrong), wrong
    assert not undeclared("words = [program('zsh'), '-c']\nsubprocess.run([*words, 'true'])\nos.execv(sys.executable)")


def test_tests_mirror_the_folders() -> None:
    for path in (ROOT / "tests").iterdir():
        if path.is_dir() and not path.name.startswith("_"):
            assert path.name in (*PACKAGES, "engines", "live", "bench", "fuzz", "mutants", "plugin",
                                 "device_plugin"), path
