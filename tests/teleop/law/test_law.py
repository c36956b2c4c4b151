"""How laws are found and named, what their lines say that they read, and what they are told of time and gain."""

# ruff: noqa: ARG005 - an end takes what it is given, used or not

from __future__ import annotations

import importlib.metadata
import subprocess
import sys
from dataclasses import dataclass, replace
from math import inf
from types import SimpleNamespace
from typing import Any, NamedTuple

import pytest

from teleop import At, Refused, Scene, Watchdog, load_scene, run
from teleop.analysis.models.linear import linear_scene
from teleop.law import BUILT_IN, find_law, known_laws, law_name, messages, reads, start_at
from teleop.laws import direct, pfra, wave
from teleop.simulation.source import rendered
from tests.fakes import law_of


def test_listing_laws_imports_none() -> None:
    program = ("import sys; from teleop.law import known_laws; known_laws(); "
               "print([name for name in sys.modules if name.startswith('teleop.laws.')])")
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize(("name", "kind", "forth", "back"), [
    ("wave", wave.Wave, ("u",), ("w",)), ("pfra", pfra.PFRA, ("x", "v"), ("f_env",)),
    ("direct", direct.Direct, ("x", "v"), ("f_env",))])
def test_a_law_is_found_by_its_name_knows_it_and_its_starts_show_what_the_packets_carry(
        name: str, kind: type, forth: tuple[str, ...], back: tuple[str, ...]) -> None:
    assert find_law(name) is kind
    assert law_name(kind()) == name
    assert tuple(message._fields for message in messages(kind())) == (forth, back)
    assert law_name(SimpleNamespace()) == "SimpleNamespace", "one that is not listed is named after its class"
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


def test_plain_functions_that_it_calls_count_even_in_a_circle_and_so_do_comprehensions_and_lambdas() -> None:
    def end(s: Any, at: At, rx: Any) -> Any:
        late = max(rx, key=lambda k: k * at.age)
        return sum(k * at.f for k in rx) + late, [at.dx for _ in rx], s

    assert reads(end) == {"age", "f", "dx"}
    assert reads(lambda s, at, rx: (spring(at), rx, s)) == {"x", "v"}
    assert reads(len) == frozenset(), "what is no plain function reads nothing"


@dataclass(frozen=True, kw_only=True)
class Inherits(wave.Wave):
    def slave(self, s: wave.WaveSlave, at: At, rx: wave.Forth) -> tuple[float, wave.Back, wave.WaveSlave]:
        return super().slave(s, at, rx)


@dataclass(frozen=True, kw_only=True)
class Names(wave.Wave):
    def slave(self, s: wave.WaveSlave, at: At, rx: wave.Forth) -> tuple[float, wave.Back, wave.WaveSlave]:
        return Base.slave(self, s, at, rx)


@dataclass(frozen=True, kw_only=True)
class Keeps(wave.Wave):
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


def test_a_plug_ins_law_is_found_by_its_entry_point_also_one_installed_meanwhile_and_replaces_no_built_in_law(
        monkeypatch: pytest.MonkeyPatch) -> None:
    """The installed packages are looked through once for many rows."""
    offered: list[Any] = []
    asked: list[str] = []
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: (asked.append(group), list(offered))[1])
    with pytest.raises(Refused, match="there is no law 'stiff'"):
        find_law("stiff")
    offered += [SimpleNamespace(name="stiff", value="teleop.laws.direct:Direct"),
                SimpleNamespace(name="wave", value="nowhere:Nothing")]
    asked.clear()
    assert [find_law("stiff") for _ in range(5)] == [direct.Direct] * 5
    assert asked == ["teleop.laws"]
    assert find_law("wave") is wave.Wave
    assert known_laws() == {**BUILT_IN, "stiff": known_laws()["stiff"]}


# What a law is told of the time since its last tick, and of the watchdog's gain at that tick


class Place(NamedTuple):
    x: float  # m


class Meter(NamedTuple):
    x: float  # m
    time: float  # s of the run, as the spans add up
    gains: float  # sum of the gains


def told(self: Any, s: Meter, at: At, rx: Place, sign: float) -> tuple[float, Place, Meter]:
    now = Meter(at.x, s.time + at.span, s.gains + at.gain)
    f = sign * self.K * (at.x - rx.x) + (sign - 1.0) * 2.0 * at.v + now.time + sign * 0.01 * now.gains
    return f, Place(at.x), now


Timed = law_of(  # position coupling that shows in its forces what it is told of time and gain
    name="Timed", master_start=lambda self, at: (Meter(at.x, 0.0, 0.0), Place(at.x)),
    slave_start=lambda self, at: (Meter(at.x, 0.0, 0.0), Place(at.x)),
    master=lambda self, s, at, rx: told(self, s, at, rx, 1.0),
    slave=lambda self, s, at, rx: told(self, s, at, rx, -1.0))


def timed() -> Scene:
    """A scene whose watchdog lets go and takes hold again."""
    scene = load_scene("canonical", law=Timed(K=200.0), link="delay(0.01) | blackout(0.1, 0.1)")
    return replace(scene, duration=0.4, watchdog=Watchdog(timeout=0.02, ramp=0.01, settle=0.02))


def probe(end: str, spans: list[float], gains: list[float]) -> Any:
    """`Timed` that writes down the spans and gains of each tick of an end."""
    own = getattr(Timed, end)

    def asked(self: Any, s: Meter, here: At, rx: Place) -> Any:
        spans.append(here.span)
        gains.append(here.gain)
        return own(self, s, here, rx)

    parts: dict[str, Any] = {end: asked}
    return law_of(Timed, **parts)(K=200.0)


@pytest.mark.parametrize("end", ["master", "slave"])
def test_in_virtual_time_span_is_the_tick_and_gain_is_that_of_the_tick_before_or_one(end: str) -> None:
    spans: list[float] = []
    gains: list[float] = []
    scene = replace(timed(), law=probe(end, spans, gains))
    recorded = run(scene).trace[f"g_{end[0]}"]  # the contract asks the law for a few ticks before the run does
    assert set(spans[-scene.ticks:]) == {scene.dt}
    assert gains[-scene.ticks:] == [1.0, *recorded[:-1].tolist()]
    assert 0.0 in gains
    assert gains[-1] == 1.0
    gains.clear()
    run(replace(scene, watchdog=None))
    assert set(gains) == {1.0}


def test_a_law_that_names_neither_has_no_line_for_them_and_the_linear_steps_have_the_tick_for_span() -> None:
    """Each end adds up its spans: an eigenvalue of one, and a constant force, which drops out."""
    text = rendered(load_scene("canonical", law="direct"))
    assert "dt, nan, nan))" in text
    assert "span" not in text
    scene = replace(load_scene("soft_tissue", law=Timed(K=200.0)), cap=None, watchdog=None)
    assert linear_scene(scene).slave.A.shape[0] > 3
