"""The kinds of message fields are found however a message type is written down."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from teleop import load_scene
from teleop.kind import kinds, wave, waves
from teleop.scene.library import file_law, own_module

MESSAGES = '''
from collections import namedtuple
from typing import Annotated, NamedTuple

from teleop import kind
from teleop.kind import Wave
from teleop.kind import Wave as Power


class Named(NamedTuple):
    u: kind.Wave
    x: float = 0.0


class Imported(NamedTuple):
    x: float
    u: Wave


class Renamed(NamedTuple):
    u: Power


class Quoted(NamedTuple):
    u: "kind.Wave"


class Noted(NamedTuple):
    u: Annotated[kind.Wave, "forward"]


class Inherited(Named):
    """Without fields of its own."""


def inner():
    from teleop import kind as kinds

    class Sample(NamedTuple):
        x: float

    class Inner(NamedTuple):
        u: kinds.Wave
        s: Sample

    return Inner


Inner = inner()
'''
SAMPLES = '''
from collections import namedtuple
from typing import Annotated, NamedTuple

Wave = float


class Own(NamedTuple):
    u: Wave


class Called(NamedTuple):
    Wave: float


class Unknown(NamedTuple):
    u: "NowhereWave"


Bare = namedtuple("Bare", "u w")
'''
LAW = '''
from dataclasses import dataclass
from typing import NamedTuple

from teleop import Wave
from teleop import kind


class Forth(NamedTuple):
    u: kind.Wave


class Back(NamedTuple):
    w: kind.Wave


@dataclass(frozen=True, kw_only=True)
class Mine(Wave):
    def master_start(self, at):
        return (), Back(0.0)

    def slave_start(self, at):
        return Wave.slave_start(self, at)[0], Forth(0.0)

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
@pytest.mark.parametrize("name", ["Named", "Imported", "Renamed", "Quoted", "Noted", "Inherited", "Inner"])
def test_a_wave_is_found_with_and_without_annotations_as_text(first: str, name: str, tmp_path: Path) -> None:
    """Without the import of annotations from __future__ no field was a wave."""
    assert waves(getattr(module(tmp_path, first + MESSAGES), name)) == ("u",)


@pytest.mark.parametrize("first", ["", FUTURE])
@pytest.mark.parametrize("name", ["Own", "Called", "Unknown", "Bare"])
def test_what_is_only_called_wave_is_none(first: str, name: str, tmp_path: Path) -> None:
    assert wave(getattr(module(tmp_path, first + SAMPLES), name)) is None


@pytest.mark.parametrize("first", ["", FUTURE])
def test_what_declares_nothing_is_a_sample(first: str, tmp_path: Path) -> None:
    own = module(tmp_path, f"""{first}
from typing import NamedTuple
from teleop import kind

class All(NamedTuple):
    u: kind.Wave
    E: kind.Total
    x: kind.Sample
    v: float
""")
    assert kinds(own.All) == {"u": "wave", "E": "total", "x": "sample", "v": "sample"}


@pytest.mark.parametrize("first", ["", FUTURE])
def test_a_law_of_ones_own_has_waves_with_and_without_annotations_as_text(first: str, tmp_path: Path) -> None:
    """It was refused: its message has no field that is a wave, write `u: kind.Wave`, which it did."""
    (tmp_path / "mine.py").write_text(first + LAW)
    assert load_scene("hard_wall", law=file_law(str(tmp_path / "mine.py"))()).has_waves
