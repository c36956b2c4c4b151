"""Runs in virtual time beside an independent reference, runs that go wrong, and what a run leaves."""

from __future__ import annotations

import json
import pickle
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import count, pairwise
from math import pi, sin, sqrt
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from scipy.linalg import expm

import teleop.simulation.bodies
from channel import Bernoulli, Delay, Link, UniformJitter
from master.hand import Grip, Rest
from slave import Tissue
from teleop import Direct, MassDamper, Refused, Result, Scene, Wave, load_result, load_scene, run
from teleop.analysis.precision.reference.reference import settle
from teleop.physics.sdirk import WALL
from teleop.simulation.metrics import UNITS
from teleop.simulation.plan import Packets
from teleop.simulation.prepared import prepare
from teleop.simulation.result import parameters
from teleop.simulation.virtual import run_prepared
from teleop.terminal.run_table import table

ROUGH = Delay(0.02) | UniformJitter(0.02) | Bernoulli(0.2)


def same(one: Any, other: Any) -> bool:
    """Are two runs the same to the bit, in all that they recorded?"""
    return list(one.trace) == list(other.trace) and all(
        np.array_equal(one.trace[name], other.trace[name], equal_nan=True) for name in one.trace
    )


def test_the_name_of_a_scene_in_place_of_a_scene_is_answered_with_how_to_load_it() -> None:
    with pytest.raises(Refused, match=r"give run a Scene, not 'canonical'; .* run\(load_scene\('canonical'\)\)"):
        run("canonical")


# A scene worked out once


def test_every_part_is_made_once_and_a_run_builds_the_slave_once(monkeypatch: pytest.MonkeyPatch) -> None:
    built = []
    build = teleop.simulation.bodies._slave

    def counted(*given: object) -> object:
        built.append(given)
        return build(*given)

    monkeypatch.setattr(teleop.simulation.bodies, "_slave", counted)
    prepared = prepare(load_scene("canonical", duration=0.2))
    assert run_prepared(prepared).status == "ok"
    assert len(built) == prepared.scene.axes
    for part in ("bodies", "slaves", "reference", "starts", "numbers", "loop"):
        assert getattr(prepared, part) is getattr(prepared, part), part
    assert prepared.bodies.slaves is prepared.slaves


def test_a_prepared_scene_runs_again_and_again_with_the_bits_of_a_run() -> None:
    scene = load_scene("canonical", duration=0.2, link=ROUGH)
    prepared, once = prepare(scene), run(scene, seed=3)
    for _ in range(2):
        again = run_prepared(prepared, seed=3)
        assert same(again, once)
        assert (again.metrics, again.sentence, again.packets) == (once.metrics, once.sentence, once.packets)


# Seeds


def test_a_seed_of_any_kind_draws_the_link_and_nothing_else() -> None:
    rough, constant = load_scene("canonical", duration=0.5, link=ROUGH), load_scene("canonical", duration=0.5)
    runs = [run(rough, seed=seed) for seed in (7, 1, 2**64 - 1)]
    assert not any(same(one, other) for one, other in pairwise(runs))
    assert same(run(constant, seed=0), run(constant, seed=9))
    for kind in (np.int64, np.uint64, np.uint8):
        got = run(rough, seed=kind(7))
        assert same(runs[0], got), kind
        assert type(got.seed) is int, kind


def test_what_is_no_seed_is_refused() -> None:
    wrong: tuple[Any, ...] = (-1, 2**64, 1.0, True, "1", None)
    for seed in wrong:
        with pytest.raises(Refused, match=r"seed must be a whole number .* write --seed 1"):
            pytest.fail(f"{seed!r}: {run(load_scene('canonical', duration=0.01), seed=seed)}")


# Delays


