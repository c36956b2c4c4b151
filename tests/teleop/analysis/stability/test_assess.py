"""Stability against published and computed numbers, against runs in virtual time, and as a user asks for it."""

from __future__ import annotations

import functools
import json
import math
import re
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.optimize import brentq

from channel import Delay, parse_link
from master.hand import Grip, Rest
from slave import Tissue, Wall
from teleop import PFRA, At, Cap, Direct, MassDamper, Refused, Scene, Wave, load_scene, number, run
from teleop.analysis.models.continuous import Continuous, continuous
from teleop.analysis.models.linear import linear_scene
from teleop.analysis.stability import report
from teleop.analysis.stability.assess import critical, is_stable, lowest, stability, swing
from tests.fakes import Motion, Springs, law_of

Typed = Callable[..., Any]


class Force(NamedTuple):
    f_e: float  # N


def late_force(law: Any, s: Force, at: At, rx: Motion) -> tuple[float, Force, Force]:
    after = Force(s.f_e - math.expm1(-300.0 * at.dt) * (at.f - s.f_e))
    return law.K * (rx.x - at.x) + law.B * (rx.v - at.v), after, after


# Position-force with the wall's force through a filter of 300 1/s at the slave, and 0.4 of the hand's taken off.
Filtered = law_of(
    master_start=lambda _, __: ((), Force(0.0)), slave_start=lambda _, at: (Force(0.0), Motion(at.x, 0.0)),
    master=lambda _, s, at, rx: (rx.f_e - 0.4 * at.f, Motion(at.x, at.v), s), slave=late_force)


HANDLE = MassDamper(mass=0.04, damping=0.8)  # kg, N s/m
SOFT, STIFF = Direct(K=400.0, B=4.0), Direct(K=2000.0, B=8.0)


def handles(law: Any, *, wall: float = 400.0, hand: tuple[float, float] = (100.0, 2.0), **changes: Any) -> Scene:
    """Two handles, a hand of no mass, and a wall that is held on to."""
    grip = Grip(mass=0.0, k=hand[0], d=hand[1], reference=Rest())
    scene = Scene(law=law, master=HANDLE, slave=HANDLE, hand=grip, environment=Tissue(k=wall, d=0.0), duration=1.0)
    return replace(scene, **changes)


def handles_link(forth: int, back: int) -> Any:
    return parse_link(f"delay({forth}e-3) ; delay({back}e-3)")


