"""The whole of a Z-width: its rows, what an interrupt keeps, the JSON, the figures, and wrong requests."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import teleop.analysis.zwidth.assess
import teleop.analysis.zwidth.report
import teleop.terminal.answer
from teleop import Refused, Scene, load_scene
from teleop.analysis.models.by_axis import along
from teleop.analysis.zwidth.assess import ZWidth, assess, levers, span
from teleop.analysis.zwidth.plane import Span
from teleop.analysis.zwidth.report import PLOTS, format_value, numbers, ratios, summary, table
from teleop.storage.strict_json import write_document

Typed = Callable[..., Any]
LEVERS = ["as it is", "damping x2", "encoder", "rate x2", "velocity filter", "virtual coupling",
          "passivity controller", "electrical damping"]


@pytest.fixture(scope="module")
def found() -> ZWidth:
    """That of the built-in wall, its runs in virtual time an eighth as long, its edges at rest to 1.4 %."""
    with pytest.MonkeyPatch.context() as patch:
        for name, shorter in (("LASTING", 0.2), ("TICKS", (200, 20_000)), ("HALVED", 4)):
            patch.setattr(teleop.analysis.zwidth.assess, name, shorter)
        return assess(load_scene("virtual_wall"))


@pytest.mark.full
def test_of_several_axes_one_is_asked(found: ZWidth, monkeypatch: pytest.MonkeyPatch) -> None:
    """The second axis is the built-in wall, the first another."""
    one = load_scene("virtual_wall")
    assert one.master is not None
    two = along(replace(one, axes=2, master=(replace(one.master, mass=0.5), one.master)), "y")
    first = next(iter(levers(two)))
    monkeypatch.setattr(teleop.analysis.zwidth.assess, "levers", lambda _: iter([first]))
    assert numbers(theory(two).base)["stable_K_free"] == numbers(found.base)["stable_K_free"]


def theory(scene: Scene) -> ZWidth:
    """What is found without the runs in virtual time."""
    def until(_: float, doing: str) -> None:
        if doing.startswith("at rest"):
            raise KeyboardInterrupt

    return assess(scene, show=until)


def rows(got: ZWidth) -> dict[str, dict[str, float | None]]:
    return {row.name: numbers(row) for row in got.rows}


class TestLevers:
    def test_every_lever_is_there_the_scene_first_and_pulls_the_way_it_must(self, found: ZWidth) -> None:
        assert [row.name for row in found.rows] == LEVERS
        assert not found.interrupted
        assert numbers(found.base)["z_width_1hz"] == pytest.approx(253.809, abs=1e-3)
        assert numbers(found.base)["stable_K_free"] == pytest.approx(1605.35, abs=5e-3)
        assert [B for B, _ in found.measured] == [0.0, 0.4, 0.8, 1.6, 4.0]
        assert found.measured[0][1] == found.base.rest
        own = {row.name: ratios(row, found.base) for row in found.rows}
        assert own["damping x2"]["passive_K"] == pytest.approx(2.0)
        assert own["damping x2"]["passive_B"] == pytest.approx(2.0)
        assert own["rate x2"]["passive_K"] == pytest.approx(2.0)
        assert own["rate x2"]["passive_B"] == pytest.approx(1.0)
        assert (own["velocity filter"]["passive_B"] or 0.0) > 5.0
        assert own["encoder"]["passive_K"] == 0.0
        assert (own["encoder"]["K_at_rest"] or 1.0) < 0.9
        assert own["virtual coupling"]["passive_K"] == pytest.approx(1.0, rel=1e-4)
        assert 1.2 < (own["electrical damping"]["passive_K"] or 0.0) < 2.0
        for name in ("damping x2", "rate x2", "passivity controller", "electrical damping"):
            assert (own[name]["K_at_rest"] or 0.0) > 1.2, name

    def test_what_rests_lies_at_the_edge_of_the_linear_loop_and_of_a_passivity_controller_is_all_that_is_claimed(
        self, found: ZWidth
    ) -> None:
        own = rows(found)
        for name in ("as it is", "damping x2", "rate x2", "electrical damping", "virtual coupling"):
            assert own[name]["K_at_rest"] == pytest.approx(own[name]["stable_K"], rel=0.05), name
        row = own["passivity controller"]
        assert row["passive_K"] is row["stable_K"] is row["z_width_1hz"] is None
        assert row["K_at_rest"]

    @pytest.mark.full
    def test_an_encoder_is_made_finer_and_coarser_and_left_out(self) -> None:
        got = theory(load_scene("virtual_wall", step=2e-5, friction=0.01))
        own = rows(got)
        assert own["resolution x4"]["passive_K"] == pytest.approx(1600.0)
        assert own["resolution /4"]["passive_K"] == pytest.approx(2.0 * 0.01 / 8e-5)
        assert own["no encoder"]["passive_B"] == pytest.approx(0.8)
        assert any("its encoder, its Coulomb friction" in note for note in got.notes)
        assert any("electrical damping left out" in note for note in got.notes)

    @pytest.mark.full
    def test_a_scene_with_a_controller_has_the_row_without(self, monkeypatch: pytest.MonkeyPatch) -> None:
        scene = load_scene("encoder_wall", every=5, cap=0.8)
        own = rows(theory(scene))
        assert own["as it is"]["passive_K"] is None
        assert own["no controller"]["passive_K"] == 0.0
        both = [lever for lever in levers(scene) if lever.name in ("as it is", "no controller")]
        monkeypatch.setattr(teleop.analysis.zwidth.assess, "levers", lambda _: iter(both))
        own = rows(assess(scene, span_B=Span(0.0, 0.1)))
        assert (own["as it is"]["K_at_rest"] or 0.0) > 1.5 * (own["no controller"]["K_at_rest"] or 1e9)

    @pytest.mark.full
    def test_a_coupled_scene_is_asked_too(self, monkeypatch: pytest.MonkeyPatch) -> None:
        scene = load_scene("virtual_coupling")
        both = [lever for lever in levers(scene) if lever.name in ("as it is", "no coupling")]
        monkeypatch.setattr(teleop.analysis.zwidth.assess, "levers", lambda _: iter(both))
        own = rows(theory(scene))
        assert own["as it is"]["passive_K"] == pytest.approx(1600.0, rel=1e-4)
        assert own["no coupling"]["passive_K"] == pytest.approx(1600.0, rel=1e-6)

    def test_a_lever_that_does_not_apply_is_left_out_and_said_why(self) -> None:
        got = theory(load_scene("virtual_wall", dt=1e-6, duration=0.01, b=0.0))
        assert {"rate x2", "damping x2"}.isdisjoint(rows(got))
        assert any("rate x2 left out: dt must be at least 1e-06" in note for note in got.notes)
        assert any("damping x2 left out" in note for note in got.notes)


    def test_a_range_bounds_both_regions(self, monkeypatch: pytest.MonkeyPatch) -> None:
        first = next(iter(levers(load_scene("virtual_wall"))))
        monkeypatch.setattr(teleop.analysis.zwidth.assess, "levers", lambda _: iter([first]))
        got = assess(load_scene("virtual_wall"), span_K=Span(0.0, 3000.0), span_B=Span(0.5, 1.0))
        assert got.stable_free is not None
        assert (got.stable.B[0], got.stable.B[-1]) == (0.5, 1.0)
        assert set(got.stable.K) == {float("inf")}
        assert {B for B, _ in got.measured} == {0.0, 0.8}  # the scene's own B, and what lies in the range
        assert dict(got.measured)[0.8] == float("inf")
        told = summary(got)
        assert told["stable"]["hand"]["K"] == [None] * 41
        assert "K_at_rest" in told["levers"][0]["beyond"]
        assert "no limit" in table(got)


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs in virtual time too short to be trusted, of four levers."""
    few = list(islice(levers(load_scene("virtual_wall")), 4))
    monkeypatch.setattr(teleop.analysis.zwidth.assess, "levers", lambda _: iter(few))
    monkeypatch.setattr(teleop.analysis.zwidth.assess, "LASTING", 0.1)
    monkeypatch.setattr(teleop.analysis.zwidth.assess, "TICKS", (100, 100))


