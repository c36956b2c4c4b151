"""A sweep on a cluster: its chunks are handed to the workers of a dask.distributed scheduler.

Workers are other processes, perhaps on other machines. A chunk travels as bytes that only a worker opens, so that the
scheduler need not have this package, and a worker opens them only if its sources are those of here. What a worker held
when it died dask gives to another one; whichever finishes, the future that asked is answered once, so no row is lost
and none comes twice.
"""

from __future__ import annotations

import asyncio
import logging
import pickle
import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, Executor, Future, InvalidStateError, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import cache
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path
from time import monotonic
from typing import Any
from uuid import uuid4
from weakref import ref

from teleop.errors import Refused
from teleop.scene.library import ROOT, beside, file_named
from teleop.storage.files import read_bytes
from teleop.sweeps.chunk import ChunkResult, Job


def answer(version: str, files: Sequence[tuple[str, str]], packed: bytes) -> tuple[str, bytes | str]:
    """Run a chunk at a worker: its address, and the rows as bytes or a sentence with the reason that there are none.

    `version`: the sources (see `sources`) that the rows are to be made by. `files`: path and digest of each file with a
    scene or a law that is not built in. Nothing of `packed` is opened before both agree.
    """
    import cloudpickle
    from distributed import get_worker

    at = str(get_worker().address)
    if sources() != version:
        return at, (f"the worker {at} has teleop {sources()}, not {version} as here; install the same there and start "
                    f"it again")
    for path, digest in files:
        if (here := digest_of(path)) != digest:
            has = "no file" if here is None else "another file"
            return at, f"the worker {at} has {has} {path}; put that of here on a disk that all share, or copy it there"
    function, job = pickle.loads(packed)
    try:
        return at, cloudpickle.dumps(function(job))
    except Refused as refused:
        return at, f"{refused} (at the worker {at})"


@cache
def sources() -> str:
    """The version of this package and a digest of its files, as this process found them: others make other rows."""
    from teleop.version import __version__

    digest = sha256()
    for package in ("teleop", "master", "slave", "channel", "scenarios"):
        for path in sorted((ROOT / package).rglob("*.py"), key=Path.as_posix):
            digest.update(path.relative_to(ROOT).as_posix().encode() + b"\0" + path.read_bytes())
    return f"{__version__} ({digest.hexdigest()[:12]})"


def digest_of(path: str) -> str | None:
    """Digest of a file and of the files beside it that it imports; none if it cannot be read."""
    try:
        digest = sha256(read_bytes(path))
        for name, file in beside(Path(path)).items():
            digest.update(f"\0{name}\0".encode() + read_bytes(file))
        return digest.hexdigest()
    except OSError:
        return None


ANSWER = 3.0  # s in which a scheduler must let somebody in, and then answer
SILENT = 30.0  # s after which one that did answer counts as lost
WORKERLESS = 60.0  # s that a sweep waits while there is no worker at all
HINT = 2.0  # s of those after which it says so
TRIES = 2  # times that a chunk is handed out whose workers die: it may only have lain beside the one that killed them
GOES_ON = "the rows that were written are kept, and the same command goes on with the others"

Work = Callable[["Job"], "ChunkResult"]


def parse_address(text: str) -> str:
    """`host:port`, `tcp://host:port` or `tls://host:port` with its protocol. Raises `Refused`.

    >>> parse_address("10.0.0.7:8786")
    'tcp://10.0.0.7:8786'
    """
    parts = re.fullmatch(r"((?:tcp|tls)://)?(\[[0-9a-fA-F:.%]+\]|[^\s:/@\[\]]+):([0-9]{1,5})", text.strip())
    if parts is None or not 0 < int(parts[3]) < 65536:
        raise Refused(f"--cluster {text} is no address of a scheduler; write HOST:PORT, for example 127.0.0.1:8786, "
                      f"as `dask scheduler` names it")
    return f"{parts[1] or 'tcp://'}{parts[2]}:{parts[3]}"


@contextmanager
def connected(address: str, tell: Callable[[str], None] = lambda _: None) -> Iterator[Cluster]:
    """An executor that hands out to the workers of the scheduler at `address`; `tell` is told what to know meanwhile.

    Raises `Refused` within 10 s if the extra is not installed, if nobody answers there, if it is no scheduler, or one
    of another release. What is under way at the end is cancelled.
    """
    at = parse_address(address)
    if find_spec("distributed") is None:
        raise Refused("--cluster needs dask.distributed: pip install 'bilateral-teleop[cluster]', or leave it out and "
                      "run on this machine")
    with _quiet():
        from distributed import Client

        _greet(at)
        try:
            client = Client(at, timeout=ANSWER, set_as_default=False)
        except (OSError, ImportError) as error:
            raise Refused(f"the scheduler at {at} let nobody in ({error}); start it again") from error
        cluster = Cluster(client.get_executor(), tell)
        try:
            yield cluster
        finally:
            cluster.shutdown()
            with suppress(Exception):  # a scheduler that is gone needs no farewell
                client.close(timeout=2.0)


