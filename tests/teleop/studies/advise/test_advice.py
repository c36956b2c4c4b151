"""`teleop advise`: laws ranked, run again by what is printed, with measured margins, and stopped; a link in figures."""

from __future__ import annotations

import csv
import json
import shlex
import signal
from pathlib import Path
from statistics import stdev
from typing import Any

import pytest

from teleop import load_scene, run
from teleop.__main__ import main
from teleop.law import two_port_laws
from teleop.studies.advise.advice import Advice, advise, score_changes
from teleop.studies.advise.laws import MARGIN, Outlook, link_text, one_way, playouts_for
from teleop.studies.advise.report import avoid, text
from teleop.studies.tune.objective import SCENE
from teleop.studies.tune.search import LawSearch, SearchJob
from teleop.studies.tune.strategy import value_at
from teleop.sweeps.grid import Range, sampled
from teleop.terminal.table import si
from tests.waiting import free_port, until

HELD_OUT = ("delay(0.025) | gamma(0.012, 2.0) | gilbert_elliott(0.01, 0.3)", "delay(0.15) | uniform(0.01)",
            "delay(0.02) | bernoulli(0.01) ; delay(0.09) | uniform(0.06) | bernoulli(0.05)")
JUDGES = range(5000, 5064)
FIXED: dict[str, Any] = {"k_e": 2000.0, "duration": 3.0, "link": "delay(0.03) | uniform(0.01) | bernoulli(0.03)"}


@pytest.fixture(scope="module")
def found() -> Advice:
    return advise("hard_wall", 36, fixed=FIXED, laws=["direct", "wave", "virtual_wall"], workers=1)


@pytest.mark.full
def test_the_jumps_are_those_of_the_force_that_the_run_has(found: Advice) -> None:
    """The advised law jumped by newtons from tick to tick, and the page said nothing of it."""
    best = found.best
    scene = load_scene("hard_wall", **best.tuned.settings, link=FIXED["link"])
    forces = [run(scene, seed=seed).trace["f_m"] for seed in best.tuned.fresh]
    assert found.jumps.tick == max(float(abs(force[1:] - force[:-1]).max()) for force in forces)
    assert found.jumps.within == max(float(abs(force[10:] - force[:-10]).max()) for force in forces)
    assert 0.0 < found.jumps.tick <= found.jumps.message
    assert f"the force at the hand jumps by up to {si(found.jumps.tick, 'N')} from one tick to the next" in " ".join(
        text(found).split())


def test_the_printed_objective_was_that_of_the_seeds_it_was_chosen_by(found: Advice) -> None:
    """A wave was advised at 0.2107 +- 0.0007, and was 0.225 on other seeds."""
    best = found.best
    assert not {*best.tuned.seeds} & {*best.tuned.fresh}
    assert len(best.tuned.score.values) == len(best.tuned.fresh) >= 4
    mean = sum(best.tuned.score.values) / len(best.tuned.score.values)
    assert best.spread == pytest.approx(stdev(best.tuned.score.values))
    assert best.value == pytest.approx(mean, rel=0.1)
    assert f"standard deviation {best.spread:.3f}" in " ".join(text(found).split())


@pytest.mark.parametrize(("start", "each"), [(10.0, 0.001), (0.5, 0.01)])
def test_the_time_that_is_left_is_told_within_a_factor_of_two(start: float, each: float) -> None:
    """Two workers, eight laws of 2000 rows with kernels that take up to twice as long to compile as others."""
    outlook, left, events, ends = Outlook(8, 2000, 2, 12.0, 0.001), dict[float, float](), [], [0.0, 0.0]
    for law in range(8):
        worker = ends.index(min(ends))
        begun = ends[worker]
        first = begun + start * (0.7 + 0.6 * (law % 2))
        ends[worker] = first + 2000 * each
        events += [(begun, "begin", law, 0), (ends[worker], "end", law, 0)]
        events += [(first + each * rows, "rows", law, rows) for rows in range(100, 2001, 100)]
    for now, event, law, rows in sorted(events):
        arguments = {"begin": (law, now), "rows": (law, rows, now), "end": (law,)}[event]
        getattr(outlook, event)(*arguments)
        if now >= 20.0:
            left[now] = outlook.time_left(now)
    assert bool(left) == (max(ends) > 20.0)
    assert all(0.5 <= (now + after) / max(ends) <= 2.0 for now, after in left.items())
    assert outlook.time_left(max(ends)) == 0.0