class TestInterrupt:
    @pytest.mark.parametrize("text", [
        "stable region", "at rest, damping", *(pytest.param(text, marks=pytest.mark.full)
                                               for text in ("rate x2", "at rest, B"))])
    def test_what_was_done_until_then_is_kept(self, text: str, short: None) -> None:
        def stop(_: float, doing: str) -> None:
            if doing.startswith(text):
                raise KeyboardInterrupt

        got = assess(load_scene("virtual_wall"), show=stop)
        assert got.interrupted
        assert got.base.curves.width == pytest.approx(253.809, abs=1e-3)
        assert (got.stable is None) == (text == "stable region")
        names = [row.name for row in got.rows]
        assert names == (LEVERS[:1] if text == "stable region" else LEVERS[:3] if text == "rate x2" else LEVERS[:4])
        assert len(got.measured) == (5 if "damping" in text else 0)
        told = json.loads(json.dumps(summary(got), allow_nan=False))
        assert told["status"] == "interrupted"
        assert table(got).count("interrupted") == 1

    def test_before_anything_is_done_there_is_nothing_to_keep(self) -> None:
        def stop(*_: object) -> None:
            raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            assess(load_scene("virtual_wall"), show=stop)

    @pytest.mark.full
    def test_progress_goes_from_nothing_to_all_and_never_back(self, short: None) -> None:
        parts: list[float] = []
        assess(load_scene("virtual_wall"), show=lambda *told: parts.append(told[0]))
        assert parts == sorted(parts)
        assert (parts[0], parts[-1]) == (0.0, 1.0)
        assert len(parts) > 100


