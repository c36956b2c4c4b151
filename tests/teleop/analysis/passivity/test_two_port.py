"""The hybrid matrix and its criteria: published numbers, scattering, terminations by brute force, runs in time."""

from __future__ import annotations

from dataclasses import replace
from math import pi, sqrt
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from channel.delay import Delay
from slave import HuntCrossley, StandardLinearSolid, Tissue, Wall
from teleop import PFRA, At, BackwardDifference, Cap, Device, Direct, Encoder, MassDamper, Scene, Wave, load_scene
from teleop.analysis.passivity.judge import judge, two_ports
from teleop.analysis.passivity.surroundings import linear_parts, touched
from teleop.analysis.passivity.two_port import TwoPort, continuous_two_port, sampled_two_port
from teleop.stages.observer import coefficients, observe
from tests.fakes import Motion, Springs, law_of

HANDLE = MassDamper(mass=0.04, damping=0.8)


class Force(NamedTuple):
    f_e: float


Share = law_of(  # each end takes a share off the force it feels
    master=lambda law, s, at, rx: (Springs.master(law, s, at, rx)[0] - 0.3 * at.f, Motion(at.x, at.v), s),
    slave=lambda law, s, at, rx: (Springs.slave(law, s, at, rx)[0] + 0.3 * at.f, Motion(at.x, at.v), s))
Senses = law_of(  # reads all there is
    master=lambda law, s, at, rx: (Springs.master(law, s, at, rx)[0] - 0.3 * at.f + 0.2 * at.f_held + 50.0 * at.dx,
                                   Motion(at.x, at.v), s),
    slave=lambda law, s, at, rx: (Springs.slave(law, s, at, rx)[0] + 0.4 * at.f - 0.2 * at.f_held - 30.0 * at.dx,
                                  Motion(at.x, at.v), s))


def echoing(b: float, echo: float) -> Any:
    """A wave channel whose far end meets nothing (echo 1) or a wall (echo -1)."""
    root = sqrt(2.0 * b)
    return law_of(
        master_start=lambda _, __: ((), Force(0.0)), slave_start=lambda _, __: ((), Force(0.0)),
        master=lambda _, s, at, rx: (b * at.v - root * rx.f_e, Force(root * at.v - rx.f_e), s),
        slave=lambda _, s, __, rx: (0.0, Force(echo * rx.f_e), s))()


def handles(law: Any, T: float = 0.0, **changes: Any) -> Scene:
    scene = Scene(law=law, master=HANDLE, slave=HANDLE, environment=Tissue(k=400.0, d=0.0), duration=1.0,
                  link=Delay(T) if T else None)
    return replace(scene, **changes)


class TestTwoHandles:
    """Two handles of 0.04 kg and 0.8 N s/m, coupled by 400 N/m and 4 N s/m, against 400 N/m."""

    def test_felt_wall_and_free_motion(self) -> None:
        for law, T, free in ((Springs(), 0.0, "1.680"), (Springs(), 0.05, "40.975"),
                             (Direct(K=400.0, B=4.0), 0.0, "0.839"), (Direct(K=400.0, B=4.0), 0.05, "0.839")):
            got = two_ports(handles(law, T)).continuous
            assert got.felt == pytest.approx(200.0, abs=0.01)
            assert f"{got.free:.3f}" == free

    def test_without_delay_it_is_absolutely_stable_and_passive_and_with_50_ms_each_way_it_is_not(self) -> None:
        got = two_ports(handles(Springs())).continuous
        assert got.absolutely_stable
        assert got.passive
        assert got.least > 1.0
        got = two_ports(handles(Springs(), 0.05)).continuous
        assert got.bands[0].low == 0.1
        assert got.bands[-1].high == pytest.approx(19.05, abs=0.05)
        assert got.bands[0].high == pytest.approx(9.600, abs=1e-3)  # it holds from there to 15.658 Hz
        assert got.bands[-1].low == pytest.approx(15.658, abs=1e-3)
        assert f"{got.least:.3f}" == "-0.643"
        assert f"{got.at:.1f}" == "5.8"
        assert not got.passive

    @pytest.mark.parametrize("law", [Springs(), Direct(K=400.0, B=4.0)])
    def test_the_free_master_by_hand(self, law: Any) -> None:
        f = np.array([0.3, 2.0, 30.0])
        s = 2j * pi * f
        own = 0.04 * s + 0.8
        spring = 400.0 / s + 4.0
        late = np.exp(-0.05 * s)
        h = continuous_two_port(handles(law, 0.05), f).h
        follows = spring * late / (own + spring)
        assert h[:, 1, 0] == pytest.approx(-follows)
        assert h[:, 1, 1] == pytest.approx(1.0 / (own + spring))
        if isinstance(law, Direct):
            assert h[:, 0, 0] == pytest.approx(own)
            assert h[:, 0, 1] == pytest.approx(late)
        else:
            assert h[:, 0, 0] == pytest.approx(own + spring * (1.0 - late * follows))
            assert h[:, 0, 1] == pytest.approx(late * spring / (own + spring))


