"""The hand: its grip, the references it follows, and recorded motions."""

import math
from collections.abc import Callable
from math import pi, sin
from pathlib import Path

import numpy as np
import pytest

import scenarios
from master.hand import Grip, Reach, Rest, Sine
from master.recording import Recording
from teleop.errors import Refused

MS = 1_000_000


def test_sine_is_sampled_at_the_ticks_however_late() -> None:
    (x,) = Sine(amplitude=0.05, frequency=1.0).samples(1, 10_001, MS)
    assert len(x) == 10_001
    for k in (0, 250, 7919, 10_000):
        assert x[k] == 0.05 * math.sin(2.0 * math.pi * (k * MS / 1e9))
    assert x[9_250] == pytest.approx(0.05, rel=1e-12)  # t is not accumulated: no drift after 9 s


def test_reach_is_the_minimum_jerk_polynomial() -> None:
    # Flash and Hogan 1985: rest at both ends, half way at half time, peak speed 15/8 of the mean.
    (x,) = Reach(to=0.3, start=0.5, duration=0.8, origin=0.1).samples(1, 2001, MS)
    path = (np.array(x) - 0.1) / 0.2
    s = (np.arange(2001) / 1000.0 - 0.5) / 0.8
    inside = (s >= 0) & (s <= 1)
    np.testing.assert_allclose(path[inside], np.polyval([6, -15, 10, 0, 0, 0], s[inside]), atol=1e-14)
    assert set(path[s < 0]) == {0.0}
    assert set(np.array(x)[s >= 1]) == {0.3}
    assert path[900] == pytest.approx(0.5, abs=1e-14)
    speed = np.diff(path) * 1000.0 * 0.8
    assert speed.max() == pytest.approx(15 / 8, rel=1e-5)
    assert speed.min() >= 0.0
    assert abs(np.diff(speed)[[500, 1299]]).max() < 1e-4  # no step in acceleration at the ends
    np.testing.assert_allclose(path[500:1301] + path[500:1301][::-1], 1.0, atol=1e-14)


def test_a_number_lies_along_the_first_axis_and_a_tuple_has_an_entry_for_each_and_grips_compare_by_value() -> None:
    assert [*Rest(at=0.02).samples(1, 3, MS)[0]] == [0.02, 0.02, 0.02]
    assert [*Rest().samples(1, 2, MS)[0]] == [0.0, 0.0]
    for one in (Sine(amplitude=0.2, frequency=250.0), Reach(to=0.2, duration=1e-3), Rest(at=0.2)):
        x, y, z = one.samples(3, 2, MS)
        assert x[1] == 0.2, one
        assert [*y] == [*z] == [0.0, 0.0], one
    for each in (Sine(amplitude=(0.1, 0.2, -0.3), frequency=250.0), Rest(at=(0.1, 0.2, -0.3)),
                 Reach(to=(0.1, 0.2, -0.3), duration=1e-3, origin=(1.0, 2.0, 3.0))):
        assert [axis[1] for axis in each.samples(3, 2, MS)] == [0.1, 0.2, -0.3], each
    whole, real = (Grip(mass=m, k=200, d=5, reference=Sine(amplitude=0.05, frequency=1.0)) for m in (0, 0.0))
    assert whole == real
    assert hash(whole) == hash(real)


# Recordings: what is replayed, and what is refused with path and line


Write = Callable[[str], str]
SHIPPED = str(Path(scenarios.__file__).with_name("reach.csv"))


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def at(text: str) -> str:
        path = tmp_path / "motion.csv"
        path.write_bytes(text.encode(errors="surrogateescape"))
        return str(path)

    return at


def test_motion_is_what_numpy_interpolates_and_rows_at_ticks_are_replayed_to_the_last_bit(write: Write) -> None:
    dice = np.random.default_rng(5)
    t = np.cumsum(dice.uniform(1e-4, 5e-3, 200)) - 0.05
    motion = dice.normal(size=(200, 3))
    path = write("".join(f"{float(a)!r},{b[0]!r},{b[1]!r},{b[2]!r}\n" for a, b in zip(t, motion.tolist(), strict=True)))
    got = Recording(path=path, scale=-2.0).samples(3, 700, MS)
    for axis in range(3):
        np.testing.assert_allclose(got[axis], -2.0 * np.interp(np.arange(700) / 1e3, t, motion[:, axis]), atol=1e-12)
    x = motion[:, 0].tolist()
    path = write("".join(f"{k * MS / 1e9!r}, {each!r}\n" for k, each in enumerate(x)))
    assert [*Recording(path=path).samples(1, 202, MS)[0]] == [*x, x[-1], x[-1]]


