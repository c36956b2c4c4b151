"""A sweep's folder survives being killed at any byte, and never takes another sweep's place."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise, product
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop import Refused
from teleop.sweeps.store import RowNumbers, Store

WHAT: dict[str, Any] = {
    "scene": "soft_tissue", "fixed": {"duration": "1.0"},
    "grid": {"axes": [{"knobs": ["delay"], "values": [0.0, 0.1]}, {"knobs": ["law"], "values": ["wave", "pfra"]}],
             "seeds": {"first": 0, "step": 1, "count": 30_000}},
    "metrics": ["x_err_rms"], "version": "0.1.0",
}


def row(number: int, **more: object) -> dict[str, Any]:
    return {"row": number, "seed": number % 3, "delay": 0.1 * number, "law": "wäve", "status": "ok", "ticks": 1000,
            "x_err_rms": 1.0 / (3.0 + number), **more}


def filled(folder: Path, count: int = 3) -> Path:
    with Store.open(folder, WHAT) as store:
        store.append(row(number) for number in range(count))
    return folder


class TestAFolder:
    def test_is_made_with_the_definition_and_keeps_what_is_appended(self, tmp_path: Path) -> None:
        with Store.open(tmp_path / "a" / "b", WHAT) as store:
            assert store.definition == WHAT
            assert len(store.done) == 0
            store.append([row(4), row(1)])
            assert list(store.done) == [1, 4]
        assert sorted(path.name for path in (tmp_path / "a" / "b").iterdir()) == ["rows.jsonl", "sweep.json"]
        assert [path.name for path in (tmp_path / "a").iterdir()] == ["b"]
        with Store.open(tmp_path / "a" / "b", WHAT) as again:
            assert list(again.done) == [1, 4]
            assert 4 in again.done
            assert 3 not in again.done
            assert list(again.rows()) == [row(4), row(1)]

    def test_makes_the_same_table_whatever_order_the_rows_finished_in(self, tmp_path: Path) -> None:
        order = np.random.default_rng(1).permutation(200).tolist()
        with Store.open(tmp_path / "s", WHAT) as store:
            for at in range(0, 200, 7):
                store.append([row(number) for number in order[at:at + 7]])
                assert (tmp_path / "s" / "rows.jsonl").read_bytes().count(b"\n") == min(at + 7, 200)  # on disk at once
            assert [got["row"] for got in store.rows()] == order
            assert list(store.table()) == [row(number) for number in range(200)]

    def test_keeps_the_first_of_twins_also_of_those_in_the_file(self, tmp_path: Path) -> None:
        path = tmp_path / "s" / "rows.jsonl"
        with Store.open(tmp_path / "s", WHAT) as store:
            store.append([row(1, x_err_rms=1.0), row(1, x_err_rms=2.0)])
            store.append([row(1, x_err_rms=3.0), row(2)])
            assert list(store.rows()) == [row(1, x_err_rms=1.0), row(2)]
        whole = path.read_bytes()
        assert whole.count(b"\n") == 2
        path.write_bytes(whole + json.dumps(row(1, x_err_rms=9.0)).encode() + b"\n")
        assert list(Store.look(tmp_path / "s").rows()) == [row(1, x_err_rms=1.0), row(2)]
        Store.open(tmp_path / "s", WHAT).close()
        assert path.read_bytes() == whole

    def test_goes_on_in_a_folder_that_was_empty(self, tmp_path: Path) -> None:
        (tmp_path / ".sweep.json.7-0.part").write_text('{"sce')  # as a kill may have left it
        assert list(Store.look(filled(tmp_path)).done) == [0, 1, 2]

    def test_is_json_that_others_read(self, tmp_path: Path) -> None:
        with Store.open(tmp_path / "s", {**WHAT, "limit": float("inf")}) as store:
            store.append([row(0, k_e=np.float64(2.5), n=np.int64(7), f_max=float("inf"), law=Path("a") / "b",
                              x_err_rms=float("nan"), link=(1, 2.0, None))])

        def never(word: str) -> None:
            pytest.fail(f"{word} is no JSON")

        (line,) = (tmp_path / "s" / "rows.jsonl").read_text("ascii").splitlines()
        got = json.loads(line, parse_constant=never)
        assert "x_err_rms" not in got
        assert (got["k_e"], got["n"], got["f_max"], got["law"], got["link"]) == (2.5, 7, "inf", "a/b", [1, 2.0, None])
        json.loads((tmp_path / "s" / "sweep.json").read_text("ascii"), parse_constant=never)
        Store.open(tmp_path / "s", {**WHAT, "limit": float("inf")}).close()

    def test_gives_every_float_back_to_the_last_bit(self, tmp_path: Path) -> None:
        values = np.random.default_rng(2).integers(0, 2**63, 300, dtype=np.int64).view(np.float64)
        finite = [v for v in values.tolist() if np.isfinite(v)]
        with Store.open(tmp_path / "s", WHAT) as store:
            store.append(row(i, x_err_rms=v) for i, v in enumerate(finite))
            assert [got["x_err_rms"] for got in store.rows()] == finite

    def test_becomes_a_table_with_the_knobs_and_metrics_of_the_definition(self, tmp_path: Path) -> None:
        with Store.open(tmp_path / "s", WHAT) as store:
            assert len(store.table()) == 0
            store.append([row(2), {"row": 0, "seed": 0, "delay": 0.0, "law": "pfra", "status": "refused", "ticks": 0,
                                   "sentence": "no"}])
            table = store.table()
        assert (table.knobs, table.metrics) == (("delay", "law"), ("x_err_rms",))
        assert list(table["law"]) == ["pfra", "wäve"]
        np.testing.assert_array_equal(table["x_err_rms"], [np.nan, 0.2])


class TestAfterAKill:
    def test_a_last_line_torn_at_any_byte_is_cut_off_and_the_row_is_done_again(self, tmp_path: Path) -> None:
        whole = (filled(tmp_path / "s") / "rows.jsonl").read_bytes()
        begins = whole[:-1].rfind(b"\n") + 1
        for size in range(begins, len(whole)):
            (tmp_path / "s" / "rows.jsonl").write_bytes(whole[:size])
            looked = Store.look(tmp_path / "s")
            assert list(looked.done) == [0, 1]
            assert list(looked.rows()) == [row(0), row(1)]
            assert (tmp_path / "s" / "rows.jsonl").stat().st_size == size  # looking changes nothing
            Store.open(tmp_path / "s", WHAT).close()
            assert (tmp_path / "s" / "rows.jsonl").read_bytes() == whole[:begins]
            (tmp_path / "s" / "rows.jsonl").write_bytes(whole[:size])
            with Store.open(tmp_path / "s", WHAT) as store:
                assert list(store.done) == [0, 1]
                store.append([row(2)])
            assert (tmp_path / "s" / "rows.jsonl").read_bytes() == whole

    def test_a_line_that_a_disk_spoiled_is_dropped_and_no_other(self, tmp_path: Path) -> None:
        for n, bad in enumerate((
                b"\x00" * 40, b'{"row":7,"x{"row":8,"x":1}', b"\xff\xfe", b"", b"[1]", b"3", b'{"row":-1}',
                b'{"row":true}', b'{"x":1}', b"[" * 100_000)):
            path = filled(tmp_path / str(n)) / "rows.jsonl"
            first, *rest = path.read_bytes().splitlines(keepends=True)
            path.write_bytes(first + bad + b"\n" + b"".join(rest) + b"{")
            assert list(Store.look(path.parent).rows()) == [row(0), row(1), row(2)], bad
            with Store.open(path.parent, WHAT) as store:
                assert list(store.done) == [0, 1, 2], bad
                store.append([row(3)])
            lines = path.read_bytes().splitlines(keepends=True)
            assert lines[:3] == [first, *rest], bad
            assert [json.loads(line)["row"] for line in lines] == [0, 1, 2, 3], bad

    @pytest.mark.live
    def test_a_writer_killed_again_and_again_comes_to_the_end_with_no_row_lost_or_doubled(self, tmp_path: Path) -> None:
        """`kill -9` at arbitrary moments: what was reported as appended is there afterwards."""
        code = (
            "import json, sys; from teleop.sweeps.store import Store\n"
            "with Store.open(sys.argv[1], json.loads(sys.argv[2])) as store:\n"
            "    todo = [n for gap in store.done.gaps(12000) for n in gap]\n"
            "    for at in range(0, len(todo), 40):\n"
            "        store.append({'row': n, 'text': 'x' * (n % 997)} for n in todo[at:at + 40])\n"
            "        print(todo[at + 39], flush=True)\n"
        )
        folder, killed = tmp_path / "s", 0
        for reports in range(25, 2000, 60):
            with subprocess.Popen([sys.executable, "-c", code, str(folder), json.dumps(WHAT)], text=True,
                                  stdout=subprocess.PIPE) as writer:
                assert writer.stdout is not None
                said = []
                for line in writer.stdout:
                    said.append(int(line))
                    if len(said) == reports:
                        writer.send_signal(signal.SIGKILL)
                        break
                said += [int(line) for line in writer.stdout if line.endswith("\n")]
            killed += writer.returncode == -signal.SIGKILL
            done = Store.look(folder).done
            assert all(number in done for number in said)
            if len(done) == 12000:
                break
        assert killed >= 2
        assert list(done.gaps(12000)) == []
        numbers = [json.loads(line)["row"] for line in (folder / "rows.jsonl").read_bytes().splitlines()]
        assert sorted(numbers) == list(range(12000))

    def test_a_definition_is_whole_before_its_folder_is(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        def interrupted(*_: object) -> None:
            raise KeyboardInterrupt

        monkeypatch.setattr(os, "fsync", interrupted)
        with pytest.raises(KeyboardInterrupt):
            Store.open(tmp_path / "s", WHAT)
        assert not list(tmp_path.iterdir())


class TestAnInterruptOrAFullDisk:
    class Short:
        """A file that takes some bytes and then no more."""

        def __init__(self, file: Any, takes: int, trouble: BaseException) -> None:
            self.file, self.takes, self.trouble = file, takes, trouble

        def write(self, data: memoryview) -> int:
            if self.takes == 0:
                raise self.trouble
            count: int = self.file.write(data[:min(self.takes, 10)])
            self.takes -= count
            return count

        def __getattr__(self, name: str) -> Any:
            return getattr(self.file, name)

    def test_in_the_middle_of_a_write_leaves_what_was_there_before(self, tmp_path: Path) -> None:
        full = OSError(errno.ENOSPC, "No space left on device")
        with Store.open(tmp_path / "s", WHAT) as store:
            store.append([row(0)])
            before, own = (tmp_path / "s" / "rows.jsonl").read_bytes(), store._file
            for takes, trouble in product((0, 1, 10, 97, 150), (full, KeyboardInterrupt())):
                store._file = self.Short(own, takes, trouble)
                with pytest.raises((Refused, KeyboardInterrupt)) as caught:
                    store.append([row(1), row(2)])
                if trouble is full:
                    assert "No space left" in str(caught.value)
                    assert "type the same command again" in str(caught.value)
                assert (tmp_path / "s" / "rows.jsonl").read_bytes() == before, (takes, trouble)
                assert list(store.done) == [0], (takes, trouble)
            store._file = own
            store.append([row(1)])
            assert list(store.rows()) == [row(0), row(1)]

    def test_after_the_write_takes_back_marks_and_lines(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        add = RowNumbers._add

        def interrupted(done: RowNumbers, number: int) -> None:
            if number == 1:
                raise KeyboardInterrupt
            add(done, number)

        with Store.open(tmp_path / "s", WHAT) as store:
            monkeypatch.setattr(RowNumbers, "_add", interrupted)
            with pytest.raises(KeyboardInterrupt):
                store.append([row(1), row(2), row(3)])
            monkeypatch.undo()
            assert list(store.done) == []
            assert len(store.done) == 0
            store.append([row(2)])
            assert list(store.rows()) == [row(2)]

    def test_writes_that_the_system_takes_in_pieces_are_finished(self, tmp_path: Path) -> None:
        with Store.open(tmp_path / "s", WHAT) as store:
            store._file = self.Short(store._file, 10_000, AssertionError())
            store.append([row(1), row(2)])
            assert list(store.rows()) == [row(1), row(2)]


def changed(values: list[float], **more: object) -> dict[str, Any]:
    axes = [{"knobs": ["delay"], "values": values}, WHAT["grid"]["axes"][1]]
    return {**WHAT, "grid": {**WHAT["grid"], "axes": axes}, **more}


class TestAnotherSweep:
    DIFFERENT: ClassVar[list[tuple[dict[str, Any], str]]] = [
        ({**WHAT, "scene": "canonical"}, 'scene is "soft_tissue" there and "canonical" here'),
        ({**WHAT, "fixed": {"duration": "2.0"}}, 'sweep: duration is "1.0" there and "2.0" here'),
        ({**WHAT, "fixed": {}}, 'sweep: duration is "1.0" there and absent here'),
        (changed([0.0, 0.2]), "value 2 of delay is 0.1 there and 0.2 here"),
        (changed([0.0, 0.2], version="9"), "value 2 of delay is 0.1 there and 0.2 here"),
        (changed([0.0]), "the list of values of delay is [0.0,0.1] (2 values) there and [0.0] (1 value) here"),
        ({**WHAT, "more": None}, "more is absent there and null here"),
        ({name: value for name, value in WHAT.items() if name != "version"},
         'version is "0.1.0" there and absent here'),
    ]

    def test_is_refused_with_the_first_difference(self, tmp_path: Path) -> None:
        before = (filled(tmp_path / "s") / "rows.jsonl").read_bytes()
        for other, said in self.DIFFERENT:
            with pytest.raises(Refused, match="holds another sweep") as caught:
                Store.open(tmp_path / "s", other)
            assert said in str(caught.value)
            assert f"write --out '{tmp_path / 's'}-1', or" in str(caught.value)
            assert (tmp_path / "s" / "rows.jsonl").read_bytes() == before, said

    def test_is_not_what_only_looks_different(self, tmp_path: Path) -> None:
        filled(tmp_path / "s")
        for same in (dict(reversed(WHAT.items())), {**WHAT, "metrics": ("x_err_rms",)}, changed([0, np.float64(0.1)])):
            with Store.open(tmp_path / "s", same) as store:
                assert len(store.done) == 3, same
        Store.open(tmp_path / "t", {"energy": 1}).close()
        with pytest.raises(Refused, match="energy is 1 there and true here"):
            Store.open(tmp_path / "t", {"energy": True})

    def test_with_a_long_axis_is_told_in_a_sentence(self, tmp_path: Path) -> None:
        Store.open(tmp_path / "s", {"values": list(range(1000))}).close()
        with pytest.raises(Refused, match=r"\(1000 values\)") as caught:
            Store.open(tmp_path / "s", {"values": list(range(1001))})
        assert len(str(caught.value)) < 400 + 2 * len(str(tmp_path))


def of_others(content: str, name: str = "sweep.json") -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        folder.mkdir()
        (folder / name).write_text(content)

    return make


class TestAFolderOfSomethingElse:
    def test_is_refused_and_left_as_it_is(self, tmp_path: Path) -> None:
        makers: tuple[Callable[[Path], Any], ...] = (
            of_others("x", "thesis.tex"), Path.touch, lambda folder: folder.symlink_to("nowhere"),
            of_others("method: bayes"), of_others("[]"), of_others('{"sce'), of_others('{"method": "grid"}'),
            lambda folder: (folder / "sweep.json").mkdir(parents=True))
        for n, make in enumerate(makers):
            folder = tmp_path / str(n) / "s"
            folder.parent.mkdir()
            make(folder)
            before = sorted((path, path.is_file() and path.read_bytes()) for path in folder.parent.rglob("*"))
            with pytest.raises(Refused, match=r"holds (no|another) sweep|cannot write") as caught:
                pytest.fail(f"{n}: {Store.open(folder, WHAT)}")
            assert "--out" in str(caught.value), n
            assert sorted((path, path.is_file() and path.read_bytes()) for path in folder.parent.rglob("*")) == before
        for folder in (tmp_path, tmp_path / "not there"):  # nor can it be looked at
            with pytest.raises(Refused, match="holds no sweep"):
                Store.look(folder)


@contextmanager
def anybody() -> Iterator[None]:
    """Without the rights of root, whom no file mode stops."""
    root = os.geteuid() == 0
    if root:
        os.seteuid(65534)
    try:
        yield
    finally:
        if root:
            os.seteuid(0)


@pytest.mark.skipif(sys.platform == "win32", reason="a folder's mode stops nobody there")
class TestAReadOnlyFolder:
    @pytest.fixture(autouse=True)
    def here(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.chdir(tmp_path)  # so that nobody has to be let through the folders above
        tmp_path.chmod(0o755)

    def test_is_refused_before_anything_is_run(self) -> None:
        Path("full").mkdir(mode=0o555)
        for folder in ("full", "full/s"):
            with anybody(), pytest.raises(Refused, match=r"cannot write to .*Permission denied.*--out"):
                Store.open(folder, WHAT)
        assert not list(Path("full").iterdir())

    def test_of_a_sweep_can_be_looked_at(self) -> None:
        path = filled(Path("s")) / "rows.jsonl"
        with path.open("ab") as file:
            file.write(b'{"row":3')
        for name, mode in ((path, 0o444), (Path("s/sweep.json"), 0o444), (Path("s"), 0o555)):
            name.chmod(mode)
        with anybody():
            store = Store.look("s")
            assert list(store.rows()) == [row(0), row(1), row(2)]
            with pytest.raises(Refused, match="cannot write to s"):
                Store.open("s", WHAT)
        with pytest.raises(Refused, match="opened to be read"):
            store.append([row(3)])


@pytest.mark.skipif(sys.platform == "win32", reason="files are not locked there")
class TestTwoWriters:
    def test_the_second_is_refused_until_the_first_has_closed(self, tmp_path: Path) -> None:
        first = Store.open(tmp_path / "s", WHAT)
        with pytest.raises(Refused, match="another process is writing"):
            Store.open(tmp_path / "s", WHAT)
        first.append([row(0)])
        assert list(Store.look(tmp_path / "s").rows()) == [row(0)]  # a reader may come meanwhile
        with pytest.raises(Refused, match="another process is writing"):
            Store.open(tmp_path / "s", WHAT)
        first.close()
        Store.open(tmp_path / "s", WHAT).close()

    CHILD = """
