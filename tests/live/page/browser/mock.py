"""A server that speaks as `teleop demo --page` does, over a small simulated scene: for states that are hard to reach.

`Mock.heard` has what the page sent.
"""

from __future__ import annotations

import json
import random
import threading
import time
from collections import deque
from contextlib import suppress
from pathlib import Path
from typing import Any

from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.sync.server import Server, ServerConnection, serve

from teleop.live.page.command import FOLDER, page_bytes
from teleop.live.page.server import Requests

LAWS = {
    "wave": "Wave variables with a spring-damper slave solved in closed form.",
    "direct": "Position forth, measured force back, nothing in between.",
}
GROUPS = {"wave": "Passive over any link", "direct": "No claim over a delay"}
SLIDERS = [
    {"name": "delay", "label": "Delay, each way", "unit": "s", "low": 0.0, "high": 0.3, "log": False},
    {"name": "jitter", "label": "Jitter", "unit": "s", "low": 0.0, "high": 0.05, "log": False},
    {"name": "loss", "label": "Loss", "unit": "", "low": 0.0, "high": 0.5, "log": False},
    {"name": "k_e", "label": "Wall stiffness", "unit": "N/m", "low": 50.0, "high": 1e5, "log": True},
    {"name": "scale", "label": "Scale of the slave\u2019s motion", "unit": "", "low": 0.25, "high": 4.0, "log": True,
     "running": True},
]
DT, F_MAX, WALL = 1e-3, 20.0, 0.03


class World:
    """A hand, the master in it, and a slave that follows a delay later and meets a soft wall in its first axis."""

    def __init__(self, axes: int, knobs: dict[str, Any]) -> None:
        self.axes, self.knobs, self.t, self.clutch = axes, knobs, 0.0, False
        self.part, self.kind = "01", "link"
        self.again()

    def again(self) -> None:
        self.since, self.steered = 0.0, False
        self.target: list[float] | None = None
        self.xm, self.xs, self.fm, self.fe = ([0.0] * self.axes for _ in range(4))
        self.settle()

    def settle(self) -> None:
        """Fill the link with rest."""
        self.link = deque([[*self.xm]] * max(1, round(self.knobs["delay"] / DT)))

    def step(self) -> None:
        self.t += DT
        self.since += DT
        s = min(1.0, max(0.0, (self.since - 0.5) / 1.5))
        own, late = 0.06 * s**3 * (10 - 15 * s + 6 * s * s), self.link.popleft()
        for i in range(self.axes):
            goal = own if i == 0 else 0.0
            if self.steered:
                goal = self.xm[i] if self.target is None else self.target[i]
            self.xm[i] += 30.0 * (goal - self.xm[i]) * DT
            self.xs[i] = late[i] if i > 0 or late[i] < WALL else WALL + 0.02 * (late[i] - WALL)
            self.fe[i] = 200.0 * (late[i] - self.xs[i])
            self.fm[i] = 0.0 if self.clutch else max(-F_MAX, min(F_MAX, 200.0 * (self.xm[i] - self.xs[i])))
        self.link.append([*self.xm])

    def rows(self) -> dict[str, Any]:
        """The row of a sixtieth of a second."""
        forces = []
        for _ in range(16):
            self.step()
            forces.append([*self.fm])
        lo, hi = [*map(min, zip(*forces, strict=True))], [*map(max, zip(*forces, strict=True))]
        delay = max(DT, self.knobs["delay"]) + random.random() * self.knobs["jitter"]
        hand = None if self.steered and self.target is None else [*self.xm]
        fe = [*self.fe]
        return {"t": self.t, "part": self.part, "kind": None if self.clutch else self.kind,
                "xm": [*self.xm], "xs": [*self.xs], "hand": hand, "fm": [*self.fm], "fs": fe,
                "fh": [0.0] * self.axes, "fe": fe, "fm_lo": lo, "fm_hi": hi, "fs_lo": fe, "fs_hi": fe,
                "E": None if self.clutch else 1e-3 * self.t,
                "queue": [self.knobs["jitter"], self.knobs["jitter"] / 2], "age": [delay, delay], "gain": [1.0, 1.0]}