class Cluster(Executor):
    """The executor of a dask client as a sweep wants one: its troubles are `Refused`."""

    def __init__(self, executor: Any, tell: Callable[[str], None] = lambda _: None) -> None:
        self._dask, self._client = executor, executor._client
        self._tell, self._warned = tell, False
        self._desk = ThreadPoolExecutor(1)  # opens what comes back: dask's own thread has others to serve
        self._count, self._due, self._seen = 1, 0.0, monotonic()
        self.address: str = self._client.scheduler.address
        self.workers: set[str] = set()  # those that have sent rows

    def threads(self) -> int:
        """Threads of all workers as of the last second, at least 1; `Refused` if there has been none for long."""
        now = monotonic()
        if now < self._due:
            return self._count
        try:
            threads_of = self._client.sync(self._client.scheduler.ncores, workers=None, callback_timeout=SILENT)
        except Exception as error:
            raise Refused(self._lost()) from error
        self._due, self._count = now + 1.0, max(1, sum(threads_of.values()))
        if threads_of:
            self._seen, self._warned = now, False
        elif now - self._seen >= WORKERLESS:
            raise Refused(f"the scheduler at {self.address} has no worker; start one (dask worker {self.address}): "
                          f"{GOES_ON}")
        elif now - self._seen >= HINT and not self._warned:
            self._warned = True
            self._tell(f"the scheduler at {self.address} has no worker; waiting {WORKERLESS:.0f} s for one: "
                       f"dask worker {self.address}")
        return self._count

    def submit(self, fn: Any, /, *args: Any, **_: Any) -> Future[Any]:
        """Hand out one job: `fn` is `teleop.sweeps.chunk.work`. The future has its rows, or a `Refused`."""
        job: Job = args[0]
        future: Future[Any] = Future()
        self._hand_out(_packed(fn, job), fn, job, future, TRIES)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Stop opening what comes back; the client stays whose it is."""
        self._desk.shutdown(wait=False, cancel_futures=True)

    def _hand_out(self, packed: bytes, fn: Work, job: Job, future: Future[ChunkResult], tries: int) -> None:
        # With a key of its own no result is taken for that of another chunk, one of an earlier sweep for example.
        sent = self._dask.submit(pickle.loads, packed, key=f"teleop-{uuid4().hex}")

        under_way = ref(sent)  # no cycle: a worker holds what it made for as long as somebody here holds the future

        def cancel(done: Future[ChunkResult]) -> None:
            dask_future = under_way()
            if done.cancelled() and dask_future is not None:
                dask_future.cancel()

        def back(done: Future[Any]) -> None:
            if not future.cancelled():
                with suppress(RuntimeError):  # nobody waits any more
                    self._desk.submit(self._settle, done, packed, fn, job, future, tries)

        sent.add_done_callback(back)
        future.add_done_callback(cancel)

    def _settle(self, sent: Future[tuple[str, bytes | str]], packed: bytes, fn: Work, job: Job,
                future: Future[ChunkResult], tries: int) -> None:
        """Answer `future` by what has come back."""
        from distributed import KilledWorker

        with suppress(InvalidStateError):  # cancelled meanwhile
            try:
                worker, got = sent.result()
                if isinstance(got, str):
                    raise Refused(got)
                done = _checked(pickle.loads(got), fn, job, worker)
            except CancelledError:
                future.set_exception(Refused(self._lost()))
            except KilledWorker as killed:
                if tries > 1:
                    self._hand_out(packed, fn, job, future, tries - 1)
                else:
                    future.set_exception(Refused(_killed(job, killed)))
            except ImportError as error:
                future.set_exception(Refused(self._lacks(error)))
            except BaseException as error:
                future.set_exception(error)
            else:
                self.workers.add(worker)
                future.set_result(done)
        del sent, future  # an error's traceback holds this frame, which must hold nothing at the scheduler

    def _lost(self) -> str:
        return (f"the scheduler at {self.address} is gone, or has dropped what it was given; start it and its workers "
                f"again: {GOES_ON}")

    def _lacks(self, error: ImportError) -> str:
        from teleop.version import __version__

        name = error.name or "a module"
        if name.partition(".")[0] == "teleop":
            cure = f"pip install bilateral-teleop=={__version__} there and start it again"
        else:
            cure = "install it there, or write what is needed of it into your script itself"
        return f"a worker of {self.address} lacks {name} ({error}); {cure}"


class _Call:
    """Pickled it is a call of `answer` that is made when it is opened: no other part of it needs this package."""

    def __init__(self, *arguments: Any) -> None:
        self.arguments = arguments

    def __reduce__(self) -> tuple[Any, ...]:
        return answer, self.arguments


def _packed(fn: Work, job: Job) -> bytes:
    import cloudpickle

    if job.scene.endswith(".py"):
        job = job._replace(scene=str(Path(job.scene).absolute()))
    files = files_of(job)
    try:
        return pickle.dumps(_Call(sources(), files, cloudpickle.dumps((fn, job))))
    except (pickle.PicklingError, TypeError, AttributeError, RecursionError) as error:
        raise Refused(f"this sweep cannot be sent to a worker ({error}); leave that out of its knobs and metrics, or "
                      f"run on this machine") from error


def files_of(job: Job) -> list[tuple[str, str]]:
    """The files of the user's own that have the scene and the laws of a job, with the digest of each.

    Raises `Refused` if one of them is gone.
    """
    every = (job.fixed, *[knobs for _, knobs, _ in job.rows])
    paths = {file_named(value) for knobs in every for value in knobs.values() if isinstance(value, str)}
    files = []
    for path in sorted({*paths, job.scene if job.scene.endswith(".py") else ""} - {""}):
        if (digest := digest_of(path)) is None:
            raise Refused(f"there is no file {path} any more; put it back: {GOES_ON}")
        files.append((path, digest))
    return files


def _checked(done: ChunkResult, fn: Work, job: Job, worker: str) -> ChunkResult:
    """The rows, those that were refused as they are refused here: a worker may only lack a file or a plug-in."""
    job_rows = {row[0]: row for row in job.rows}
    for i, row in enumerate(done.rows):
        if row["status"] == "refused":
            mine = next(iter(fn(job._replace(rows=[job_rows[row["row"]]], engine="plain")).rows), None)
            if mine is None or mine["status"] != "refused":
                raise Refused(f"the worker {worker} refuses row {row['row']}, which can be run here: "
                              f"{row.get('sentence')} (give a file by its whole path, on a disk that all share)")
            done.rows[i] = mine
    return done


def _killed(job: Job, killed: Any) -> str:
    first, last = job.rows[0][0], job.rows[-1][0]
    rows = f"row {first}" if first == last else f"rows {first} to {last}"
    worker = getattr(killed.last_worker, "address", "unknown")
    return (f"workers died one after another while they held {rows}, the last of them {worker}; see its log (out of "
            f"memory?), give workers more memory or fewer threads: {GOES_ON}")


def _greet(at: str) -> None:
    """Ask who is there, and raise `Refused` unless it is a scheduler of this release."""
    from distributed import __version__

    async def ask() -> tuple[Any, Any]:
        from distributed.core import rpc
        from distributed.security import Security

        async with rpc(at, timeout=ANSWER, connection_args=Security().get_connection_args("client")) as remote:
            return await remote.identity(), await remote.versions()

    try:
        who, what = asyncio.run(asyncio.wait_for(ask(), 2.0 * ANSWER))
        kind, theirs = str(who["type"]), str(what["packages"]["distributed"])
    except Exception as error:  # whoever listens there may send anything
        why = " ".join(str(error).split())[:160] or type(error).__name__
        raise Refused(f"no scheduler answers at {at} ({why}); start one (dask scheduler), or give the address that it "
                      f"names as its own") from error
    if kind != "Scheduler":
        raise Refused(f"what answers at {at} is no scheduler but a {kind.lower()}; give the scheduler's address")
    if theirs.split(".")[:2] != __version__.split(".")[:2]:
        raise Refused(f"the scheduler at {at} runs distributed {theirs}, here it is {__version__}, and these do not "
                      f"understand each other; pip install 'distributed=={theirs}' here, or that of here there")


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep dask's own log lines and warnings off the terminal: what matters of them is told as a sentence."""
    import distributed  # noqa: F401  (it sets up its logging when it is imported)

    known = [logging.getLogger(name) for name in ("distributed", "tornado", "asyncio")]
    known += [logger for name, logger in logging.root.manager.loggerDict.items() if isinstance(logger, logging.Logger)
              and name.startswith(("distributed.", "tornado.")) and logger.handlers]
    before = [(logger, logger.handlers, logger.propagate) for logger in known]
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", module="distributed")
        for logger in known:
            logger.handlers, logger.propagate = [logging.NullHandler()], False
        try:
            yield
        finally:
            for logger, handlers, propagate in before:
                logger.handlers, logger.propagate = handlers, propagate
