"""A Haply Inverse3 as the master's device, through Haply's Inverse service: read at ticks, without a thread.

    python -m master hard_wall --peer HOST:9001 --device haply
    python -m master hard_wall --peer HOST:9001 --device "haply:ws://localhost:10001?axes=y&clutch=a"

At each tick what has come is read, within a share of the tick, and the newest state stands; a command goes out with
every force. What the service does with a force that is not renewed its documentation says without a time ("per-tick,
non-persistent": the device "returns to idle"), so a watchdog process sends zero as well, and `deadline` is for who has
measured it.
"""

from __future__ import annotations

import errno
import socket
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from math import hypot
from select import select
from time import monotonic_ns, thread_time_ns
from typing import Any
from urllib.parse import urlsplit

try:
    from master.inverse_service import WORDS, InverseService, State
except ModuleNotFoundError as error:
    raise ImportError("an Inverse3 is reached by websockets, which is not installed; type pip install "
                      "'bilateral-teleop[haply]', or pip install websockets") from error
from teleop.errors import DeviceError, Refused
from teleop.live.devices.device_watchdog import DeviceWatchdog
from teleop.live.devices.settings import Reader, axes_of, one_of, positive, within
from teleop.live.devices.settings import settings_of as typed_settings
from teleop.live.orders import SHARE, intake
from teleop.physics.rotation import RotationAxes
from teleop.protocol.endpoint import Axes, Reading
from teleop.scene.scene import Scene

URL = "ws://localhost:10001"  # where the service listens if nobody has told it otherwise
MOST = 2  # commands without an answer: more would wait in a queue of a service that is slow, and age there
STALE_NS = 50_000_000  # a state is no longer where the hand is: at 1 m/s it is 50 mm away
PAUSE_NS = 10_000_000  # since the last command: what the service said to that is too old for a tick
RETRY_NS = 250_000_000  # between two attempts to reach the service
HANDSHAKE_NS = 1_000_000_000  # for the service to say which devices it has
OPEN_NS = 2_000_000_000  # for the first state, before the run
FRESH_NS = 20_000_000  # for an answer to a command after a pause
WINDOW_NS = 20_000_000  # over which the grip's angular velocity is taken: the service tells none
PIECE = 128  # bytes of the service that are looked at between two looks at the clock: up to 64 frames, 0.8 ms at most
ROOM = 1 << 12  # bytes that are read at once
UNSENT = 1 << 16  # bytes that the service has not taken
SHARE_NS = 300_000  # that may go into what the service says at a look of the watchdog process, which has no ticks
LIMIT = 3.0  # N: chosen, not the device's own


@dataclass(frozen=True)
class Settings:
    """Settings behind the `?` of a device's address, each with its default."""

    device: str | None = None  # identifier; None: the first that is listed
    word: str | None = None  # of a force; None: as the service's settings of the device say
    axes: tuple[tuple[int, float], ...] = ((0, 1.0), (1, 1.0), (2, 1.0))  # of the device, in the scene's order, signed
    origin: tuple[float, ...] = (0.0, 0.0, 0.0)  # m, in the device's frame: where the scene's positions count from
    limit: float = LIMIT  # N: a longer force is made so long
    clutch: str | None = None  # button of the grip that holds the operator's clutch open, while it is pressed
    wrist: str | None = None  # button of the grip that holds the clutch of the rotation alone open
    present: str | None = None  # button of the grip that is pressed while the operator is there
    deadline: float | None = None  # s after which the service lets go by itself, if that was measured


