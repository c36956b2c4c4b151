"""Folders of all kinds that commands leave, and hostile variants of them, to be opened by `teleop report`.

`serve` opens them in a process whose address space is limited. A case is made by a number alone, so that what failed
can be opened again: `python -c "from tests.fuzz.folders import serve; serve('FOLDER', FIRST, COUNT, 1)"`.
"""

from __future__ import annotations

import io
import json
import os
import random
import resource
import shutil
import signal
import sys
import zipfile
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout, suppress
from pathlib import Path
from struct import pack
from typing import Any

import numpy as np

from teleop.scene.library import OWN

ROOM = 3 << 30  # bytes of address space; numpy, matplotlib and their threads take 1.5 GB of it
GROWS = 400 << 20  # bytes that the resident memory may grow by in all cases together
SECONDS = 30  # that a case may take, on a machine that has other things to do
NASTY_TEXTS = (
    "\x1b]0;owned\x07\x1b[2J", "a\nstatus   ok\r", "\u202egnp", "\ud800", "\x00", "$\\frac$", "x" * 5000, "", "../../x",
    "/dev/zero", "evil.py", "./evil.py", "evil", "delay(0.1) | mahimahi('/dev/zero')", "ping_log('secret')", "nan",
    "none", "1e999", "<script>alert(1)</script>", "</style><img src=x onerror=alert(2)>", "%s%n",
    "{0.__class__}", "wave", "m", "s", "m\udcff",
)
NASTY_NUMBERS = (0, -1, 1, 2**31, 2**53, 2**63, 2**64, -(2**63), 10**30, 1e308, -1e308, 5e-324, 1e-9, 0.5, 1e9, 1e12)
NASTY: tuple[Any, ...] = (
    *NASTY_TEXTS, *NASTY_NUMBERS, None, True, False, [], {}, [[]], [None], {"": {}}, [1, "a"], {"k": 3}, ["x"] * 2000)
RAW = (b"NaN", b"-Infinity", b"1e999", b"[" * 5000, b"[" * 200 + b"]" * 200, b"9" * 5000, b'{"a":1,"a":2}', b"\xff",
       b"")
FLOATS = (float("nan"), float("inf"), -float("inf"), -1.0, -0.0, 0.5, 1e9, 1e18, 1e308, 5e-324, 999.0, 1000.0, 2.0**53)


KNOBS = ("duration", "dt", "link", "law", "motion", "up", "down", "k_e", "axes", "energy", "playout", "observer")
VALUES = ("1e5", "1e-6", "secret", "delay(0.1) | ping_log('secret')", 'mahimahi("/dev/zero")', "pfra", "direct", "none",
          "fixed:1e9", "-1", "nan", "3", "false", "\x1b[2J", "gamma(0.1, 1e9)", "duplicate(1.0)")


