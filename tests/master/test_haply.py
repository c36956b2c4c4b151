"""A Haply Inverse3 through a stand-in of its service: what is read, what is told, and what goes wrong."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from itertools import count
from math import cos, hypot, sin
from typing import Any

import pytest

pytest.importorskip("websockets", reason="the extra `haply` is not installed")

from master.haply import STALE_NS, Inverse3, settings_of, zeroing
from teleop import DeviceError, MassDamper, Refused, Scene, Wave, load_scene
from tests.master.inverse_stand_in import RATE, StandIn

BODY = MassDamper(mass=0.3, damping=1.0)


def scene(axes: int = 3) -> Scene:
    return Scene(law=Wave(), master=BODY, slave=BODY, axes=axes, duration=1.0)


class Bench:
    """The service, and time that goes on by `step` (s) whenever the device looks at its clock."""

    def __init__(self, word: str = "vector") -> None:
        self.service, self.now, self.step = StandIn(word), 0.0, 1e-5
        self.serves = True

    def clock(self) -> int:
        self.now += self.step
        if self.serves:
            self.service.pump(self.now)
        return round(self.now * 1e9)

    def open(self, more: str = "", axes: int = 3) -> Inverse3:
        self.step = 0.05  # so that a service that has nothing to say is not really waited for
        try:
            return Inverse3(scene(axes), self.service.url + more, clock=self.clock)
        finally:
            self.step = 1e-5

    def go(self, device: Inverse3, ticks: int, force: tuple[float, ...] = (0.0, 0.0, 0.0)) -> Any:
        """So many ticks of 1 ms; the last reading."""
        reading = None
        for k in range(ticks):
            self.now += 1e-3
            self.clock()
            reading = device.read(k)
            device.hold(force)
        return reading

    def trouble(self, device: Inverse3, ticks: int = 400) -> str:
        for _ in range(ticks):
            try:
                self.go(device, 1)
            except DeviceError as error:
                return str(error)
        raise AssertionError("nothing was wrong")

    def well_again(self, device: Inverse3, ticks: int = 1000) -> Any:
        for _ in range(ticks):
            try:
                return self.go(device, 1)
            except DeviceError:
                pass
        raise AssertionError("it never came back")


@pytest.fixture(params=["vector", "values"])
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    made = Bench(request.param)
    yield made
    made.service.close()


@pytest.fixture
def new() -> Iterator[Bench]:
    made = Bench()
    yield made
    made.service.close()


def test_it_reads_where_the_cursor_is_and_a_force_is_told_in_the_words_of_the_service_and_pushes_against_the_hand(
    bench: Bench
) -> None:
    device = bench.open("?origin=0,-0.12,0.15")
    reading = bench.go(device, 300)
    service = bench.service
    assert hypot(RATE * service.x[1], service.v[1]) > 5e-3  # the hand moves, wherever in its swing it is by now
    assert reading.x == pytest.approx(service.x, abs=0.2e-3 * (1.0 + abs(service.v[1])) + 1e-4)
    assert reading.v == pytest.approx(service.v, abs=5e-3)
    assert reading.f is None
    bench.go(device, 20, (1.0, -0.5, 0.25))
    assert service.force == {"x": -1.0, "y": 0.5, "z": -0.25}


def test_axes_are_taken_as_is_asked_for_and_a_force_beyond_the_limit_keeps_its_direction(new: Bench) -> None:
    device = new.open("?axes=-yx&origin=0,-0.12,0.15&limit=2", axes=2)
    new.service.x, new.service.v = [0.01, 0.02, 0.0], [0.0, 0.0, 0.0]
    reading = new.go(device, 3, (0.5, 0.25))
    assert reading.x == pytest.approx((-0.02, 0.01), abs=1e-3)
    new.go(device, 2, (0.5, 0.25))
    assert new.service.force == {"x": -0.25, "y": 0.5, "z": 0.0}
    new.go(device, 5, (30.0, 40.0))
    assert tuple(new.service.force.values()) == pytest.approx((-1.6, 1.2, 0.0))


def test_power_is_the_same_in_the_frame_of_the_scene_and_of_the_device(new: Bench) -> None:
    """However the axes are turned: the motors take from the hand what the law was told."""
    device = new.open("?axes=z-xy&limit=50")
    new.go(device, 50)
    reading = new.go(device, 1, (1.0, 2.0, 3.0))
    new.clock()
    told = new.service.commands[-1]["inverse3"][0]["commands"]["set_cursor_force"]["vector"]
    state = device._link.state
    assert state is not None
    at_device = sum(told[name] * v for name, v in zip("xyz", state.velocity, strict=True))
    assert at_device == pytest.approx(-sum(f * v for f, v in zip((1.0, 2.0, 3.0), reading.v, strict=True)), rel=1e-12)


def test_buttons_of_the_grip_are_the_operators_switches_also_the_clutch_of_the_rotation_alone(new: Bench) -> None:
    device = new.open("?clutch=a&present=b&wrist=c")
    for pressed, clutch, present in (("a", True, False), ("b", False, True), ("c", "rotation", False),
                                     ("ac", True, False)):
        new.service.buttons = {button: button in pressed for button in "abc"}
        reading = new.go(device, 3)
        assert (reading.clutch, reading.present) == (clutch, present)
    new.service.without = {"wireless_verse_grip"}
    assert "the grip has no button a (no buttons)" in new.trouble(device, 3)


def test_an_orientation_that_is_no_unit_quaternion_is_no_state(new: Bench) -> None:
    device = new.open()
    reading = new.go(device, 3)
    assert (reading.clutch, reading.present) == (None, None), "there is no switch where no button is named"
    for length in (0.0, 0.5, 1.1):
        new.service.orientation = {"w": length, "x": 0.0, "y": 0.0, "z": 0.0}
        assert f"quaternion ({length:g}, 0, 0, 0) is no unit quaternion" in new.trouble(device, 3)
        new.service.orientation = {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0}
        assert new.well_again(device).x


def opened_for(bench: Bench, name: str, more: str = "") -> Inverse3:
    return Inverse3(load_scene(name), bench.service.url + more, clock=bench.clock)


@pytest.mark.parametrize(("axes", "about"), [("xyz", (0, 0, 1)), ("yzx", (0, 1, 0)), ("x-yz", (0, 0, -1)),
                                             ("zyx", (-1, 0, 0))])
def test_the_grip_turns_the_scenes_rotation_beyond_half_a_turn(new: Bench, axes: str, about: tuple[int, ...]) -> None:
    """About the device's z, at 5 rad/s, in axes that are turned and in those of a mirror."""
    device, rate = opened_for(new, "pose", f"?axes={axes}"), 5.0
    reading: Any = None
    for k in range(700):
        angle = rate * (k + 1) * 1e-3
        new.service.orientation = {"w": cos(angle / 2), "x": 0.0, "y": 0.0, "z": sin(angle / 2)}
        new.now += 1e-3 - 4 * new.step
        new.clock()
        reading = device.read(k)
        device.hold((0.0,) * 6)
    assert reading.x[3:] == pytest.approx([rate * 0.7 * each for each in about], abs=0.02)
    assert reading.v[3:] == pytest.approx([rate * each for each in about], rel=0.02)
    device.hold((1.0, 0.0, 0.0, 9.0, 9.0, 9.0))  # a torque, which no motor has
    new.clock()
    assert hypot(*new.service.force.values()) == pytest.approx(1.0)


