"""Jobs for several processes, with each answer as it comes."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from contextlib import suppress
from enum import Enum
from functools import partial
from multiprocessing import get_context
from typing import TYPE_CHECKING, Any, TypeVar

from teleop.errors import Refused

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

Job = TypeVar("Job")
Answer = TypeVar("Answer")
POLL = 1.0  # s


class StreamKind(Enum):
    """Kind of a part that a process sends."""

    PART, ANSWER, RAISED = range(3)


def in_parallel(function: Callable[[Job], Answer], jobs: Sequence[Job], workers: int) -> Iterator[Answer]:
    """Yield the answer of `function` to each job, as they come; in this process where there is one worker.

    Function and jobs are pickled, so both belong to modules. Leaving the loop waits for the jobs in flight.
    """
    workers = min(workers, len(jobs))
    if workers < 2:
        yield from map(function, jobs)
        return
    pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_begin)
    try:
        yield from _in_turn(pool, function, jobs, workers)
    finally:
        pool.shutdown(cancel_futures=True)


def _in_turn(pool: Executor, function: Callable[[Job], Answer], jobs: Sequence[Job], workers: int) -> Iterator[Answer]:
    waiting, running = iter(jobs), set[Future[Answer]]()
    while True:
        for job in waiting:
            running.add(pool.submit(function, job))
            if len(running) >= 2 * workers:  # an interrupt waits for no more than these
                break
        if not running:
            return
        done, running = wait(running, return_when=FIRST_COMPLETED)
        for future in done:
            yield future.result()


def stream(function: Callable[[Job, Callable[[Any], None]], Answer], jobs: Sequence[Job], workers: int,
           begin: Callable[[int], None], take: Callable[[int, Any], None], poll: Callable[[], None]
           ) -> Iterator[tuple[int, Answer]]:
    """Yield the number and the answer of each job, as they come; parts that it sends are taken in this process.

    `function(job, send)` is called in one of several processes, in this one where there is one worker. `begin(number)`
    is called when a job is handed out, and `take(number, part)` for each part that it sends. `poll()` is called once a
    second and more often. Leaving the loop ends the processes at once; one that has lost its starter ends when it next
    sends something. Raises `Refused` if a process ends before its job does.
    """
    workers = min(workers, len(jobs))
    if workers < 2:
        for number, job in enumerate(jobs):
            begin(number)
            yield number, function(job, partial(take, number))
        return
    from multiprocessing.connection import wait as ready

    spawn = get_context("spawn")
    processes: list[tuple[Any, Connection[Any, Any]]] = []
    running: dict[Any, int] = {}  # by its pipe, the number of a job
    waiting = iter(enumerate(jobs))

    def hand_out(pipe: Any) -> None:
        for number, job in waiting:
            begin(number)
            running[pipe] = number
            pipe.send(job)
            return

    try:
        for _ in range(workers):
            ours, theirs = spawn.Pipe()
            process = spawn.Process(target=_serve, args=(function, theirs), daemon=True)
            process.start()
            processes.append((process, ours))
            theirs.close()
            hand_out(ours)
        while running:
            pipes: list[Any] = ready([*running], POLL)
            for pipe in pipes:
                try:
                    kind, part = pipe.recv()
                except (EOFError, ConnectionResetError):
                    raise Refused("a process of the search ended before its work did, for want of memory or by a "
                                  "signal; type the same command again to go on") from None
                if kind is StreamKind.RAISED:
                    raise part
                if kind is StreamKind.PART:
                    take(running[pipe], part)
                    continue
                number = running.pop(pipe)
                hand_out(pipe)
                yield number, part
            poll()
    finally:
        for process, _ in processes:
            process.terminate()
        for process, pipe in processes:
            process.join()
            pipe.close()


def _serve(function: Callable[[Any, Callable[[Any], None]], Any], pipe: Connection[Any, Any]) -> None:
    """Run one job after the other for as long as the process lives that hands them out."""
    _begin()
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):
        while True:
            job = pipe.recv()
            answer: tuple[StreamKind, Any]
            try:
                answer = StreamKind.ANSWER, function(job, lambda part: pipe.send((StreamKind.PART, part)))
            except (BrokenPipeError, ConnectionResetError):
                raise
            except Exception as error:
                answer = StreamKind.RAISED, error
            pipe.send(answer)


def _begin() -> None:
    """Leave Ctrl-C to the process that started this one, and linear algebra to one thread: there is a process a core.

    It goes before the first job, since the job's function loads numpy.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(name, "1")
