"""Sweeps that others have sent: opening one runs nothing, follows nothing, and takes what its bytes can mean."""

from __future__ import annotations

import json
import tracemalloc
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from teleop import Refused
from teleop.__main__ import main
from teleop.sweeps.pictures.layout import thinned
from teleop.sweeps.pictures.report import summary_of, told_of
from teleop.sweeps.store import LONGEST, RowNumbers, Store, rows_of

DEFINITION: dict[str, Any] = {
    "scene": "soft_tissue", "fixed": {}, "metrics": ["x_err_rms"], "sources": "0", "version": "0.1.0",
    "grid": {"axes": [{"knobs": ["delay"], "values": [0.0, 0.1]}, {"knobs": ["k_e"], "values": [1.0, 2.0]}],
             "seeds": {"first": 0, "step": 1, "count": 2}},
}


def row(number: int, **other: Any) -> dict[str, Any]:
    return {"row": number, "seed": number % 2, "delay": 0.1 * (number // 4), "k_e": 1.0 + number // 2 % 2,
            "status": "ok", "ticks": 10, "x_err_rms": 0.5, **other}


def sweep_of(folder: Path, *rows: Any, **other: Any) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "sweep.json").write_text(json.dumps({**DEFINITION, **other}))
    (folder / "rows.jsonl").write_text("".join(json.dumps(each) + "\n" for each in rows))
    return folder


@pytest.fixture
def peak() -> Any:
    """What was allocated since, at most, in bytes."""
    tracemalloc.start()
    yield lambda: tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()


def test_a_row_number_of_1e12_takes_no_terabyte(tmp_path: Path, peak: Callable[[], int]) -> None:
    rows = [row(n) for n in (0, 10**12, 1 << 60)]
    for count in (2, 1 << 62, 10**290):
        grid = {**DEFINITION["grid"], "seeds": {"first": 0, "step": 1, "count": count}}
        folder = sweep_of(tmp_path / str(count)[:9], *rows, grid=grid)
        done = Store.look(folder).done
        assert list(done) == ([0] if count == 2 else [0, 10**12, 1 << 60]), count
        assert list(done.gaps(8)) == [range(1, 8)], count
        assert len(told_of(folder)[2]) == len(done), count
    assert peak() < 30_000_000  # the first one imports, too


def test_missing_rows_between_far_apart_ones_are_the_longest_ranges_of_as_many_as_the_grid_says() -> None:
    done = RowNumbers()
    for number in (0, 4095, 4096, 3 * 4096, 10**9):
        done._add(number)
    gaps = [range(1, 4095), range(4097, 3 * 4096), range(3 * 4096 + 1, 10**9)]
    assert list(done.gaps(10**9 + 1)) == gaps
    assert list(done.gaps(10**9 + 5)) == [*gaps, range(10**9 + 1, 10**9 + 5)]
    assert list(done.gaps(4096)) == gaps[:1]
    assert rows_of(DEFINITION) == 8
    assert rows_of({"grid": {"axes": [{"knobs": ["k"], "values": {"count": 10**6}}], "seeds": [1, 5]}}) == 2 * 10**6
    assert rows_of({}) > 10**18


def test_a_file_of_rows_that_is_one_endless_line_is_refused(tmp_path: Path, peak: Callable[[], int]) -> None:
    folder = sweep_of(tmp_path / "s", row(0))
    with (folder / "rows.jsonl").open("ab") as file:
        file.truncate(1 << 40)
    with pytest.raises(Refused, match="a line of more than 1 MB"):
        Store.look(folder)
    assert peak() < 10 * LONGEST


def test_a_scene_that_a_sweep_names_is_not_run_but_for_who_trusts_the_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("evil.py").write_text("from pathlib import Path\nPath('ran').touch()\n"
                               "from scenarios.soft_tissue import scene\n")
    folder = sweep_of(Path("s"), *map(row, range(8)), scene="evil.py")
    assert main(["report", str(folder), "--plot"]) == 0
    assert (folder / "sweep.png").is_file()
    assert not Path("ran").exists()
    assert main(["report", "--trust", str(folder), "--plot"]) == 0
    assert Path("ran").exists()


DEFINITIONS: list[dict[str, Any]] = [
    {"scene": 3}, {"scene": None}, {"fixed": 3}, {"metrics": "x"}, {"metrics": [1]}, {"metrics": ["m"] * 1001},
    {"grid": []}, {"grid": {"axes": 3}}, {"grid": {"axes": [3]}}, {"grid": {"axes": [{}]}},
    {"grid": {"axes": [{"knobs": "k"}]}}, {"grid": {"axes": [{"knobs": ["k"], "values": 3}]}},
    {"grid": {"axes": [], "seeds": "x"}}, {"grid": {"axes": [], "seeds": {"count": -1}}},
]


def test_a_definition_of_wrong_types_is_one_sentence(tmp_path: Path) -> None:
    for n, other in enumerate(DEFINITIONS):
        folder = sweep_of(tmp_path / str(n), row(0), **other)
        with pytest.raises(Refused, match=r"holds no sweep \(sweep.json: it.* (must be|has no)|more than 1000"):
            pytest.fail(f"{other}: {told_of(folder)}")
    (folder / "sweep.json").write_text("{}")
    with pytest.raises(Refused):
        told_of(folder)