class Inverse3:
    """An Inverse3 of Haply by its WebSocket service, haply or haply:ws://HOST:PORT.

    `read` and `hold` return at once, whatever the service does; what is wrong is a `DeviceError`. A service that goes
    away is called again every 0.25 s, and one that says nothing for 0.05 s is read no more until it does. The motors
    push with -force, no longer than `limit`: where that may be reached, give the scene's `cap` the same, so that the
    law knows of it.
    """

    watchdog: DeviceWatchdog | None

    def __init__(self, scene: Scene, url: str = URL, *, clock: Callable[[], int] = monotonic_ns) -> None:
        """Raises `Refused` for what it cannot drive, `DeviceError` if no Inverse3 is there."""
        self._settings, self._uri = settings_of(url)
        self._rows, self._turns = _rows(self._settings.axes, scene), bool(scene.rotations)
        self._rotation = RotationAxes()
        self._turned: deque[tuple[int, Axes]] = deque()  # ns and rad, of the last states
        self._buttons = self._settings.clutch, self._settings.wrist, self._settings.present
        self._clock, self._link = clock, _Link(self._uri, self._settings, int(SHARE * scene.dt_ns))
        self._force = (0.0, 0.0, 0.0)
        self._pushes = self._commanded = False
        self._commanded_ns = 0  # ns, when a command went out last
        if self._settings.deadline is None:
            self.watchdog = DeviceWatchdog(open="master.haply:zeroing", arguments=(url,), device=(
                f"haply {self._uri} {self._settings.device or ''}".strip()))
        else:
            self.watchdog, self.deadline = None, self._settings.deadline
        if not self._link.wait(clock, OPEN_NS):
            why = self._link.trouble or f"the Inverse service at {self._uri} said nothing for {OPEN_NS / 1e9:g} s"
            self._link.drop()
            raise DeviceError(why)

    def read(self, k: int) -> Reading:
        """Position, velocity and switches, as newest told. The service tells no force of the hand."""
        link, now = self._link, self._clock()
        link.poll(now)
        if link.ready and not self._commanded:
            paused = now - self._commanded_ns > PAUSE_NS and not link.unanswered
            self._send(now)
            if paused:
                link.wait(self._clock, FRESH_NS)
                now = self._clock()
        self._commanded = False
        state = link.state
        if state is None or link.trouble is not None:
            raise DeviceError(link.trouble or f"the Inverse service at {self._uri} has not answered yet")
        if now - link.heard > STALE_NS:
            raise DeviceError(f"the Inverse service at {self._uri} has said nothing for {STALE_NS / 1e9:g} s")
        return self._reading(state)

    def hold(self, force: Axes) -> None:
        """Push with -`force` (N, per axis of the scene) from now on."""
        self._force, now = self._pushed(force), self._clock()
        if not self._link.ready:
            self._link.poll(now)  # a watchdog that has fired asks for zero, and does not read
        if not self._link.ready:
            raise DeviceError(self._link.trouble or f"the Inverse service at {self._uri} is not there")
        self._commanded = True
        self._send(now)

    def close(self) -> None:
        """Push with nothing, and let the service know that this was all."""
        link = self._link
        if link.ready:
            link.command((0.0, 0.0, 0.0))
            link.wait(self._clock, FRESH_NS)
            link.goodbye()
        link.drop()

    def _send(self, now: int) -> None:
        """Tell the newest force, unless the service has too much to answer. Letting go is never put off."""
        pushes = any(self._force)
        if self._link.unanswered < MOST or (self._pushes and not pushes):
            self._link.command(self._force)
            self._pushes, self._commanded_ns = pushes, now

    def _pushed(self, force: Axes) -> tuple[float, float, float]:
        """The motors' force in the device's frame, N."""
        out = [0.0, 0.0, 0.0]
        for (i, sign), f in zip(self._rows, force, strict=False):  # no motor turns its grip
            out[i] -= sign * f
        length = hypot(*out)
        shrink = min(1.0, self._settings.limit / length) if length else 1.0
        return out[0] * shrink, out[1] * shrink, out[2] * shrink

    def _reading(self, state: State) -> Reading:
        at, origin = state.position, self._settings.origin
        x = tuple([sign * (at[i] - origin[i]) for i, sign in self._rows])
        v = tuple([sign * state.velocity[i] for i, sign in self._rows])
        if self._turns:
            phi, omega = self._orientation(state)
            x, v = x + phi, v + omega
        clutch, wrist, present = [_pressed(state, button) for button in self._buttons]
        return Reading(x, v, None, "rotation" if wrist and not clutch else clutch if wrist is None else bool(clutch),
                       present)


    def _orientation(self, state: State) -> tuple[Axes, Axes]:
        """The grip's turn (rad) and angular velocity (rad/s) about the scene's axes."""
        if state.orientation is None:
            raise DeviceError("the grip tells no orientation; switch it on, or take a scene of three axes")
        w, *about = state.orientation
        hand = _handedness(self._rows)  # a turn is the other way round in a mirror
        phi = self._rotation.phi((w, *[hand * sign * about[i] for i, sign in self._rows]))
        turned = self._turned
        if not turned or self._link.heard > turned[-1][0]:
            turned.append((self._link.heard, phi))
        while len(turned) > 2 and turned[-1][0] - turned[1][0] >= WINDOW_NS:
            turned.popleft()
        (since, before), (until, _) = turned[0], turned[-1]
        seconds = max(until - since, 1) / 1e9
        return phi, tuple([(now - then) / seconds for now, then in zip(phi, before, strict=True)])


def _handedness(rows: list[tuple[int, float]]) -> float:
    """1 where the scene's axes are turned from the device's, -1 where they are its mirror image."""
    (i, a), (j, b), (k, c) = rows
    return a * b * c * (1.0 if (j - i) % 3 == (k - j) % 3 == 1 else -1.0)