class TestTheDelayMargin:
    @pytest.mark.parametrize(("law", "wall", "ms", "hz", "at_1_khz", "at_10_khz"), [
        (SOFT, 400.0, 9.504, 14.235, 9, 95), (STIFF, 2000.0, 1.520, None, 2, 15),
        (Springs(K=2000.0, B=8.0), 2000.0, 14.840, None, 11, 144),
    ])
    def test_is_the_computed_one_without_a_clock_and_with(
        self, law: Any, wall: float, ms: float, hz: float | None, at_1_khz: int, at_10_khz: int
    ) -> None:
        found = continuous(handles(law, wall=wall))
        assert found.stable_without_delay
        assert round(found.round_trip * 1e3, 3) == ms
        assert hz is None or round(found.frequency or 0.0, 3) == hz
        assert stability(handles(law, wall=wall)).critical_round_trip == at_1_khz
        assert stability(handles(law, wall=wall, dt=1e-4)).critical_round_trip == at_10_khz

    def test_of_a_firm_hand_on_a_soft_coupling_is_none(self) -> None:
        firm = handles(SOFT, hand=(400.0, 8.0))
        assert continuous(firm) == Continuous(True, None, None)
        found = stability(replace(firm, link=Delay(30.0)))
        assert (found.verdict, found.critical_round_trip, found.delay_margin) == ("stable", None, None)

    def test_is_that_of_a_transfer_function_by_hand(self) -> None:
        """|L| = 1 of `L = k_e (B s + K)/((m s^2 + (b+d) s + k)(m s^2 + (b+B) s + K + k_e))`."""
        def L(w: float) -> complex:
            s = 1j * w
            own = (0.04 * s * s + 2.8 * s + 100.0) * (0.04 * s * s + 4.8 * s + 800.0)
            return 400.0 * (4.0 * s + 400.0) / own

        w = brentq(lambda w: abs(L(w)) - 1.0, 60.0, 200.0, xtol=1e-12)
        found = continuous(handles(SOFT))
        assert found.frequency == pytest.approx(w / (2.0 * math.pi), rel=1e-9)
        # The loop is closed with a minus: f_m acts against the hand.
        assert found.round_trip == pytest.approx((np.angle(-L(w)) % (2.0 * math.pi)) / w, rel=1e-9)

    def test_counts_both_ways_together(self) -> None:
        for forth, back in ((4, 5), (1, 8), (7, 2)):
            link = handles_link(forth, back)
            assert not is_stable(handles(SOFT, link=link))
            assert is_stable(handles(SOFT, link=handles_link(forth, back - 1)))
            assert stability(handles(SOFT, link=link)).delay_margin == -1

    @pytest.mark.parametrize("observer", [None, 200.0])
    def test_of_a_law_with_memory_and_a_force_sensor_is_the_limit_of_short_ticks(self, observer: float | None) -> None:
        hand = Grip(mass=0.1, k=100.0, d=2.0, reference=Rest())
        scene = replace(handles(Filtered(), observer=observer, dt=1e-5, duration=0.1), hand=hand)
        limit = continuous(scene).round_trip
        ticks = stability(scene).critical_round_trip
        assert limit is not None
        # Two half ticks of hold and the force that is read a tick late.
        assert ticks * 1e-5 == pytest.approx(limit, abs=5e-5)

    def test_of_pfra_that_reflects_all_is_that_of_direct_reflection_and_of_several_axes_that_of_the_worst(self) -> None:
        three = handles(SOFT, axes=3, environment=(None, Tissue(k=400.0, d=0.0), Tissue(k=100.0, d=0.0)))
        for scene in (handles(PFRA(alpha=1.0, K=400.0, B=4.0)), three):
            assert continuous(scene).round_trip == pytest.approx(continuous(handles(SOFT)).round_trip, rel=1e-9)
            assert stability(scene).critical_round_trip == 9

    def test_of_waves_is_none(self) -> None:
        for k_e in (50.0, 1e6):
            scene = load_scene("soft_tissue", k_e=k_e)
            assert continuous(scene) == Continuous(True, None, None)
            found = stability(scene)
            assert (found.verdict, found.critical_round_trip) == ("stable", None)
            assert found.integrators == 1  # two hands that agree on a force may stand anywhere
            assert found.gain_margin == 1.0  # so that any more makes it wander off

    def test_of_damping_injection_needs_the_sum_of_the_delays(self) -> None:
        """Two free 5 kg masses, 400 N/m, 50 ms each way."""
        body = MassDamper(mass=5.0)
        for Bd, verdict in ((15.0, "unstable"), (20.0, "stable")):
            law = Springs(K=400.0, B=0.0, Bd=Bd)
            found = stability(Scene(law=law, master=body, slave=body, link=Delay(0.05), duration=1.0))
            assert found.verdict == verdict
            assert found.integrators == 1  # both free masses together may stand anywhere
            assert (found.mode.growth > 0.0) == (verdict == "unstable")


