"""The page's server with children that only speak as slave, channel and master do; and what a browser says to it."""

from __future__ import annotations

import asyncio
import json
import sys
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from inspect import signature
from pathlib import Path
from typing import Any

import pytest
from websockets.asyncio.client import ClientConnection, connect
from websockets.typing import Origin

from teleop.live.page.controls import Controls
from teleop.live.page.page import Page
from teleop.live.page.server import Requests
from teleop.live.page.session import PageParts, Start
from teleop.live.process.interrupt import Interrupt
from tests.waiting import PATIENCE

FAKE = (sys.executable, "-S", "-E", str(Path(__file__).with_name("fake.py")))  # it needs no package
TOKEN = "a-token"
HTML = b"<!doctype html><style>b{}</style><script>let a = 1;</script>"


@dataclass
class Browser:
    """One page that is open. What it is told is kept in `got`, by type."""

    socket: ClientConnection
    got: list[dict[str, Any]] = field(default_factory=list)

    async def say(self, kind: str, **fields: Any) -> None:
        await self.socket.send(json.dumps({"type": kind, **fields}))

    async def until(self, kind: str, shows: Callable[[dict[str, Any]], Any] = lambda _: True) -> dict[str, Any]:
        """Read on to the next message of this type that shows this."""
        async with asyncio.timeout(PATIENCE):
            while True:
                message: dict[str, Any] = json.loads(await self.socket.recv())
                self.got.append(message)
                if message["type"] == kind and shows(message):
                    return message

    async def told(self, words: str) -> dict[str, Any]:
        """Read on to a sentence with these words."""
        return await self.until("said", lambda message: words in message["text"])


@dataclass
class Served:
    """A page that is served. `folder`: of its parts."""

    port: int
    folder: Path
    page: Page
    interrupt: Interrupt

    @property
    def host(self) -> str:
        return f"127.0.0.1:{self.port}"

    @asynccontextmanager
    async def open(self, **other: Any) -> AsyncIterator[Browser]:
        """A page in a browser."""
        other = {"max_queue": None, **other}  # one that is behind is not closed before ten seconds have passed
        async with connect(f"ws://{self.host}/ws?token={TOKEN}", origin=Origin(f"http://{self.host}"),
                           proxy=None, open_timeout=PATIENCE, ping_interval=None, **other) as socket:
            yield Browser(socket)

    def orders(self, name: str) -> list[dict[str, Any]]:
        """What an end was told; not where a slave is that it is being brought to, nor that the hand swings."""
        return [order for order in self.all_orders(name) if order["order"] != "align" and "swing" not in order]

    def all_orders(self, name: str) -> list[dict[str, Any]]:
        """All that an end was told."""
        path = self.folder / f"orders-{name}.jsonl"
        return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []

    async def until(self, true: Callable[[], Any], missing: str = "it never came") -> None:
        end = time.monotonic() + PATIENCE
        while not true():
            assert time.monotonic() < end, missing
            await asyncio.sleep(0.01)

    def index(self) -> dict[str, Any]:
        found: dict[str, Any] = json.loads((self.folder / "page.json").read_text())
        return found


Scenario = Callable[..., Awaitable[None]]


@pytest.fixture
def served(tmp_path: Path) -> Callable[..., Served]:
    """`served(scenario)`: serve a page of hard_wall, have the scenario run beside it, and end both.

    A scenario of two arguments is given a browser too, which shows rows.
    """
    return lambda scenario, html=HTML: asyncio.run(_serve(scenario, tmp_path / "page", html))


async def _steps(scenario: Scenario, page: Served) -> None:
    if len(signature(scenario).parameters) == 1:
        await scenario(page)
    else:
        async with page.open() as browser:
            await browser.until("rows")
            await scenario(page, browser)


async def _serve(scenario: Scenario, folder: Path, html: bytes) -> Served:
    folder.mkdir()
    interrupt = Interrupt()
    parts = PageParts(folder, {"scene": "hard_wall", "seed": 0, "command": ["teleop", "demo", "--page"]})
    page = Page(Controls("hard_wall", {}), parts, Start("hard_wall", 0, program=FAKE), interrupt, time.monotonic)
    port: asyncio.Future[int] = asyncio.get_running_loop().create_future()
    running = asyncio.create_task(page.run(Requests(html, TOKEN), 0, port.set_result))
    await asyncio.wait([running, port], return_when=asyncio.FIRST_COMPLETED)
    served = Served(await port, folder, page, interrupt)
    steps = asyncio.ensure_future(_steps(scenario, served))
    try:
        await asyncio.wait([running, steps], return_when=asyncio.FIRST_COMPLETED)
        if running.done():
            steps.cancel()
            running.result()
        await steps
    finally:
        interrupt.name = "SIGINT"
        await asyncio.wait_for(running, PATIENCE)
    return served
