"""How laws are found and named, and how their lines say what they read."""

from __future__ import annotations

import importlib.metadata
import subprocess
import sys
from dataclasses import dataclass, replace
from math import inf
from types import SimpleNamespace
from typing import Any

import pytest

from teleop import Refused, load_scene, run
from teleop.law import BUILT_IN, At, find_law, known_laws, law_name, messages, reads, start_at
from teleop.laws import direct, pfra, wave


@pytest.mark.parametrize(("name", "kind"), [("wave", wave.Wave), ("pfra", pfra.PFRA), ("direct", direct.Direct)])
def test_a_law_is_found_by_its_name_and_knows_it(name: str, kind: type) -> None:
    assert find_law(name) is kind
    assert law_name(kind()) == name


def plugin(name: str, value: str) -> Any:
    return lambda group: [SimpleNamespace(name=name, value=value)] if group == "teleop.laws" else []


def test_a_plug_ins_law_is_found_by_its_entry_point(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.metadata, "entry_points", plugin("stiff", "teleop.laws.direct:Direct"))
    assert find_law("stiff") is direct.Direct
    assert set(known_laws()) == {"stiff", *BUILT_IN}


def test_a_plug_in_does_not_replace_a_built_in_law(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.metadata, "entry_points", plugin("wave", "nowhere:Nothing"))
    assert find_law("wave") is wave.Wave
    assert known_laws()["wave"] == BUILT_IN["wave"]


def test_listing_laws_imports_none() -> None:
    program = ("import sys; from teleop.law import known_laws; known_laws(); "
               "print([name for name in sys.modules if name.startswith('teleop.laws.')])")
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_law_that_is_not_listed_is_named_after_its_class() -> None:
    assert law_name(SimpleNamespace()) == "SimpleNamespace"


@pytest.mark.parametrize(("law", "forth", "back"), [
    (wave.Wave(), ("u",), ("w",)), (pfra.PFRA(), ("x", "v"), ("f_env",)), (direct.Direct(), ("x", "v"), ("f_env",))
])
def test_the_starts_show_what_the_packets_carry(law: Any, forth: tuple[str, ...], back: tuple[str, ...]) -> None:
    kinds = messages(law)
    assert (kinds[0]._fields, kinds[1]._fields) == (forth, back)


def test_before_the_first_tick_an_end_holds_nothing_and_heard_nothing() -> None:
    assert start_at(0.2, 0.1, 3.0, 1e-3) == At(0.2, 0.1, 3.0, 0.0, 0.0, False, inf, 1e-3, 1e-3, 1.0)


# What an end reads


@pytest.mark.parametrize(("end", "fields"), [
    (wave.Wave().master, {"v", "fresh"}),
    (wave.Wave().slave, {"x", "v", "fresh", "dt", "span", "gain"}),
    (pfra.PFRA().master_sums, {"v", "f"}),
    (pfra.PFRA().master, {"x", "v", "f"}),
    (direct.Direct().master, {"x", "v"}),
    (direct.Direct().slave, {"x", "v", "f"}),
])
def test_a_laws_lines_say_what_it_pays_for(end: Any, fields: set[str]) -> None:
    assert reads(end) == fields


def spring(at: At) -> float:
    return damper(at) + at.x


def damper(at: At) -> float:
    return at.v if at.v > 0.0 else spring(at)


def test_the_plain_functions_that_it_calls_count_even_in_a_circle() -> None:
    assert reads(lambda s, at, rx: (spring(at), rx, s)) == {"x", "v"}


def test_so_do_comprehensions_and_lambdas_in_every_version_of_python() -> None:
    def end(s: Any, at: At, rx: Any) -> Any:
        late = max(rx, key=lambda k: k * at.age)
        return sum(k * at.f for k in rx) + late, [at.dx for _ in rx], s

    assert reads(end) == {"age", "f", "dx"}


@dataclass(frozen=True, kw_only=True)
class Inherits(wave.Wave):
    """A law that has another as its base class."""

    def slave(self, s: wave.WaveSlave, at: At, rx: wave.Forth) -> tuple[float, wave.Back, wave.WaveSlave]:
        return super().slave(s, at, rx)


@dataclass(frozen=True, kw_only=True)
class Names(wave.Wave):
    """A law that names the class of another."""

    def slave(self, s: wave.WaveSlave, at: At, rx: wave.Forth) -> tuple[float, wave.Back, wave.WaveSlave]:
        return Base.slave(self, s, at, rx)


@dataclass(frozen=True, kw_only=True)
class Keeps(wave.Wave):
    """A law that keeps another."""

    inner: wave.Wave = wave.Wave()

    def slave(self, s: wave.WaveSlave, at: At, rx: wave.Forth) -> tuple[float, wave.Back, wave.WaveSlave]:
        return self.inner.slave(s, at, rx)


Base = wave.Wave


@pytest.mark.parametrize(("law", "fields"), [
    (Names(), {"x", "v", "fresh", "dt", "span", "gain"}), (Inherits(), {*At._fields} - {"f"}),
    (Keeps(), {*At._fields} - {"f"})])
def test_a_law_that_calls_the_same_end_of_another_is_told_what_that_one_reads(law: Any, fields: set[str]) -> None:
    """It was told no span, and its first force was NaN."""
    assert reads(law.slave) == fields
    scene = load_scene("canonical", law=wave.Wave(), left_out=0.1, duration=0.2)
    here, there = run(replace(scene, law=law)).trace, run(scene).trace
    assert list(here["f_s"]) == list(there["f_s"])


def test_what_is_no_plain_function_reads_nothing() -> None:
    assert reads(len) == frozenset()


def test_the_installed_packages_are_looked_through_once_for_many_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def entry_points(group: str) -> Any:
        asked.append(group)
        return plugin("stiff", "teleop.laws.direct:Direct")(group)

    monkeypatch.setattr(importlib.metadata, "entry_points", entry_points)
    assert [find_law("stiff") for _ in range(5)] == [direct.Direct] * 5
    assert asked == ["teleop.laws"]


def test_a_package_that_was_installed_in_the_meantime_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    offered: list[Any] = []
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: list(offered))  # noqa: ARG005
    with pytest.raises(Refused, match="there is no law 'stiff'"):
        find_law("stiff")
    offered += plugin("stiff", "teleop.laws.direct:Direct")("teleop.laws")
    assert find_law("stiff") is direct.Direct
