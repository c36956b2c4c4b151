"""A live run as a link: its arrivals to the nanosecond, in both directions, under any tick; and what is no such run."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from channel import Recorded, describe, parse_link
from teleop import Refused, load_scene, run, sweep
from teleop.analysis.models.linear import refuse_nonlinear_parts
from teleop.simulation.plan import link_plans
from tests.channel.conftest import MS, live_run

FWD = [(0, 20 * MS + 1, 21), (1, 20 * MS + 2, 21), (3, 24 * MS, 24), (3, 25 * MS, 25), (2, 26 * MS, 26)]
BWD = [(k, k * MS + 7 * MS, k + 7) for k in range(0, 90, 2)]


def arrivals(effect: Recorded, direction: int, count: int, dt_ns: int = MS) -> list[tuple[int, int]]:
    found = effect.arrivals(direction, count, dt_ns, 1, 100)
    return [*zip(found.packet.tolist(), found.time_ns.tolist(), strict=True)]


def test_the_arrivals_are_those_of_the_run_to_the_nanosecond_in_both_directions(tmp_path: Path) -> None:
    link = Recorded(str(live_run(tmp_path / "run", FWD, BWD, ticks=100)))
    apart = Recorded(str(tmp_path / "run" / "master"), str(tmp_path / "run" / "slave"))
    for direction, count, came in ((0, 70, FWD), (1, 90, BWD)):
        assert arrivals(link, direction, count) == [(packet, time_ns) for packet, time_ns, _ in came]
    assert arrivals(apart, 1, 90) == arrivals(link, 1, 90)
    # behind a delay, in one direction alone: the third millisecond's message came twice, none from the fourth on
    behind = parse_link(f"delay(0.003) | recorded({str(tmp_path / 'run')!r}) ; delay(0.01)")
    found = behind.arrivals(0, 3, MS, 1, 100)
    assert [*zip(found.packet.tolist(), found.time_ns.tolist(), strict=True)] == [(0, 24 * MS), (0, 25 * MS)]
    assert len(behind.arrivals(1, 3, MS, 1, 100).packet) == 3


def test_a_message_that_was_read_too_late_for_its_tick_arrives_at_the_tick_that_took_it(tmp_path: Path) -> None:
    """An end that stalled, or that takes in a flood bit by bit, takes what came at a later tick."""
    link = Recorded(str(live_run(tmp_path / "run", [(0, 20 * MS, 30)], BWD, ticks=100)))
    (_, time_ns), = arrivals(link, 0, 50)
    assert -(-time_ns // MS) == 30
    assert time_ns == 29 * MS + 1
    scene = load_scene("hard_wall", duration=0.05, link=link)
    fwd = link_plans(scene, 0).fwd
    assert fwd is not None
    assert np.flatnonzero(fwd.played_at >= 0).tolist() == [30]


def test_a_message_that_came_before_the_tick_of_its_number_enters_no_later_than_it_leaves(tmp_path: Path) -> None:
    """So it is where the other end's clock is ahead, by half a round trip at most."""
    link = Recorded(str(live_run(tmp_path / "run", [(5, 4 * MS, 5)], BWD, ticks=100)))
    assert arrivals(link, 0, 50) == [(5, 5 * MS)]


