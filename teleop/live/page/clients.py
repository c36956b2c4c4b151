"""The pages that are open: a socket each. What is told all of them is made once.

A page that takes its messages too slowly loses pictures, never the others; what waits for it is bounded. One that says
too much, or nonsense, is told so, and then closed.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from http import HTTPStatus
from typing import Any, Protocol

from websockets.asyncio.server import Server, ServerConnection, broadcast, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from teleop.errors import Refused
from teleop.live.page.allowance import GARBAGE, MOST, SECONDS, Allowance
from teleop.live.page.messages import LONGEST, Garbage, read, said
from teleop.live.page.requests import HOST, Requests

PAGES = 8  # at most
BEHIND = 1 << 16  # bytes that wait for a page, and it is shown no more pictures until it has taken them
LOST = 1 << 20  # bytes, and it is given up: the last ten seconds and a few hundred sentences
SLOWER = 0.005  # s between two messages that are dropped: the system has the sender wait meanwhile
AWAY, POLICY, FULL = 1001, 1008, 1013  # codes of a closed socket


class Host(Protocol):
    """What the pages are told, and who hears them. `page` is any one of them, the same while it is open."""

    def greeting(self) -> list[str]:
        """The messages for a page that has just been opened."""
        ...

    def hear(self, page: ServerConnection, message: dict[str, Any]) -> None:
        """Take a message of a page, of a right shape. Raises `Garbage` or `Refused`."""
        ...

    def gone(self, page: ServerConnection) -> None:
        """A page has been closed."""
        ...


class Clients:
    """Serves the page and its socket. `now`: the clock, s."""

    def __init__(self, requests: Requests, host: Host, now: Callable[[], float]) -> None:
        self._requests, self._host, self._now = requests, host, now
        self._server: Server | None = None
        self._pages: set[ServerConnection] = set()

    def __len__(self) -> int:
        return len(self._pages)

    @property
    def waiting(self) -> int:
        """The most bytes that wait for a page."""
        return max(map(_waiting, self._pages), default=0)

    async def serve(self, port: int) -> int:
        """Listen on this machine; the port, which the system chooses if it is 0. Raises `Refused`."""
        quiet = logging.getLogger("teleop.page")
        quiet.addHandler(logging.NullHandler())
        quiet.propagate = False  # whatever a stranger sends is no line on this terminal
        try:
            self._server = await serve(
                self._open, HOST, port, process_request=self._request, compression=None, max_size=LONGEST,
                max_queue=16, write_limit=BEHIND, open_timeout=5.0, close_timeout=1.0, ping_interval=10.0,
                ping_timeout=10.0, server_header=None, logger=quiet)
        except (OSError, OverflowError) as error:
            why = getattr(error, "strerror", None) or error
            raise Refused(f"cannot listen on {HOST}:{port} ({why}); give another port with --port, or leave it out for "
                          "one that is free") from error
        found: int = self._server.sockets[0].getsockname()[1]
        return found

    async def close(self, why: str) -> None:
        """Close all pages, and listen no more."""
        if self._server is not None:
            await asyncio.gather(*[page.close(AWAY, why) for page in self._pages])
            self._server.close()
            await self._server.wait_closed()

    def show(self, text: str) -> None:
        """Send all pages a picture; one that is behind does without."""
        broadcast([page for page in self._pages if _waiting(page) < BEHIND], text)

    def tell(self, text: str) -> None:
        """Send all pages what none may miss; one that is lost is given up."""
        for page in list(self._pages):
            self._tell(page, text)

    def _tell(self, page: ServerConnection, text: str) -> None:
        if _waiting(page) > LOST:
            page.transport.abort()
        else:
            broadcast([page], text)

    def _request(self, connection: ServerConnection, request: Request) -> Response | None:
        headers = {name: request.headers.get_all(name)[-1] if len(request.headers.get_all(name)) == 1 else ""
                   for name in ("Host", "Origin", "Upgrade") if name in request.headers}
        answer = self._requests.answer(request.path, headers)
        return None if answer is None else _response(*answer)

    async def _open(self, page: ServerConnection) -> None:
        if len(self._pages) >= PAGES:
            await page.close(FULL, f"{PAGES} pages are open already; close one of them")
            return
        try:
            for text in self._host.greeting():
                broadcast([page], text)
            self._pages.add(page)
            await self._hear(page)
        except ConnectionClosed:
            pass
        finally:
            self._pages.discard(page)
            self._host.gone(page)

    async def _hear(self, page: ServerConnection) -> None:
        allowed = Allowance()
        async for data in page:
            if not allowed.takes(self._now()):
                if allowed.begins:
                    self._tell(page, said("warn", f"this page says more than {MOST} messages a second; the rest is "
                                                  "dropped"))
                if allowed.floods:
                    await page.close(POLICY, f"more than {MOST} messages a second, for {SECONDS} s")
                    return
                await asyncio.sleep(SLOWER)
                continue
            try:
                self._host.hear(page, read(data))
            except Garbage as garbage:
                if allowed.garbage(garbage.kind):
                    self._tell(page, said("error", f"not understood: {garbage}"))
                if allowed.talks_nonsense:
                    await page.close(POLICY, f"{GARBAGE} messages that are none")
                    return
            except Refused as refused:
                self._tell(page, said("error", str(refused)))


def _waiting(page: ServerConnection) -> int:
    """Bytes that the page has not taken yet, beyond what the system holds for it."""
    return page.transport.get_write_buffer_size()


def _response(status: HTTPStatus, headers: dict[str, str], body: bytes) -> Response:
    return Response(status.value, status.phrase, Headers({
        **headers, "Content-Length": str(len(body)), "Connection": "close"}), body)
