"""Sweeps on a cluster: a real scheduler and its workers as processes on loopback, some of which are killed."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from teleop import Refused, Result, sweep
from teleop.scene.library import ROOT
from teleop.sweeps import cluster
from teleop.sweeps.chunk import Job
from teleop.sweeps.cluster import answer, connected, digest_of, files_of, parse_address, sources
from teleop.sweeps.runner import carry_out, plan_sweep
from tests.programs import COMPILERS, program
from tests.waiting import PATIENCE, until

pytestmark = pytest.mark.live

AXES: dict[Any, Any] = {"law": ["wave", "direct", "pfra"], "k_e": [100.0, 400.0]}
FIXED = {"duration": 0.3, "link": "delay(0.01) | uniform(0.02) | bernoulli(0.1)"}
LONG: dict[Any, Any] = {"k_e": [100.0, 400.0]}  # with 60 seeds long enough to kill something meanwhile
ENV = {"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin", "OPENBLAS_NUM_THREADS": "1",
       "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0"}  # a chunk is given up when one worker has died of it
OWN = """
from scenarios.soft_tissue import scene as tissue


def scene(*, k_e: float = 300.0, duration: float = 0.2):
    return tissue(k_e=k_e, duration=duration)
"""


@cache
def near_rows() -> list[dict[str, Any]]:
    """The rows of `LONG` by threads."""
    return [*sweep("soft_tissue", LONG, seeds=60, fixed=FIXED)]


def lines(folder: Path) -> list[int]:
    return [json.loads(line)["row"] for line in (folder / "rows.jsonl").read_text().splitlines()]


class Rig:
    """A scheduler and the workers that are started for it, each a process."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.processes = folder, []  # of Popen
        told = folder / "scheduler.json"
        self.scheduler = self.start("scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(told))
        until(lambda: told.is_file() and told.read_text().endswith("}"))
        self.address: str = json.loads(told.read_text())["address"]
        from distributed import Client

        self.client = Client(self.address, set_as_default=False)

    def start(self, role: str, *words: str, **env: str) -> subprocess.Popen[bytes]:
        log = (self.folder / f"{role}{len(self.processes)}.log").open("wb")
        started = subprocess.Popen([sys.executable, "-m", f"distributed.cli.dask_{role}", "--no-dashboard", *words],
                                   cwd=self.folder, env={**ENV, **env}, stdout=log, stderr=log)
        self.processes.append(started)
        return started

    def workers(self, number: int, **env: str) -> None:
        words = self.address, "--no-nanny", "--nthreads", "1", "--local-directory", str(self.folder)
        wanted = len(self.client.nthreads()) + number
        for _ in range(number):
            self.start("worker", *words, **env)
        until(lambda: len(self.client.nthreads()) == wanted)

    def kill_workers(self) -> None:
        """Leave the scheduler without a worker."""
        for process in self.processes[1:]:
            process.kill()
        until(lambda: not self.client.nthreads())

    def tasks(self) -> int:
        return int(self.client.run_on_scheduler(lambda dask_scheduler: len(dask_scheduler.tasks)))

    def end(self) -> None:
        self.client.close(timeout=1)
        for process in self.processes:
            process.kill()
            process.wait()


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    """A scheduler that gives a chunk up as soon as one worker has died of it, and two workers."""
    made = Rig(tmp_path_factory.mktemp("rig"))
    made.workers(2)
    yield made
    made.end()


def typed(folder: Path, *words: str) -> subprocess.Popen[str]:
    """`teleop sweep WORDS`, begun in a process of its own."""
    return subprocess.Popen([sys.executable, "-m", "scenarios", "sweep", *words], cwd=folder, text=True, env=ENV,
                            stdout=subprocess.PIPE, stderr=subprocess.PIPE)


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Chunks of a few rows, so that many are under way one after another."""
    monkeypatch.setattr("teleop.sweeps.runner.CHUNK", 0.01)


class Killer:
    """Kills a worker while it holds a chunk, once some rows have come."""

    def __init__(self, rig: Rig) -> None:
        self.rig, self.pids, self.held = rig, rig.client.run(os.getpid), 0

    def __call__(self, done: int, _: int) -> None:
        if self.held or done < 6:
            return
        worker, pid = max(self.pids.items())
        os.kill(pid, signal.SIGSTOP)  # what it holds now it cannot finish
        time.sleep(0.2)
        self.held = len(self.rig.client.processing()[worker])
        os.kill(pid, signal.SIGKILL if self.held else signal.SIGCONT)


class TestTheRows:
    def test_are_those_of_threads_bit_for_bit(self, rig: Rig) -> None:
        def peak(result: Result) -> float:
            return float(abs(result.trace["f_m"]).max()) + 1.0

        program(*COMPILERS)
        figures: list[tuple[str, Sequence[Any] | None]] = [
            ("plain", None), ("plain", [peak, "x_err_rms"]), ("c", ["x_err_max"])]
        before = rig.tasks()
        for engine, metrics in figures:
            axes, fixed = (AXES, FIXED) if engine == "plain" else (LONG, {**FIXED, "energy": False})
            far = sweep("soft_tissue", axes, seeds=3, fixed=fixed, metrics=metrics, engine=engine,
                        executor=rig.client.get_executor())
            assert list(far) == list(sweep("soft_tissue", axes, seeds=3, fixed=fixed, metrics=metrics, engine="plain"))
            assert len(far) == (18 if engine == "plain" else 6)
        assert rig.client.status == "running"  # the client is still its owner's
        until(lambda: rig.tasks() <= before)  # what came back is not kept, though the client is open

    def test_of_ones_own_scene_are_by_its_path(self, rig: Rig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        (tmp_path / "own.py").write_text(OWN)
        monkeypatch.chdir(tmp_path)
        far = sweep("own.py", {"k_e": [100.0, 200.0, -1.0]}, executor=rig.client.get_executor())
        assert list(far) == list(sweep("own.py", {"k_e": [100.0, 200.0, -1.0]}))
        assert far.counts() == {"ok": 2, "refused": 1}

    @pytest.mark.full
    def test_outlive_a_worker_that_is_killed(self, rig: Rig, tmp_path: Path, small: None) -> None:
        """What it held is asked for once more."""
        kill, before = Killer(rig), rig.tasks()
        told: list[int] = []

        def show(done: int, of: int) -> None:
            told.append(done)
            kill(done, of)

        with connected(rig.address) as executor:
            far = sweep("soft_tissue", LONG, seeds=60, fixed=FIXED, executor=executor, out=tmp_path / "s", show=show)
        assert kill.held > 0
        assert told[-1] == 120
        assert list(far) == near_rows()
        until(lambda: rig.tasks() <= before)
        assert sorted(lines(tmp_path / "s")) == list(range(120))

    def test_a_worker_refuses_are_not_written(self, rig: Rig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """A file that lies here and not there is no property of the row."""
        (tmp_path / "trace").write_text("".join(f"{ms}\n" for ms in range(1, 400)))
        monkeypatch.chdir(tmp_path)
        files = {"up": "trace", "down": "trace", "duration": 0.2}
        with pytest.raises(Refused, match="whole path"):
            sweep("lte", fixed=files, executor=rig.client.get_executor(), out=tmp_path / "s")
        assert not (tmp_path / "s" / "rows.jsonl").read_text()
        files |= {"up": str(tmp_path / "trace"), "down": str(tmp_path / "trace")}
        assert sweep("lte", fixed=files, executor=rig.client.get_executor()).counts() == {"ok": 1}


class TestTheCommand:
    WORDS = ("soft_tissue", "--grid", "law=wave,direct", "delay=0:0.04:3", "--seeds", "2", "--set", "duration=0.2")

    @pytest.mark.full
    def test_leaves_the_folder_that_threads_leave(self, rig: Rig, tmp_path: Path) -> None:
        out, err = typed(tmp_path, *self.WORDS, "--cluster", rig.address.removeprefix("tcp://")).communicate()
        assert err == ""
        assert re.search(f"cluster   {rig.address}, rows by [12] of its workers\n", out)
        far = tmp_path / "runs" / "soft_tissue-sweep"
        assert sorted(lines(far)) == list(range(12))
        told = json.loads(typed(tmp_path, *self.WORDS, "--json", "--out", "here").communicate()[0])
        assert (told["cluster"], told["ran"]) == (None, 12)
        near = tmp_path / "here"
        assert sorted((far / "rows.jsonl").read_text().splitlines()) == sorted(
            (near / "rows.jsonl").read_text().splitlines())
        again = typed(tmp_path, *self.WORDS, "--json", "--out", "here", "--cluster", rig.address)
        told = json.loads(again.communicate()[0])
        assert (told["ran"], told["cluster"]) == (0, {"address": rig.address, "workers": 0})

    @pytest.mark.full
    def test_interrupted_leaves_nothing_behind_at_the_scheduler(self, rig: Rig, tmp_path: Path) -> None:
        before = rig.tasks()
        words = ["soft_tissue", "--seeds", "1000", "--set", "duration=1", "--engine", "plain", "--out", "s"]
        running = typed(tmp_path, *words, "--cluster", rig.address)
        until(lambda: (tmp_path / "s" / "rows.jsonl").is_file() and len(lines(tmp_path / "s")) > 3)
        assert rig.tasks() > before
        running.send_signal(signal.SIGINT)
        out, err = running.communicate(timeout=PATIENCE)
        assert (running.returncode, err) == (130, "")
        assert "the same command goes on" in out
        assert len(set(lines(tmp_path / "s"))) == len(lines(tmp_path / "s")) < 1000
        until(lambda: rig.tasks() <= before)

    def test_refuses_an_address_where_nobody_is_in_one_sentence(self, tmp_path: Path) -> None:
        with socket.create_server(("127.0.0.1", 0)) as one:
            port = one.getsockname()[1]
        running = typed(tmp_path, *self.WORDS, "--cluster", f"127.0.0.1:{port}")
        out, err = running.communicate(timeout=PATIENCE)
        assert (running.returncode, out, err.count("\n")) == (2, "", 1)
        assert f"no scheduler answers at tcp://127.0.0.1:{port}" in err
        assert not (tmp_path / "runs").exists()


class TestAnAddress:
    def test_is_host_and_port(self) -> None:
        for text in ("h:1", "tcp://h:8786", "tls://h.example.org:8786", "[::1]:1", "10.0.0.7:65535"):
            assert parse_address(text) == (text if "//" in text else f"tcp://{text}")
        for text in ("", "h", "h:", ":8786", "h:0", "h:65536", "h:x", "http://h:8787", "h:1/x", "a b:1", "::1:8786",
                     "h:8786:1", "h:-1", "u@h:1"):
            with pytest.raises(Refused, match="HOST:PORT"), connected(text):
                pytest.fail(text)

    def test_of_one_that_lets_callers_in_and_says_nothing_is_refused_within_ten_seconds(self) -> None:
        with socket.create_server(("127.0.0.1", 0)) as one:
            began = time.monotonic()
            with pytest.raises(Refused, match="no scheduler answers"), connected(f"127.0.0.1:{one.getsockname()[1]}"):
                pass
        assert time.monotonic() - began < 10.0

    def test_of_a_worker_or_a_scheduler_of_another_release_is_refused_and_all_without_the_extra(
        self, rig: Rig, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        with pytest.raises(Refused, match="no scheduler but a worker"), connected(next(iter(rig.client.nthreads()))):
            pass
        monkeypatch.setattr("distributed.__version__", "2023.1.0")
        with pytest.raises(Refused, match="pip install 'distributed=="), connected(rig.address):
            pass
        monkeypatch.setattr("teleop.sweeps.cluster.find_spec", lambda _: None)
        with pytest.raises(Refused, match=r"pip install 'bilateral-teleop\[cluster\]'"), connected(rig.address):
            pass


class TestAWorker:
    def test_of_other_sources_gives_no_rows(self, rig: Rig) -> None:
        _, said = rig.client.submit(answer, "0.0.1 (abc)", [], b"", pure=False).result()
        assert "not 0.0.1 (abc) as here" in said
        assert sources() in said

    def test_without_the_file_of_the_scene_or_law_gives_no_rows(self, rig: Rig, tmp_path: Path) -> None:
        (tmp_path / "own.py").write_text(OWN)
        for there, has in (("own.py", "another file"), ("none.py", "no file")):
            path = str(tmp_path / there)
            _, said = rig.client.submit(answer, sources(), [(path, "digest")], b"", pure=False).result()
            assert f"has {has} {path}; put" in said

    def test_is_told_the_files_of_the_scene_and_of_each_law(self, tmp_path: Path) -> None:
        (tmp_path / "law_mine.py").write_text("K = 1.0\n")
        scene, law = str(tmp_path / "own.py"), str(tmp_path / "law_mine.py")
        job = Job(scene, {}, [(0, {"law": "wave"}, 0), (1, {"law": f"{law}:Mine"}, 0)], (), "plain")
        with pytest.raises(Refused, match=r"no file .*own\.py any more"):
            files_of(job)
        (tmp_path / "own.py").write_text(OWN)
        assert files_of(job) == [(law, digest_of(law)), (scene, digest_of(scene))]
        (tmp_path / "mine.py").write_text("from law_mine import Law\n")  # another file beside one's own is told too
        (tmp_path / "law_mine.py").write_text("import gains\n")
        found = set()
        for gain in ("1", "2"):
            (tmp_path / "gains.py").write_text(gain)
            (tmp_path / "not_asked_for.py").write_text(gain)
            found |= {digest_of(str(tmp_path / "mine.py")), digest_of(str(tmp_path / "mine.py"))}
        assert len(found) == 2

    def test_that_lacks_a_figure_says_so(self, rig: Rig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        (tmp_path / "figures_of_mine.py").write_text("def count(result):\n    return result.ticks\n")
        monkeypatch.syspath_prepend(str(tmp_path))
        count = import_module("figures_of_mine").count
        with pytest.raises(Refused, match=r"lacks figures_of_mine .*into your script"):
            sweep("soft_tissue", fixed=FIXED, metrics=[count], executor=rig.client.get_executor())

    def test_tells_here_what_a_figure_raised_there(self, rig: Rig) -> None:
        def broken(result: Result) -> float:
            raise ZeroDivisionError(f"of {result.ticks} ticks")

        # The line is known there; the name of the file only to cloudpickle before 3.1.3.
        words = r"metric broken \(.*(\.py|dynamic-code>):\d+\) raised ZeroDivisionError: of 300 ticks, in row 0"
        with pytest.raises(Refused, match=words) as refused:
            sweep("soft_tissue", fixed=FIXED, metrics=[broken], executor=rig.client.get_executor())
        assert "ZeroDivisionError: of 300 ticks" in str(refused.value.__cause__)

    def test_is_not_sent_what_cannot_be(self, rig: Rig) -> None:
        mine = socket.socket()

        def held(result: Result) -> float:
            return float(result.ticks + mine.fileno())

        with pytest.raises(Refused, match="cannot be sent"):
            sweep("soft_tissue", fixed=FIXED, metrics=[held], executor=rig.client.get_executor())
        mine.close()

    def test_is_not_left_with_chunks_that_nobody_waits_for(self, rig: Rig, tmp_path: Path) -> None:
        over = str(tmp_path / "over")

        def slow(result: Result) -> float:
            while result.seed and not os.path.exists(over):
                time.sleep(0.05)
            return 0.0

        def stop(*_: int) -> None:
            raise KeyboardInterrupt

        before = rig.tasks()  # dask keeps those that raised something for as long as the client is open
        with pytest.raises(KeyboardInterrupt):
            sweep("soft_tissue", seeds=9, fixed=FIXED, metrics=[slow], executor=rig.client.get_executor(), show=stop)
        until(lambda: rig.tasks() <= before)
        Path(over).touch()


class TestAFrailCluster:
    """In this order: with workers that die, without one, with a wrong one, without a scheduler."""

    def test_whose_workers_die_of_a_row_ends_the_sweep_with_it(self, rig: Rig) -> None:
        def deadly(result: Result) -> float:
            os.kill(os.getpid(), signal.SIGKILL)
            return float(result.ticks)

        rig.workers(2 - len(rig.client.nthreads()))
        with pytest.raises(Refused, match=r"held row 0, .*the same command goes on"):
            sweep("soft_tissue", fixed=FIXED, metrics=[deadly], executor=rig.client.get_executor())
        until(lambda: not rig.client.nthreads())

    @pytest.mark.full
    def test_without_a_worker_is_waited_for_and_given_up(self, rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
        rig.kill_workers()
        monkeypatch.setattr(cluster, "WORKERLESS", 3.0)
        monkeypatch.setattr(cluster, "HINT", 1.0)
        told: list[str] = []
        said, before = f"dask worker {rig.address}", rig.tasks()
        with pytest.raises(Refused, match=said), connected(rig.address, told.append) as pool:
            sweep("soft_tissue", fixed=FIXED, executor=pool)
        assert [said in sentence for sentence in told] == [True]
        until(lambda: rig.tasks() <= before)

    @pytest.mark.full
    def test_whose_worker_has_another_teleop_is_refused(self, rig: Rig, tmp_path: Path) -> None:
        rig.kill_workers()
        (tmp_path / "teleop").mkdir()
        (tmp_path / "teleop" / "__init__.py").write_text("")
        rig.workers(1, PYTHONPATH=str(tmp_path))
        with pytest.raises(Refused, match=r"lacks teleop.*pip install bilateral-teleop=="):
            sweep("soft_tissue", fixed=FIXED, executor=rig.client.get_executor())

    @pytest.mark.full
    def test_that_is_lost_loses_no_row(self, rig: Rig, tmp_path: Path, small: None) -> None:
        def end(done: int, _: int) -> None:
            if done >= 10:
                rig.scheduler.kill()

        rig.kill_workers()
        rig.workers(1)
        plan = plan_sweep("soft_tissue", LONG, seeds=60, fixed=FIXED)
        with pytest.raises(Refused, match=r"is gone.*the same command goes on"), connected(rig.address) as pool:
            carry_out(plan, executor=pool, out=tmp_path / "s", show=end)
        there = lines(tmp_path / "s")
        assert 10 <= len(there) == len(set(there)) < 120
        assert list(carry_out(plan, out=tmp_path / "s")) == near_rows()
        assert sorted(lines(tmp_path / "s")) == list(range(120))