def test_another_tick_meets_the_same_delays_and_gaps_in_time(tmp_path: Path) -> None:
    link = Recorded(str(live_run(tmp_path / "run", FWD, BWD, ticks=100)))
    half = arrivals(link, 1, 20, MS // 2)
    assert half == [(k, k * MS // 2 + 7 * MS) for k in range(20) if k % 4 < 2]
    double = arrivals(link, 0, 3, 2 * MS)
    assert double == [(0, 20 * MS + 1), (1, 26 * MS)]


def test_a_longer_scene_begins_the_record_again_and_what_was_under_way_at_its_end_is_no_loss(tmp_path: Path) -> None:
    """In a scene as long as the run it is under way still; for a longer one it has the fate of the first messages."""
    came = [(k, k * MS + 40 * MS - 9, k + 40) for k in range(60) if k != 2]  # a run of 100 ticks
    link = Recorded(str(live_run(tmp_path / "run", came, BWD, ticks=100)))
    found = arrivals(link, 0, 200)
    assert [packet for packet, _ in found] == [k for k in range(200) if k not in (2, 62, 102, 162)]
    assert [at for at in found if at[0] < 60] == [(packet, time_ns) for packet, time_ns, _ in came]
    assert all(time_ns > 99 * MS for packet, time_ns in found if packet >= 60)
    scene = load_scene("free_motion", duration=0.1, link=link)
    fwd = link_plans(scene, 0).fwd
    assert fwd is not None
    assert (fwd.received, fwd.lost, fwd.in_flight) == (59, 2, 39)
    assert [at for at in found if 100 <= at[0] < 160] == [(k + 100, at + 100 * MS) for k, at, _ in came]


def test_a_link_that_was_dead_to_the_end_of_the_run_is_dead_as_long(tmp_path: Path) -> None:
    came = [(k, k * MS + 10 * MS, k + 10) for k in range(20)]  # a run of 100 ticks
    link = Recorded(str(live_run(tmp_path / "run", came, BWD, ticks=100)))
    assert [packet for packet, _ in arrivals(link, 0, 120)] == [*range(20), *range(89, 120)]
    dead = Recorded(str(live_run(tmp_path / "dead", [], BWD, ticks=100)))
    assert arrivals(dead, 0, 300) == []


def test_its_text_has_the_digest_so_that_another_run_under_the_same_path_is_another_link(tmp_path: Path) -> None:
    folder = live_run(tmp_path / "run", FWD, BWD, ticks=100)
    link = Recorded(str(folder))
    text = describe(link)
    assert text == f"recorded(path={str(folder)!r}, digest={link.digest!r})"
    assert parse_link(text) == link
    assert len(link.digest) == 12
    shown = load_scene("hard_wall", link=f"recorded({str(folder)!r})").knobs["link"]
    assert shown == text
    assert load_scene("hard_wall", link="delay( 0.05 )").knobs["link"] == "delay( 0.05 )"
    other = Recorded(str(live_run(tmp_path / "other", FWD[1:], BWD, ticks=100)))
    assert other.digest != link.digest
    (folder / "slave" / "arrivals.bin").write_bytes((tmp_path / "other" / "slave" / "arrivals.bin").read_bytes())
    with pytest.raises(Refused, match=f"has the digest {other.digest}, not '{link.digest}': its run was another"):
        parse_link(text)


def test_in_a_sweep_a_row_is_the_run_and_another_recording_is_another_sweep(tmp_path: Path) -> None:
    folder = live_run(tmp_path / "run", [(k, k * MS + 9 * MS, k + 9) for k in range(0, 80, 3)], BWD, ticks=100)
    fixed = {"duration": 0.1, "link": f"recorded({str(folder)!r})"}
    table = sweep("free_motion", {"x_limit": [1.0, 2.0]}, fixed=fixed, engine="plain", out=tmp_path / "sweep")
    alone = run(load_scene("free_motion", **fixed)).metrics["x_err_rms"]
    assert [*table["x_err_rms"]] == [alone, alone]
    assert alone != run(load_scene("free_motion", duration=0.1)).metrics["x_err_rms"]
    shutil.rmtree(folder)
    live_run(folder, FWD, BWD, ticks=100)
    with pytest.raises(Refused, match="holds another sweep"):
        sweep("free_motion", {"x_limit": [1.0, 2.0]}, fixed=fixed, engine="plain", out=tmp_path / "sweep")


def test_stability_over_the_link_of_a_live_run_names_the_link_and_not_only_fields_that_nobody_wrote(
    tmp_path: Path
) -> None:
    folder = live_run(tmp_path / "run", FWD, BWD, ticks=100, left_out={"m": {7}})
    with pytest.raises(Refused, match=r"ticks are left out.*in place of a recorded link give --link 'delay\(0.05\)'"):
        refuse_nonlinear_parts(load_scene("free_motion", link=f"recorded('{folder}')"))


def spoiled(path: Path, **keys: object) -> None:
    first, rows = path.read_bytes().split(b"\n", 1)
    path.write_bytes(json.dumps({**json.loads(first), **keys}).encode() + b"\n" + rows)


def met(folder: Path, session: str) -> None:
    (folder / "events.jsonl").write_text(json.dumps({"k": 0, "what": "met", "why": f"session {session}"}) + "\n")


BROKEN: list[tuple[Callable[[Path], object], str]] = [
    (lambda at: Recorded(str(at / "master")), "is the folder of one end, which has the arrivals of one direction"),
    (lambda at: Recorded(str(at.parent)), "is no folder of a live run"),
    (lambda at: Recorded(str(at / "nowhere")), "is no folder of a live run"),
    (lambda at: Recorded(str(at / "slave"), str(at / "master")), "give the master's folder first"),
    (lambda at: Recorded(str(at), left_out=1), "left_out must be True or False"),  # type: ignore[arg-type]
    (lambda at: Recorded(str(at), digest="0"), "has the digest .*, not '0'"),
    (lambda at: ((at / "slave" / "arrivals.bin").unlink(), Recorded(str(at))), "holds no arrivals.bin to run again"),
    (lambda at: (spoiled(at / "slave" / "arrivals.bin", version=9), Recorded(str(at))), "is of version 9"),
    (lambda at: (spoiled(at / "slave" / "arrivals.bin", dt_ns=5000), Recorded(str(at))), "holds no ticks with the arr"),
    (lambda at: (met(at / "master", "a"), met(at / "slave", "b"), Recorded(str(at))), "not the two ends of one run"),
    (lambda at: (spoiled(at / "slave" / "record.bin", scene="x"), Recorded(str(at))), "not the two ends of one run"),
    (lambda at: (spoiled(at / "master" / "record.bin", mode="lockstep"), Recorded(str(at))), "by packets .* --link"),
]


def test_what_is_no_live_run_is_refused_in_one_sentence(tmp_path: Path) -> None:
    sound = live_run(tmp_path / "sound" / "run", FWD, BWD, ticks=100)
    for i, (spoil, sentence) in enumerate(BROKEN):
        folder = shutil.copytree(sound, tmp_path / str(i) / "run")
        with pytest.raises(Refused, match=sentence) as refused:
            spoil(folder)
        assert "\n" not in str(refused.value), i