class TestJson:
    def test_it_has_every_number_with_its_unit(self, found: ZWidth) -> None:
        told = json.loads(json.dumps(summary(found, ["teleop", "zwidth"]), allow_nan=False))
        assert told["status"] == "done"
        assert told["z_width_1hz"] == pytest.approx(told["z_max_1hz"] - told["z_min_1hz"])
        assert told["units"]["z_width_1hz"] == "N s/m"
        assert told["units"]["area"] == "decades x decades"
        assert told["gap"] == pytest.approx(told["area"] / 3.0)
        assert told["passive"]["corners"] == [[0.0, 0.0], pytest.approx([1600.0, 0.0]), pytest.approx([0.0, 0.8])]
        assert len(told["impedance"]["frequency"]) == len(told["impedance"]["upper"]) == len(told["impedance"]["lower"])
        assert told["parameters"]["law"]["K"] == 800.0
        assert [lever["name"] for lever in told["levers"]] == LEVERS
        assert told["levers"][1]["ratio"]["z_width_1hz"] == pytest.approx(2.0, rel=1e-3)
        assert told["stable"]["free"]["K"][0] == pytest.approx(1605.35, abs=5e-3)
        assert set(told["levers"][0]) > set(numbers(found.base))
        for key in numbers(found.base):
            assert key in told["units"], key

    def test_the_table_says_them_too_with_four_digits_and_no_exponents(self, found: ZWidth) -> None:
        text = table(found)
        for words in ("253.8", "x2", "passivity controller", "Z_max 254.6, Z_min 0.8385", "5.058", "29700"):
            assert words in text, words
        assert max(map(len, text.splitlines()[:10])) < 130
        assert [format_value(value) for value in (None, float("inf"), 0.0, 12345.6, 0.83853)] == [
            "-", "no limit", "0", "12350", "0.8385"]