def test_rows_that_were_there_are_no_measure_of_the_time_that_is_left() -> None:
    outlook = Outlook(1, 1000, 1, 7.0, 0.01)
    outlook.begin(0, 0.0, known=500)
    outlook.rows(0, 400, 0.001)
    outlook.rows(0, 500, 0.002)
    assert outlook.time_left(1.0) == pytest.approx(7.0 - 1.0 + 500 * 0.01)
    assert outlook.time_left(1.0, busy=3.0) == pytest.approx(21.0 - 1.0 + 3.0 * 500 * 0.01)
    outlook.rows(0, 600, 10.0)
    outlook.rows(0, 700, 20.0)
    assert outlook.time_left(20.0, busy=3.0) == pytest.approx(30.0)


def searching(law: str, link: str) -> tuple[SearchJob, LawSearch]:
    """A search over a link as `advise` makes them, and one that has not begun."""
    fixed = {"k_e": 2000.0, "link": link}
    scene = load_scene("hard_wall", **fixed, law=law)
    playouts = playouts_for(scene, (one_way(scene, 0, 0), one_way(scene, 1, 0)))
    job = SearchJob("hard_wall", law, 12_000, fixed=fixed, margin=MARGIN, playouts=playouts)
    return job, LawSearch(job._replace(budget=10**6, engine="vector"), workers=1)


def best_of_random(search: LawSearch, count: int) -> tuple[Any, ...]:
    """The best of so many random points within the law's conditions, chosen by other seeds as a search chooses."""
    search.seeds, search.left = range(4000, 4001), count
    spans = {name: Range(0.0, 1.0) if isinstance(span, Range) else span for name, span in search.spans.items()}
    drawn = sampled(spans, count, key=77, latin=False).rows(range(count))
    search._try([search._repair(tuple([value_at(span, values[name]) if isinstance(span, Range) else values[name]
                                     for name, span in search.spans.items()])) for _, values, _ in drawn])
    ranked = sorted(search.scores, key=lambda point: search.scores[point].order)
    points = search._select_stable([point for point in ranked if not search.scores[point].broken], 60)
    for seeds, most in ((range(4100, 4108), 60), (range(4200, 4224), 10)):
        scores = search._score_points(points[:most], seeds)
        points = [points[i] for i in sorted(range(len(scores)), key=lambda i: scores[i].order)]
    return points[0]


@pytest.mark.soak
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("link", HELD_OUT)
@pytest.mark.parametrize("law", two_port_laws())
def test_a_search_was_worse_than_the_best_of_5000_random_points(law: str, link: str) -> None:
    """Two of seven knobs of two_layer were moved in 300 rows. Both are judged by seeds that neither has seen.

    The links were not used while the search was written.
    """
    job, search = searching(law, link)
    tuned = LawSearch(job, workers=1).run()
    theirs = best_of_random(search, 5000)
    ours = tuple([tuned.best[name] for name in search.names])
    found, reference = search._score_points([ours, theirs], JUDGES)
    print(f"{law} over {link}: {found.value:.4f} {found.broken}, best of 5000 random points {reference.value:.4f} "
          f"{reference.broken}")
    assert found.value <= 1.03 * reference.value


def test_laws_are_ranked_and_the_best_runs_as_it_is_printed_and_stands_the_wall_of_its_margin(found: Advice) -> None:
    values = [one.value for one in found.laws]
    assert values == sorted(values)
    best = found.best
    assert best.value == values[0] < 1.0
    scene = load_scene("hard_wall", **best.tuned.settings, link=FIXED["link"])
    errors = [run(scene, seed=seed).metrics["x_err_rms"] for seed in (1, 2, 3, 4)]
    assert best.tuned.score.figures[SCENE]["x_err_rms"] == pytest.approx(sum(errors) / 4.0, rel=1e-12)
    assert best.margins.wall >= 4000.0  # the last that the gains stand; the search asks for twice the wall
    held, _ = score_changes(best.tuned, [{"k_e": best.margins.wall}], tasks=[SCENE])
    assert not held[0].broken