class TestTheDominantMode:
    @pytest.mark.parametrize(("law", "delay"), [
        ("direct", 0.03), ("wave", 0.006), *(pytest.param("direct", T, marks=pytest.mark.full) for T in (0.01, 0.4))])
    def test_is_what_a_run_grows_or_dies_with(self, law: str, delay: float) -> None:
        scene = load_scene("soft_tissue", law=law, delay=delay, amplitude=0.0, frequency=0.0, dt=2e-3, duration=20.0)
        scene = replace(scene, start_m=1e-3, x_limit=1e300, energy=False)
        mode = stability(scene).mode
        trace = run(scene).trace["x_m"]
        loud = int(np.flatnonzero(np.abs(trace) > 1e-9)[-1])
        # Under waves the master stays where it came to: its steps are the motion.
        part = trace[loud - 2500:loud] if law == "direct" else np.diff(trace)[2000:2600]
        # A motion of one mode alone obeys x(k+2) = 2 Re z x(k+1) - |z|^2 x(k).
        (sum_, product), *_ = np.linalg.lstsq(np.column_stack([part[1:-1], part[:-2]]), part[2:], rcond=None)
        z = complex(sum_ / 2.0, math.sqrt(-product - sum_ * sum_ / 4.0))
        assert z == pytest.approx(complex(mode.z.real, abs(mode.z.imag)), abs=2e-6)
        assert mode.growth == pytest.approx(math.log(abs(z)) / 2e-3, abs=2e-3)
        assert mode.frequency == pytest.approx(math.atan2(z.imag, z.real) / (2.0 * math.pi * 2e-3), rel=1e-3)

    def test_of_a_loop_that_nothing_closes_is_an_ends_own(self) -> None:
        """A slave in free space reflects no force, so all that lasts is the hand on the master."""
        for delay in (0.01, 5.0):
            mode = stability(load_scene("free_motion", law="direct", delay=delay)).mode
            assert mode.growth == pytest.approx(-5.5 / (2 * 0.5), rel=1e-6)


class TestALongDelay:
    @pytest.mark.full
    def test_of_three_thousand_samples_each_way_needs_no_matrix_of_that_size(self) -> None:
        tracemalloc.start()
        try:
            found = stability(load_scene("soft_tissue", law="direct", delay=3.0))
            most = tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()
        assert found.round_trip == 6_000
        assert most < 20e6  # bytes; the matrix would take 288e6
        # Roots lie 1/T apart along the band in which |L| > 1, up to about 4.3 Hz, a pair each; none grows at more
        # than log(max |L|)/T.
        assert 27 < found.unstable < 2 * 4.3 * 6.0
        assert 0.5 / 6.0 < found.mode.growth < 1.0 / 6.0

    def test_had_twenty_two_growing_roots_and_no_dominant_mode(self) -> None:
        scene = load_scene("soft_tissue", law="direct", delay=10.0, k_e=100.0, **{"law.K": 2000.0})
        found = stability(scene)
        assert found.unstable == 22
        assert found.mode.z == pytest.approx(greatest_of_direct(scene), abs=1e-13)
        assert round(found.mode.frequency, 3) == 3.017
        assert round(found.mode.growth, 4) == 0.0020

    @pytest.mark.full
    @pytest.mark.parametrize("seed", range(8))
    def test_has_the_dominant_mode_that_its_equation_has(self, seed: int) -> None:
        """Tissue, coupling and 0.3 to 16 s of delay at random; the edge of stability among them."""
        dice = np.random.default_rng(seed)
        knobs = {"k_e": 10.0 ** dice.uniform(1.0, 3.0), "law.K": 10.0 ** dice.uniform(2.5, 3.5)}
        scene = load_scene("soft_tissue", law="direct", delay=10.0 ** dice.uniform(-0.5, 1.2), **knobs)
        if seed % 2:
            edge = stability(scene).gain_margin
            hand = replace(scene.hand, k=scene.hand.k * edge) if scene.hand else None
            scene = replace(scene, hand=hand)
        found = stability(scene)
        assert found.mode.z == pytest.approx(greatest_of_direct(scene), abs=1e-12)
        assert (found.mode.growth > 0.0) == (found.unstable > 0)


def greatest_of_direct(scene: Scene) -> complex:
    """The greatest root of `z^d = l(z)`: rate = (log l(e^rate) + 2 pi i n)/d, again and again, for each n."""
    linear = linear_scene(scene)
    d, ends = linear.round_trip, (linear.master, linear.slave)

    def log_l(rates: Any) -> Any:
        product = 1.0
        for A, B, C, D in ends:
            inner = np.linalg.inv(np.exp(rates)[:, None, None] * np.eye(len(A)) - A)
            product = (C @ inner @ B + D) if isinstance(product, float) else product @ (C @ inner @ B + D)
        return np.log(np.trace(product, axis1=1, axis2=2))  # of one field back: the only eigenvalue that is not 0

    turns = np.arange(int(8.0 * d * linear.dt))  # up to 8 Hz
    rates = 2j * np.pi * turns / d
    for _ in range(80):
        logs = log_l(rates)
        rates = (logs + 2j * np.pi * np.round(((d * rates - logs) / (2j * np.pi)).real)) / d
    return complex(np.exp(rates[rates.real.argmax()]))