def test_scenes_that_it_cannot_be_the_master_of_are_refused(new: Bench) -> None:
    with pytest.raises(Refused, match="has no joints of the scene's"):
        opened_for(new, "leader_follower")
    with pytest.raises(Refused, match="the scene has 3 axes that are places"):
        new.open("?axes=xy")
    new.service.without = {"wireless_verse_grip"}
    assert "the grip tells no orientation" in new.trouble(opened_for(new, "pose"), 3)


def test_reading_alone_keeps_the_states_coming(new: Bench) -> None:
    """The service answers commands and says nothing else; before a run nobody holds a force."""
    device = new.open("?origin=0,-0.12,0.15")
    for _ in range(20):
        new.now += 0.5
        assert device.read(0).x[1] == pytest.approx(new.service.x[1], abs=2e-3)


def test_a_slow_service_is_told_the_newest_force_and_no_queue_and_letting_go_before_it_answers(new: Bench) -> None:
    device = new.open()
    new.go(device, 5)
    before = len(new.service.commands)
    new.serves = False
    for k in range(40):
        new.now += 1e-3
        device.read(k)
        device.hold((0.01 * k, 0.0, 0.0))
    new.serves = True
    new.go(device, 3, (2.0, 0.0, 0.0))
    assert len(new.service.commands) - before <= 6
    assert new.service.force["x"] == -2.0
    new.serves = False
    for _ in range(5):
        device.hold((2.0, 0.0, 0.0))
    device.hold((0.0, 0.0, 0.0))
    new.serves = True
    new.clock()
    assert new.service.force["x"] == 0.0