@pytest.mark.parametrize(("dt", "delay", "ticks"), [
    (1e-3, 0.05, 50), (1e-3, 0.0501, 51), (1e-3, 0.0499, 50), (0.7e-3, 0.07, 100), (0.01, 0.3, 30), (1e-3, 0.0, 1),
])
def test_a_delay_is_whole_ticks_rounded_up_at_every_tick(dt: float, delay: float, ticks: int) -> None:
    trace = run(load_scene("canonical", dt=dt, delay=delay, duration=1500 * dt)).trace
    k = np.arange(1500)
    for seq in ("seq_m", "seq_s"):
        assert np.array_equal(trace[seq], np.where(k >= ticks, k - ticks, -1))


def test_each_direction_has_its_own_delay() -> None:
    scene = load_scene("canonical", duration=0.3)
    trace = run(replace(scene, link=Link(fwd=Delay(0.03), bwd=Delay(0.11)))).trace
    assert trace["seq_s"][200] == 170
    assert trace["seq_m"][200] == 90


# Status


def test_a_run_that_ends_says_so_counts_its_packets_and_has_the_time_of_its_clock() -> None:
    ticking = count(0, 2_500_000_000)
    got = run(load_scene("canonical", duration=0.2), clock=lambda: next(ticking))
    assert (got.status, got.ticks, got.mode, got.run_time) == ("ok", 200, "virtual", 2.5)
    assert got.sentence == "ran to its end, 200 ticks of 0.001 s"
    for way in ("fwd", "bwd"):
        counts = got.packets[way]
        assert (counts.sent, counts.received, counts.in_flight, counts.lost) == (200, 150, 50, 0)
    bare = run(replace(load_scene("canonical", duration=0.2), link=None))
    assert (bare.packets["fwd"].sent, bare.packets["fwd"].received, bare.packets["fwd"].in_flight) == (200, 199, 1)
    assert bare.run_time is None


UNSTABLE = Scene(
    law=Direct(K=2000.0, B=8.0, kf=3.0), master=MassDamper(mass=0.04, damping=0.8), link=Delay(0.05),
    slave=MassDamper(mass=0.04, damping=0.8), environment=Tissue(k=2000.0, d=0.0), start_m=1e-3, duration=60.0,
    hand=Grip(mass=0.0, k=100.0, d=2.0, reference=Rest()), x_limit=1e3, energy=True,
)


def test_a_run_that_diverges_ends_early_and_says_when_and_what() -> None:
    got = run(UNSTABLE)
    assert got.status == "diverged"
    assert 100 < got.ticks < UNSTABLE.ticks
    assert all(len(column) == got.ticks for column in got.trace.values())
    when = f"diverged at t = {(got.ticks - 1) * 1e-3:g} s (tick {got.ticks - 1}): "
    assert got.sentence.startswith(when)
    rest = got.sentence.removeprefix(when)
    assert rest in {f"{name} passed 1000 m; a smaller dt, gain or delay may hold it" for name in ("x_m", "x_s")}
    assert np.abs(got.trace["x_m"]).max() < 1e3  # the record ends before the limit was passed


# The canonical scene against an independent reference: its equations, and integrators made by others


