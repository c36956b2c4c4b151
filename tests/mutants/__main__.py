"""Apply each mutant of `mutants.toml`, or those with a word in their name or file, to a copy, and run its tests."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tomllib
from argparse import ArgumentParser
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue
from tempfile import TemporaryDirectory
from time import monotonic
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
NOT_COPIED = shutil.ignore_patterns(".*_cache", ".git", ".venv", "__pycache__", "runs", "build", "dist")


class Mutant(NamedTuple):
    """A mistake in one line, and the tests that find it."""

    name: str
    file: str
    line: str  # all of the line or a part, once in the file
    instead: str
    tests: str  # arguments of pytest, parted by blanks

    def mistaken(self, text: str) -> str:
        """The text of the file with the mistake in it. Raises `SystemExit` if the line is not there exactly once."""
        if text.count(self.line) != 1:
            raise SystemExit(f"{self.file} has {self.line!r} {text.count(self.line)} times; mend mutants.toml")
        return text.replace(self.line, self.instead)


def read() -> list[Mutant]:
    return [Mutant(**each) for each in tomllib.loads(Path(__file__).with_name("mutants.toml").read_text())["mutant"]]


def run(tree: Path, tests: str, *codes: int) -> subprocess.CompletedProcess[str]:
    """Run tests on a tree's own packages, with no kernel of another. Raises `SystemExit` if they end otherwise."""
    shutil.rmtree(tree / ".cache", ignore_errors=True)
    environment = {**os.environ, "PYTHONPATH": str(tree), "XDG_CACHE_HOME": str(tree / ".cache")}
    code = f"import sys, pytest, teleop; assert teleop.__file__.startswith({str(tree)!r}); sys.exit(pytest.main())"
    words = [sys.executable, "-c", code, "-n0", "-xq", "--tb=no", "--timeout=120", "--hypothesis-profile=mutants"]
    words += dict.fromkeys(tests.split())
    done = subprocess.run(words, cwd=tree, env=environment, capture_output=True, text=True, check=False)
    if done.returncode not in codes:
        raise SystemExit(f"pytest {tests} ended with {done.returncode}\n{done.stdout[-2000:]}{done.stderr[-2000:]}")
    return done


def is_caught(trees: SimpleQueue[Path], mutant: Mutant) -> bool:
    """True if a test fails in one of the trees with this mistake in it; afterwards the tree is as it was."""
    tree, since = trees.get(), monotonic()
    text = (tree / mutant.file).read_text()
    (tree / mutant.file).write_text(mutant.mistaken(text))
    done = run(tree, mutant.tests, 0, 1)
    (tree / mutant.file).write_text(text)
    trees.put(tree)
    print("caught  " if done.returncode else "SURVIVED", f"{monotonic() - since:5.1f} s  {mutant.name}", flush=True)
    return done.returncode == 1


def main() -> int:
    """0 if all are caught, else 1."""
    parser = ArgumentParser(prog="python -m tests.mutants", description=__doc__)
    parser.add_argument("word", nargs="*")
    parser.add_argument("-n", type=int, default=1)
    wanted = parser.parse_args()
    mutants = [each for each in read() if any(word in f"{each.name} {each.file}" for word in wanted.word or [""])]
    if not mutants:
        parser.error("no mutant has such a word in its name or file")
    trees: SimpleQueue[Path] = SimpleQueue()
    with TemporaryDirectory() as folder, ThreadPoolExecutor(wanted.n) as pool:
        for i in range(wanted.n):
            trees.put(tree := shutil.copytree(ROOT, Path(folder) / f"{i}", ignore=NOT_COPIED))
        run(tree, " ".join(each.tests for each in mutants), 0)  # without a mutant all pass
        caught = sum(pool.map(lambda mutant: is_caught(trees, mutant), mutants))
    print(f"{caught} of {len(mutants)} caught")
    return int(caught < len(mutants))


if __name__ == "__main__":
    sys.exit(main())
