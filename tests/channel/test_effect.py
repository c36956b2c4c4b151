"""Effects and chains: how they are joined, what a chain refuses, how rows are sorted."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from channel.bernoulli import Bernoulli
from channel.delay import Delay
from channel.duplicate import Duplicate
from channel.effect import Chain
from channel.in_order import InOrder
from channel.mahimahi import Mahimahi
from channel.schedule import by_number, by_time
from channel.uniform import UniformJitter
from teleop.errors import Refused


def test_joining_is_flat_and_associative() -> None:
    a, b, c = Delay(0.1), Bernoulli(0.2), UniformJitter(0.01)
    assert (a | b) | c == a | (b | c) == Chain((a, b, c))
    assert ((a | b) | (c | a)).effects == (a, b, c, a)
    assert (a | b) != (b | a)
    assert len({a | b, a | b, b | a}) == 2
    for wrong in (lambda: a | 3, lambda: (a | b) | None):  # type: ignore[operator]
        with pytest.raises(TypeError):
            wrong()


def test_a_chain_is_made_of_effects() -> None:
    with pytest.raises(Refused, match=r"made of effects, not 0\.05"):
        Chain((0.05,))  # type: ignore[arg-type]
    with pytest.raises(Refused, match="made of effects"):
        Chain((Delay,))  # type: ignore[arg-type]


def test_effects_are_values() -> None:
    assert Delay(1) == Delay(1.0)
    assert repr(Delay(1)) == "Delay(delay=1.0)"
    with pytest.raises(AttributeError):
        Delay(1.0).delay = 2.0  # type: ignore[misc]


def test_in_order_behind_a_queue_that_sees_disorder_is_refused(recordings: Path) -> None:
    """When such a queue drops a packet, those that wait for it could only leave late or with foresight."""
    queue, jitter = Mahimahi(str(recordings / "trace")), UniformJitter(0.01)
    for wrong in (lambda: jitter | queue | InOrder(),
                  lambda: Duplicate(0.1) | Delay(0.1) | queue | Delay(0.1) | InOrder()):
        with pytest.raises(Refused, match=r"in_order\(\) cannot stand behind a queue"):
            wrong()
    assert len((queue | jitter | InOrder() | queue | jitter | InOrder()).effects) == 6


def test_by_time_and_by_number_sort_with_the_other_as_tie_break() -> None:
    packet, time_ns = np.array([3, 1, 2, 1, 0]), np.array([5, 5, 4, 2, 5])
    assert [x.tolist() for x in by_time(packet, time_ns)] == [[1, 2, 0, 1, 3], [2, 4, 5, 5, 5]]
    assert [x.tolist() for x in by_number(packet, time_ns)] == [[0, 1, 1, 2, 3], [5, 2, 5, 4, 5]]
    for rows in (by_time, by_number):
        run = np.arange(5), np.arange(5)
        assert all(got is given for got, given in zip(rows(*run), run, strict=True))


def test_the_other_teleop_is_recognised(tmp_path: Path) -> None:
    """Another package on the index imports as `teleop` too: one sentence, not an obscure failure."""
    (tmp_path / "teleop.py").write_text("robots = 1\n")
    (tmp_path / "channel").symlink_to(Path(__file__).parents[2] / "channel")
    code = "import sys; sys.path.insert(0, sys.argv[1]); import channel"
    got = subprocess.run([sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, check=False,
                         cwd=tmp_path)
    assert got.returncode == 1
    assert "another package called teleop" in got.stderr.splitlines()[-1]
    assert "install bilateral-teleop" in got.stderr.splitlines()[-1]
