"""What a row of a sweep costs with a law of a plug-in, and of a file of one's own, over one with a built-in law.

All three are the lines of `teleop.laws.wave`: the built-in law itself, a copy in a package with an entry point, and a
copy in a file. The rows are so short that what is done for each of them, the law looked up among it, is most of it.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import invalidate_caches
from pathlib import Path
from tempfile import TemporaryDirectory

from teleop.scene.library import ROOT
from teleop.sweeps.runner import sweep

Row = tuple[str, str, str]
ROWS = {"plain": 300, "vector": 3000}
TICKS = 50
ASKED = "asked: at most 1.1"


def own_laws(rounds: int) -> list[Row]:
    """Rows of (what, measured, asked)."""
    rows: list[Row] = []
    with TemporaryDirectory() as folder, _copies(Path(folder)) as (plug_in, file):
        names = {"built in": "wave", "of a plug-in": plug_in, "of a file": file}
        for engine, count in ROWS.items():
            if engine != "plain":
                from teleop.sweeps.kernels.compiled import need_numba

                need_numba(engine)
            for law in names.values():
                _swept(engine, law, 8)  # compiles
            spent: dict[str, list[float]] = {name: [] for name in names}
            for _ in range(rounds):
                for name, law in names.items():  # in turn
                    spent[name].append(_swept(engine, law, count) / count)
            rows += _told(engine, spent)
    return rows


def _told(engine: str, spent: dict[str, list[float]]) -> list[Row]:
    best = {name: min(each) for name, each in spent.items()}  # what else the machine does only adds to them
    own = best.pop("built in")
    rows: list[Row] = [(f"{engine}, a row of {TICKS} ticks, law built in", f"{own * 1e6:.0f} us", "")]
    return rows + [(f"  law {name}, over it", f"{each / own:.2f} times", ASKED) for name, each in best.items()]


def _swept(engine: str, law: str, rows: int) -> float:
    """Processor time (s) of a sweep of soft tissue over its stiffness."""
    began = time.process_time()
    sweep("soft_tissue", {"law": [law], "k_e": [100.0 + n for n in range(rows)]}, engine=engine, workers=1,
          fixed={"duration": 1e-3 * TICKS})
    return time.process_time() - began


@contextmanager
def _copies(folder: Path) -> Iterator[tuple[str, str]]:
    """The law's lines in a package that is found by its entry point, and in a file: what each is named in a sweep."""
    source = (ROOT / "teleop" / "laws" / "wave.py").read_text(encoding="utf-8")
    (folder / "bench_waves.py").write_text(source, encoding="utf-8")
    (folder / "waves_of_a_file.py").write_text(source, encoding="utf-8")
    told = folder / "bench_waves-1.0.dist-info"
    told.mkdir()
    (told / "METADATA").write_text("Metadata-Version: 2.1\nName: bench-waves\nVersion: 1.0\n", encoding="utf-8")
    (told / "entry_points.txt").write_text("[teleop.laws]\nbench_waves = bench_waves:Wave\n", encoding="utf-8")
    sys.path.append(str(folder))
    invalidate_caches()
    try:
        yield "bench_waves", f"{folder / 'waves_of_a_file.py'}:Wave"
    finally:
        sys.path.remove(str(folder))
