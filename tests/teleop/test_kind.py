"""The kinds of message fields are found however a message type is written down."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from teleop import load_scene
from teleop.kind import kinds, wave, waves
from teleop.scene.library import file_law, own_module

MESSAGES = '''
from typing import Annotated, NamedTuple
from teleop import kind
from teleop.kind import Wave
from teleop.kind import Wave as Power

class Named(NamedTuple): u: kind.Wave; x: float = 0.0
class Imported(NamedTuple): x: float; u: Wave
class Renamed(NamedTuple): u: Power
class Quoted(NamedTuple): u: "kind.Wave"
class Noted(NamedTuple): u: Annotated[kind.Wave, "forward"]
class Inherited(Named): "Without fields of its own."

def inner():
    from teleop import kind as kinds
    class Sample(NamedTuple): x: float
    class Inner(NamedTuple): u: kinds.Wave; s: Sample
    return Inner

Inner = inner()
'''
SAMPLES = '''
from collections import namedtuple
from typing import NamedTuple
from teleop import kind
Wave = float

class Own(NamedTuple): u: Wave
class Called(NamedTuple): Wave: float
class Unknown(NamedTuple): u: "NowhereWave"
class All(NamedTuple): u: kind.Wave; E: kind.Total; x: kind.Sample; v: float
Bare = namedtuple("Bare", "u w")
'''
LAW = '''
from dataclasses import dataclass
from typing import NamedTuple
from teleop import Wave, kind

class Forth(NamedTuple): u: kind.Wave
class Back(NamedTuple): w: kind.Wave

@dataclass(frozen=True, kw_only=True)
class Mine(Wave):
    def master_start(self, at): return (), Back(0.0)
    def slave_start(self, at): return Wave.slave_start(self, at)[0], Forth(0.0)
    def master(self, s, at, rx):
        force, message, s = Wave.master(self, s, at, rx)
        return force, Forth(message.u), s
    def slave(self, s, at, rx):
        force, message, s = Wave.slave(self, s, at, rx)
        return force, Back(message.w), s
'''
FUTURE = "from __future__ import annotations\n"


def module(folder: Path, source: str) -> Any:
    path = folder / "own.py"
    path.write_text(source)
    return own_module(path, "messages", "")


@pytest.mark.parametrize("first", ["", FUTURE])
def test_a_wave_is_found_with_and_without_annotations_as_text(first: str, tmp_path: Path) -> None:
    """Without the import of annotations from __future__ no field was a wave, and a law of ones own was refused."""
    messages = module(tmp_path, first + MESSAGES)
    for name in ("Named", "Imported", "Renamed", "Quoted", "Noted", "Inherited", "Inner"):
        assert waves(getattr(messages, name)) == ("u",), name
    samples = module(tmp_path, first + SAMPLES)
    for name in ("Own", "Called", "Unknown", "Bare"):  # they are only called so
        assert wave(getattr(samples, name)) is None, name
    assert kinds(samples.All) == {"u": "wave", "E": "total", "x": "sample", "v": "sample"}
    (tmp_path / "mine.py").write_text(first + LAW)
    assert load_scene("hard_wall", law=file_law(str(tmp_path / "mine.py"))()).has_waves