class TestACriticalValue:
    def test_parts_stable_from_unstable_takes_the_nearest_change_and_tells_of_each(self) -> None:
        def scene(k_e: float) -> Scene:
            return load_scene("soft_tissue", law="direct", k_e=k_e, delay=0.005)

        soft = critical(scene, "k_e", low=10.0, high=1e5, near=100.0, tol=10.0)
        found = critical(scene, "k_e", low=10.0, high=1e5, near=1e5, tol=0.1)
        assert [one.stable for one in found.all] == ["below", "above"]
        assert (found.value, found.low, found.high, found.stable) == found.all[1]
        assert (soft.stable, soft.changes, found.changes) == ("below", 2, 2)
        assert soft.value == pytest.approx(found.all[0].value, abs=10.0)
        for one, tol in [(soft.all[0], 10.0), *((one, 0.1) for one in found.all)]:
            assert one.high - one.low <= tol
            assert is_stable(scene(one.low)) == (one.stable == "below") != is_stable(scene(one.high))

    def test_where_verdicts_alternate_is_the_lowest_tried(self) -> None:
        """Below it all that were tried are alike; a bisection would have come to some change or other."""
        asked: dict[float, bool] = {}

        def judge(value: Any) -> bool:
            asked[value] = value < 30.0 or int(value) % 3 == 0
            return asked[value]

        made: Any = lambda value: value  # noqa: E731  # no scene is needed where the judge needs none
        found = lowest(made, "K", low=20.0, high=120.0, judge=judge, places=21)
        assert found.value == found.high == min(value for value, rested in asked.items() if not rested)
        assert found.low == max(value for value in asked if value < found.value)
        assert (found.stable, found.method, found.tried) == ("below", "stepwise", len(asked))
        assert found.high - found.low == pytest.approx(5.0 / 2**5)
        assert found.changes == len(found.all) > 3
        assert all(asked[one.low] == (one.stable == "below") != asked[one.high] for one in found.all)
        close = lowest(made, "K", low=20.0, high=120.0, judge=judge, places=21, tol=1e-3)
        assert close.high - close.low <= 1e-3


class TestVirtualTime:
    def test_agrees_with_the_roots_where_there_are_any(self) -> None:
        for delay, verdict in ((0.013, "stable"), (0.016, "unstable")):
            scene = load_scene("soft_tissue", law="direct", delay=delay)
            assert stability(scene).verdict == swing(scene).verdict == verdict

    def test_tells_a_limit_cycle_from_both(self) -> None:
        """A cap bounds an unstable linear loop: it then swings where its phase is right for any gain.

        The cap's describing function is real, so the frequency is that of the loop whose gain is lowered to its
        margin (A. Gelb and W. E. Vander Velde, Multiple-Input Describing Functions, 1968, ch. 3).
        """
        scene = replace(handles(STIFF, wall=2000.0, link=Delay(2e-3)), duration=4.0)
        margin = stability(scene).gain_margin
        assert margin < 1.0
        at_margin = stability(replace(scene, law=replace(STIFF, kf=margin))).mode
        found = swing(replace(scene, cap=Cap(f_max=0.5)))
        assert found.verdict == "limit cycle"
        assert found.frequency == pytest.approx(at_margin.frequency, rel=0.1)
        assert 1e-5 < found.amplitude < 1e-2

    @pytest.mark.full
    def test_looks_where_the_slave_touches(self) -> None:
        """In free space this scene is stable; pressed against its wall it bounces for ever."""
        scene = load_scene("hard_wall", law="direct")
        assert swing(scene).verdict == "limit cycle"
        assert swing(replace(scene, environment=None)).verdict == "stable"

    def test_kicks_a_scene_that_stands_still_and_needs_no_hand(self) -> None:
        """Kicked, it bounces for ever; without the delay it comes to rest."""
        still = handles(SOFT, environment=Wall(k=400.0, at=-1e-3), link=Delay(0.02), duration=4.0)
        assert swing(still).verdict == "limit cycle"
        assert swing(replace(still, link=None)).verdict == "stable"
        assert swing(replace(handles(Wave(), link=Delay(0.01), duration=3.0), hand=None)).verdict == "stable"