class TestWaves:
    def test_a_free_end_feels_like_a_mass_and_a_clamped_one_like_a_spring(self) -> None:
        """b = 0.8 N s/m, 50 ms: b T = 0.04 kg, b/T = 16 N/m, resonance at 1/(4 T) = 5 Hz."""
        f = np.array([1.0, 4.0, 5.0])
        s = 2j * pi * f
        free, clamped = (continuous_two_port(handles(echoing(0.8, echo), 0.05), f).h[:, 0, 0] - 0.04 * s - 0.8
                         for echo in (1.0, -1.0))
        assert np.abs(free[:2]) == pytest.approx([0.25994, 2.46215], abs=1e-5)
        assert free == pytest.approx(0.8 * np.tanh(0.05 * s))
        assert clamped[:2] == pytest.approx(0.8 / np.tanh(0.05 * s[:2]))

    @settings(max_examples=15)
    @given(b=st.floats(0.1, 20.0), K=st.floats(10.0, 5e3), T=st.floats(0.001, 0.5),
           ratio=st.floats(0.0, 0.9) | st.floats(1.1, 5.0))
    def test_without_a_clock_they_are_passive_at_every_delay(self, b: float, K: float, T: float, ratio: float) -> None:
        law = Wave(b=b, K=K, B=ratio * b)
        got = continuous_two_port(handles(law, T), np.geomspace(0.05, 300.0, 200))
        h = got.h
        hermitian = 0.5 * (h + h.conj().transpose(0, 2, 1))
        assert np.linalg.eigvalsh(hermitian).min() >= -1e-6
        assert got.absolutely_stable.all()


matrices = st.lists(st.complex_numbers(max_magnitude=4.0), min_size=4, max_size=4).map(
    lambda v: TwoPort(np.array([1.0]), np.array(v).reshape(1, 2, 2)))


class TestCriteria:
    @settings(max_examples=150)
    @given(port=matrices)
    def test_llewellyn_is_the_scattering_test(self, port: TwoPort) -> None:
        """mu > 1 of the scattering matrix (Edwards and Sinsky 1992), which has none of the same terms."""
        h, eye = port.h[0], np.eye(2)
        if abs(np.linalg.det(h + eye)) < 1e-3 or abs(h[0, 1] * h[1, 0]) < 1e-3:
            return
        S = np.diag([1.0, -1.0]) @ (h - eye) @ np.linalg.inv(h + eye)
        det = np.linalg.det(S)
        mu = (1 - abs(S[0, 0]) ** 2) / (abs(S[1, 1] - det * S[0, 0].conjugate()) + abs(S[0, 1] * S[1, 0]))
        edge = min(abs(port.eta[0] - 1.0), abs(h[0, 0].real), abs(h[1, 1].real), abs(mu - 1.0))
        if edge > 1e-6:
            assert bool(port.absolutely_stable[0]) == (mu > 1.0)

    @settings(max_examples=50)
    @given(port=matrices, resistance=st.floats(0.0, 50.0), reactance=st.floats(-50.0, 50.0))
    def test_what_is_felt_of_a_passive_one_is_passive(self, port: TwoPort, resistance: float, reactance: float) -> None:
        if port.absolutely_stable[0]:
            assert port.perceived_impedance(np.array([complex(resistance, reactance)]))[0].real >= -1e-6

    @settings(max_examples=50)
    @given(port=matrices)
    def test_raisbeck_is_the_determinant_of_the_hermitian_part(self, port: TwoPort) -> None:
        h = port.h[0]
        assert port.raisbeck[0] == pytest.approx(np.linalg.det(h + h.conj().T).real, abs=1e-9)
        if port.raisbeck[0] > 1e-6 and h[0, 0].real > 1e-6:
            assert port.absolutely_stable[0]  # passive is more

    def test_an_ideal_teleoperator_is_transparent(self) -> None:
        ideal = TwoPort(np.array([1.0]), np.array([[[0.0, 1.0], [-1.0, 0.0]]], dtype=complex))
        assert ideal.eta[0] == pytest.approx(1.0)
        assert ideal.perceived_impedance(np.array([3.0 - 7.0j]))[0] == pytest.approx(3.0 - 7.0j)

    def test_edges_of_bands_do_not_depend_on_the_grid(self) -> None:
        """eta = 1 + (f - 3)(f - 5)."""
        def make(f: Any) -> TwoPort:
            h = np.zeros((len(f), 2, 2), dtype=complex)
            h[:, 0, 0] = 0.5 * (2.0 + (f - 3.0) * (f - 5.0))
            h[:, 1, 1], h[:, 0, 1], h[:, 1, 0] = 1.0, 1.0, 1.0
            return TwoPort(f, h)

        got = judge(make, low=0.7, high=20.0)
        assert got.bands == (pytest.approx((3.0, 5.0), rel=1e-6),)
        assert got.least == pytest.approx(0.0, abs=1e-9)
        assert got.at == pytest.approx(4.0, rel=1e-4)


