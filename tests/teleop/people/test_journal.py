"""The journal: cut at any byte, or killed while it writes, a session goes on to the bytes of an undisturbed one."""

from __future__ import annotations

import os
import signal
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from teleop.errors import Refused
from teleop.people.felt import in_series
from teleop.people.journal import NAME, Journal, read_journal
from teleop.people.plan import LevelMethod, StudyPlan
from teleop.people.simulated import Person, simulate_session
from teleop.storage.strict_json import json_text
from tests.teleop.people.plans import comparison


def person(plan: StudyPlan, number: int = 3) -> Person:
    """A simulated person, behind a compliance of 0.002 m/N."""
    felt = {level: in_series(0.002, level) for level in (plan.task.standard, *plan.task.levels)}
    return Person(plan, number, dict.fromkeys("AB", felt), dict(zip("AB", plan.conditions, strict=True)))


def carried_on(plan: StudyPlan, path: Path) -> bytes:
    """The bytes of the journal after the session has been carried on to its end."""
    with Journal(path, sync=False) as journal:
        simulate_session(person(plan), journal)
    return path.read_bytes()


class DyingJournal(Journal):
    """A journal whose process is killed as soon as so many bytes are in the file."""

    die_at = 0

    def append(self, row: Mapping[str, Any]) -> None:
        """Write a line, or the part of it that makes the file long enough, and die."""
        line = json_text(row).encode() + b"\n"
        room = self.die_at - self.path.stat().st_size
        if room < len(line):
            os.write(self._file.fileno(), line[:room])
            os.kill(os.getpid(), signal.SIGKILL)
        super().append(row)


@pytest.mark.parametrize("method", LevelMethod)
def test_a_journal_that_is_cut_at_any_byte_goes_on_to_the_same_bytes(tmp_path: Path, method: LevelMethod) -> None:
    """Every fifth line is cut at each of its bytes' tenths, the whole journal at its ends."""
    plan = comparison(method=method)
    whole = carried_on(plan, tmp_path / "whole")
    path = tmp_path / NAME
    lines = whole.split(b"\n")
    places = {0, 1, len(whole) - 1, len(whole)}
    at = 0
    for i, line in enumerate(lines):
        places |= {at + len(line) * part // 10 for part in range(11)} if i % 10 == 3 else {at}
        at += len(line) + 1
    for cut in sorted(place for place in places if place <= len(whole)):
        path.write_bytes(whole[:cut])
        assert carried_on(plan, path) == whole, cut


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_session_killed_while_it_writes_goes_on_to_the_same_bytes_at_fifty_places(tmp_path: Path) -> None:
    """SIGKILL with a part of a line on the disk, each time a little further on."""
    plan = comparison()
    whole = carried_on(plan, tmp_path / "whole")
    path = tmp_path / NAME
    for place in range(50):
        child = os.fork()
        if child == 0:
            with DyingJournal(path, sync=False) as journal:
                journal.die_at = len(whole) * (place + 1) // 51
                simulate_session(person(plan), journal)
            os._exit(1)
        assert os.WIFSIGNALED(os.waitpid(child, 0)[1])
        assert path.stat().st_size == len(whole) * (place + 1) // 51
    assert carried_on(plan, path) == whole


def test_each_line_is_on_the_disk_before_the_next_step(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, synced = tmp_path / NAME, []
    monkeypatch.setattr(os, "fsync", lambda descriptor: synced.append(os.fstat(descriptor).st_size))
    with Journal(path) as journal:
        synced.clear()
        for i in range(3):
            journal.append({"kind": "trial", "number": i})
            assert synced[-1] == path.stat().st_size
    assert len(synced) == 3


def test_two_processes_cannot_run_one_person_and_a_damaged_line_is_named(tmp_path: Path) -> None:
    path = tmp_path / "sub-01" / NAME
    path.parent.mkdir()
    with Journal(path, sync=False) as journal:
        journal.append({"kind": "session"})
        with pytest.raises(Refused, match="sub-01 is being run by another process; end that one first"):
            Journal(path)
    path.write_bytes(b'{"kind": "session"}\n{"kind" "trial"}\n')
    with pytest.raises(Refused, match=r"line 2 of .* is damaged \(it is no JSON"):
        Journal(path)
    path.write_bytes(b'[1]\n')
    with pytest.raises(Refused, match=r"line 1 of .* is no line of a journal"):
        read_journal(path)
    assert read_journal(tmp_path / "none") == []