def test_a_service_that_says_nothing_is_not_read_and_an_inverse3_that_is_unplugged_comes_back(new: Bench) -> None:
    device = new.open()
    new.go(device, 5)
    new.service.answers = False
    assert "said nothing for 0.05 s" in new.trouble(device, 2 * STALE_NS // 1_000_000)
    new.service.answers = True
    assert new.well_again(device).x
    new.service.without = {"inverse3"}
    assert "lists no Inverse3 049D" in new.trouble(device, 5)
    new.service.without = set()
    assert new.well_again(device, 5).x


NO_STATES: tuple[Any, ...] = (
    "", "{", "[1, 2]", "null", '{"inverse3": 3}', b"\xff\xfe", "[" * 5_000, '{"inverse3": [{"device_id": "049D"}]}',
    '{"inverse3": [{"device_id": "049D", "state": {"cursor_position": {"x": 1}, "cursor_velocity": {}}}]}',
    '{"inverse3": {"049D": {"state": {}}}}',
)


def test_what_is_no_state_is_said_and_the_next_state_mends_it(new: Bench) -> None:
    """Nor is a position that is no finite number, which reaches no law."""
    device = new.open()
    new.go(device, 5)
    told = '"cursor_position": {"x": '
    numbers = {number: json.dumps(new.service.state()).replace(f"{told}0.0", told + number)
               for number in ("NaN", "Infinity", "1e999", '"0.1"', "true", "null")}
    assert all(number in state for number, state in numbers.items())
    for said in (*NO_STATES, *numbers.values()):
        new.service.say = said
        sentence = new.trouble(device, 5)
        assert ("finite" if said in numbers.values() else "Inverse") in sentence, said
        assert "\n" not in sentence
        new.service.say = None
        assert new.well_again(device, 5).x


def test_a_service_without_an_inverse3_says_what_it_has(new: Bench) -> None:
    new.service.without = {"inverse3"}
    with pytest.raises(DeviceError, match=r"lists no Inverse3, but wireless_verse_grip 7C11; plug it in"):
        new.open()
    new.service.without = set()
    with pytest.raises(DeviceError, match=r"lists no Inverse3 04EA, but inverse3 049D"):
        new.open("?device=04EA")
    assert new.service.commands == [], "another than the one that is asked for is not driven"
    for status, cure in (("calibrated", "grip on the base"), ("power_supply", "plug its power")):
        new.service.status[status] = False
        with pytest.raises(DeviceError, match=cure):
            new.open()
        new.service.status[status] = True


def test_a_service_that_is_started_again_is_found_again(new: Bench) -> None:
    device = new.open()
    new.go(device, 5, (1.0, 0.0, 0.0))
    port, word = new.service.port, new.service.word
    new.service.close()
    new.service = StandIn(word)  # at another port: at the device's nobody listens
    assert "closed the connection" in new.trouble(device, 3)
    with pytest.raises(DeviceError):
        device.hold((1.0, 0.0, 0.0))
    for _ in range(3):
        new.now += 0.3
        sentence = new.trouble(device, 1)
    assert "cannot be reached (Connection refused); start it" in sentence
    new.service.close()
    new.service = StandIn(word, port)
    new.service.at = new.now
    assert new.well_again(device).x
    new.go(device, 3, (1.5, 0.0, 0.0))
    assert new.service.force["x"] == -1.5


def test_letting_go_alone_finds_the_service_again(new: Bench) -> None:
    """An end whose watchdog has fired does not read until zero was taken."""
    device = new.open()
    new.go(device, 5, (1.0, 0.0, 0.0))
    new.service.drop()
    assert "closed the connection" in new.trouble(device, 3)
    for _ in range(400):
        new.now += 1e-3
        new.clock()
        with suppress(DeviceError):
            device.hold((0.0, 0.0, 0.0))
    new.clock()
    assert new.service.force["x"] == 0.0
    assert new.well_again(device).x, "and by another connection it reads again"


def test_the_watchdog_lets_go_over_a_connection_of_its_own_and_closing_lets_go(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Who has measured when the service lets go needs none."""
    device = bench.open()
    bench.go(device, 5, (1.0, 1.0, 1.0))
    monkeypatch.setattr("master.haply.monotonic_ns", bench.clock)
    assert device.watchdog is not None
    assert device.watchdog.open == "master.haply:zeroing"
    zeroing(*device.watchdog.arguments)()
    assert set(bench.service.force.values()) == {0.0}
    bench.go(device, 5, (1.0, 1.0, 1.0))
    assert set(bench.service.force.values()) == {-1.0}
    device.close()
    assert set(bench.service.force.values()) == {0.0}
    measured = bench.open("?deadline=0.1")
    assert (measured.watchdog, measured.deadline) == (None, 0.1)


WRONG = (
    ("http://localhost:10001", "ws://HOST:PORT"), ("ws://", "ws://HOST:PORT"), ("localhost:10001", "ws://HOST:PORT"),
    ("ws://localhost:99999", "ws://HOST:PORT"), ("ws://localhost?speed=1", "no setting 'speed'"),
    ("ws://localhost?axes=xx", "each once"), ("ws://localhost?axes=x-", "each once"), ("ws://h?axes=", "each once"),
    ("ws://localhost?limit=0", "above 0"), ("ws://localhost?limit=nan", "finite"), ("ws://h?limit=a", "is a number"),
    ("ws://localhost?origin=1,2", "three numbers"), ("ws://localhost?word=force", "vector or values"),
    ("ws://localhost?device=a%22b", "letters and digits"),
)


def test_an_address_that_cannot_be_meant_is_refused_and_one_where_nobody_listens_is_said() -> None:
    for url, why in WRONG:
        with pytest.raises(Refused, match=why):
            settings_of(url)
    with pytest.raises(DeviceError, match=r"cannot be reached \(Connection refused\)"):
        Inverse3(scene(), "ws://127.0.0.1:9", clock=partial(next, count(0, 50_000_000)))


class Flood:
    """The socket of a service that sends without pause, of which never all is read; `unit` is repeated."""

    def __init__(self, sock: Any, unit: bytes) -> None:
        self.sock, self.unit, self.given, self.at = sock, unit, 0, 0

    def recv(self, most: int) -> bytes:
        self.given += most
        assert self.given < 10_000_000, "it is read without end"
        data = (self.unit * (most // len(self.unit) + 2))[self.at:self.at + most]
        self.at = (self.at + most) % len(self.unit)
        return data

    def __getattr__(self, name: str) -> Any:
        return getattr(self.sock, name)


@pytest.mark.parametrize(("unit", "words"), [
    (None, "sends more than can be read, so its newest state is not known"), (b"\x89\x00", "sends more than can"),
    (b"\x01\x00", "in more than 100 parts"), (b"\x81\x00", "sends more than can be read"),
], ids=["states", "pings", "parts without an end", "empty messages"])
def test_one_read_of_a_service_that_sends_without_pause_did_not_come_back(
    new: Bench, unit: bytes | None, words: str,
) -> None:
    """In 12 s. What comes is bounded at each tick, and after 50 ms of it the device reads as one that fails."""
    device = new.open()
    new.go(device, 20)
    link = device._link
    if unit is None:
        text = json.dumps(new.service.state()).encode()
        unit = b"\x81\x7e" + len(text).to_bytes(2, "big") + text
    elif unit == b"\x01\x00":
        unit = b"\x01\x00" + b"\x00\x00" * 1000  # a first part, and empty ones
    flood = link._sock = Flood(link._sock, unit)
    said: list[str] = []
    for _ in range(100):
        before = flood.given
        try:
            new.go(device, 1)
        except DeviceError as error:
            said.append(str(error))
        assert flood.given - before <= 1 << 17, "at one tick"
    assert any(words in each for each in said), said[:1]
    assert new.well_again(device), "by another connection"