class TestTheCommand:
    def test_says_verdict_mode_and_margins_in_json_too(self, typed: Typed, monkeypatch: pytest.MonkeyPatch) -> None:
        answer = typed("stability", "soft_tissue", "--set", "law=direct", "--continuous")
        assert (answer.code, answer.err) == (0, "")
        for words in ("unstable: 2 roots outside", "grows", "50 + 50 = 100 ticks", "29 ticks", "dB", "28.788 ms"):
            assert words in answer.out
        monkeypatch.setattr(report, "PLACES", 5)
        answer = typed("stability", "soft_tissue", "--set", "law=direct", "--critical", "k_e", "--json")
        told = json.loads(answer.out)
        assert (told["verdict"], told["unstable"], told["round_trip"]) == ("unstable", 2, 100)
        assert told["critical"]["knob"] == "k_e"
        edge = told["critical"]["value"]
        for factor, verdict in ((0.999, "stable"), (1.001, "unstable")):
            settings = ["--set", "law=direct", "--set", f"k_e={factor * edge}"]
            assert json.loads(typed("stability", "soft_tissue", *settings, "--json").out)["verdict"] == verdict

    @pytest.mark.full
    def test_finds_a_laws_knob_over_any_link_in_its_unit(self, typed: Typed, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(report, "PLACES", 5)
        arguments = ["stability", "soft_tissue", "--set", "law=direct", "--link", "delay(0.02) ; delay(0.03)",
                     "--critical"]
        told = json.loads(typed(*arguments, "law.kf", "--range", "0.1:1", "--tol", "1e-4", "--json").out)
        assert (told["fwd"], told["bwd"]) == (20, 30)
        assert told["critical"]["value"] == pytest.approx(told["gain_margin"], abs=1e-4)
        for more, unit in ((["law.kf", "--range", "0.1:1"], ""), (["k_e", "--range", "20:400"], "N/m")):
            answer = typed(*arguments, *more, "--tol", "0.1")
            found = re.search(rf"critical +{more[0]} = [0-9.e+-]+ ?(\S*) \(within [0-9.e+-]+ ?(\S*)\)", answer.out)
            assert found is not None, answer
            assert found.groups() == (unit, unit)

    def test_runs_what_is_not_linear(self, typed: Typed) -> None:
        answer = typed("stability", "hard_wall", "--set", "law=direct", "--time", "--json")
        told = json.loads(answer.out)
        assert (told["verdict"], told["method"]) == ("limit cycle", "virtual time")
        assert number("frequency", told["frequency"], above=0.0) == pytest.approx(3.14, abs=0.01)

    @pytest.mark.full
    def test_finds_a_critical_value_in_virtual_time(self, typed: Typed, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(report, "PLACES_IN_TIME", 4)  # and none so near the edge that its run is long
        answer = typed("stability", "soft_tissue", "--set", "law=direct", "--time", "--critical", "delay",
                       "--range", "0.005:0.05", "--tol", "4e-3", "--json")
        assert json.loads(answer.out)["critical"]["value"] == pytest.approx(0.0145, abs=2e-3)

    @pytest.mark.full
    def test_said_nothing_while_it_searched_and_lost_all_by_an_interrupt(
        self, typed: Typed, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        judged: list[Scene] = []
        ends = [0]

        def judge(scene: Scene) -> bool:
            if len(judged) == ends[0]:
                raise KeyboardInterrupt
            judged.append(scene)
            return is_stable(scene)

        monkeypatch.setattr(report, "critical", functools.partial(critical, judge=judge))
        arguments = ["stability", "soft_tissue", "--set", "law=direct", "--set", "delay=0.005", "--critical", "k_e",
                     "--range", "10:1e5"]
        for ends[0], words in ((0, "before any value of k_e was judged"),
                               (5, "after 5 values of k_e, from 10 to 31.62 N/m: it is stable at each of them"),
                               (60, "after 60 values of k_e, from 10 to 1e+05 N/m: it is stable at 460.4")):
            judged.clear()
            answer = typed(*arguments)
            assert answer.code == 130
            assert words in answer.out
        judged.clear()
        told = json.loads(typed(*arguments, "--json").out)
        assert (told["status"], told["critical"], len(told["so_far"]["tried"])) == ("interrupted", None, 60)
        assert told["dominant"]["growth"] < 0.0

    def test_bisects_a_whole_number_over_whole_numbers(self, typed: Typed) -> None:
        answer = typed("stability", "virtual_wall", "--critical", "delay", "--range", "0:10")
        assert "delay = 2 ticks is the first that is unstable, 1 is not yet" in answer.out
        told = json.loads(typed("stability", "virtual_wall", "--critical", "every", "--range", "1:9", "--json").out)
        assert (told["critical"]["value"], told["critical"]["low"], told["critical"]["high"]) == (5, 4, 5)

    def test_lists_every_change_and_shows_the_bracket_on_the_way(self, typed: Typed) -> None:
        knobs = {"law": "direct", "delay": 0.005}
        lines: list[tuple[float, str]] = []
        answer = report.ask("soft_tissue", knobs, knob="k_e", span="10:1e5", show=lambda *line: lines.append(line))
        told = report.summary(answer)["critical"]
        assert told["all"][0] == {key: told[key] for key in ("value", "low", "high", "stable")}
        assert (told["changes"], len(told["all"])) == (2, 2)
        other = f"the verdict changes also at {told['all'][1]['value']:.7g} N/m (stable above)"
        assert other in report.table(answer)
        assert lines[0][1] == "k_e = 10 N/m is stable"
        assert lines[-1] == (1.0, "done")
        assert all(0.0 < part <= 1.0 for part, _ in lines)
        assert re.fullmatch(r"k_e = .* N/m is (un)?stable; changes between 460\.\d+ and 460\.\d+", lines[-2][1])

    @pytest.mark.full
    @pytest.mark.parametrize("duration", ["1.5", "10"])
    def test_behind_an_encoder_names_the_lowest_that_hums_in_any_runs(self, typed: Typed, duration: str) -> None:
        answer = typed("stability", "encoder_wall", "--time", "--critical", "K", "--range", "100:5000", "--set",
                       f"duration={duration}")
        assert "K = 1201 N/m is the lowest of 26 values tried that does not come to rest, to 2 steps of the encoder; " \
            "the next below, 1194 N/m, does" in answer.out


class TestWithoutAClock:
    def test_a_law_that_keeps_samples_or_names_the_tick_before_is_refused(self) -> None:
        differences = law_of(
            master=lambda _, s, at, __: (0.1 * (at.x - s.x) / at.dt, Motion(at.x, at.v), Motion(at.x, 0.0)),
            master_start=lambda _, at: (Motion(at.x, 0.0), Motion(at.x, 0.0)))
        held = law_of(master=lambda _, s, at, __: (0.5 * at.f_held, Motion(at.x, at.v), s))
        for law, words in ((differences(), "no limit for short ticks"), (held(), "f_held")):
            with pytest.raises(Refused, match=words):
                continuous(handles(law))

    def test_a_loop_that_is_unstable_without_delay_says_so(self) -> None:
        assert continuous(handles(Springs(K=-500.0, B=0.0))) == Continuous(False, 0.0, None)

    def test_a_matched_wave_whose_coefficients_cancel_was_called_not_linear(self) -> None:
        """b = B = K: the coupling's part of w_s is the difference of large numbers, and no reason to refuse."""
        assert continuous(load_scene("soft_tissue", law=Wave(b=10.0, K=10.0, B=10.0))).stable_without_delay
