"""A stand-in of Haply's Inverse service, with an Inverse3 that is a mass in a hand; by hand, or as a process.

    python tests/master/inverse_stand_in.py vector [PORT]

It answers each message with one state, in the words of 3.5 (`vector`, a `mount` among its settings) or of 3.1
(`values`), and takes no force in the words of the other. A force stands until the next command of any connection.
"""

from __future__ import annotations

import json
import socket
import sys
from contextlib import suppress
from math import exp, sin
from select import select
from time import monotonic
from typing import Any

from websockets.frames import Frame, Opcode
from websockets.http11 import Request
from websockets.protocol import State as Connection
from websockets.server import ServerProtocol

MASS, SPRING, DAMPING = 0.3, 200.0, 8.0  # kg, N/m, N s/m: a hand that holds the cursor
AMPLITUDE, RATE = 0.02, 6.0  # m, rad/s: and moves it forward and back
STEP = 1e-4  # s


class StandIn:
    """The service. `pump(now)` does what is to be done at `now` (s); `say` replaces what it answers."""

    def __init__(self, word: str = "vector", port: int = 0, device: str = "049D") -> None:
        self.word, self.device = word, device
        self.force = {"x": 0.0, "y": 0.0, "z": 0.0}  # N, that the motors push with
        self.commands: list[dict[str, Any]] = []
        self.x, self.v, self.at = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], 0.0  # m, m/s from the middle; s
        self.buttons = {"a": False, "b": False, "c": False}
        self.orientation = {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0}
        self.status = {"calibrated": True, "in_use": False, "power_supply": True, "ready": True, "started": True}
        self.say: Any = None  # bytes or text instead of a state
        self.answers = True
        self.extra: dict[str, Any] = {}
        self.without: set[str] = set()  # kinds of devices that it does not list
        self._listening = socket.create_server(("127.0.0.1", port))
        self._listening.setblocking(False)
        self.port: int = self._listening.getsockname()[1]
        self._clients: list[tuple[socket.socket, ServerProtocol]] = []
        self._waiting: list[ServerProtocol] = []

    @property
    def url(self) -> str:
        return f"ws://127.0.0.1:{self.port}"

    def sockets(self) -> list[socket.socket]:
        return [self._listening, *[sock for sock, _ in self._clients]]

    def pump(self, now: float) -> None:
        """Move to `now`, take what has come, and answer it."""
        while self.at < now:
            self._move()
        try:
            sock, _ = self._listening.accept()
        except BlockingIOError:
            pass
        else:
            sock.setblocking(False)
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._clients.append((sock, ServerProtocol()))
        for client in list(self._clients):
            self._serve(*client)

    def close(self) -> None:
        for sock in self.sockets():
            sock.close()
        self._clients = []

    def drop(self) -> None:
        for sock, _ in self._clients:
            sock.close()
        self._clients = []

    def _move(self) -> None:
        for i, name in enumerate("xyz"):
            goal = AMPLITUDE * sin(RATE * self.at) * (1.0 - exp(-self.at)) if name == "y" else 0.0
            pull = SPRING * (goal - self.x[i]) - DAMPING * self.v[i]
            self.v[i] += STEP * (pull + self.force[name]) / MASS
            self.x[i] += STEP * self.v[i]
        self.at += STEP

    def _serve(self, sock: socket.socket, protocol: ServerProtocol) -> None:
        try:
            data = sock.recv(1 << 16)
        except BlockingIOError:
            data = None
        except ConnectionResetError:
            data = b""
        if data == b"":
            self._clients.remove((sock, protocol))
            sock.close()
            return
        if data:
            protocol.receive_data(data)
            for event in protocol.events_received():
                if isinstance(event, Request):
                    protocol.send_response(protocol.accept(event))
                    self._answer(protocol, inventory=True)
                elif isinstance(event, Frame) and event.opcode is Opcode.TEXT:
                    self._obey(json.loads(event.data))
                    self._waiting.append(protocol)
        while self.answers and protocol in self._waiting:
            self._waiting.remove(protocol)
            if protocol.state is Connection.OPEN:
                self._answer(protocol)
        for out in protocol.data_to_send():
            with suppress(BrokenPipeError, ConnectionResetError):
                sock.sendall(out)

    def _obey(self, said: dict[str, Any]) -> None:
        self.commands.append(said)
        for one in said.get("inverse3", []):
            told = one.get("commands", {}).get("set_cursor_force", {})
            if one.get("device_id") == self.device and self.word in told:
                self.force = told[self.word]

    def _answer(self, protocol: ServerProtocol, *, inventory: bool = False) -> None:
        said = self.say if self.say is not None else json.dumps(self.state(inventory))
        protocol.send_text(said if isinstance(said, bytes) else said.encode())

    def state(self, inventory: bool = False) -> dict[str, Any]:
        x, y, z = self.x
        state = {
            "angular_position": {"a0": 0.0, "a1": 0.0, "a2": 0.0},
            "body_orientation": {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0},
            "control_domain": "cartesian", "control_mode": "idle", "current_cursor_force": self.force,
            "cursor_position": {"x": x, "y": y - 0.12, "z": z + 0.15},
            "cursor_velocity": dict(zip("xyz", self.v, strict=True)),
        }
        device: dict[str, Any] = {"device_id": self.device, "state": state, "status": self.status}
        if inventory:
            device["config"] = {"handedness": "right", **({"mount": {}} if self.word == "vector" else {})}
        grip = {"device_id": "7C11", "state": {"orientation": self.orientation, "buttons": self.buttons}}
        listed = {"inverse3": [device], "wireless_verse_grip": [grip]}
        return {**({"session_id": 7} if inventory else {}),
                **{kind: [] if kind in self.without else devices for kind, devices in listed.items()}, **self.extra}


def main(word: str, port: str = "0") -> None:
    """Serve until the process is ended; its first line is the address, then there is one for each force of 0.1 N."""
    service = StandIn(word, int(port))
    began, told = monotonic(), (0, True)
    print(service.url, flush=True)
    while True:
        select(service.sockets(), [], [], 0.001)
        service.pump(monotonic() - began)
        pushed = max(map(abs, service.force.values()))
        if (shown := (int(pushed * 10), pushed == 0.0)) != told:
            told = shown
            print(f"pushes {pushed:.3g}", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