class Hostile:
    """Changes to a folder, drawn by `dice`. `outside`: a folder whose files must stay what they are."""

    def __init__(self, dice: random.Random, folder: Path, outside: Path) -> None:
        self.dice, self.folder, self.outside = dice, folder, outside
        self.done: list[str] = []

    def change(self) -> None:
        """One change to one file."""
        files = sorted(path for path in self.folder.rglob("*")
                       if path.is_file() and not path.is_symlink() and path.stat().st_size < 1 << 24)
        if not files:
            return
        path = self.dice.choice(files)
        makes: list[Callable[[Path], None]] = [self.bytes_of, self.kind_of, self.links_beside]
        if path.suffix in (".json", ".jsonl", ".bin"):
            makes += [self.json_of] * 8
        if path.suffix in (".json", ".bin"):
            makes += [self.scene_of] * 3
        if path.suffix == ".bin":
            makes += [self.rows_of] * 5
        if path.suffix == ".npz":
            makes += [self.arrays_of] * 6
        make = self.dice.choice(makes)
        self.done.append(f"{make.__name__} {path.name}")
        with suppress(OSError):  # where an earlier change has left a folder in place of a file
            make(path)

    def bytes_of(self, path: Path) -> None:
        """Bits flipped, bytes cut off, put in, doubled or zeroed."""
        data, dice = bytearray(path.read_bytes()), self.dice
        at, length = dice.randrange(len(data) + 1), dice.choice((1, 1, 2, 8, 100, 5000))
        way = dice.randrange(6)
        if way == 0:
            for _ in range(dice.choice((1, 3, 30))):
                if data:
                    data[dice.randrange(len(data))] ^= 1 << dice.randrange(8)
        elif way == 1:
            del data[at:]
        elif way == 2:
            del data[at : at + length]
        elif way == 3:
            data[at:at] = dice.randbytes(length)
        elif way == 4:
            data[at:at] = data[at : at + length]
        else:
            data[at : at + length] = bytes(length)
        path.write_bytes(data)

    def kind_of(self, path: Path) -> None:
        """What is no file, or another one, in its place."""
        path.unlink()
        way = self.dice.randrange(8)
        if way == 0:
            os.mkfifo(path)
        elif way == 1:
            path.mkdir()
        elif way in (2, 3):
            path.symlink_to(self.outside / self.dice.choice(("precious", "none", path.name)))
        elif way == 4:
            path.symlink_to("/dev/zero")
        elif way == 5:
            path.touch()
        elif way == 6:
            with path.open("wb") as file:
                file.truncate(1 << 40)

    def links_beside(self, path: Path) -> None:
        """Links out of the folder where `report` writes, and the summary gone, so that it does write."""
        for name in ("trace.npz", "summary.json", "plot.png", "sweep.png", "report.html", ".plot.png.part",
                     ".sweep.png.part", ".report.html.part"):
            if self.dice.random() < 0.6:
                (path.parent / name).unlink(missing_ok=True)
                if name != "summary.json" or self.dice.random() < 0.3:
                    (path.parent / name).symlink_to(self.outside / self.dice.choice(("precious", "none")))

    def scene_of(self, path: Path) -> None:
        """Another scene, or other knobs of it, in all files that name one: they are to agree."""
        scene = self.dice.choice(("evil.py", "../evil.py", "evil", "lte", "recorded_reach", "hard_wall", "rubber"))
        knobs = {self.dice.choice(KNOBS): self.dice.choice(VALUES) for _ in range(self.dice.randrange(3))}
        for each in (path, *self.folder.rglob("record.bin")):
            if each.is_symlink() or not each.is_file() or each.stat().st_size >= 1 << 24:
                continue
            head, newline, rest = each.read_bytes().partition(b"\n" if each.suffix == ".bin" else b"\0")
            with suppress(ValueError, RecursionError, TypeError, KeyError):
                held = json.loads(head)
                held["scene"] = scene if self.dice.random() < 0.5 else held["scene"]
                if each.suffix == ".bin":
                    held["knobs"] = {**held["knobs"], **knobs}
                each.write_bytes(json.dumps(held).encode() + newline + rest)

    def json_of(self, path: Path) -> None:
        """Another value, name or text of JSON somewhere in a file of JSON, or in a line of one."""
        data = path.read_bytes()
        lines = [data] if path.suffix == ".json" else data.split(b"\n", 1 if path.suffix == ".bin" else -1)
        i = 0 if path.suffix == ".bin" else self.dice.randrange(len(lines))
        with suppress(ValueError, RecursionError, IndexError):
            lines[i] = self._other(json.loads(lines[i]), lines[i])
        if path.suffix == ".jsonl" and self.dice.random() < 0.2:
            lines.insert(self.dice.randrange(len(lines) + 1), self.dice.choice(lines))
        path.write_bytes(b"\n".join(lines))

    def _other(self, value: Any, line: bytes) -> bytes:
        dice, holder = self.dice, [value]
        at: Any = holder
        key: Any = 0
        while isinstance(at[key], dict | list) and at[key] and dice.random() < dice.choice((0.6, 1.0)):
            at = at[key]
            key = dice.choice(sorted(at) if isinstance(at, dict) else range(len(at)))
        way = dice.randrange(6)
        if way == 0 and isinstance(at, dict):
            del at[key]
        elif way == 1 and isinstance(at, dict):
            at[dice.choice(NASTY_TEXTS)] = at.pop(key)
        elif way == 2:
            at[key] = "RAW"
            return json.dumps(holder[0]).encode().replace(b'"RAW"', dice.choice(RAW), 1)
        elif way == 3 and isinstance(at, dict):
            other = json.dumps({key: dice.choice(NASTY)}).encode()
            return line.replace(b"{", other[:-1] + b", ", 1) if b"{" in line else line  # a name twice
        else:
            at[key] = dice.choice(NASTY)
        return json.dumps(holder[0]).encode()

    def rows_of(self, path: Path) -> None:
        """Other numbers in the rows of a record, most of all in its ticks."""
        head, _, body = path.read_bytes().partition(b"\n")
        rows, width = bytearray(body), 10
        with suppress(ValueError, TypeError, KeyError, RecursionError):
            width = len(json.loads(head)["columns"]) or 1
        for _ in range(self.dice.choice((1, 1, 5))):
            count = len(rows) // (8 * width)
            if count:
                row = self.dice.choice((0, count - 1, self.dice.randrange(count)))
                column = self.dice.randrange(width + 3)
                place = 8 * (row * width + (column if column < width else 0))
                rows[place : place + 8] = pack("<d", self.dice.choice((*FLOATS, float(row), row * 1e6)))
        path.write_bytes(head + b"\n" + rows)

    def arrays_of(self, path: Path) -> None:
        """Another archive of arrays: of other types, shapes, names and values, or one that inflates."""
        dice = self.dice
        try:
            with np.load(path, allow_pickle=False) as held:
                arrays = dict(held)
        except Exception:  # an earlier change has left no archive
            return
        name = dice.choice(sorted(arrays))
        column = arrays[name]
        way = dice.randrange(10)
        if way == 0:
            del arrays[name]
        elif way == 1:
            arrays[name] = column[: len(column) // 2]
        elif way == 2:
            arrays[name] = np.array([object(), None], dtype=object)
        elif way == 3:
            arrays[name] = column.astype(dice.choice(("f4", "c16", "U8", "i1", ">f8", "f2", "?", "m8[s]")))
        elif way == 4:
            arrays[name] = np.repeat(column.reshape(len(column), -1), dice.choice((1, 3, 17)), axis=1)
        elif way == 5 and len(column):
            changed = column.astype(float)
            changed.ravel()[dice.randrange(changed.size)] = dice.choice(FLOATS)
            arrays[name] = changed
        elif way == 6:
            arrays[name] = np.full(column.shape, dice.choice(FLOATS))
        elif way == 7:
            arrays[dice.choice(("x" * 300, "../evil", "t\x1b[2J", "E_link", "x_s"))] = column
        elif way == 8:
            head = io.BytesIO()
            np.lib.format.write_array_header_1_0(
                head, {"descr": "<f8", "fortran_order": False, "shape": (dice.choice((10**8, 10**18, len(column))),)})
            with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
                archive.writestr("t.npy", head.getvalue() + bytes(dice.choice((0, 10, 2 * 10**7))))
            return
        dice.choice((np.savez, np.savez_compressed))(path, **arrays)


def serve(folder: str, first: int, count: int, draw_each: int) -> None:
    """Open the cases `first` .. of the folders in `folder`; a line of JSON for each that came to no good end.

    One in `draw_each` is drawn, too.
    """
    from teleop.__main__ import main

    resource.setrlimit(resource.RLIMIT_AS, (ROOM, ROOM))
    place = Path(folder)
    kinds = sorted(path.name for path in (place / "sound").iterdir())
    os.chdir(place)
    with redirect_stdout(io.StringIO()):
        main(["report", str(place / "sound" / kinds[0]), "--plot"])  # what is imported is no matter of a case
    (place / "sound" / kinds[0] / "report.html").unlink()
    began = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10
    for number in range(first, first + count):
        troubles = _opened(main, place, kinds[number % len(kinds)], number, draw_each)
        used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10
        if used - began > GROWS:
            troubles.append(f"memory grew by {used - began >> 20} MB")
            began = used
        for trouble in troubles:
            print(json.dumps({"case": number, "kind": kinds[number % len(kinds)], "trouble": trouble}), flush=True)
    print("done", flush=True)


def _opened(  # noqa: PLR0912 (a branch for each thing that may go wrong)
    main: Callable[[Any], int], place: Path, kind: str, number: int, draw_each: int
) -> list[str]:
    """One case; what went wrong with it."""
    dice, outside = random.Random(number), place / "outside"
    case = place / "case"
    shutil.rmtree(case, ignore_errors=True)
    shutil.copytree(place / "sound" / kind, case)
    before = _contents(outside)
    hostile = Hostile(dice, case, outside)
    for _ in range(dice.choice((1, 1, 1, 2, 4))):
        hostile.change()
    words = ["report", str(case)]
    if kind == "ends" and dice.random() < 0.7:
        words = ["report", str(case / "master"), str(case / "slave"), "--out", str(case / "new")]
    words += ["--json"] * (dice.random() < 0.2) + ["--plot"] * (number % draw_each == 0)
    out, err = io.StringIO(), io.StringIO()
    signal.alarm(SECONDS)
    try:
        with redirect_stdout(out), redirect_stderr(err):
            code: Any = main(words)
    except BaseException as error:  # whatever it is, it is told
        code = f"{type(error).__name__}: {error}"[:500]
    finally:
        signal.alarm(0)
    said = out.getvalue() + err.getvalue()
    troubles = []
    if code not in (0, 2):
        troubles.append(f"it came to {code}")
    if code == 2 and (err.getvalue().count("\n") != 1 or not err.getvalue().startswith("teleop: ")):
        troubles.append(f"it is not refused in one sentence: {err.getvalue()[:300]!r}")
    if code == 0 and (err.getvalue() or not out.getvalue()):
        troubles.append(f"it said {err.getvalue()[:300]!r} beside its table")
    if not all(line.isprintable() for line in said.split("\n")):
        troubles.append("it gave the terminal orders")
    if "Memory" in said or "out of memory" in said:
        troubles.append(f"it ran out of memory: {said[-300:]}")
    for page in case.glob("report*.html"):
        written = page.is_file() and not page.is_symlink() and page.stat().st_size < 1 << 24
        if written and any(begin in page.read_bytes() for begin in (b"<script", b"<img", b"\x1b")):
            troubles.append("a text became markup in its page")
    if _contents(outside) != before or (place / "ran").exists():
        troubles.append("it touched what is outside")
        (place / "ran").unlink(missing_ok=True)
    odd = [name for name in sys.modules if name.startswith(OWN)]
    if odd:
        troubles.append(f"it ran {odd}")
    return [f"{trouble} ({', '.join(hostile.done)}; {' '.join(words)})" for trouble in troubles]


def _contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}
