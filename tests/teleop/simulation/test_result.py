"""What a run leaves: a summary that JSON can hold, a trace, and both read back as they were."""

from __future__ import annotations

import json
import pickle
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from teleop import Refused, Result, load_result, load_scene, run
from teleop.simulation.metrics import UNITS
from teleop.simulation.plan import Packets
from teleop.simulation.result import parameters
from teleop.terminal.run_table import table


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
        assert told["law"]["name"] == "pfra"  # type: ignore[index]
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
