"""The list of mutants follows the code: each line is there once, its mistake compiles, and its tests exist."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from tests.mutants.__main__ import ROOT, Mutant, read

MUTANTS = read()


@pytest.mark.parametrize("mutant", MUTANTS, ids=[each.name for each in MUTANTS])
def test_a_mutant_is_one_line_that_is_there_once_and_its_tests_exist(mutant: Mutant) -> None:
    text = (ROOT / mutant.file).read_text()
    mistaken = mutant.mistaken(text)
    compile(mistaken, mutant.file, "exec")
    assert ast.dump(ast.parse(mistaken)) != ast.dump(ast.parse(text)), "it changes nothing but blanks or a comment"
    assert mutant.tests.split()
    for words in mutant.tests.split():
        file, *nodes = words.partition("[")[0].split("::")
        assert (ROOT / file).is_file(), file
        names = {node.name for node in ast.walk(ast.parse((ROOT / file).read_text()))
                 if isinstance(node, ast.FunctionDef | ast.ClassDef)}
        assert {*nodes} <= names, words


def test_there_are_sixty_of_them_by_sixty_names_in_every_room() -> None:
    assert len({each.name for each in MUTANTS}) == len(MUTANTS) >= 60
    rooms = {path.name for path in (ROOT / "teleop").iterdir() if (path / "__init__.py").is_file()} - {"bench"}
    files = [Path(each.file).parts for each in MUTANTS]
    assert rooms | {"master", "slave", "channel"} <= {parts[1] if parts[0] == "teleop" else parts[0] for parts in files}
