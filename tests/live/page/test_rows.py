"""What the page is shown of two records."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import pytest

from teleop.live.page.rows import PAST, RecordTail, RowMessages, RowsMessage

OWN = ["k", "late_ns", "seq"]
WAVES = {"m": [*OWN, "x_m", "f_h", "f_m", "queue_m", "g_m", "E_in_fwd", "E_out_bwd", "E_port_m"],
         "s": [*OWN, "x_s", "f_env", "f_s", "queue_s", "g_s", "E_in_bwd", "E_out_fwd", "E_port_s"]}
PORTS = {"m": [*OWN, "x_m", "f_h", "f_m", "E_port_m"], "s": [*OWN, "x_s", "f_env", "f_s", "E_port_s"]}


def end(folder: Path, e: str, columns: list[str], *rows: list[float]) -> RecordTail:
    """The record of an end with these rows, not read yet."""
    folder.mkdir()
    header = {"end": e, "dt_ns": 1_000_000, "axes": 1, "scene": "hard_wall", "knobs": {}, "seed": 0, "mode": "live",
              "columns": columns}
    data = b"".join(struct.pack(f"<{len(columns)}d", *row) for row in rows)
    (folder / "record.bin").write_bytes(json.dumps(header).encode() + b"\n" + data)
    return RecordTail(folder)


def message(rows: RowMessages, ends: dict[str, RecordTail]) -> tuple[RowsMessage, dict[str, Any]]:
    shown = rows.message(1.0, ends, {e: follower.read() for e, follower in ends.items()}, (0.06,))
    assert shown is not None
    return shown, json.loads(shown.text)


def waves(k: int, f: float) -> list[float]:
    return [k, 0.0, k - 50.0, 0.03, 1.0, f, 0.002, 1.0, 5.0 + k, 2.0, 0.0]


def test_the_last_row_and_the_extremes_since_the_last_message_are_shown(tmp_path: Path) -> None:
    rows = RowMessages(1e-3)
    ends = {e: end(tmp_path / e, e, WAVES[e], waves(100, 1.0), waves(101, -7.0), waves(102, 3.0))
            for e in "ms"}
    shown, text = message(rows, ends)
    assert (text["fm"], text["fm_lo"], text["fm_hi"]) == ([3.0], [-7.0], [3.0])
    assert shown.forces["s"] == ((-7.0,), (3.0,))
    assert text["hand"] == [0.06]
    assert text["age"] == pytest.approx([0.05, 0.05])
    _, again = message(rows, ends)  # nothing new
    assert (again["fm_lo"], again["fm_hi"]) == ([3.0], [3.0])


def test_the_energy_is_that_of_a_tick_that_both_ends_have(tmp_path: Path) -> None:
    ends = {"m": end(tmp_path / "m", "m", WAVES["m"], waves(0, 0.0), waves(1, 0.0), waves(2, 0.0)),
            "s": end(tmp_path / "s", "s", WAVES["s"], waves(0, 0.0), waves(1, 0.0))}
    _, text = message(RowMessages(1e-3), ends)
    assert text["E"] == pytest.approx((6.0 - 2.0) + (6.0 - 2.0))


def test_a_law_without_waves_has_the_energy_at_its_ports_and_no_queue(tmp_path: Path) -> None:
    ends = {"m": end(tmp_path / "m", "m", PORTS["m"], [0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.7]),
            "s": end(tmp_path / "s", "s", PORTS["s"], [0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.2])}
    _, text = message(RowMessages(1e-3), ends)
    assert text["E"] == pytest.approx(0.5)
    assert text["queue"] is None
    assert text["age"] == [None, None]
    assert text["gain"] == [1.0, 1.0]


@pytest.mark.parametrize("turned", ["m", "s"])
def test_while_one_end_is_turned_and_the_other_is_not_there_is_no_energy(tmp_path: Path, turned: str) -> None:
    ends = {e: end(tmp_path / e, e, PORTS[e], [0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0]) if e == turned
            else end(tmp_path / e, e, WAVES[e], waves(0, 0.0)) for e in "ms"}
    _, text = message(RowMessages(1e-3), ends)
    assert text["E"] is None
    assert text["queue"] is None


def test_the_queue_of_several_axes_is_the_longest_as_on_the_live_line(tmp_path: Path) -> None:
    """It was that of the first axis."""
    ends = {}
    for e, queues in (("m", [0.0, 0.03, 0.01]), ("s", [0.002, 0.0, 0.04])):
        columns = [*OWN, *[f"x_{e}"] * 3, *[f"f_{e}"] * 3, *[f"queue_{e}"] * 3]
        ends[e] = end(tmp_path / e, e, columns, [0.0, 0.0, -1.0, *[0.0] * 6, *queues])
    assert message(RowMessages(1e-3), ends)[1]["queue"] == pytest.approx([0.04, 0.03])


def test_a_number_that_is_not_finite_is_null(tmp_path: Path) -> None:
    ends = {e: end(tmp_path / e, e, WAVES[e], waves(0, float("nan"))) for e in "ms"}
    assert message(RowMessages(1e-3), ends)[1]["fm"] == [None]


def test_nothing_is_shown_before_both_ends_have_a_row(tmp_path: Path) -> None:
    ends = {"m": end(tmp_path / "m", "m", WAVES["m"], waves(0, 0.0)), "s": end(tmp_path / "s", "s", WAVES["s"])}
    new = {e: follower.read() for e, follower in ends.items()}
    assert RowMessages(1e-3).message(0.0, ends, new, None) is None


def test_of_what_has_passed_ten_seconds_are_kept(tmp_path: Path) -> None:
    rows = RowMessages(1e-3)
    ends = {e: end(tmp_path / e, e, WAVES[e], waves(0, 0.0)) for e in "ms"}
    for _ in range(PAST + 5):
        message(rows, ends)
    assert len(json.loads(rows.past_message())["rows"]) == PAST
