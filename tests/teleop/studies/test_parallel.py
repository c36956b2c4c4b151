"""Jobs that processes do, with what they send on their way."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import pytest

from teleop.errors import Refused
from teleop.studies.parallel import stream


def squares(job: int, send: Callable[[Any], None]) -> int:
    """Send each number below the job's, answer its square; a job below 0 refuses, one of 99 is killed."""
    if job < 0:
        raise Refused("below zero")
    if job == 99:
        os._exit(9)
    for number in range(job):
        send(number)
    return job * job


def carried_out(jobs: list[int], workers: int) -> tuple[dict[int, int], dict[int, list[int]], list[int]]:
    parts: dict[int, list[int]] = {}
    begun: list[int] = []
    answers = dict(stream(squares, jobs, workers, begun.append,
                            lambda number, part: parts.setdefault(number, []).append(part), lambda: None))
    return answers, parts, begun


@pytest.mark.parametrize("workers", [1, 2])
def test_every_part_is_taken_before_its_answer_and_a_refusal_of_a_job_is_that_of_the_whole(workers: int) -> None:
    answers, parts, begun = carried_out([3, 1, 2], workers)
    assert answers == {0: 9, 1: 1, 2: 4}
    assert parts == {0: [0, 1, 2], 1: [0], 2: [0, 1]}
    assert sorted(begun) == [0, 1, 2]
    with pytest.raises(Refused, match="below zero"):
        carried_out([2, -1], workers)


def test_a_process_that_was_killed_says_what_to_type() -> None:
    with pytest.raises(Refused, match="type the same command again"):
        carried_out([99, 99], 2)