def _pressed(state: State, button: str | None) -> bool | None:
    """State of a button, None where no button is named. Raises `DeviceError` if the grip has none of that name."""
    if button is None:
        return None
    if state.buttons is None or button not in state.buttons:
        names = ", ".join(sorted(state.buttons or ())) or "no buttons"
        raise DeviceError(f"the grip has no button {button} ({names}); switch the grip on, or name one that it has")
    return state.buttons[button]


class _Link:
    """The connection, made anew whenever it is lost. All its calls return at once but `wait`."""

    def __init__(self, uri: str, settings: Settings, share_ns: int = SHARE_NS) -> None:
        self._uri, self._settings, self._share_ns = uri, settings, share_ns
        where = urlsplit(uri)
        self._where = where.hostname, where.port or 80
        self._addresses: list[Any] = []  # the addresses that the name has, of which the first is tried next
        self._untried = 0
        self._sock: socket.socket | None = None
        self._service: InverseService | None = None
        self._in = self._out = b""
        self._behind: int | None = None  # ns, since when there is always more to take in; None: there was not
        self._since = self._retry = 0  # ns: when the connection was begun, and when the next is
        self._messages = 0  # that came, over all connections
        self._why: str | None = None
        self._device = settings.device
        self.heard = 0  # ns, when a state came last

    @property
    def ready(self) -> bool:
        """True if a command can be told."""
        return self._service is not None and self._service.state is not None

    @property
    def state(self) -> State | None:
        return None if self._service is None else self._service.state

    @property
    def unanswered(self) -> int:
        return 0 if self._service is None else self._service.unanswered

    @property
    def trouble(self) -> str | None:
        """Reason why there is no state to use, None while there is one."""
        return self._why if self._service is None or self._service.trouble is None else self._service.trouble

    def poll(self, now: int) -> None:
        """Take what has come and send what is to go; call the service again if it is time."""
        if self._sock is None:
            if now < self._retry:
                return
            self._call(now)
        try:
            self._take(now)
            self._flush()
        except (OSError, DeviceError) as error:
            self._lose(now, error)
        if self._service is not None and self._service.state is None and now - self._since > HANDSHAKE_NS:
            self._lose(now, DeviceError(self._service.trouble or (
                f"what answers at {self._uri} says nothing; is that the Inverse service?")))

    def command(self, force: tuple[float, float, float]) -> None:
        """Tell a force; what the system does not take now goes with the next call."""
        assert self._service is not None
        self._service.command(force)
        with suppress(OSError, DeviceError):  # the next `poll` meets it too, and says it
            self._flush()

    def wait(self, clock: Callable[[], int], most: int) -> bool:
        """Wait up to `most` ns for the next message; False: none came, or one that tells no state."""
        until, before = clock() + most, self._messages
        while (now := clock()) < until:
            self.poll(now)
            if self._messages > before:
                return self.trouble is None
            select([self._sock] if self._sock is not None else [], [], [], 0.005)
        return False

    def goodbye(self) -> None:
        """Say that the connection is over, if it is not lost already."""
        if self._service is None:
            return
        self._service.close()
        with suppress(OSError, DeviceError):
            self._flush()

    def drop(self) -> None:
        """Let go of the connection."""
        if self._sock is not None:
            self._sock.close()
        self._sock = self._service = None
        self._in = self._out = b""

    def _call(self, now: int) -> None:
        self._since, self._behind = now, None
        try:
            if not self._addresses:  # once: a name server may take seconds
                self._addresses = socket.getaddrinfo(*self._where, type=socket.SOCK_STREAM)
            self._untried = (self._untried or len(self._addresses)) - 1
            family, kind, number, _, at = self._addresses[0]
            self._addresses = [*self._addresses[1:], self._addresses[0]]
            self._sock = socket.socket(family, kind, number)
            self._sock.setblocking(False)
            self._sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._sock.connect_ex(at)
        except OSError as error:
            self._lose(now, error)
            return
        self._service = InverseService(self._uri, self._device, self._settings.word)
        self._out = self._service.to_send()

    def _take(self, now: int) -> None:
        """Take what has come, as much as a tick has time for. Raises `DeviceError` where that is never all."""
        assert self._service is not None
        before = self._service.states, self._service.messages
        for _ in intake(self._share_ns, clock=thread_time_ns):  # of the processor, whatever else it does
            if not self._in and not self._receive():
                self._behind = None
                break
            piece, self._in = self._in[:PIECE], self._in[PIECE:]
            self._service.receive(piece)
        else:
            self._behind = now if self._behind is None and before[0] else self._behind
        self._messages += self._service.messages - before[1]
        if self._service.states > before[0]:
            self.heard, self._why = now, None
            self._device = self._service.device  # the same one after the connection was lost
        if self._behind is not None and now - self._behind > STALE_NS:
            raise DeviceError(f"the Inverse service at {self._uri} sends more than can be read, so its newest state is "
                              "not known; end what else is connected to it, or start it anew")

    def _receive(self) -> bool:
        """Have bytes in hand; False if there are none now. Raises OSError or `DeviceError` where there will be none."""
        assert self._sock is not None
        try:
            self._in = self._sock.recv(ROOM)
        except OSError as error:
            if error.errno in (errno.EAGAIN, errno.EWOULDBLOCK, errno.ENOTCONN):
                return False
            raise
        if not self._in:
            raise DeviceError(f"the Inverse service at {self._uri} closed the connection")
        return True

    def _flush(self) -> None:
        if self._sock is None or self._service is None:
            return
        self._out += self._service.to_send()
        try:
            while self._out:
                self._out = self._out[self._sock.send(self._out):]
        except OSError as error:
            if error.errno not in (errno.EAGAIN, errno.EWOULDBLOCK, errno.ENOTCONN):
                raise
        if len(self._out) > UNSENT:
            raise DeviceError(f"the Inverse service at {self._uri} does not take what it is told; start it anew")

    def _lose(self, now: int, error: Exception) -> None:
        had = self.ready
        self.drop()
        self._retry = now + RETRY_NS * (not self._untried)
        if isinstance(error, OSError) and had:
            self._why = f"the Inverse service at {self._uri} closed the connection ({error.strerror or error})"
        elif isinstance(error, OSError):
            self._why = (f"the Inverse service at {self._uri} cannot be reached ({error.strerror or error}); start it, "
                         "or give its address as haply:ws://HOST:PORT")
        else:
            self._why = str(error)


