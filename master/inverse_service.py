"""Haply's Inverse service as a function of bytes: what it says of an Inverse3, and what it is told. No socket.

The service speaks JSON over a WebSocket, and answers each message with one state of all its devices; at the start it
tells them with their settings, unasked. Position, velocity and force are in m, m/s and N, in a right-handed frame whose
x is to the right, y forward, away from the hand's owner, and z up.

Source: docs.haply.co/inverseSDK, pages "WebSocket Protocol", "Control Commands", "Basis Permutation" and "Mount &
Workspace Transforms" of 3.5, and the example of 3.1. A force is the `vector` of a command in 3.5 and its `values` in
3.1; a service whose settings of a device have a `mount`, which is new in 3.5, is told the first.
"""

from __future__ import annotations

from collections.abc import Sequence
from json import JSONDecoder
from math import isfinite
from typing import Any, NamedTuple

from websockets.client import ClientProtocol
from websockets.exceptions import WebSocketException
from websockets.frames import Frame, Opcode
from websockets.protocol import State as Connection
from websockets.uri import parse_uri

from teleop.errors import DeviceError
from teleop.physics.rotation import Quaternion, unit_quaternion

Vector = tuple[float, float, float]
WORDS = ("vector", "values")  # of a force, in 3.5 and in 3.1
PARTS = 100  # of one message
GRIPS = ("wireless_verse_grip", "verse_grip")  # of which the first that is listed is read


class State(NamedTuple):
    """State of an Inverse3 and of the grip on it, as the service reports it."""

    position: Vector  # m
    velocity: Vector  # m/s
    orientation: Quaternion | None  # of the grip: w, x, y, z; None: there is no grip
    buttons: dict[str, bool] | None  # of the grip, by name: is it pressed; None: there is no grip with buttons


class InverseService:
    """Connection to the service at `uri`, from its first byte on.

    `device`: the identifier of the Inverse3; None: the first that is listed. `word`: how a force is told; None: as the
    service's settings say. `state` is the newest, `unanswered` counts commands to which no state has come, and
    `trouble` says what is wrong with what came last, None if nothing is.
    """

    def __init__(self, uri: str, device: str | None = None, word: str | None = None) -> None:
        self.uri, self.device, self.word = uri, device, word
        self.state: State | None = None
        self.messages = self.states = 0  # that came, and those of them that tell a state
        self.unanswered = 0
        self.trouble: str | None = None
        self._protocol = ClientProtocol(parse_uri(uri), max_size=1 << 20)
        self._protocol.send_request(self._protocol.connect())
        self._parts: list[bytes] = []
        self._inventory = False

    def receive(self, data: bytes) -> None:
        """Take bytes of the connection. Raises `DeviceError` if they end it: what comes next needs a new connection."""
        protocol = self._protocol
        protocol.receive_data(data)
        for event in protocol.events_received():
            if isinstance(event, Frame):
                self._take(event)
        wrong = protocol.handshake_exc or protocol.parser_exc
        if wrong is not None:
            raise DeviceError(f"what answers at {self.uri} is no Inverse service ({_reason(wrong)}); give its address, "
                              "by default ws://localhost:10001")
        if protocol.state in (Connection.CLOSING, Connection.CLOSED):
            raise DeviceError(f"the Inverse service at {self.uri} closed the connection")

    def command(self, force: Sequence[float]) -> None:
        """Have the motors push with `force`, N along x, y and z. There is a device once a state has come."""
        x, y, z = force
        text = (f'{{"inverse3":[{{"device_id":"{self.device}","commands":{{"set_cursor_force":{{"{self.word}":'
                f'{{"x":{x!r},"y":{y!r},"z":{z!r}}}}}}}}}]}}')
        self._protocol.send_text(text.encode())
        self.unanswered += 1

    def close(self) -> None:
        """Say that the connection is over."""
        if self._protocol.state is Connection.OPEN:
            self._protocol.send_close()

    def to_send(self) -> bytes:
        """The bytes that are to go out now."""
        return b"".join(self._protocol.data_to_send())

    def _take(self, frame: Frame) -> None:
        """A frame; a message may come in several."""
        if frame.opcode in (Opcode.TEXT, Opcode.BINARY, Opcode.CONT):
            if len(self._parts) >= PARTS:
                raise DeviceError(f"the Inverse service at {self.uri} sent a message in more than {PARTS} parts; start "
                                  "it anew")
            self._parts.append(bytes(frame.data))
            if frame.fin:
                data, self._parts = b"".join(self._parts), []
                self._message(data)

    def _message(self, data: bytes) -> None:
        self.messages += 1
        self.unanswered = max(0, self.unanswered - 1)
        try:
            self.state, self.trouble = self._read(data), None
            self.states += 1
        except DeviceError as error:
            self.trouble = str(error)

    def _read(self, data: bytes) -> State:
        """The state that a message tells. Raises `DeviceError` if it tells none."""
        try:
            message = _JSON.decode(data.decode())
        except (ValueError, RecursionError) as error:
            raise DeviceError(f"the Inverse service sent what is no JSON of finite numbers: {data[:40]!r}") from error
        if not isinstance(message, dict):
            raise DeviceError(f"the Inverse service sent no list of devices: {data[:40]!r}")
        device = self._find_device(message)
        status = _part(device, "status")
        for name, cure in CURES.items():
            if status.get(name) is False:
                raise DeviceError(f"the Inverse3 {self.device} {cure}")
        state = _part(device, "state")
        orientation, buttons = _grip(message)
        return State(_vector(state, "cursor_position"), _vector(state, "cursor_velocity"), orientation, buttons)

    def _find_device(self, message: dict[str, Any]) -> dict[str, Any]:
        """The entry of the Inverse3 that is driven. Raises `DeviceError` if it is not listed."""
        listed = [one for one in _entries(message, "inverse3") if isinstance(one.get("device_id"), str)]
        for one in listed:
            if self.device in (None, one["device_id"]):
                name, settings = one["device_id"], one.get("config")
                if not name.isalnum():
                    raise DeviceError(f"the Inverse service lists a device by no identifier: {name[:40]!r}")
                self.device = name
                if isinstance(settings, dict) and self.word is None:
                    self.word = WORDS[0] if "mount" in settings else WORDS[1]
                self.word = self.word or WORDS[1]
                return one
        wanted = "Inverse3" if self.device is None else f"Inverse3 {self.device}"
        kinds = [f"{kind} {one.get('device_id')}" for kind in message for one in _entries(message, kind)]
        raise DeviceError(f"the Inverse service at {self.uri} lists no {wanted}, but {', '.join(kinds) or 'nothing'}; "
                          "plug it in, or name another by ?device=")


