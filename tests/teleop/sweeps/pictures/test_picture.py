"""Pictures of a sweep show what is in the table: each cell its rows, the boundary where the status changes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations, product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from teleop import Refused, Table
from teleop.sweeps.pictures.layout import OTHER, STATUS, spaced
from teleop.sweeps.pictures.picture import draw

figures = pytest.importorskip("matplotlib.figure")
colors = pytest.importorskip("matplotlib.colors")

DELAYS = (0.0, 0.1, 0.2, 0.3)
STIFFNESSES = (10.0, 100.0, 1000.0)


@pytest.fixture
def drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """`drawn(table, ...)` draws it and returns matplotlib's figure, to be looked into."""
    made: list[Any] = []

    def remember(figure: Any, *_: Any, **__: Any) -> None:
        figure.draw_without_rendering()  # nobody looks at the pixels here
        made.append(figure)

    monkeypatch.setattr(figures.Figure, "savefig", remember)

    def look(table: Table, *rest: Any, **named: Any) -> Any:
        draw(table, tmp_path / "picture", *rest, **named)
        return made[-1]

    return look


def rows(knobs: dict[str, Sequence[Any]], of: Callable[..., Any], seeds: int = 1) -> Table:
    """A table over all combinations; `of(seed, **knobs)` gives a row's status, or its metric (and then it is ok)."""
    made = []
    for number, (*values, seed) in enumerate(product(*knobs.values(), range(seeds))):
        point = dict(zip(knobs, values, strict=True))
        got = of(seed, **point)
        end = {"status": got, "x_err_rms": 1.0} if isinstance(got, str) else {"status": "ok", "x_err_rms": got}
        made.append({"row": number, "seed": seed, **point, "ticks": 1, **end})
    return Table(made, tuple(knobs), ("x_err_rms",))


def below(limit: float) -> Callable[..., str]:
    """Diverged where the delay times the stiffness is above a limit."""
    return lambda _, delay, k_e, **__: "ok" if delay * k_e < limit else "diverged"


def panels(figure: Any) -> list[Any]:
    return [axes for axes in figure.axes if axes.get_label() != "<colorbar>" and axes.axison]


def mesh(axes: Any) -> Any:
    """Colours of the cells, (y, x, 4)."""
    (found,) = (each for each in axes.collections if type(each).__name__ == "QuadMesh")
    return found.get_facecolor().reshape(*np.array(found.get_coordinates().shape[:2]) - 1, 4)


def boundary(axes: Any) -> list[Any]:
    return [segment for each in axes.collections if type(each).__name__ == "LineCollection"
            for segment in each.get_segments()]


def legend(figure: Any) -> list[str]:
    return [text.get_text() for each in figure.legends for text in each.get_texts()]


def colour(name: str) -> Any:
    return colors.to_rgba({"ok": "#56B4E9", "diverged": "#D55E00", "refused": "#BDBDBD", "stopped": "#8C564B"}[name])


# Linear RGB as it is seen without the cones for red, green or blue (Machado, Oliveira & Fernandes 2009, severity 1).
SEEN = {
    "all cones": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    "no red": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "no green": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "no blue": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}
XYZ = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]  # of linear sRGB


def lab(name: str, cones: str) -> Any:
    """CIE 1976 L*a*b* of a colour, as it is seen."""
    rgb = np.array(colors.to_rgb(name))
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    x, y, z = np.array(XYZ) @ np.clip(np.array(SEEN[cones]) @ linear, 0.0, 1.0) / [0.9505, 1.0, 1.089]
    fx, fy, fz = (np.cbrt(v) if v > 216.0 / 24389.0 else (24389.0 / 27.0 * v + 16.0) / 116.0 for v in (x, y, z))
    return np.array([116.0 * fy - 16.0, 500.0 * (fx - fy), 200.0 * (fy - fz)])


