"""Output of `teleop zwidth`: a table for a person, and a JSON document."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import isfinite
from typing import TYPE_CHECKING, Any, NamedTuple

from teleop.scene.axes import labels_of, unit_on
from teleop.terminal.answer import WithUnit, finite, scene_head, titled, with_units
from teleop.terminal.table import columns, facts

if TYPE_CHECKING:
    from teleop.analysis.zwidth.assess import LeverRow, ZWidth
    from teleop.analysis.zwidth.plane import Boundary


class LeverColumn(NamedTuple):
    """A metric of the levers: its key in the JSON, its head in the table and its unit along a line."""

    key: str
    head: str
    unit: str


METRICS = (
    LeverColumn("z_width_1hz", "Z-width 1 Hz", "N s/m"), LeverColumn("area", "area", "decades x decades"),
    LeverColumn("passive_K", "passive K", "N/m"), LeverColumn("passive_B", "passive B", "N s/m"),
    LeverColumn("stable_K_any_B", "stable K", "N/m"), LeverColumn("stable_K", "at own B", "N/m"),
    LeverColumn("K_at_rest", "at rest", "N/m"),
)
UNITS = {metric.key: metric.unit for metric in METRICS} | {
    "stable_K_free": "N/m", "z_max_1hz": "N s/m", "z_min_1hz": "N s/m", "gap": "decades",
}
MEANING = {
    "z_width_1hz": "Z_max - Z_min at 1 Hz, 0 where nothing wider than the device is passive",
    "area": "integral of log10(Z_max/Z_min) over log10 f, 0.1 to 100 Hz or half the rate, where above 0",
    "gap": "area over the decades of frequency",
    "passive_K": "greatest K of the passive region at any B", "passive_B": "greatest B of it at any K",
    "stable_K": "least unstable K of the linear loop at the scene's own B, with its hand",
    "stable_K_free": "the same without a hand",
    "stable_K_any_B": "the same with the hand, if there is one, at the B where it is greatest",
    "K_at_rest": "greatest K that came to rest in virtual time at the scene's own B",
    "null": "not claimed, not looked at, or none in the range", "beyond": "no limit within the range looked at",
    "ratio": "to the scene as it is",
}


def numbers(row: LeverRow) -> dict[str, float | None]:
    """A row's metrics by their keys."""
    c = row.curves
    return {
        "z_max_1hz": c.at_one[0], "z_min_1hz": c.at_one[1], "z_width_1hz": c.width, "area": c.area, "gap": c.gap,
        "passive_K": row.region.stiffest, "passive_B": row.region.most_damped, "stable_K": row.stable,
        "stable_K_free": row.stable_free, "stable_K_any_B": row.stable_any, "K_at_rest": row.rest,
    }


def ratios(row: LeverRow, base: LeverRow) -> dict[str, float | None]:
    """A row's metrics over those of the scene as it is; None where there is no such ratio."""
    base_values = numbers(base)
    factors: dict[str, float | None] = {}
    for key, value in numbers(row).items():
        before = base_values[key]
        comparable = value is not None and isfinite(value) and before and isfinite(before)
        factors[key] = value / before if comparable and value is not None and before else None
    return factors


def table(got: ZWidth) -> str:
    """The levers as lines, the factor to the scene as it is behind each number, and below what it all is."""
    if not got.rows:
        return facts(_facts(got))
    head = ("", *(metric.head for metric in METRICS))
    unit = ("", *(metric.unit.replace("decades x decades", "dec^2") for metric in METRICS))
    body = [(row.name, *_cells(row, got.base, first=i == 0)) for i, row in enumerate(got.rows)]
    return f"{columns([head, unit, *body])}\n\n{facts(_facts(got))}"


def _cells(row: LeverRow, base: LeverRow, *, first: bool) -> Iterator[str]:
    values, times = numbers(row), ratios(row, base)
    for metric in METRICS:
        value, factor = values[metric.key], times[metric.key]
        behind = " " * 7 if first or factor is None else f" x{factor:<5.3g}"
        yield format_value(value) + behind