def in_time(scene: Scene, f: float, *, at_master: bool, forth: int, back: int) -> tuple[complex, complex]:
    """f_m and v_s at the frequency f, from ticks: one port moved by a sinusoid, the other left alone.

    Written out for laws without a state: the slave between two ticks by DOP853, its velocity by a fine integral.
    """
    law, dt, w = scene.law, scene.dt, 2.0 * pi * f
    per = round(1.0 / (f * dt))  # ticks in a period
    ticks, body = 30 * per, scene.slave
    still = At(0.0, 0.0, 0.0, 0.0, 0.0, False, float("inf"), dt)
    rests = law.slave_start(still)[1], law.master_start(still)[1]
    sent_forth, sent_back = [], []
    y, fm, motion = np.zeros(2), [], []
    c = None if scene.observer is None else coefficients(scene.observer, 0.04, 0.8, dt)
    before_m = before_s = (0.0, 0.0)  # position and velocity
    f_m = f_s = touch = 0.0
    fine = np.linspace(0.0, dt, 9)
    weights = np.array([1, 4, 2, 4, 2, 4, 2, 4, 1]) * dt / 24.0
    for k in range(ticks):
        t = k * dt
        x_m, v_m, a_m = (-np.cos(w * t) / w, np.sin(w * t), w * np.cos(w * t)) if at_master else (0.0, 0.0, 0.0)
        f_env = 0.0 if at_master else np.sin(w * t)
        rx_m = sent_back[k - back] if k >= back else rests[1]
        rx_s = sent_forth[k - forth] if k >= forth else rests[0]
        touch = 0.04 * a_m + 0.8 * v_m + f_m if c is None else observe(c, touch, before_m[1], v_m, f_m)
        at_m = At(x_m, v_m, touch, f_m, x_m - before_m[0], True, 0.0, dt)
        at_s = At(y[0], y[1], f_env, f_s, y[0] - before_s[0], True, 0.0, dt)
        f_m, tx, _ = law.master((), at_m, rx_m)
        f_s, tx_s, _ = law.slave((), at_s, rx_s)
        before_m, before_s = (x_m, v_m), (y[0], y[1])
        sent_forth.append(tx)
        sent_back.append(tx_s)
        fm.append(f_m)
        got = solve_ivp(lambda s, q, f_s=f_s: [q[1], (f_s - (0.0 if at_master else np.sin(w * s)) - body.damping * q[1])
                                               / body.mass], (t, t + dt), y, t_eval=t + fine, rtol=1e-9, atol=1e-12)
        motion.append(got.y[1])
        y = got.y[:, -1]
    t = np.arange(ticks)[-5 * per:] * dt
    turn = np.exp(-1j * w * (t[:, None] + fine))
    power = 2j / (len(t) * dt)  # of sin: the phasor of sin is 1
    f_m = sum(power * np.array(fm[-5 * per:])[:, None] * turn @ weights)
    return complex(f_m), complex(sum(power * (np.array(motion[-5 * per:]) * turn) @ weights))


@pytest.mark.parametrize(("law", "observer"), [
    (Senses(), 50.0), *(pytest.param(law, None, marks=pytest.mark.full)
                        for law in (Springs(), Direct(K=400.0, B=4.0), Senses())),
])
def test_the_sampled_matrix_is_what_ticks_do(law: Any, observer: float | None) -> None:
    """At 25 Hz and 200 ticks a second, where holding and delays of ticks matter much."""
    scene = handles(law, 0.01, dt=5e-3, observer=observer)
    f = 25.0
    s = 2j * pi * f
    h = sampled_two_port(scene, np.array([f])).h[0]
    f_m, v_s = in_time(scene, f, at_master=True, forth=2, back=2)
    assert h[0, 0] == pytest.approx(f_m + 0.04 * s + 0.8, rel=1e-4)
    assert h[1, 0] == pytest.approx(-v_s, rel=1e-4)
    f_m, v_s = in_time(scene, f, at_master=False, forth=2, back=2)
    assert h[0, 1] == pytest.approx(f_m, rel=1e-4)
    assert h[1, 1] == pytest.approx(-v_s, rel=1e-4)
    if type(law) is not Senses:  # which has no limit
        without = continuous_two_port(scene, np.array([f])).h[0]
        assert abs(h[1, 0] / without[1, 0] - 1.0) > 0.05


