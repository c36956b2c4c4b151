"""The pages that are open: a socket each. What is told all of them is made once.

A page that takes its messages too slowly loses pictures, never the others; what waits for it is bounded. One that says
too much, or nonsense, is told so, and then closed. Who has not shown the token is one of at most `STRANGERS`, and for
`STRANGE` seconds.
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
from websockets.frames import Frame, Opcode
from websockets.http11 import Request, Response

from teleop.errors import Refused
from teleop.live.page.allowance import GARBAGE, MOST, SECONDS, Allowance
from teleop.live.page.messages import LONGEST, Garbage, read, said
from teleop.live.page.requests import HOST, METHODS, Requests

PAGES = 8  # at most
STRANGERS = 32  # connections that are no page, or not yet; of more the oldest is dropped
STRANGE = 5.0  # s for a request to come and be answered
ACCEPTED = 16  # connections that are taken up at once
PIECE = 1 << 10  # bytes that are taken apart at once: up to 512 frames
LONGEST_METHOD = 8  # bytes
LEAVE = 1.0  # s for a connection to end in order
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


class PageConnection(ServerConnection):
    """A connection, from its first byte on: a method that is answered, and frames that a page may send."""

    clients: Clients  # set by the class that `Clients` makes

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin, as a stranger."""
        super().connection_made(transport)
        self.allowed, self.heads = Allowance(), False
        self._method: bytes | None = b""  # so far; None: it is known
        self._deaf = False  # nothing that comes is looked at any more
        self.clients.arrived(self)

    def connection_lost(self, exc: Exception | None) -> None:
        """End."""
        self.clients.forget(self)
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Take bytes, some at a time, for of many frames the first ones may end it."""
        if self._method is not None:
            data = self._after_method(data)
        for start in range(0, len(data), PIECE):
            if self._deaf:
                return
            super().data_received(data[start:start + PIECE])

    def process_event(self, event: Any) -> None:
        """Take a frame. A part of a message, and a frame of control, counts as a message: a page sends none."""
        if self._deaf:
            return
        counts = isinstance(event, Frame) and (not event.fin or event.opcode in (Opcode.PING, Opcode.PONG))
        if counts and not self.allowed.takes(self.clients.now()):
            self._deaf = True
            self.protocol.fail(POLICY, f"more than {MOST} messages a second, in parts or pings")
            self.send_data()
            self.loop.call_later(LEAVE, self.transport.abort)
            return
        super().process_event(event)

    def _after_method(self, data: bytes) -> bytes:
        """The bytes of a request that is a GET; those of another method are answered here, and none are left."""
        assert self._method is not None
        self._method += data
        method, blank, _ = self._method[:LONGEST_METHOD].partition(b" ")
        if not blank and len(self._method) < LONGEST_METHOD and b"\n" not in self._method:
            return b""
        data, self._method = self._method, None
        self.heads = method == b"HEAD"
        if method.replace(b"-", b"x").isalpha() and method.decode() not in METHODS:  # or the head of a longer one
            self._deaf = True
            self.transport.write(_response(*Requests.of_method()).serialize())
            self.transport.write_eof()
            return b""
        return b"GET" + data[len(method):] if self.heads else data


class Clients:
    """Serves the page and its socket. `now`: the clock, s."""

    def __init__(self, requests: Requests, host: Host, now: Callable[[], float]) -> None:
        self._requests, self._host, self.now = requests, host, now
        self._server: Server | None = None
        self._pages: set[PageConnection] = set()
        self._strangers: dict[PageConnection, None] = {}  # oldest first

    def __len__(self) -> int:
        return len(self._pages)

    @property
    def waiting(self) -> int:
        """The most bytes that wait for a page."""
        return max(map(_waiting, self._pages), default=0)

    def arrived(self, connection: PageConnection) -> None:
        """Count a stranger; the oldest of too many is dropped."""
        self._strangers[connection] = None
        if len(self._strangers) > STRANGERS:
            oldest = next(iter(self._strangers))
            del self._strangers[oldest]
            oldest.transport.abort()

    def forget(self, connection: PageConnection) -> None:
        """Count a connection as a stranger no more: it is a page, or over."""
        self._strangers.pop(connection, None)

    async def serve(self, port: int) -> int:
        """Listen on this machine; the port, which the system chooses if it is 0. Raises `Refused`."""
        quiet = logging.getLogger("teleop.page")
        quiet.addHandler(logging.NullHandler())
        quiet.propagate = False  # whatever a stranger sends is no line on this terminal
        connection = type("PageConnection", (PageConnection,), {"clients": self})
        try:
            self._server = await serve(
                self._open, HOST, port, process_request=self._request, compression=None, max_size=LONGEST,
                max_queue=16, write_limit=BEHIND, open_timeout=STRANGE, close_timeout=LEAVE, ping_interval=10.0,
                ping_timeout=10.0, server_header=None, logger=quiet, create_connection=connection, backlog=ACCEPTED)
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

    def _tell(self, page: PageConnection, text: str) -> None:
        if _waiting(page) > LOST:
            page.transport.abort()
        else:
            broadcast([page], text)

    def _request(self, connection: ServerConnection, request: Request) -> Response | None:
        assert isinstance(connection, PageConnection)
        names = ("Host", "Origin") if connection.heads else ("Host", "Origin", "Upgrade")
        headers = {name: request.headers.get_all(name)[-1] if len(request.headers.get_all(name)) == 1 else ""
                   for name in names if name in request.headers}
        answer = self._requests.answer(request.path, headers)
        return None if answer is None else _response(*answer, without_body=connection.heads)

    async def _open(self, page: ServerConnection) -> None:
        assert isinstance(page, PageConnection)
        self.forget(page)
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

    async def _hear(self, page: PageConnection) -> None:
        allowed = page.allowed
        async for data in page:
            if not allowed.takes(self.now()):
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


def _response(status: HTTPStatus, headers: dict[str, str], body: bytes, *, without_body: bool = False) -> Response:
    return Response(status.value, status.phrase, Headers({
        **headers, "Content-Length": str(len(body)), "Connection": "close"}), b"" if without_body else body)