def zeroing(url: str) -> Callable[[], None]:
    """Make the function of the watchdog process: it sends zero to the service at `url`, over its own connection."""
    settings, uri = settings_of(url)

    def zero() -> None:
        link = _Link(uri, settings)
        try:
            if not link.wait(monotonic_ns, RETRY_NS):
                raise DeviceError(link.trouble or f"the Inverse service at {uri} says nothing")
            link.command((0.0, 0.0, 0.0))
            if not link.wait(monotonic_ns, RETRY_NS):
                raise DeviceError(f"the Inverse service at {uri} did not answer a force of zero")
            link.goodbye()
        finally:
            link.drop()

    return zero


def settings_of(url: str) -> tuple[Settings, str]:
    """The settings that an address has behind its `?`, and the address before it. Raises `Refused`.

    >>> settings_of("ws://localhost:10001?axes=-y&limit=2")[0].axes
    ((1, -1.0),)
    """
    uri, settings = typed_settings("an Inverse3", url, READ, f"haply:{URL}?axes=y&limit=2")
    parts = urlsplit(uri)
    try:
        sound = parts.scheme == "ws" and parts.hostname and (parts.port is None or parts.port > 0)
    except ValueError:
        sound = False
    if not sound:
        raise Refused(f"an Inverse service is at ws://HOST:PORT, not {url!r}; write for example haply:{URL}")
    return Settings(**settings), parts._replace(fragment="").geturl()


def _text(name: str, text: str) -> str:
    if not text.isalnum():
        raise Refused(f"{name} is a word of letters and digits, not {text!r}; write {name.rpartition(' ')[2]}=a")
    return text


def _place(name: str, text: str) -> tuple[float, ...]:
    place = tuple([within(-1e3, 1e3)(name, each) for each in text.split(",")])
    if len(place) != 3:
        raise Refused(f"{name} has three numbers in m, along the device's x, y and z, not {text!r}; write for example "
                      "origin=0,-0.12,0.15")
    return place


READ: dict[str, Reader] = {
    "device": _text, "word": one_of(*WORDS), "axes": axes_of, "origin": _place, "limit": positive, "clutch": _text,
    "wrist": _text, "present": _text, "deadline": positive,
}
"""How each setting is read."""


def _rows(axes: tuple[tuple[int, float], ...], scene: Scene) -> list[tuple[int, float]]:
    """For each axis of the scene that is a translation, the device's axis and its sign. Raises `Refused`."""
    count = 3 if scene.rotations == (3,) and scene.axes == 6 else scene.axes
    if "rad" in scene.axis_units[:count]:
        raise Refused("an Inverse3 has no joints of the scene's: it tells a place, and its grip's orientation; take a "
                      "scene of one to three axes in m, or pose")
    if count > len(axes):
        raise Refused(f"the scene has {count} axes that are places, and the Inverse3 gives it {len(axes)}; take a "
                      "scene of at most three, or name more by ?axes=xyz")
    return list(axes[:count])
