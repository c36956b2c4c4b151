"""What is public: the names of `teleop`, `master`, `slave` and `channel`, and nothing underneath."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from teleop.scene.library import ROOT

PACKAGES = ("teleop", "master", "slave", "channel")
GROUPS = ("bench", "laws", "effects", "scenes", "estimators", "devices", "robots")  # a command, and entry points


def listed_for_type_checkers(package: str) -> dict[str, str]:
    """The names that a package imports for type checkers alone, each with its module."""
    tree = ast.parse((ROOT / package / "__init__.py").read_text(encoding="utf-8"))
    blocks = [node for node in tree.body if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"]
    return {name.name: str(node.module) for block in blocks for node in block.body
            if isinstance(node, ast.ImportFrom) for name in node.names}


@pytest.mark.parametrize("package", PACKAGES)
class TestEveryPackage:
    def test_type_checkers_and_python_find_the_same_names_in_the_same_modules(self, package: str) -> None:
        module = import_module(package)
        homes = {name: f"{package}.{home}" for home, names in module._HOMES.items() for name in names}
        assert listed_for_type_checkers(package) == homes
        assert {*module.__all__} - {"DISTRIBUTION", "__version__"} == {*homes}
        assert all(getattr(module, name) is not None for name in module.__all__)
        assert dir(module) == sorted(module.__all__)
        with pytest.raises(AttributeError, match=f"module '{package}' has no attribute 'misspelt'"):
            _ = module.misspelt

    def test_a_name_is_of_the_module_that_defines_it(self, package: str) -> None:
        module = import_module(package)
        for home, names in module._HOMES.items():
            tree = ast.parse(Path(import_module(f"{package}.{home}").__file__ or "").read_text(encoding="utf-8"))
            made = {node.name for node in tree.body if isinstance(node, ast.ClassDef | ast.FunctionDef)}
            made |= {target.id for node in tree.body if isinstance(node, ast.Assign)
                     for target in node.targets if isinstance(target, ast.Name)}
            assert {*names} <= made, home

    def test_importing_it_loads_none_of_them_and_a_tab_completes_them_alone(self, package: str) -> None:
        """`dir` hid them among what the file needs for itself."""
        code = (f"import sys, {package}\nprint(*sys.modules)\nimport rlcompleter\n"
                f"assert 'TYPE_CHECKING' not in dir({package}) and 'numpy' not in sys.modules\n"
                f"print(*filter(None, map(rlcompleter.Completer(vars()).complete, ['{package}.'] * 99, range(99))))")
        done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
        loaded, completed = (line.split() for line in done.stdout.splitlines())
        assert {name for name in loaded if name.partition(".")[0] in PACKAGES} == {package, "teleop", "teleop.version"}
        assert not {"numpy", "asyncio", "msgpack", "dataclasses"} & {*loaded}
        public = {name for name in import_module(package).__all__ if not name.startswith("_")}
        assert public == {each.removeprefix(f"{package}.").rstrip("()") for each in completed}


INNER = re.compile(rf"(?:from|import) +(?:{'|'.join(PACKAGES)})\.", re.MULTILINE)


def test_scenes_and_the_readme_import_nothing_but_public_names() -> None:
    for path in (ROOT / "scenarios").rglob("[!_]*.py"):
        assert INNER.findall(path.read_text(encoding="utf-8")) == [], path
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert INNER.findall(text) == []
    for package, name in re.findall(rf"`({'|'.join(PACKAGES)})\.([A-Za-z_]\w*)[`(]", text):
        module = import_module(package)
        assert hasattr(module, name) or name in GROUPS, name