def test_the_page_has_law_gains_figures_what_to_type_and_which_law_is_refused(found: Advice) -> None:
    page = " ".join(text(found).split())
    for part in (f"take {found.best.law} with ", "rms of tracking", "margin", "promises",
                 "run it: teleop run hard_wall --set law="):
        assert part in page
    assert any("playout hold" in line and "active" in line for line in avoid(found)) == (found.best.law == "wave")
    assert found.laws[-1].law == "virtual_wall"
    assert "one-port" in found.laws[-1].refused
    assert any(line.startswith("virtual_wall: ") for line in avoid(found)), "it does not go with the scene"


def test_where_no_law_keeps_the_constraints_the_page_says_what_comes_nearest() -> None:
    none = advise("hard_wall", 6, fixed={**FIXED, "x_limit": 0.01}, laws=["direct", "wave"], workers=1)
    assert none.best is None
    page = text(none)
    assert "none: no law keeps the constraints" in page
    assert "diverged" in page
    assert "run it" not in page


def test_delay_jitter_and_loss_of_each_direction_are_those_of_the_link() -> None:
    """0.06 s and up to 0.04 s more, uniform: median 0.08 s, 99.5 % within 0.0998 s; 3 % lost."""
    scene = load_scene("hard_wall", link="delay(0.06) | uniform(0.04) | bernoulli(0.03)")
    way = one_way(scene, 0, 1)
    assert way.least == pytest.approx(0.06, abs=1e-4)
    assert way.median == pytest.approx(0.08, abs=1e-3)
    assert way.late == pytest.approx(0.0998, abs=2e-4)
    assert way.greatest <= 0.1
    assert way.lost == pytest.approx(0.03, abs=0.006)
    assert "each way" in link_text((way, one_way(scene, 1, 1)))
    scene = load_scene("hard_wall", link="delay(0.04) ; delay(0.2)")
    assert link_text((one_way(scene, 0, 0), one_way(scene, 1, 0))) == (
        "forward 40.0 ms, 0.0% of packets lost; backward 200 ms, 0.0% of packets lost")


def test_playouts_are_tried_where_there_is_something_to_choose_and_a_fixed_one_waits_for_nearly_all() -> None:
    for law, link, playouts in (
            ("wave", "delay(0.05)", ()), ("wave", "delay(0.02) | bernoulli(0.1)", ("integral", "fixed:0.02:integral")),
            ("pfra", "delay(0.02) | bernoulli(0.1)", ("zero", "fixed:0.02")),
            ("wave", "delay(0.06) | uniform(0.04)", ("integral", "fixed:0.1:integral"))):  # all but half a percent
        scene = load_scene("hard_wall", law=law, link=link)
        assert playouts_for(scene, (one_way(scene, 0, 0), one_way(scene, 1, 0))) == playouts, (law, link)


WALL = ["advise", "--link", "delay(0.03) | bernoulli(0.03)", "--wall", "2000"]
LOG = "".join(f"[170000000{i // 10}.{i % 10}00000] 64 bytes from 192.0.2.1: icmp_seq={i} ttl=57 "
              f"time={60 + i % 3}.0 ms\n" for i in range(1, 60) if i % 20)


def rows(folder: Path) -> list[str]:
    path = folder / "rows.jsonl"
    return path.read_text().splitlines() if path.is_file() else []


def answer(folder: Path) -> dict[str, Any]:
    """What is answered, but for times and the command."""
    document: dict[str, Any] = json.loads((folder / "summary.json").read_text())
    return {key: value for key, value in document.items() if key not in ("command", "seconds", "seconds_told")}