@pytest.mark.parametrize("cones", SEEN)
def test_every_status_has_a_colour_of_its_own_for_colour_blind_readers_too(cones: str) -> None:
    assert {"ok", "limit cycle", "unstable", "diverged", "refused"} <= STATUS.keys()
    every = {*STATUS.values(), OTHER, "#FFFFFF"}  # white: no row
    for one, other in combinations(sorted(every), 2):
        assert np.linalg.norm(lab(one, cones) - lab(other, cones)) > 20.0, (one, other)


class TestAStabilityMap:
    def test_colours_cells_by_their_status_and_draws_the_boundary_where_that_changes_alone(self, drawn: Any) -> None:
        """White is what was not run yet; the legend says what a status is held to."""
        table = rows({"delay": DELAYS, "k_e": STIFFNESSES}, below(15.0))
        figure = drawn(table, words={"diverged": "diverged: beyond 0.3 m"})
        (axes,) = panels(figure)
        for (j, k_e), (i, delay) in product(enumerate(STIFFNESSES), enumerate(DELAYS)):
            np.testing.assert_allclose(mesh(axes)[j, i], colour("ok" if delay * k_e < 15.0 else "diverged"))
        found = {tuple(map(tuple, np.round(segment, 6))) for segment in boundary(axes)}
        between = round(10.0**2.5, 6), round(10.0**1.5, 6)  # on a log axis the middle is the geometric mean
        upright = {((0.05, between[0]), (0.05, 1000.0)), ((0.15, between[1]), (0.15, between[0]))}
        level = {((0.05, between[0]), (0.15, between[0])),
                 ((0.15, between[1]), (0.25, between[1])), ((0.25, between[1]), (0.3, between[1]))}
        assert found == upright | level
        assert legend(figure) == ["ok", "diverged: beyond 0.3 m", "boundary"]
        (axes,) = panels(drawn(Table(list(table)[:7], ("delay", "k_e"), ("x_err_rms",))))
        np.testing.assert_array_equal(mesh(axes)[1, 2], np.ones(4))

    @pytest.mark.parametrize(("delays", "scaled", "which"), [
        ((0.0, 0.02, 0.1, 0.12), "linear", 0), ((0.01, 0.1, 1.0), "log", 1), ((0.0, 0.01, 0.1, 1.0), "symlog", 0),
        ((0.1, 0.2), "linear", 1), ((3.0, -2.0, 1.0), "linear", 1)])
    def test_no_cell_reaches_past_the_grid(
        self, drawn: Any, delays: tuple[float, ...], scaled: str, which: int
    ) -> None:
        for knobs in ({"delay": delays, "k_e": STIFFNESSES}, {"k_e": STIFFNESSES, "delay": delays})[which:which + 1]:
            (axes,) = panels(drawn(rows(knobs, lambda _, delay, **__: "ok" if delay < 0.15 else "diverged")))
            (cells,) = (each for each in axes.collections if type(each).__name__ == "QuadMesh")
            edges = np.unique(cells.get_coordinates()[..., which])
            assert (axes.get_xscale(), axes.get_yscale())[which] == scaled
            assert (axes.get_xlim(), axes.get_ylim())[which] == (edges[0], edges[-1]) == (min(delays), max(delays))
            for low, value, high in zip(edges[:-1], sorted(delays), edges[1:], strict=True):  # each is in its cell
                assert low <= value <= high

    def test_has_a_boundary_beside_a_status_of_another_kind_and_none_beside_what_never_ran(self, drawn: Any) -> None:
        for status in ("stopped", "refused"):
            figure = drawn(rows({"delay": DELAYS, "k_e": STIFFNESSES}, lambda _, k_e, status=status, **__:
                                status if k_e > 500.0 else "ok"))
            (axes,) = panels(figure)
            assert bool(boundary(axes)) == (status == "stopped")
            np.testing.assert_allclose(mesh(axes)[2, 0], colour(status))
            assert legend(figure) == ["ok", status, "boundary"][:3 - (status == "refused")]

    def test_has_a_panel_for_each_law_with_its_share(self, drawn: Any) -> None:
        figure = drawn(rows({"law": ("direct", "wave"), "delay": DELAYS, "k_e": STIFFNESSES}, lambda _, law, delay, k_e:
                            "ok" if law == "wave" or delay * k_e < 15.0 else "diverged"),
                       title="soft_tissue", units={"delay": "s"})
        direct, wave = panels(figure)
        assert (direct.get_title(), wave.get_title()) == ("law direct: 58.3 % ok", "law wave: 100 % ok")
        assert boundary(direct)
        assert not boundary(wave)
        assert figure.get_suptitle() == "soft_tissue · 24 rows: 19 ok, 5 diverged"
        assert (direct.get_xlabel(), direct.get_ylabel(), wave.get_ylabel()) == ("delay (s)", "k_e", "")

    def test_of_several_seeds_shows_the_share_that_ends_ok_among_those_that_ran(self, drawn: Any) -> None:
        def of(seed: int, delay: float, **_: float) -> str:
            worse = (DELAYS.index(delay), seed)
            return "refused" if delay == 0.0 and seed < 2 else "ok" if worse < (2, 1) else "diverged"

        figure = drawn(rows({"delay": DELAYS, "k_e": STIFFNESSES}, of, seeds=4))
        (axes,) = panels(figure)
        shown = mesh(axes)
        np.testing.assert_allclose(shown[:, 0], [colour("ok")] * 3, atol=0.01)  # the refused do not count
        np.testing.assert_allclose(shown[:, 1], [colour("ok")] * 3, atol=0.01)
        np.testing.assert_allclose(shown[:, 3], [colour("diverged")] * 3, atol=0.01)
        quarter = 0.5 * (np.array(colour("diverged")) + colors.to_rgba("#F5EFE6"))  # half way to the middle of the bar
        np.testing.assert_allclose(shown[:, 2], [quarter] * 3, atol=0.01)
        assert {round(x, 6) for segment in boundary(axes) for x, _ in segment} == {0.15}
        assert "share" in figure.axes[-1].get_ylabel()
        assert legend(figure) == ["half of the runs end ok"]

    def test_of_rows_that_all_ended_ok_would_be_of_one_colour_so_a_metric_is_drawn(self, drawn: Any) -> None:
        figure = drawn(rows({"delay": DELAYS, "k_e": STIFFNESSES}, lambda _, delay, **__: delay))
        assert figure.axes[-1].get_ylabel().startswith("x_err_rms")
        bare = Table([{"row": i, "seed": 0, "a": i % 3, "b": i // 3, "ticks": 1, "status": "ok"} for i in range(9)],
                     ("a", "b"), ())
        assert legend(drawn(bare)) == ["ok"]
        assert legend(drawn(rows({"delay": DELAYS, "k_e": STIFFNESSES}, below(1e9)), "stability")) == ["ok"]

    def test_of_a_random_sample_is_its_points(self, drawn: Any) -> None:
        where = np.random.default_rng(3).random((40, 3))
        made = [{"row": i, "seed": 0, "delay": a, "k_e": b, "n": c, "ticks": 1, "status": "ok" if a < b else "diverged"}
                for i, (a, b, c) in enumerate(where.tolist())]
        figure = drawn(Table(made, ("delay", "k_e", "n"), ()))
        (axes,) = panels(figure)
        (dots,) = axes.collections
        order = np.argsort(where[:, 0])
        np.testing.assert_allclose(dots.get_offsets(), where[order, :2])
        expected = [colour("ok" if a < b else "diverged") for a, b, _ in where[order]]
        np.testing.assert_allclose(dots.get_facecolor(), expected)
        assert figure.get_suptitle().endswith("n varies too")


class TestTheAxes:
    def test_are_logarithmic_where_the_values_are_spaced_so(self) -> None:
        for values, scale in (
                ((0.0, 0.1, 0.2, 0.3), "linear"), ((10.0, 100.0, 1000.0), "log"), ((1.0, 2.0, 3.0, 4.0), "linear"),
                ((0.0, 0.001, 0.01, 0.1), "symlog"), ((-1.0, 0.0, 1.0), "linear"), ((1.0, 1000.0), "log"),
                ((1.0, 2.0), "linear"), ((100.0, 110.0, 121.0), "linear"), ((1, 2, 4, 8, 16), "log"),
                ((5.0, 1.0, 3.0), "linear"), ((-100.0, -10.0, -1.0), "linear")):
            assert spaced(values)[0] == scale, values

    def test_are_the_two_knobs_with_most_values_in_their_order(self, drawn: Any) -> None:
        figure = drawn(rows({"n": (1, 2), "k_e": STIFFNESSES, "delay": DELAYS}, lambda *_, **__: "ok"))
        first, second = panels(figure)
        assert (first.get_xlabel(), first.get_ylabel()) == ("k_e", "delay")
        assert [axes.get_title() for axes in (first, second)] == ["n 1: 100 % ok", "n 2: 100 % ok"]

    def test_of_knobs_that_go_in_step_one_is_drawn_and_the_other_named(self, drawn: Any) -> None:
        made = [{**row, "d_e": -row["k_e"] / 100.0} for row in rows({"delay": DELAYS, "k_e": STIFFNESSES}, below(15.0))]
        figure = drawn(Table(made, ("delay", "k_e", "d_e"), ("x_err_rms",)))
        (axes,) = panels(figure)
        assert axes.get_ylabel() == "k_e"
        assert "d_e goes with k_e" in figure.get_suptitle()

    @pytest.mark.full
    @pytest.mark.parametrize(("knobs", "titles", "said"), [
        ({"law": [f"law{i}" for i in range(20)], "delay": DELAYS, "k_e": STIFFNESSES},
         [f"law law{i}" for i in (0, 4, 8, 11, 15, 19)], "6 of 20 values of law"),  # both ends are shown
        ({"law": ("a", "b", "c"), "n": (1, 2, 3), "delay": DELAYS, "k_e": (1.0, 2.0, 3.0, 4.0)},
         [f"law {law}, n {n}" for law in "abc" for n in (1, 3)], "2 of 3 values of n"),  # rather one with numbers
        ({"law": "abcd", "n": (1, 2), "m": (1, 2), "delay": DELAYS, "k_e": STIFFNESSES},
         [f"law c, n {n}, m {m}" for n in (1, 2) for m in (1, 2)], ""),  # as few as possible
        ({"n": (1, 2, 3), "law": "abcd", "other": "def", "delay": DELAYS, "k_e": (1.0, 2.0, 3.0, 4.0)}, None,
         "n 2 alone, of 3 values, 2 of 4 values of law"),
    ], ids=["both ends", "numbers first", "few lose", "one left"])
    def test_of_more_values_than_panels_some_are_shown_and_the_title_says_which(
        self, drawn: Any, knobs: Any, titles: list[str] | None, said: str
    ) -> None:
        figure = drawn(rows(knobs, below(1e9)))
        assert len(panels(figure)) == len(titles or range(6))
        assert titles is None or [axes.get_title().split(":")[0] for axes in panels(figure)] == titles
        assert figure.get_suptitle().endswith(said)

    def test_every_column_of_panels_has_its_label(self, drawn: Any) -> None:
        for count in (1, 2, 5):
            got = panels(drawn(rows({"law": [f"law{i}" for i in range(count)], "delay": DELAYS, "k_e": STIFFNESSES},
                                    below(15.0))))
            assert len(got) == count
            assert sum(axes.get_xlabel() == "delay" for axes in got) == min(3, count)


class TestAMetricMap:
    def test_colours_by_the_median_of_the_seeds_that_end_ok(self, drawn: Any) -> None:
        def of(seed: int, delay: float, **_: float) -> Any:
            return "diverged" if delay == 0.3 or seed == 3 else delay + (0.0, 0.1, 10.0)[seed]

        figure = drawn(rows({"delay": DELAYS, "k_e": STIFFNESSES}, of, seeds=4), "metric")
        (axes,) = panels(figure)
        bar = figure.axes[-1]
        assert bar.get_ylabel() == "x_err_rms (m), median of the runs ok"
        low, high = bar.get_ylim()
        assert (low, high) == pytest.approx((0.1, 0.3))  # medians are delay + 0.1
        from matplotlib import colormaps

        for i, delay in enumerate(DELAYS[:3]):
            np.testing.assert_allclose(mesh(axes)[0, i], colormaps["viridis"]((delay + 0.1 - low) / (high - low)),
                                       atol=0.01)
        np.testing.assert_allclose(mesh(axes)[0, 3], colour("diverged"))
        assert legend(figure) == ["none ended ok", "half of the runs end ok"]

    def test_tells_small_values_apart_beside_one_that_ran_away(self, drawn: Any) -> None:
        figure = drawn(rows({"delay": DELAYS, "k_e": STIFFNESSES}, lambda _, delay, k_e:
                            -1e9 if (delay, k_e) == (0.3, 1000.0) else -delay * k_e), "metric")
        shown = mesh(panels(figure)[0])
        assert np.abs(shown[2, 2] - shown[0, 1]).max() > 0.05  # -200 and -1

    def test_of_one_that_is_named_goes_by_ratios_where_the_values_are_far_apart(self, drawn: Any) -> None:
        figure = drawn(rows({"delay": DELAYS, "k_e": STIFFNESSES}, lambda _, k_e, delay:
                            k_e**2 if delay < 0.25 else "diverged"), metric="x_err_rms")
        assert figure.axes[-1].get_ylabel().startswith("x_err_rms")
        assert figure.axes[-1].get_yscale() == "log"

    @pytest.mark.parametrize("of", [lambda *_, **__: float("nan"), lambda *_, **__: "diverged",
                                    lambda *_, **__: "refused", lambda *_, **__: 2.0, lambda *_, **__: 0.0])
    def test_is_drawn_with_nothing_or_one_value_to_show(self, drawn: Any, of: Any) -> None:
        drawn(rows({"delay": DELAYS, "k_e": STIFFNESSES}, of), "metric")


class TestCurves:
    @staticmethod
    def of(seed: int, delay: float, law: str = "wave") -> Any:
        if law == "direct" and delay > 0.15 and seed > 1:
            return "diverged"
        return 1.0 + delay + 0.1 * seed**2 + (law == "direct")

    def test_are_medians_within_quartiles_within_extremes(self, drawn: Any) -> None:
        figure = drawn(rows({"delay": DELAYS}, self.of, seeds=5))
        (axes,) = panels(figure)
        (line,) = axes.get_lines()
        np.testing.assert_array_equal(line.get_xdata(), DELAYS)
        np.testing.assert_allclose(line.get_ydata(), 1.4 + np.array(DELAYS))
        extremes, quartiles = (each.get_paths()[0].vertices for each in axes.collections)
        at = extremes[:, 0] == 0.2
        assert sorted(set(np.round(extremes[at, 1], 9))) == pytest.approx([1.2, 2.8])
        assert sorted(set(np.round(quartiles[quartiles[:, 0] == 0.2, 1], 9))) == pytest.approx([1.3, 2.1])
        assert (axes.get_xlabel(), axes.get_ylabel()) == ("delay", "x_err_rms (m)")

    def test_have_a_line_for_each_law_and_crosses_where_not_every_run_ended_ok(self, drawn: Any) -> None:
        figure = drawn(rows({"law": ("direct", "wave"), "delay": DELAYS}, self.of, seeds=4))
        (axes,) = panels(figure)
        direct, crosses, wave = axes.get_lines()
        np.testing.assert_allclose(wave.get_ydata(), 1.25 + np.array(DELAYS))
        np.testing.assert_allclose(direct.get_ydata()[2:], [2.25, 2.35])  # of seeds 0 and 1
        np.testing.assert_array_equal(crosses.get_xdata(), [0.2, 0.3])
        assert crosses.get_color() == direct.get_color() != wave.get_color()
        assert legend(figure) == ["law direct", "law wave", "quartiles of the seeds", "extremes", "not every run ok"]

    @pytest.mark.parametrize(("sign", "zero", "scale"), [
        (1.0, 0.0, "log"), (-1.0, 0.0, "symlog"), (1.0, 1.0, "symlog"),
    ])
    def test_of_a_run_that_grows_leave_the_others_apart(self, drawn: Any, sign: float, zero: float, scale: str) -> None:
        def of(_: int, law: str, delay: float) -> float:
            return sign * (1e9 if law == "a" and delay > 0.25 else (1.0 + (law == "a")) * (1.0 + delay - zero))

        (axes,) = panels(drawn(rows({"law": ("a", "b"), "delay": DELAYS}, of)))
        assert axes.get_yscale() == scale
        one, two = (axes.transData.transform((0.1, sign * k * (1.1 - zero)))[1] for k in (1.0, 2.0))
        height = axes.bbox.height
        assert abs(one - two) > 0.01 * height  # on a linear scale 1e-9 of it

    def test_have_gaps_where_no_run_ended_ok(self, drawn: Any) -> None:
        (axes,) = panels(drawn(rows({"delay": DELAYS}, lambda _, delay: "diverged" if delay == 0.1 else 1.0)))
        np.testing.assert_array_equal(axes.get_lines()[0].get_ydata(), [1.0, np.nan, 1.0, 1.0])
        assert not axes.collections  # one seed has no spread

    def test_have_a_panel_for_each_value_of_a_third_knob(self, drawn: Any) -> None:
        figure = drawn(rows({"law": ("a", "b"), "delay": DELAYS, "n": (1, 2, 3)}, lambda _, n, **__: float(n)),
                       "curves")
        assert [axes.get_title() for axes in panels(figure)] == ["n 1", "n 2", "n 3"]
        assert [axes.get_lines()[0].get_ydata()[0] for axes in panels(figure)] == [1.0, 2.0, 3.0]

    def test_over_texts_are_points_side_by_side(self, drawn: Any) -> None:
        figure = drawn(rows({"law": ("direct", "wave"), "link": ("a", "b")}, lambda seed, **_: float(seed),
                            seeds=3))
        (axes,) = panels(figure)
        assert [text.get_text() for text in axes.get_xticklabels()] == ["direct", "wave"]
        first, second = axes.get_lines()
        assert first.get_linestyle() == "None" or first.get_linewidth() == 0.0
        assert all(a < b for a, b in zip(first.get_xdata(), second.get_xdata(), strict=True))

    def test_of_many_values_some_are_shown_and_the_title_says_so(self, drawn: Any) -> None:
        figure = drawn(rows({"delay": np.linspace(0, 1, 30).tolist(), "k_e": [float(i) for i in range(1, 21)]},
                            lambda _, k_e, **__: k_e), "curves")
        assert len(panels(figure)[0].get_lines()) == 7
        assert "7 of 20 values of k_e" in figure.get_suptitle()


class TestRequests:
    """Others that cannot be drawn, a full disk and a missing matplotlib: as they are typed, `../test_command.py`."""

    def table(self) -> Table:
        return rows({"delay": DELAYS, "law": ("a", "b")}, lambda *_, **__: 1.0)

    def test_without_something_that_varies_or_a_metric_are_refused(self, tmp_path: Path) -> None:
        bare = [{k: v for k, v in row.items() if k != "x_err_rms"} for row in self.table()]
        for table, kind, metric, said in (
                (Table([], ("delay",), ()), None, None, "several values"),
                (rows({"delay": (0.1,)}, lambda *_, **__: 1.0, seeds=9), None, None, "several values"),
                (Table(bare, ("delay", "law"), ()), None, None, "no metric to draw"),
                (rows({"delay": DELAYS, "k_e": STIFFNESSES}, below(1.0)), "stability", "x_err_rms",
                 "--picture metric")):
            with pytest.raises(Refused, match=said):
                draw(table, tmp_path / "p", kind, metric=metric)
        assert not list(tmp_path.iterdir())

    def test_of_the_same_rows_give_the_same_bytes(self, tmp_path: Path) -> None:
        (a,), (b,) = (draw(self.table(), tmp_path / name) for name in "ab")
        assert a.read_bytes() == b.read_bytes()