CURES = {
    "calibrated": "is not calibrated; put its grip on the base as its guide shows, until its light is steady",
    "power_supply": "has no power for its motors; plug its power supply in",
}
"""What the status of a device says, and what to do where it is false."""


def _grip(message: dict[str, Any]) -> tuple[Quaternion | None, dict[str, bool] | None]:
    for kind in GRIPS:
        for one in _entries(message, kind):
            state = _part(one, "state")
            buttons = state.get("buttons")
            pressed = None
            if isinstance(buttons, dict):
                pressed = {name: is_so for name, is_so in buttons.items() if isinstance(is_so, bool)}
            return (_quaternion(state["orientation"]) if "orientation" in state else None), pressed
    return None, None


def _entries(message: dict[str, Any], kind: str) -> list[dict[str, Any]]:
    listed = message.get(kind)
    return [one for one in listed if isinstance(one, dict)] if isinstance(listed, list) else []


def _part(entry: dict[str, Any], name: str) -> dict[str, Any]:
    part = entry.get(name)
    return part if isinstance(part, dict) else {}


def _vector(state: dict[str, Any], name: str) -> Vector:
    x, y, z = _numbers(state.get(name), "xyz", name)
    return x, y, z


def _quaternion(value: Any) -> Quaternion:
    return unit_quaternion(_numbers(value, "wxyz", "orientation"))


def _numbers(value: Any, names: str, what: str) -> list[float]:
    numbers: list[Any] = [value.get(name) for name in names] if isinstance(value, dict) else [None]
    if not all(type(number) in (int, float) and isfinite(number) for number in numbers):
        raise DeviceError(f"the Inverse service told a {what} that is no finite number for each of {', '.join(names)}")
    return [float(number) for number in numbers]


def _reason(error: Exception) -> str:
    return str(error) if isinstance(error, WebSocketException) and str(error) else type(error).__name__


def _refuse(constant: str) -> Any:
    raise ValueError(constant)


_JSON = JSONDecoder(parse_constant=_refuse)
