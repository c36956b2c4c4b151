"""The table of a run, its numbers as a person reads them, and that no text in it gives the terminal an order."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop import Refused, Result, load_scene, run
from teleop.simulation.result import Packets
from teleop.terminal.options import guarded
from teleop.terminal.run_table import heading, table
from teleop.terminal.table import PREFIX, columns, duration, facts, grouped, printable, si


def rows(result: Result) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for line in table(result).splitlines():
        label, text = re.split(r" {3,}", line, maxsplit=1)
        found.setdefault(label, []).append(text)
    return found


@pytest.fixture(scope="module")
def wave() -> Result:
    return run(load_scene("canonical", duration=1.0))


class TestTable:
    def test_says_what_ran_how_it_ended_and_the_figures_with_units(self, wave: Result) -> None:
        told, got = rows(wave), wave.metrics
        assert told["run"] == ["canonical, law wave(b=2, K=500, B=20), virtual time, seed 0"]
        assert told["status"] == ["ok: ran to its end, 1000 ticks of 0.001 s"]
        assert told["tracking error"] == [f"{got['x_err_rms'] * 1e3:.1f} mm rms, {got['x_err_max'] * 1e3:.1f} mm max"]
        assert re.fullmatch(r"[\d.]+ m?N rms, [\d.]+ m?N max", told["force error"][0])
        assert got["f_m_end"] > 1.0
        assert told["force at the end"] == [f"{got['f_m_end']:.2f} N felt, 0 N touched, mean over the last 0.1 s"]
        assert told["delay seen"] == ["50.0 ms fwd, 50.0 ms bwd"]
        assert told["packets"][0] == "fwd: 1000 sent, 950 received, 0 lost, 0 late, 50 under way at the end"
        assert told["link energy"][0].startswith("0 J smallest, ")
        kept = rows(run(load_scene("canonical", law="two_layer", duration=0.5)))["law energy"][0]
        assert re.fullmatch(r"-?[\d.]+ \w?J smallest, [\d.]+ \w?J at the end", kept)

    def test_says_the_queue_and_what_a_wave_takes_with_it(self, wave: Result) -> None:
        got = run(load_scene("canonical", duration=1.0, link="delay(0.05)|bernoulli(0.1)"))
        fwd, bwd = ([1e3 * got.metrics[f"queue_{way}_{what}"] for what in ("end", "max")] for way in ("fwd", "bwd"))
        queue, takes = rows(got)["queue"]
        assert queue == (f"{fwd[0]:.2f} ms (up to {fwd[1]:.2f} ms) fwd, {bwd[0]:.2f} ms (up to {bwd[1]:.2f} ms) bwd at "
                         "the end")
        assert takes == f"so a wave takes {50 + fwd[0]:.1f} ms fwd, {50 + bwd[0]:.1f} ms bwd, delay and queue"
        steady = run(load_scene("canonical", duration=1.0, playout="integral"))
        assert steady.metrics["queue_fwd_max"] == pytest.approx(0.0, abs=1e-12)
        assert "queue" not in rows(steady)  # all that came was played at once
        assert "queue" not in rows(wave)

    def test_says_what_is_felt_in_free_space_and_of_what_is_pressed(self) -> None:
        result = run(load_scene("hard_wall", duration=5.0))
        got = result.metrics
        free, pressed = rows(result)["felt"]
        assert free == (f"in free space it adds {got['felt_drag']:.3g} N s/m of drag and {got['felt_mass']:.3g} kg of "
                        f"apparent mass to the master (fit {100.0 * got['felt_fit']:.0f} %)")
        share = f"{100 * got['felt_share']:.3g} % of what is touched"
        assert pressed == f"a stiffness of {got['felt_stiffness']:.0f} N/m, {share}"

    def test_a_mass_below_zero_is_told_as_a_spring_only_where_it_is_one(self, wave: Result) -> None:
        """What is left of it is a drag that is held for a tick, a fit that explains little, and a run that diverged."""
        held, words = -0.5e-3 * 20.0, "it pulls back as a spring does"
        for mass, fit, status, springs in ((-0.2, 0.9, "ok", True), (held, 1.0, "ok", False), (-0.2, 0.4, "ok", False),
                                           (-0.2, 0.9, "diverged", False)):
            fitted = {"felt_mass": mass, "felt_drag": 20.0, "felt_fit": fit}
            (felt,) = rows(replace(wave, status=status, metrics=fitted))["felt"]
            assert f"20 N s/m of drag and {mass:.3g} kg of apparent mass" in felt
            assert felt.endswith(f"; less than 0 kg: {words}") == springs
            assert (words in felt) == springs

    def test_leaves_out_what_the_scene_or_the_run_does_not_have(self, wave: Result) -> None:
        told = rows(run(load_scene("canonical", duration=0.1, link=None, energy=False)))
        assert set(told) == {"run", "status", "tracking error", "force error", "force at the end"}
        told = rows(replace(wave, status="stopped", sentence="the peer left", ticks=0, metrics={}, run_time=0.1))
        assert told == {"run": told["run"], "status": ["stopped: the peer left"]}
        for name in ("x_err_max", "f_err_max", "T_fwd_max"):  # half of a pair
            assert table(replace(wave, metrics={key: value for key, value in wave.metrics.items() if key != name}))

    def test_has_each_line_where_there_is_something_to_tell(self, wave: Result) -> None:
        """An end without a summary had "ordinary scheduling", and packets of a lossless link were missing."""
        varied = {**wave.metrics, "T_fwd_mean": 0.02, "T_fwd_max": 0.03}
        del varied["T_bwd_mean"], varied["T_bwd_max"]
        late: dict[str, Any] = {"skipped": 2, "late_us": {"p50": 61.0, "p99": 172.0, "p100": 2300.0}, "cpu": 0.05}
        ends = {"master": late, "slave": {**late, "late_us": {}, "cpu": None}}
        link = {"rtt": {"mean": 0.1}, "jitter": 1e-4, "lost": 2557, "reordered": 0}
        quick = {"realtime": {"scheduler": "SCHED_FIFO, priority 40", "memory": "locked"}, "sealed": False}
        steps = {"error_estimate_max": 4.94e-10, "error_estimate_sum": 1.2e-8, "substeps_max": 3,
                 "ticks_over_tolerance": 0, "tolerance": 1e-9}
        cases: tuple[tuple[dict[str, Any], dict[str, list[str] | None]], ...] = (
            ({}, {"time per tick": None, "watchdog": None, "queue": None}),
            ({"status": "diverged", "sentence": "diverged at t = 1 s"}, {"status": ["diverged at t = 1 s"]}),
            ({"notes": ("mind this", "and that")}, {"note": ["mind this", "and that"]}),
            ({"run_time": 0.004}, {"time per tick": ["4.00 us, 250 times real time"]}),
            ({"packets": {"fwd": Packets(sent=9, received=7, lost=2, late=1, overtaken=3, duplicates=4),
                          "bwd": Packets(sent=9, received=9, rejected={"checksum": 2, "version": 0})}},
             {"packets": ["fwd: 9 sent, 7 received, 2 lost, 1 late, 3 overtaken, 4 doubled",
                          "bwd: 9 sent, 9 received, 0 lost, 0 late, 2 rejected (checksum)"]}),
            ({"metrics": varied}, {"delay seen": ["20.0 ms (up to 30.0 ms) fwd, nothing came bwd"]}),
            ({"metrics": {**wave.metrics, "g_m_min": 0.0, "g_s_min": 1.0}},
             {"watchdog": ["let go: smallest gain 0% at the master, 100% at the slave"]}),
            ({"metrics": {**wave.metrics, "g_m_min": 1.0, "g_s_min": 1.0}}, {"watchdog": None}),
            ({"mode": "live", "extra": ends, "run_time": 1.0}, {
                "late ticks": [
                    "master: 2 skipped, half under 61.0 us late, 99 % under 172 us late, at most 2.30 ms late",
                    "slave: 2 skipped"],
                "time per tick": ["50.0 us master of processor time"]}),
            ({"mode": "lockstep", "extra": ends}, {"late ticks": None}),
            ({"mode": "live", "extra": {"master": link}},
             {"link seen": ["master: round trip 100 ms, jitter 100 us, 2557 missing, 0 out of order"]}),
            ({"mode": "live", "extra": {"master": link},
              "packets": {way: replace(each, saved=2600) for way, each in wave.packets.items()}},  # by a deadband
             {"link seen": ["master: round trip 100 ms, jitter 100 us, 2557 missing or not sent, 0 out of order"]}),
            ({"mode": "live", "extra": {"master": quick, "slave": quick}},
             {"real time": ["both ends: scheduler SCHED_FIFO, priority 40, memory locked"]}),
            ({"mode": "live", "extra": {"master": {"sealed": True}, "slave": quick}},
             {"real time": ["master: ordinary scheduling, real-time scheduling was not asked for",
                            "slave: scheduler SCHED_FIFO, priority 40, memory locked"]}),
            *[({"mode": "live", "extra": {"master": {"sentence": sentence}, "slave": quick}},
               {"real time": ["slave: scheduler SCHED_FIFO, priority 40, memory locked"]}) for sentence in (
                   "the process ended without a word after tick 9; this is made from its record",
                   "still running: this is its record up to tick 9")],
            ({"extra": {"integration": {"master": steps, "slave": {**steps, "ticks_over_tolerance": 2}}}},
             {"integration": ["master: error estimated at 4.94e-10 m a tick (12.0 nm added up), up to 3 sub-steps",
                              "slave: error estimated at 4.94e-10 m a tick (12.0 nm added up), up to 3 sub-steps; "
                              "2 ticks above 1.00 nm"]}),
        )
        for changes, lines in cases:
            told = rows(replace(wave, **changes))
            assert {label: told.get(label) for label in lines} == lines, changes
            assert table(replace(wave, **changes)).isascii()


NASTY = "\x1b]0;owned\x07\x1b[2J\r\nstatus   ok\x9b31m\u202egnp.exe\ud800\x00"


class TestText:
    def test_that_a_file_holds_gives_the_terminal_no_orders(self) -> None:
        result = run(load_scene("canonical", duration=0.01))
        shown = table(replace(result, scene=NASTY, sentence=NASTY, notes=(NASTY, "a\nnote   forged")))
        assert all(line.isprintable() for line in shown.split("\n"))
        assert not any(line.startswith(("status   ok", "note   forged")) for line in shown.split("\n"))
        assert r"\x1b[2J" in shown

    def test_of_a_refusal_gives_the_terminal_no_orders_either_and_at_length_is_cut(
            self, capsys: pytest.CaptureFixture[str]) -> None:
        def refuse() -> int:
            raise Refused(NASTY + "x" * 10_000)

        assert guarded(refuse) == 2
        said = capsys.readouterr().err
        assert said.removesuffix("\n").isprintable()
        assert len(said) < 5000
        assert printable("x" * 10, most=5) == "xx..."
        assert printable("a\nb\x1b", lines=True, most=2) == "a\nb\\x1b", "lines stay where they are wanted"


def test_figures_over_axes_in_m_and_in_rad_have_no_unit_and_say_so() -> None:
    told = rows(run(load_scene("pose", duration=0.5)))
    for label in ("tracking error", "force error", "force at the end"):
        assert told[label][0].endswith("over axes in m and in rad"), told[label]
    assert "over axes" not in told["angle error"][0]  # of the rotation alone
    joints = rows(run(load_scene("leader_follower", duration=0.05)))
    assert " rad" in joints["integration"][0]
    assert "over axes" not in joints["tracking error"][0]


def test_another_law_ran_with_untuned_gains_and_no_note_and_two_with_other_gains_had_the_same_header() -> None:
    heads = []
    for knobs, noted in (({"law": "pfra"}, True), ({"law": "deadband(0.1) | pfra"}, True), ({}, False),
                         ({"law": "pfra", "law.alpha": "0.5"}, False), ({"law": "wave"}, False),
                         ({"law": "wave()"}, False)):
        result = run(load_scene("hard_wall", duration=0.01, **knobs))
        heads.append(heading(result))
        assert any("runs with its defaults, which are not tuned for scene hard_wall" in note
                   for note in result.notes) == noted, knobs
    assert heads[-2:] == ["hard_wall, law wave(b=20, K=1000, B=20)", "hard_wall, law wave(b=2, K=500, B=20)"]


# Aligned text, facts and columns, and numbers as a person reads them: SI prefixes, durations, counts


def test_facts_stand_behind_the_longest_label_each_on_its_line_and_columns_are_as_wide_as_their_widest_cell() -> None:
    assert facts([("run", "a"), ("", "b"), ("longest", "c")]) == "run       a\n          b\nlongest   c"
    assert facts([("scene", "x\nstatus   ok\x1b[2J")]) == r"scene   x\nstatus   ok\x1b[2J"
    assert facts([]) == ""
    lines = columns([("name", "size", "note"), ("a", "10", ""), ("bcdef", "7", "odd")], left=(0, 2)).splitlines()
    assert lines == ["name   size  note", "a        10", "bcdef     7  odd"]


@given(st.floats(min_value=1e-9, max_value=9.99e11) | st.floats(min_value=-9.99e11, max_value=-1e-9))
def test_a_number_with_a_prefix_reads_back_to_three_digits(value: float) -> None:
    number, unit = si(value, "m").split(" ")
    factor = {letter: 1e3**power for power, letter in PREFIX.items()}[unit.removesuffix("m")]
    assert float(number) * factor == pytest.approx(value, rel=5.001e-3)
    assert 1.0 <= abs(float(number)) < 1000.0
    assert len(re.sub(r"[-.]", "", number)) == 3


def test_a_number_beyond_the_prefixes_or_none_is_read_all_the_same() -> None:
    for value, text in ((0.0, "0 m"), (-0.0, "0 m"), (-0.011, "-11.0 mm"), (999.6, "1.00 km"), (0.0009996, "1.00 mm"),
                        (5.08e17, "5.08e+17 m"), (1.7e-18, "1.70e-18 m"), (float("inf"), "inf m"),
                        (float("nan"), "nan m")):
        assert si(value, "m") == text


@given(st.floats(min_value=0.0, max_value=1e9))
def test_a_duration_reads_back_in_a_unit_that_suits_it(seconds: float) -> None:
    text, unit = duration(seconds).split(" ")
    read = float(text) * {"s": 1.0, "min": 60.0, "h": 3600.0}[unit]
    assert read == pytest.approx(seconds, rel=0.0502, abs=1.0 if unit == "s" else 0.0)
    assert "e" not in text
    assert text != "0"
    assert (unit == "s") == (seconds < 99.5)


@given(st.integers(0, 10**20))
def test_a_count_reads_back_from_groups_of_three(count: int) -> None:
    assert int(grouped(count).replace(" ", "")) == count
    assert all(len(group) == 3 for group in grouped(count).split(" ")[1:])