@dataclass
class Reference:
    """The canonical scene as its equations say, by general-purpose integrators.

    The gripped master goes by a matrix exponential of the whole state (x, v, x_ref, v_ref, f), the slave by
    DOP853 with the changes of contact located as events; waves go through plain lists. Nothing of the stack's own
    steps is used.
    """

    b: float = 2.0
    K: float = 500.0
    B: float = 20.0
    delay: int = 50
    dt: float = 1e-3

    k_e: ClassVar[float] = 5000.0
    d_e: ClassVar[float] = 5.0
    at: ClassVar[float] = 0.03

    def __post_init__(self) -> None:
        M, b_m, k_h, d_h = 0.1 + 0.4, 0.5, 200.0, 5.0
        rates = np.zeros((5, 5))
        rates[0, 1] = rates[2, 3] = 1.0
        rates[1] = np.array([-k_h, -(d_h + b_m), k_h, d_h, -1.0]) / M
        self.master_step = expm(rates * self.dt)
        self.contacts = 0

    def slave_step(self, x: float, v: float, f: float) -> tuple[float, float]:
        """0.5 kg and 1 N s/m beside a wall that cannot pull, f held."""
        wall = (WALL, 0.5, 1.0, self.k_e, self.d_e, 1.5, 0.0, 0.0)
        p, u, changes = settle(wall, float(x) - self.at, float(v), float(f), 0.0, self.dt, "DOP853")
        self.contacts += changes
        return self.at + p, u

    def run(self, ticks: int) -> dict[str, np.ndarray]:
        root, b, K, B, dt = sqrt(2.0 * self.b), self.b, self.K, self.B, self.dt
        x_m = v_m = x_s = v_s = x_d = 0.0
        u_sent, w_sent = [0.0] * self.delay, [0.0] * self.delay
        rows = []
        for k in range(ticks):
            w_m, u_s = w_sent[k], u_sent[k]
            f_m = b * v_m - root * w_m
            u_sent.append(root * v_m - w_m)
            v_d = (root * u_s - K * (x_d - x_s) + B * v_s) / (b + B + K * dt)
            x_d += dt * v_d
            f_s = root * u_s - b * v_d
            w_sent.append(u_s - sqrt(2.0 / b) * f_s)
            rows.append((x_m, v_m, f_m, x_s, v_s, f_s))
            r0, r1 = (0.05 * sin(2.0 * pi * dt * j) for j in (k, k + 1))
            x_m, v_m, *_ = self.master_step @ [x_m, v_m, r0, (r1 - r0) / dt, f_m]
            x_s, v_s = self.slave_step(x_s, v_s, f_s)
        return dict(zip(("x_m", "v_m", "f_m", "x_s", "v_s", "f_s"), np.array(rows).T, strict=True))


@pytest.mark.parametrize("reference", [Reference(), *[pytest.param(each, marks=pytest.mark.full) for each in (
    Reference(b=0.5, K=4000.0, B=30.0, delay=7), Reference(b=4.0, K=200.0, B=5.0, delay=1))]])
def test_the_canonical_scene_is_what_its_equations_say(reference: Reference) -> None:
    want = reference.run(2000)
    law = Wave(b=reference.b, K=reference.K, B=reference.B)
    got = run(load_scene("canonical", duration=2.0, law=law, delay=reference.delay * 1e-3)).trace
    assert reference.contacts >= 4
    assert got["f_env"].max() > 0.5
    assert got["f_env"].min() == 0.0  # it cannot pull
    for name, scale in (("x_m", 1.0), ("v_m", 10.0), ("f_m", 10.0), ("x_s", 1.0), ("v_s", 100.0), ("f_s", 100.0)):
        assert np.abs(got[name] - want[name]).max() < 1e-11 * scale, name


@pytest.fixture(scope="module")
def wan() -> Result:
    return run(load_scene("jittery_wan", duration=0.3), seed=3)