def format_value(value: float | None) -> str:
    """A number to four digits; a dash for None, words for what has no limit."""
    if value is None:
        return "-"
    if not isfinite(value):
        return "no limit"
    return f"{float(f'{value:.4g}'):.0f}" if 1e4 <= value < 1e8 else f"{value:.4g}"


def _facts(got: ZWidth) -> Iterator[tuple[str, str]]:
    if got.interrupted:
        yield "interrupted", "what was done until then is here, the rest is missing"
    yield "scene", f"{titled(got.scene)}, own K {got.scene.law.K:g} N/m, own B " \
                   f"{got.scene.law.B:g} N s/m"
    if not got.rows:
        return
    base = got.base
    low, high = base.curves.at_one[1], base.curves.at_one[0]
    wide = "" if base.curves.width is None else f", Z-width {base.curves.width:.4g} N s/m"
    yield "at 1 Hz", f"Z_max {format_value(high)}, Z_min {format_value(low)} N s/m{wide}"
    if base.curves.area is not None:
        yield "0.1-100 Hz", f"area {base.curves.area:.4g} decades of impedance times decades of frequency, a gap of " \
                            f"{base.curves.gap:.4g} decades on average"
    yield "passive", base.region.sentence
    free = "" if base.stable_free is None else f"; there with a free handle {format_value(base.stable_free)} N/m"
    yield "stable K", f"of the linear loop at the B where it is greatest, then at the scene's own B{free}"
    if got.measured:
        limits = ", ".join(f"{B:.3g}: {format_value(K)}" for B, K in got.measured)
        yield "at rest", f"in virtual time, at B = {limits} N/m"
    for row in got.rows[1:]:
        yield row.name, row.what + ("; " + row.region.sentence if row.region.corners is None
                                    and row.region.sentence != base.region.sentence else "")
    for note in got.notes:
        yield "note", note


def summary(got: ZWidth, command: Sequence[str] = ()) -> dict[str, Any]:
    """The JSON document; what does not exist is null."""
    sentence = got.base.region.sentence if got.rows else "interrupted before anything was found"
    axis = labels_of(got.scene).units_for(got.scene.axes)[0]
    stiffness, damping = unit_on("N/m", axis), unit_on("N s/m", axis)

    def boundary(edge: Boundary | None) -> dict[str, Any] | None:
        return edge and {"B": WithUnit(list(edge.B), damping), "K": WithUnit([finite(K) for K in edge.K], stiffness)}

    body = {
        "meaning": MEANING,
        "range": {"K": WithUnit(list(got.span_K), stiffness), "B": WithUnit(list(got.span_B), damping)},
        "stable": {"hand": boundary(got.stable), "free": boundary(got.stable_free)},
        "measured": [{"B": WithUnit(B, damping), "K": WithUnit(finite(K), stiffness)} for B, K in got.measured],
        "levers": [_row(row, got.base, axis) for row in got.rows], "notes": list(got.notes),
    }
    if got.rows:
        region, curves = got.base.region, got.base.curves
        body |= {
            "passive": {"corners": None if region.corners is None else [[0.0, 0.0], *map(list, region.corners)],
                        "sentence": region.sentence},
            "impedance": {"frequency": WithUnit(curves.frequency.tolist(), "Hz"),
                          "upper": WithUnit(None if curves.upper is None else curves.upper.tolist(), damping),
                          "lower": WithUnit(curves.lower.tolist(), damping)},
            **_with_units(numbers(got.base), axis),
        }
    return {**scene_head(got.scene, "zwidth", status="interrupted" if got.interrupted else "done", sentence=sentence,
                         seed=got.seed, command=command), **with_units(body)}


def _row(row: LeverRow, base: LeverRow, axis: str) -> dict[str, Any]:
    values = numbers(row)
    return {
        "name": row.name, "what": row.what, **_with_units(values, axis),
        "beyond": [key for key, value in values.items() if value is not None and not isfinite(value)],
        "ratio": WithUnit(ratios(row, base), "1"), "sentence": row.region.sentence,
    }


def _with_units(values: dict[str, float | None], axis: str) -> dict[str, WithUnit]:
    return {key: WithUnit(finite(value), unit_on(UNITS[key], axis)) for key, value in values.items()}
