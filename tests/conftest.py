"""What is common to all tests: which run when, side by side with what, and how hypothesis draws its examples.

The long ones run only when they are asked for: `pytest -m soak`, `pytest -m fuzz`; and `pytest -m full`, which repeats
for every law, engine and scene what the suite shows with one or two of them. So do style, types and import rules,
which are a job of their own: `pytest -m house`, or by the name of their file. The rest goes file by file to as
many workers as `-n` says, and whatever starts processes and looks at the clock to one of them, one after the other, so
that no two of these wait for each other: beside ends with real-time scheduling those in a process of the tests starve.
The pages before stand-ins of the ends, and the browsers before stand-ins of the page's server, go to another. These two
sleep most of their time, so there is a worker more than there are cores.

Bytecode is written whatever the environment says: tests start hundreds of processes, and each would compile anew. On a
fresh checkout each worker first imports a part of the files that is its own, so that no two compile the same.

No example of hypothesis is judged by its time, which is the machine's. The examples are the same at every run, so that
what falls falls again; only the tests marked `fuzz` draw new ones, and print what repeats a failure.
"""

from __future__ import annotations

import gc
import os
import re
import signal
import sys
from contextlib import suppress
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, settings
from xdist.scheduler import LoadScopeScheduling

from tests.programs import uses_programs

ASKED_FOR = {"soak": "takes minutes", "fuzz": "takes minutes", "house": "is a job of its own",
             "docs": "is a job of its own", "full": "is a repetition, or takes seconds"}
TIMED = (
    "tests/live/", "tests/channel/test_relay_process.py", "tests/teleop/bench/",
)

CLOCKLESS = ("tests/live/test_stepped.py", "tests/live/test_device_lock.py")  # with sockets or processes, by no clock
STAND_INS = "tests/live/page/"
REAL = ("test_real.py",)  # of these files there: with the ends of a run

os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # or numpy starts threads that spin: half of what its import takes
sys.dont_write_bytecode = False
settings.register_profile(
    "suite", max_examples=50, deadline=None, suppress_health_check=[HealthCheck.too_slow], derandomize=True,
    database=None, print_blob=True,
)
settings.load_profile("suite")
settings.register_profile(  # for mutants, of which it matters that an example is found, and not the least one
    "mutants", settings.get_profile("suite"), phases=(Phase.explicit, Phase.generate))


def pytest_configure() -> None:
    """Let processes of tests take a Ctrl-C, which a suite that was started in the background ignores."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(tryfirst=True)
def pytest_collection(session: pytest.Session) -> None:
    """Begin at a place of each worker's own among the files, if all are collected by several.

    What is collected stays: no garbage is looked for meanwhile, a tenth of the time.
    """
    gc.disable()
    worker = getattr(session.config, "workerinput", None)
    if worker is not None and session.config.args == session.config.getini("testpaths"):
        files = sorted(Path(__file__).parent.rglob("test_*.py"))
        start = int(worker["workerid"].removeprefix("gw")) * len(files) // worker["workercount"]
        for file in files[start:] + files[:start]:
            with suppress(BaseException):  # what cannot be imported, the collection reports
                import_module(".".join(file.relative_to(session.config.rootpath).with_suffix("").parts))


def pytest_collection_finish() -> None:
    gc.enable()


@pytest.hookimpl(tryfirst=True)  # before `-m` chooses
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark what can start a program; skip what has to be asked for; refuse a name that each worker has otherwise.

    In a run of the whole suite what would be skipped is not taken up at all: each worker set up 2,200 such tests.
    """
    markers = str(config.getoption("-m"))
    arguments = config.invocation_params.args
    skipped: list[pytest.Item] = []
    for item in items:
        if uses_programs(item):
            item.add_marker("program")
        if " at 0x" in item.name:  # the workers would end with "Different tests were collected"
            raise pytest.UsageError(f"{item.nodeid} is named by an address in memory; give its parameters ids")
        for name, why in ASKED_FOR.items():
            is_named = name == "house" and any(item.path.name in str(argument) for argument in arguments)
            if item.get_closest_marker(name) and name not in markers and not is_named:  # a folder is a keyword too
                item.add_marker(pytest.mark.skip(reason=f"{why}: pytest -m {name}"))
                skipped.append(item)
    if skipped and config.args == config.getini("testpaths"):
        left_out = set(skipped)
        items[:] = [item for item in items if item not in left_out]
        config.hook.pytest_deselected(items=[*left_out])


class ByFile(LoadScopeScheduling):  # it has no types
    """A file goes to one worker, all that are timed to the same."""

    def _split_scope(self, nodeid: str) -> str:
        file = nodeid.split("::", 1)[0]
        if file.startswith(STAND_INS) and not file.endswith(REAL):
            return "stand-ins"
        if not file.startswith(TIMED) or file in CLOCKLESS or not _is_live(file):
            return file
        return "timed"


@cache
def _is_live(file: str) -> bool:
    """True of a file in which anything is marked `live` or has two ends; the others there need no clock."""
    return re.search(r"mark\.live|\bpair\b", (Path(__file__).parent.parent / file).read_text()) is not None


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> ByFile:
    """The scheduler of `-n`."""
    return ByFile(config, log)