import json, sys
from pathlib import Path
from teleop.sweeps.store import Store
from teleop.errors import Refused

for turn in sys.stdin:  # all start at the same line
    folder, definition = turn.split(" ", 1)
    try:
        store = Store.open(folder, json.loads(definition))
        print(store.definition["scene"], flush=True)
        sys.stdin.readline()
        store.close()
    except Refused as refused:
        print("refused:", refused, flush=True)
        sys.stdin.readline()
"""

    def test_of_many_that_start_at_once_one_writes_its_own_definition(self, tmp_path: Path) -> None:
        root = str(Path(__file__).resolve().parents[3])
        children = [
            subprocess.Popen([sys.executable, "-c", self.CHILD], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                             text=True, env={**os.environ, "PYTHONPATH": root})
            for _ in range(4)
        ]
        try:
            for turn in range(20):
                folder = tmp_path / f"s{turn}"
                if turn % 2:  # one that is there and empty
                    folder.mkdir()
                said = self.ask(children, [f"{folder} {json.dumps({**WHAT, 'scene': str(i)})}" for i in range(4)])
                winners = [(i, one) for i, one in enumerate(said) if not one.startswith("refused:")]
                assert [one for _, one in winners] == [str(i) for i, _ in winners]
                assert len(winners) == 1, said
                assert Store.look(folder).definition["scene"] == winners[0][1]
                assert {*os.listdir(folder)} == {"rows.jsonl", "sweep.json"}
                for child in children:
                    self.tell(child, "close")
        finally:
            for child in children:
                child.kill()
                child.communicate()

    @staticmethod
    def tell(child: subprocess.Popen[str], line: str) -> None:
        child.stdin.write(line + "\n")
        child.stdin.flush()

    def ask(self, children: list[subprocess.Popen[str]], lines: list[str]) -> list[str]:
        for child, line in zip(children, lines, strict=True):
            self.tell(child, line)
        return [child.stdout.readline().strip() for child in children if child.stdout is not None]


class TestDone:
    @given(st.sets(st.one_of(st.integers(0, 70), st.integers(0, 5000))), st.lists(st.integers(0, 200), max_size=4),
           st.integers(0, 200))
    def test_is_the_set_of_numbers_and_knows_what_is_missing(self, some: set[int], runs: list[int], stop: int) -> None:
        numbers = some.union(*(range(begin, begin + 30) for begin in runs))  # whole bytes of ones too
        done = RowNumbers()
        for number in [*numbers, *numbers]:
            done._add(number)
        assert set(done) == numbers
        assert len(done) == len(numbers)
        assert {n for n in range(-3, 6000) if n in done} == numbers
        gaps = list(done.gaps(stop))
        assert [n for gap in gaps for n in gap] == [n for n in range(stop) if n not in numbers]
        assert all(gap and a.stop < gap.start for a, gap in pairwise(gaps))

    def test_of_many_rows_is_small(self) -> None:
        done = RowNumbers()
        for number in range(200_000):
            done._add(number)
        done._add(10_000_000)
        assert sum(map(len, done._pages.values())) < 26_000
        assert list(done.gaps(10_000_001)) == [range(200_000, 10_000_000)]