class Mock:
    """The server of one page address, `url`; its scene runs in a thread until `stop`, and has run for `ran` s before.

    By then the scene's own motion is over. `document`: another than the page, as the screen of a trial.
    """

    def __init__(self, axes: int = 1, port: int = 0, ran: float = 3.1, document: Path = FOLDER / "page.html") -> None:
        self.knobs: dict[str, Any] = {"law": "wave", "delay": 0.05, "jitter": 0.0, "loss": 0.0, "k_e": 2e4}
        self.world, self.heard, self.past = World(axes, self.knobs), [], deque(maxlen=600)
        well = {"gain": 1.0, "cause": None}
        self.status: dict[str, Any] = {"lost": None, "m": well, "s": well}
        self.clients: set[ServerConnection] = set()
        self.parts, self.lock, self.over = 1, threading.RLock(), threading.Event()
        self.energy: str | None = "link"
        self.silent = False  # it stands still, with its sockets open
        while self.world.t < ran:
            self.past.append(self.world.rows())
        self.requests = Requests(page_bytes(document), "mock")  # as the page's own server answers
        self.server: Server = serve(self._client, "127.0.0.1", port, process_request=self._request,
                                    open_timeout=2, close_timeout=0.2)
        self.port = self.server.socket.getsockname()[1]
        self.url = f"http://127.0.0.1:{self.port}/?token=mock"
        self._threads = [threading.Thread(target=self.server.serve_forever), threading.Thread(target=self._run)]
        for thread in self._threads:
            thread.start()

    def hello(self) -> dict[str, Any]:
        n = self.world.axes
        joints = {"names": [f"joint{i + 1}" for i in range(n)], "units": ["rad"] * n,
                  "walls": [WALL, *[None] * (n - 1)], "caps": [F_MAX] * n,
                  "spans": [0.12, *[0.4] * (n - 1)]} if n > 3 else {}
        return {**joints, "type": "hello", "scene": "hard_wall", "axes": n, "dt": DT, "law": self.knobs["law"],
                "laws": [{"name": name, "says": says, "group": GROUPS[name]} for name, says in LAWS.items()],
                "gains": f"{self.knobs['law']}(b=20)", "notes": [],
                "wall": WALL, "f_max": F_MAX,
                "sliders": [{**one, "value": self.knobs.get(one["name"], 1.0)} for one in SLIDERS], "span": 0.12,
                "link": f"delay({self.knobs['delay']:g})", "energy": self.energy}

    def say(self, level: str, text: str) -> None:
        self.send({"type": "said", "level": level, "text": text})

    def send(self, message: dict[str, Any]) -> None:
        with self.lock:
            for client in list(self.clients):
                with suppress(ConnectionClosed, OSError):
                    client.send(json.dumps(message))

    def of(self, kind: str) -> list[dict[str, Any]]:
        """What was heard of this type."""
        return [message for message in list(self.heard) if message["type"] == kind]

    def stop(self) -> None:
        self.over.set()
        self.server.shutdown()
        for client in list(self.clients):
            client.close()
        for thread in self._threads:
            thread.join()

    def _request(self, _connection: ServerConnection, request: Request) -> Response | None:
        answer = self.requests.answer(request.path, dict(request.headers.raw_items()))
        return None if answer is None else Response(answer.status, "", Headers(answer.headers), answer.body)

    def _client(self, client: ServerConnection) -> None:
        with self.lock:
            client.send(json.dumps(self.hello()))
            client.send(json.dumps({"type": "past", "rows": list(self.past)}))
            self.clients.add(client)
        try:
            for text in client:
                self._take(json.loads(text))
        except ConnectionClosed:
            pass
        finally:
            self.clients.discard(client)

    def _take(self, message: dict[str, Any]) -> None:
        with self.lock:
            self.heard.append(message)
            if message["type"] == "hand":
                self.world.target, self.world.steered = message["to"], True
            elif message["type"] == "clutch":
                self.world.clutch = message["open"]
            elif message["type"] == "scale":
                self.status = {**self.status, "scale": message["to"]}
            elif message["type"] in ("again", "turn"):
                if message["type"] == "again":
                    self.world.again()
                self.knobs.update({name: value for name, value in message.items() if name != "type"})
                self.world.settle()
                self.parts += 1
                self.world.part = f"{self.parts:02d}"
                self.send(self.hello())
                self.say("info", f"{self.knobs['law']}, {1e3 * self.knobs['delay']:.0f} ms: a new session.")
                if self.knobs["law"] == "direct" and self.knobs["delay"] > 0.05:
                    self.say("warn", "The swing grows: over this delay direct reflection feeds it.")

    def _run(self) -> None:
        due, count = time.monotonic(), 0
        while not self.over.wait(max(0.0, due - time.monotonic())):
            due, count = due + 1 / 60, count + 1
            if self.silent:
                continue
            with self.lock:
                row = self.world.rows()
                self.past.append(row)
                self.send({"type": "rows", **row})
                if count % 15 == 0:
                    link = {name: self.knobs[name] for name in ("delay", "jitter", "loss")}
                    self.send({"type": "status", **link, "clutch": self.world.clutch, "parts": self.parts,
                               **self.status})