def test_a_ping_log_and_a_wall_are_answered_once_and_the_same_command_again_runs_nothing(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, folder = tmp_path / "ping.txt", tmp_path / "a"
    log.write_text(LOG)
    words = ["advise", "--ping", str(log), "--wall", "2000", "--set", "duration=2.5", "--laws", "wave,direct",
             "--budget", "9", "--workers", "1", "--out", str(folder), "--plot"]
    assert main(words) == 0
    page = capsys.readouterr().out
    assert "30.5 ms median" in page
    assert (folder / "advice.txt").read_text() in page
    document = json.loads((folder / "summary.json").read_text())
    assert 12 <= document["rows"] <= 18
    assert {one["law"] for one in document["laws"]} == {"wave", "direct"}
    with (folder / "laws.csv").open() as file:
        assert [row["law"] for row in csv.DictReader(file)] == [one["law"] for one in document["laws"]]
    assert (folder / "advise.png").stat().st_size > 10_000
    assert f"ping_log('{log}')" in " ".join(document["run"])
    before, first = rows(folder), answer(folder)
    assert main(words) == 0
    assert (rows(folder), answer(folder)) == (before, first)
    assert main(["report", str(folder)]) == 0
    capsys.readouterr()
    words[words.index("2000")] = "900"
    assert main(words) == 2
    assert "k_e is 2000.0 there and 900.0 here" in capsys.readouterr().err
    assert answer(folder) == first


def test_a_delivery_trace_and_ones_own_law_are_taken_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    trace = tmp_path / "up.txt"
    trace.write_text("".join(f"{ms}\n" for ms in range(20, 4000, 20)))  # 15 packets every 20 ms
    law = Path(__file__).resolve().parents[4] / "scenarios/examples/law.py"
    link = f"mahimahi('{trace}') | delay(0.02) ; delay(0.03)"
    assert main(["advise", "--link", link, "--wall", "500", "--laws", str(law), "--set", "duration=1.6", "--budget",
                 "3", "--workers", "1", "--out", str(tmp_path / "a")]) == 0
    page = capsys.readouterr().out
    assert "forward " in page
    assert "; backward 30.0 ms" in page
    assert json.loads((tmp_path / "a/summary.json").read_text())["laws"][0]["value"] is not None


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of an advice that nobody stopped, by one worker."""
    folder = tmp_path_factory.mktemp("undisturbed") / "a"
    assert main([*STOPPED, "--out", str(folder), "--workers", "1"]) == 0
    return folder


STOPPED = [*WALL, "--set", "duration=1.6", "--laws", "wave,direct", "--budget", "24"]


@pytest.mark.full
@pytest.mark.live
@pytest.mark.parametrize("signal_", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_an_advice_that_was_stopped_by_a_signal_began_anew(
        signal_: signal.Signals, process: Any, ended: Any, tmp_path: Path, undisturbed: Path) -> None:
    running = process("-m", "teleop", *STOPPED, "--workers", "2", "--out", "a")
    until(lambda: rows(tmp_path / "a") or running.poll() is not None)
    running.send_signal(signal_)
    stopped = ended(running)
    assert stopped.code in (130, -signal_)
    assert ("the same command goes on from here" in stopped.out) == (signal_ is signal.SIGINT)
    before = [line for line in rows(tmp_path / "a") if line.endswith("}")]
    assert 0 < len(before) < len(rows(undisturbed))
    assert main([*STOPPED, "--workers", "2", "--out", str(tmp_path / "a")]) == 0
    assert rows(tmp_path / "a")[:len(before)] == before
    assert answer(tmp_path / "a") == answer(undisturbed)
    assert sorted(rows(tmp_path / "a")) == sorted(rows(undisturbed))


@pytest.mark.full
@pytest.mark.live
def test_the_lines_that_are_printed_start_the_answer_live(process: Any, ended: Any, tmp_path: Path) -> None:
    words = ["advise", "--link", "delay(0.01) | uniform(0.004) | bernoulli(0.02)", "--wall", "1000", "--set",
             "duration=1.5", "--laws", "two_layer", "--budget", "12", "--workers", "1", "--out", "a"]
    advised = ended(process("-m", "teleop", *words))
    assert advised.code == 0, advised.err
    starts = [shlex.split(line) for line in advised.out.splitlines() if line.startswith("  python -m ")]
    lines = {words[2]: words[1:] for words in starts}
    assert [*lines] == ["master", "slave"]
    assert all("law.K=" in " ".join(words) for words in lines.values())
    port = str(free_port())
    ends = {name: process(*[word.replace("9001", port) for word in lines[name]], "--out", name)
            for name in ("slave", "master")}
    for name, running in ends.items():
        done = ended(running)
        assert done.code == 0, done.err
        summary = json.loads((tmp_path / name / "summary.json").read_text())
        assert summary["status"] == "ok", summary["sentence"]
