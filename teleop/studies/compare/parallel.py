"""Jobs carried out by several processes, each answer as it comes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from typing import TypeVar

Job = TypeVar("Job")
Answer = TypeVar("Answer")


def in_parallel(function: Callable[[Job], Answer], jobs: Sequence[Job], workers: int) -> Iterator[Answer]:
    """The answer of `function` to each job, as they come; in this process where there is one worker.

    Function and jobs are pickled, so both belong to modules. Whoever goes on no further waits for the jobs in flight.
    """
    workers = min(workers, len(jobs))
    if workers < 2:
        yield from map(function, jobs)
        return
    from multiprocessing import get_context

    pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_begin)
    try:
        yield from _ended(pool, function, jobs, workers)
    finally:
        pool.shutdown(cancel_futures=True)


def _ended(pool: Executor, function: Callable[[Job], Answer], jobs: Sequence[Job], workers: int) -> Iterator[Answer]:
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


def _begin() -> None:
    """Leave Ctrl-C to the process that started this one, and linear algebra to one thread: there is a process a core.

    It goes before the first job, whose function brings numpy.
    """
    import os
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(name, "1")