@pytest.mark.parametrize(("law", "observer"), [
    (Wave(b=2.0, K=500.0, B=20.0), None), (Share(), 200.0), (Share(), None),
    *(pytest.param(law, observer, marks=pytest.mark.full) for law in (Springs(), PFRA(alpha=1.0))
      for observer in (200.0, None))])
def test_a_short_tick_is_no_tick(law: Any, observer: float | None) -> None:
    f = np.array([0.2, 3.0, 20.0])
    apart = []
    for dt in (1e-4, 1e-5):
        scene = handles(law, 0.05, observer=observer, dt=dt)
        got, limit = sampled_two_port(scene, f).h, continuous_two_port(scene, f).h
        apart.append(np.abs(got - limit).max() / np.abs(limit).max())
    assert apart[0] < 0.02
    assert apart[1] < 0.15 * apart[0]


class TestDevice:
    f = np.array([1.0, 20.0, 80.0])

    def test_an_estimator_is_in_the_matrix(self) -> None:
        s = 2j * pi * self.f
        scene = handles(Springs(), 0.005, device_m=Device(velocity=BackwardDifference()))
        plain = sampled_two_port(handles(Springs(), 0.005), self.f).h
        got = sampled_two_port(scene, self.f).h
        hold = (1.0 - np.exp(-s * 1e-3)) / (s * 1e-3)
        # The slave, which is told of v_m, and the force on the master both see (1 - 1/z)/T X for V.
        assert got[:, 0, 1] == pytest.approx(plain[:, 0, 1])
        assert got[:, 1, 1] == pytest.approx(plain[:, 1, 1])
        told = hold * (400.0 / s + 4.0 * hold) / (400.0 / s + 4.0) / hold
        assert got[:, 1, 0] == pytest.approx(plain[:, 1, 0] * told)

    def test_a_late_force_is_a_longer_way(self) -> None:
        late = np.exp(-2j * pi * self.f * 1e-3 * 3)
        law = Direct(K=400.0, B=4.0)
        plain = sampled_two_port(handles(law), self.f).h
        got = sampled_two_port(handles(law, device_m=Device(delay=3)), self.f).h
        assert got[:, 0, 1] == pytest.approx(plain[:, 0, 1] * late)
        assert got[:, 1] == pytest.approx(plain[:, 1])

    def test_a_playout_that_lags_or_scales_is_said_to_be_left_out(self) -> None:
        """The two-port was that without the queue that is kept, and without a word."""
        for playout, lags in (("integral:0.05", True), ("fixed:0.1:scaled:0.5", True), ("integral", False),
                              ("fixed:0.1", False)):
            assert linear_parts(load_scene("soft_tissue", playout=playout))[1] == [f"playout {playout}"] * lags

    def test_an_encoder_and_a_cap_are_left_out_and_a_law_without_a_limit_has_the_sampled_matrix_alone(self) -> None:
        rough = handles(Direct(), cap=Cap(f_max=1.0), device_m=Device(encoder=Encoder(step=1e-4)))
        assert sampled_two_port(rough, self.f).h == pytest.approx(sampled_two_port(handles(Direct()), self.f).h)
        got = two_ports(handles(Direct(), device_m=Device(velocity=BackwardDifference())))
        assert got.continuous is None
        assert got.sampled is not None
        assert "ticks" in got.why_not["continuous"]


class TestTouched:
    s = 2j * pi * np.array([0.5, 20.0])

    def test_a_wall_in_contact_is_a_tissue_a_solid_relaxes_and_what_has_none_has_none(self) -> None:
        for environment in (Tissue(k=300.0, d=2.0, at=0.3), Wall(k=300.0, d=2.0, at=0.01),
                            Wall(k=300.0, d=2.0, at=-0.2, side=-1.0)):
            got = touched(handles(Direct(), environment=environment), self.s)
            assert got == pytest.approx(300.0 / self.s + 2.0, rel=1e-6), environment
        solid = StandardLinearSolid(k=100.0, k1=200.0, tau=0.1)
        got = touched(handles(Direct(), environment=solid), self.s)
        assert got == pytest.approx(100.0 / self.s + 20.0 / (1.0 + 0.1 * self.s))
        assert touched(handles(Direct(), environment=None), self.s) == pytest.approx([0.0, 0.0])
        assert touched(handles(Direct(), environment=HuntCrossley(k=1e3)), self.s) is None