ROWS: list[dict[str, Any]] = [
    {"status": 3}, {"sentence": []}, {"delay": {}}, {"seed": -1}, {"seed": 1 << 70}, {"ticks": "1"}, {"more": 1},
    {"x_err_rms": "x"}, {"x_err_rms": [1]}, {"x_err_rms": 10**301}, {"delay": [[[[]]]] * 3}, {"row": True},
]


def test_a_row_of_wrong_types_is_left_out_or_one_sentence(tmp_path: Path) -> None:
    for n, other in enumerate(ROWS):
        folder = sweep_of(tmp_path / str(n), row(0), row(1, **other))
        try:
            assert len(told_of(folder)[2]) in (1, 2), other
        except Refused as refused:
            assert len(str(refused)) < 300, other  # noqa: PT017 (or it is left out)


def test_a_summary_of_wrong_types_is_left_out(tmp_path: Path) -> None:
    folder = sweep_of(tmp_path / "s", *map(row, range(8)))
    wrong: tuple[Any, ...] = (
        {"rows": "8"}, {"rows": -1}, {"runs": 3}, {"runs": [3]}, {"limits": 3}, {"limits": {"x_limit": "far"}},
        {"why": []}, {"scene": 3}, [], "x", 3, None, {"engine": None})
    for text in ("", "{", "\xff", *map(json.dumps, wrong)):
        (folder / "summary.json").write_text(text, encoding="latin-1")
        assert summary_of(folder) == {}, text
    assert main(["report", str(folder)]) == 0


def test_orders_to_a_terminal_in_any_text_are_not_obeyed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    nasty = "\x1b[2J\nstatus  8 done: 8 ok\r\x9b31m$\\frac$\u202e"
    axes = [{"knobs": [nasty], "values": [1, 2]}]
    rows = [{"row": i, "seed": 0, nasty: [1.0, "a", nasty][i], "status": nasty if i else "ok", "ticks": 1,
             nasty * 2: 1.0, "sentence": nasty} for i in range(3)]
    folder = sweep_of(tmp_path / "s", *rows, scene=nasty, metrics=[nasty * 2], grid={"axes": axes})
    (folder / "summary.json").write_text(json.dumps({"engine": nasty, "why": nasty, "rows": 3}))
    assert main(["report", str(folder)]) == 0
    out, err = capsys.readouterr()
    assert all(line.isprintable() for line in (out + err).split("\n"))
    assert not any(line.startswith("status  8") for line in out.split("\n"))


@pytest.mark.parametrize("name", ["sweep.json", "rows.jsonl", "summary.json"])
def test_a_link_in_place_of_what_is_read_is_not_followed(name: str, tmp_path: Path) -> None:
    other, folder = (sweep_of(tmp_path / each, *map(row, range(8))) for each in "os")
    (folder / name).unlink(missing_ok=True)
    (other / "summary.json").write_text('{"engine": "of another"}')
    (folder / name).symlink_to(other / name)
    if name == "summary.json":
        assert "of another" not in told_of(folder)[1]
    else:
        with pytest.raises(Refused, match="it is a link, not a file"):
            told_of(folder)


def test_a_link_in_place_of_the_picture_stays_and_so_does_its_target(tmp_path: Path) -> None:
    folder = sweep_of(tmp_path / "s", *map(row, range(8)))
    (tmp_path / "precious").write_text("precious")
    for name in ("sweep.png", ".sweep.png.part"):
        (folder / name).symlink_to(tmp_path / "precious")
    assert main(["report", str(folder), "--plot"]) == 0
    assert (tmp_path / "precious").read_text() == "precious"
    assert (folder / "sweep-2.png").read_bytes().startswith(b"\x89PNG")


def test_a_table_of_very_many_knobs_is_refused_a_picture_before_it_is_looked_for() -> None:
    with pytest.raises(Refused, match="too many for the panels"):
        thinned([2] * 40, 6, [True] * 40)


@pytest.mark.full
def test_a_map_of_more_cells_than_a_picture_has_is_no_gigabyte(tmp_path: Path, request: pytest.FixtureRequest) -> None:
    import_module("matplotlib.backends.backend_agg")  # before all is counted that is allocated
    peak = request.getfixturevalue("peak")
    axes = [{"knobs": [knob], "values": {"count": 1000}} for knob in ("delay", "k_e")]
    points = {(i, i * 7 % 1000) for i in range(1000)}  # of 1e6 cells, each of 32 bytes as a colour
    rows = [row(n, seed=0, delay=float(x), k_e=float(y)) for n, (x, y) in enumerate(sorted(points))]
    folder = sweep_of(tmp_path / "s", *rows, grid={"axes": axes, "seeds": [0]})
    assert main(["report", str(folder), "--picture", "stability"]) == 0
    assert peak() < 20_000_000