def test_the_plane_is_drawn_so_that_both_regions_and_both_edges_are_seen(
    found: ZWidth, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib")
    made: list[Any] = []
    monkeypatch.setattr(teleop.analysis.zwidth.report.plot, "save", lambda figure, *_: made.append(figure) or [])
    PLOTS["plane"](found, tmp_path / "plane", ("png",))
    whole, corner = made[0].axes
    (_, B), (_, K) = corner.get_xlim(), corner.get_ylim()
    assert min(0.8 / B, 1600.0 / K) > 0.2  # K T/2 + B = b: its shares of the panel's width and height
    assert whole.get_xlim()[1] > 30.0 * B
    (frame,) = (patch for patch in whole.patches if str(patch.get_label()).startswith("the part that is shown"))
    assert (frame.get_x(), frame.get_x() + frame.get_width()) == pytest.approx(corner.get_xlim())
    assert (frame.get_y(), frame.get_y() + frame.get_height()) == pytest.approx(corner.get_ylim())
    solid, dashed = whole.get_lines()[:2]  # the dashed edge lies over the wider and paler solid one
    assert (solid.get_linestyle(), dashed.get_linestyle()) == ("-", "--")
    assert solid.get_linewidth() > 2.0 * dashed.get_linewidth()
    assert solid.get_alpha() <= 0.5


def left_by(typed: Typed, folder: str, *options: str) -> set[str]:
    """The files in the folder, and nothing beside it, after an interrupt of the command."""
    assert typed("zwidth", "virtual_wall", "--out", folder, *options).code == 130
    assert [path.name for path in Path().iterdir()] == [folder]
    return {path.name for path in Path(folder).iterdir()}


@pytest.fixture
def ctrl_c() -> Iterator[None]:
    """Ctrl-C as a process has it that was started at a terminal."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


class TestCommand:
    @pytest.fixture(autouse=True)
    def quick(self, monkeypatch: pytest.MonkeyPatch, found: ZWidth) -> None:
        """The command shows an answer that was found before."""
        monkeypatch.setattr(teleop.analysis.zwidth.report, "assess", lambda *_, **__: found)

    def test_it_leaves_a_new_folder_with_json_and_plots_and_prints_one_object(self, typed: Typed) -> None:
        pytest.importorskip("matplotlib")
        answer = typed("zwidth", "virtual_wall", "--plot")
        assert (answer.code, answer.err) == (0, "")
        assert "253.8" in answer.out
        folder = Path("runs/virtual_wall-zwidth-1")
        assert {file.name for file in folder.iterdir()} == {"summary.json", "plane.png", "impedance.png", "levers.png"}
        assert json.loads((folder / "summary.json").read_text())["command"][:2] == ["teleop", "zwidth"]
        assert json.loads(typed("zwidth", "virtual_wall", "--json", "--out", "here").out)["path"] == "here"
        assert Path("here/summary.json").is_file()

    def test_interrupted_it_leaves_what_is_done_and_says_so(
        self, typed: Typed, monkeypatch: pytest.MonkeyPatch, found: ZWidth
    ) -> None:
        part = replace(found, rows=found.rows[:1], stable=None, stable_free=None, measured=[], interrupted=True)
        monkeypatch.setattr(teleop.analysis.zwidth.report, "assess", lambda *_, **__: part)
        assert typed("zwidth", "virtual_wall", "--out", "part").code == 130
        assert json.loads(Path("part/summary.json").read_text())["status"] == "interrupted"

    def test_interrupted_while_it_draws_it_leaves_the_numbers_and_whole_plots(
        self, typed: Typed, monkeypatch: pytest.MonkeyPatch, ctrl_c: None
    ) -> None:
        pytest.importorskip("matplotlib")

        def draw(_: ZWidth, path: Path, __: object) -> list[Path]:
            signal.raise_signal(signal.SIGINT)
            path.with_suffix(".png").write_bytes(b"whole")
            return [path.with_suffix(".png")]

        monkeypatch.setitem(PLOTS, "plane", draw)
        assert left_by(typed, "here", "--plot") == {"plane.png", "summary.json"}
        told = json.loads(Path("here/summary.json").read_text())
        assert told["status"] == "interrupted"
        assert told["notes"][-1] == "interrupted before it was drawn: impedance, levers"
        assert told["z_width_1hz"] == pytest.approx(253.809, abs=1e-3)
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler

    def test_an_error_without_an_interrupt_stays_one(self, typed: Typed, monkeypatch: pytest.MonkeyPatch) -> None:
        pytest.importorskip("matplotlib")

        def fail(*_: object) -> None:
            raise ZeroDivisionError

        monkeypatch.setitem(PLOTS, "plane", fail)
        with pytest.raises(ZeroDivisionError):
            typed("zwidth", "virtual_wall", "--out", "here", "--plot")
        assert not list(Path().iterdir())

    def test_a_signal_waits_for_the_numbers(self, typed: Typed, monkeypatch: pytest.MonkeyPatch, ctrl_c: None) -> None:
        def slow(path: Path, document: object) -> None:
            for _ in range(3):
                signal.raise_signal(signal.SIGINT)
            write_document(path, document)

        monkeypatch.setattr(teleop.terminal.answer, "write_document", slow)
        assert left_by(typed, "here") == {"summary.json"}
        assert json.loads(Path("here/summary.json").read_text())["status"] == "interrupted"

    def test_who_ignores_ctrl_c_or_has_a_handler_keeps_it(
        self, typed: Typed, monkeypatch: pytest.MonkeyPatch, ctrl_c: None
    ) -> None:
        seen: list[object] = []

        def look(path: Path, document: object) -> None:
            seen.append(signal.getsignal(signal.SIGINT))
            write_document(path, document)

        monkeypatch.setattr(teleop.terminal.answer, "write_document", look)
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        typed("zwidth", "virtual_wall", "--json", "--out", "here")
        assert seen == [signal.SIG_IGN] == [signal.getsignal(signal.SIGINT)]


def test_a_law_without_stiffness_and_damping_is_refused_and_a_range_that_is_left_out_is_everything() -> None:
    nothing = SimpleNamespace(start=lambda _: (), force=lambda s, _: (0.0, s))
    with pytest.raises(Refused, match=r"no stiffness K and damping B .* --set law=virtual_wall"):
        assess(replace(load_scene("virtual_wall"), law=nothing))
    assert span("--range-k", None) == Span(0.0, None)
    assert span("--range-k", "1:2e3") == Span(1.0, 2000.0)