def test_ways_to_write_the_same_motion(write: Write) -> None:
    for text in ("t,x\n0,0.5\n1,1.5\n", "0,0.5\n1,1.5\n", "\ufefft,x\r\n0,0.5\r\n1,1.5\r\n",
                 "# made by hand\n\n  T , X\n# more\n0 , 5e-1  # here\n\n1,+1.5"):
        (x,) = Recording(path=write(text)).samples(1, 3, 500 * MS)
        assert [*x] == [0.5, 1.0, 1.5], text
    assert [*Recording(path=write("0, 0.5")).samples(1, 2, MS)[0]] == [0.5, 0.5], "a hand that stays"


def test_one_column_moves_the_first_axis_and_three_need_three(write: Write) -> None:
    assert [[*axis] for axis in Recording(path=write("0, 0.5")).samples(3, 1, MS)] == [[0.5], [0.0], [0.0]]
    with pytest.raises(Refused, match="along 3 axes, the scene has axes=1; set axes=3"):
        Recording(path=write("0, 0.5, 0, 0")).samples(1, 1, MS)


def test_the_file_is_read_once_and_only_named_in_the_text(write: Write) -> None:
    path = write("0, 0.5")
    recording = Recording(path=path, scale=2.0)
    write("0, 0.7")
    assert [*recording.samples(1, 1, MS)[0]] == [1.0]
    assert repr(recording) == f"Recording(path={path!r}, scale=2.0)"
    assert recording != Recording(path=path, scale=2.0)  # other contents: another motion
    assert recording != Recording(path=path)


BROKEN = [
    ("", "holds no motion"),
    ("t, x\n# nothing came\n", "holds no motion"),
    ("t, x\n0, 1\n0.1\n", "line 3: 1 column in place of 2"),
    ("t, x, y, z\n0, 1, 2\n", "line 2: 3 columns in place of 4"),
    ("t, x\n0, 1, 2, 3\n", "line 2: 4 columns in place of 2"),
    ("0, 1, 2\n", "line 1: 3 columns in place of 2 or 4"),
    ("0, 1, 2, 3\n0.1, 1, 2, \n", "line 2: '' is not a number"),
    ("t, x\n0, 1\n0.1, one\n", "line 3: 'one' is not a number"),
    ("time, x\n0, 1\n", "line 1: 'time' is not a number"),
    ("t, x\n0, 1\nt, x\n", "line 3: 't' is not a number"),
    ("0; 1\n", "line 1: '0; 1' is not a number"),
    ("0, 1_0\n", "line 1: '1_0' is not a number"),
    ("0, nan\n", "line 1: 'nan' is not finite"),
    ("0, 1e999\n", "line 1: '1e999' is not finite"),
    ("0, 1\n0.2, 1\n0.1, 1\n", r"line 3: t = 0\.1 s does not come after 0\.2 s"),
    ("0, 1\n0, 2\n", "line 2: t = 0 s does not come after 0 s"), ("\x89PNG\udcff\udcfe", "is not text"),
]


def test_broken_recordings_are_refused_with_path_and_line(write: Write) -> None:
    for text, says in BROKEN:
        with pytest.raises(Refused, match=says) as refused:
            Recording(path=write(text))
        assert "motion.csv" in str(refused.value)


def test_shipped_reach_is_what_its_head_says() -> None:
    def m(t: float, a: float, b: float) -> float:
        s = min(max((t - a) / (b - a), 0.0), 1.0)
        return s**3 * (10 - 15 * s + 6 * s * s)

    def h(t: float, a: float, b: float) -> float:
        return 4 * m(t, a, b) * (1 - m(t, a, b))

    def tremor(t: float, i: int) -> float:
        fast = 0.20 * sin(2 * pi * 8.7 * t + 2.1 * i) + 0.12 * sin(2 * pi * 10.9 * t + 4.3 * i)
        return m(t, 0, 0.5) * (fast + 0.5 * sin(2 * pi * 0.37 * t + 1.3 * i))

    x, y, z = Recording(path=SHIPPED).samples(3, 601, 10 * MS)
    for k in range(601):
        t = k / 100
        presses = 8 * m(t, 1.9, 2.3) - 9 * m(t, 2.4, 2.8) + 12 * m(t, 2.9, 3.3) - 10 * m(t, 3.4, 3.8)
        want_x = 40 * m(t, 0.5, 1.4) + presses + 6 * m(t, 3.9, 4.2) - 43 * m(t, 4.6, 5.5) + tremor(t, 0)
        want_y = 6 * h(t, 0.5, 1.4) + 10 * m(t, 1.8, 4.4) - 8 * m(t, 4.6, 5.6) + tremor(t, 1)
        want_z = 9 * h(t, 0.5, 1.4) + 5 * h(t, 4.6, 5.5) - 2 * m(t, 1.4, 1.9) + tremor(t, 2)
        assert (1e3 * x[k], 1e3 * y[k], 1e3 * z[k]) == pytest.approx((want_x, want_y, want_z), abs=6e-4)
    assert x[0] == y[0] == z[0] == 0.0  # it begins where a master at rest stands
    assert 0.045 < max(x) < 0.055  # and goes deeper than the canonical wall, at 0.03 m