class TestSummary:
    def test_has_what_makes_the_run_again_and_a_unit_for_every_figure(self, wan: Result) -> None:
        summary = wan.summary(["teleop", "run"])
        assert summary["command"] == ["teleop", "run"]
        assert (summary["scene"], summary["seed"], summary["dt"], summary["ticks"]) == ("jittery_wan", 3, 1e-3, 300)
        assert summary["parameters"]["law"] == {"name": "wave", "b": 2.0, "K": 500.0, "B": 20.0}
        assert summary["parameters"]["duration"] == 0.3
        assert set(summary["versions"]) == {"bilateral-teleop", "python", "numpy"}
        for name, entry in wan.summary()["metrics"].items():
            assert entry == {"value": wan.metrics[name], "unit": UNITS[name]}

    def test_is_strict_json_even_where_a_scene_has_an_infinite_knob(self) -> None:
        scene = load_scene("canonical", duration=0.05)
        scene = replace(scene, knobs={**scene.knobs, "slew": float("inf"), "file": Path("a/b"), "none": None})
        told = json.loads(json.dumps(run(scene).summary(), allow_nan=False))["parameters"]
        assert (told["slew"], told["file"], told["none"]) == ("inf", "a/b", None)

    def test_of_a_diverged_run_has_only_finite_figures(self) -> None:
        result = run(load_scene("canonical", **{"law": "direct", "law.K": 1e9}))
        assert result.status == "diverged"
        assert result.ticks < 10_000
        assert all(np.isfinite(list(result.metrics.values())))
        json.dumps(result.summary(), allow_nan=False)


    def test_tells_of_a_number_that_is_not_finite_as_a_text_and_is_read_back(self, wan: Result, tmp_path: Path) -> None:
        """The summary was a traceback instead: JSON has no such number."""
        extra = {"stamp_margin": -np.inf, "ages": (1.0, np.nan), "deep": [{"f": np.float64(np.inf)}]}
        replace(wan, extra=extra).save(tmp_path / "run")
        read = load_result(tmp_path / "run")
        assert read.extra == {"stamp_margin": "-inf", "ages": [1.0, "nan"], "deep": [{"f": "inf"}]}
        assert read.metrics == wan.metrics

    def test_names_the_metrics_that_are_not_finite_in_a_note(self, tmp_path: Path) -> None:
        result = run(load_scene("canonical", duration=0.4, **{"law.b": 1e200, "law.K": 1e300}))
        told = [note for note in result.notes if note.startswith("not finite, and so left out of the metrics: ")]
        assert len(told) == 1
        assert told[0].endswith("metrics: f_err_rms")
        assert "f_err_rms" not in result.metrics
        assert load_result(result.save(tmp_path / "run").path or "").notes == result.notes


def test_without_a_link_one_message_is_always_under_way() -> None:
    counts = Packets.without_link(10)
    assert (counts.sent, counts.received, counts.in_flight) == (10, 9, 1)
    assert Packets.without_link(0) == Packets()


class TestParameters:
    def test_keep_numbers_texts_and_truths_and_write_the_rest_out(self) -> None:
        told = parameters(load_scene("jittery_wan", law="pfra"))
        assert told["law"]["name"] == "pfra"
        assert re.fullmatch(r"Fixed\(delay=0.065, gaps=Integral\(.*\)\)", str(told["playout"]))
        assert told["energy"] is True


class TestStored:
    def test_reads_back_as_it_was(self, wan: Result, tmp_path: Path) -> None:
        saved = wan.save(tmp_path / "run", ["teleop"])
        read = load_result(tmp_path / "run")
        assert saved.path == read.path == tmp_path / "run"
        for field in ("scene", "seed", "mode", "status", "sentence", "ticks", "dt", "metrics", "packets", "notes"):
            assert getattr(read, field) == getattr(wan, field), field
        assert read.trace.keys() == wan.trace.keys()
        for name, column in wan.trace.items():
            np.testing.assert_array_equal(read.trace[name], column)
            assert read.trace[name].dtype == column.dtype

    def test_keeps_what_only_a_live_run_knows_beside_an_archive_that_numpy_reads_alone_with_time_first(
        self, wan: Result, tmp_path: Path
    ) -> None:
        replace(wan, extra={"master": {"skipped": 3}}).save(tmp_path / "run")
        assert load_result(tmp_path / "run").extra == {"master": {"skipped": 3}}
        with np.load(tmp_path / "run" / "trace.npz", allow_pickle=False) as arrays:
            assert arrays.files == list(wan.trace)
            assert arrays.files[0] == "t"

    BROKEN: ClassVar[tuple[Callable[[Path], object], ...]] = (
        lambda folder: (folder / "summary.json").unlink(),
        lambda folder: (folder / "trace.npz").unlink(),
        lambda folder: (folder / "summary.json").write_text("{"),
        lambda folder: (folder / "summary.json").write_text("[]"),
        lambda folder: (folder / "summary.json").write_text('{"status": "ok"}'),
        lambda folder: (folder / "summary.json").write_bytes(b"\xff\xfe\x00"),
        lambda folder: (folder / "trace.npz").write_bytes(b""),
        lambda folder: (folder / "trace.npz").write_bytes(b"garbage"),
        lambda folder: (folder / "trace.npz").write_bytes((folder / "trace.npz").read_bytes()[:-100]),
        lambda folder: np.save(folder.joinpath("trace.npz").open("wb"), np.zeros(3)),
    )

    def test_refuses_what_is_no_complete_run(self, wan: Result, tmp_path: Path) -> None:
        for n, break_it in enumerate(self.BROKEN):
            wan.save(tmp_path / str(n))
            break_it(tmp_path / str(n))
            with pytest.raises(Refused, match="holds no complete run"):
                pytest.fail(f"{n}: {load_result(tmp_path / str(n))}")

    @pytest.mark.parametrize("name", ["summary.json", "trace.npz"])
    def test_the_refusal_of_a_folder_with_a_link_in_it_did_not_say_which_file_that_is(
        self, wan: Result, tmp_path: Path, name: str
    ) -> None:
        wan.save(tmp_path / "run")
        (tmp_path / "run" / name).rename(tmp_path / name)
        (tmp_path / "run" / name).symlink_to(tmp_path / name)
        with pytest.raises(Refused, match=rf"holds no complete run \({name}: it is a link, not a file\)"):
            load_result(tmp_path / "run")

    def test_written_into_a_folder_of_links_leaves_what_they_lead_to_alone(self, wan: Result, tmp_path: Path) -> None:
        (tmp_path / "precious").write_bytes(b"precious")
        folder = tmp_path / "run"
        folder.mkdir()
        for name in ("trace.npz", "summary.json"):
            (folder / name).symlink_to("../precious")
        wan.write(folder)
        assert (tmp_path / "precious").read_bytes() == b"precious"
        assert load_result(folder).ticks == wan.ticks

    def test_with_an_estimate_that_is_not_finite_is_read_and_told_like_any_other(
        self, wan: Result, tmp_path: Path
    ) -> None:
        own = {"error_estimate_max": float("inf"), "error_estimate_sum": float("nan"), "substeps_max": 3,
               "ticks_over_tolerance": 1, "tolerance": 1e-9}
        replace(wan, extra={"integration": {"slave": own}}).save(tmp_path / "run")
        assert "error estimated at inf m a tick (nan m added up)" in table(load_result(tmp_path / "run"))


class TestInPython:
    def test_prints_in_one_line_and_is_a_table_in_a_notebook_that_runs_nothing(self, wan: Result) -> None:
        assert repr(wan) == "Result(jittery_wan, law wave(b=2, K=500, B=20), virtual: ok, 300 ticks of 0.001 s)"
        page = replace(wan, notes=("<script>",))._repr_html_()
        assert f"<th>x_err_rms</th><td>{wan.metrics['x_err_rms']:.4g} m</td>" in page
        assert "<th>note</th><td>&lt;script&gt;</td>" in page

    def test_has_its_strips_in_a_notebook_and_a_sentence_where_matplotlib_is_missing(
        self, wan: Result, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        pytest.importorskip("matplotlib")
        assert wan._repr_html_().count("<svg") >= 3
        assert replace(wan, trace={})._repr_html_().startswith("<table>")
        monkeypatch.setattr("teleop.terminal.plotting.find_spec", lambda _: None)
        page = wan._repr_html_()
        assert "<svg" not in page
        assert "Strips over time need matplotlib: pip install" in page
        assert "<table>" in page

    def test_a_misspelt_name_names_the_nearest_also_of_a_result_that_was_read_or_pickled(
        self, wan: Result, tmp_path: Path
    ) -> None:
        for result in (wan, load_result(wan.save(tmp_path / "run").path or tmp_path), pickle.loads(pickle.dumps(wan))):
            with pytest.raises(KeyError, match="there is no metric 'x_err_rm'; did you mean x_err_rms"):
                result.metrics["x_err_rm"]
            with pytest.raises(KeyError, match=r"there is no column of this run 'f_mm'; did you mean f_m\?"):
                result.trace["f_mm"]
            assert "f_mm" not in result.trace
