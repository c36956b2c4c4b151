"""Server of the page and its socket, on this machine alone: who may connect, what a page may send, and how much."""

from __future__ import annotations

import asyncio
import json
import logging
import re
from base64 import b64encode
from collections.abc import Callable, Mapping, Sequence
from hashlib import sha256
from hmac import compare_digest, new
from http import HTTPStatus
from typing import Any, NamedTuple, Protocol
from urllib.parse import parse_qs, urlsplit

from websockets.asyncio.server import Server, ServerConnection, broadcast, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.frames import Frame, Opcode
from websockets.http11 import Request, Response

from teleop.errors import Refused, number_of
from teleop.scene.axes import MOST_AXES
from teleop.storage.strict_json import Check, Misshapen, list_of, optional, parse, real, record, text, truth

METHODS = ("GET", "HEAD")
HOST = "127.0.0.1"  # where the page listens
_HOST = re.compile(r"(127\.0\.0\.1|localhost|\[::1\])(:\d{1,5})?", re.IGNORECASE)
_NONCE = re.compile(r"[0-9a-f]{32}")
_INLINE = {"script-src": re.compile(rb"<script[^>]*>(.*?)</script>", re.DOTALL),
           "style-src": re.compile(rb"<style[^>]*>(.*?)</style>", re.DOTALL)}


class HttpResponse(NamedTuple):
    """Response over HTTP."""

    status: HTTPStatus
    headers: dict[str, str]
    body: bytes


class Requests:
    """Rules for requests: the page is at `/`, its socket at `/ws`, both with the token of the printed address.

    A page that comes back after its socket was closed asks `/proof` first: only a server that knows the token can
    answer. Whoever else listens at the port by then, of the users of this machine, is not sent the token.

    Only a browser on this machine may ask, or one behind `ssh -L`, whose port may differ. So the host must be a name of
    this machine, which a page of another site cannot have (DNS rebinding), and a socket must be opened by a page of the
    same host and port. `page`: the only file served. `token`: a part of its address.
    """

    def __init__(self, page: bytes, token: str) -> None:
        self._page, self._token = page, token.encode()
        self._sources = "; ".join(f"{kind} {' '.join(map(_hash, form.findall(page))) or chr(39) + 'none' + chr(39)}"
                                  for kind, form in _INLINE.items())

    def answer(self, target: str, headers: Mapping[str, str]) -> HttpResponse | None:
        """Answer a GET of `target`; None: the socket may be opened. Each name in `headers` has one value."""
        host = headers.get("Host", "")
        if not _HOST.fullmatch(host):
            return _sentence(HTTPStatus.FORBIDDEN, "this page is for this machine alone; open the address that "
                                                   "was printed, from elsewhere through ssh -L")
        try:
            url = urlsplit(target)
            query = parse_qs(url.query, max_num_fields=10)
        except ValueError:
            return _sentence(HTTPStatus.BAD_REQUEST, "this is no address; open the one that was printed")
        token, nonce = (query.get(name, [""])[-1] for name in ("token", "nonce"))
        if url.path == "/proof" and _NONCE.fullmatch(nonce):
            return _text(HTTPStatus.OK, new(self._token, f"proof {nonce}".encode(), sha256).hexdigest())
        if url.path not in ("/", "/ws"):
            return _sentence(HTTPStatus.NOT_FOUND, "there is nothing here but the page; open the address printed")
        if not compare_digest(token.encode(errors="surrogatepass"), self._token):
            return _sentence(HTTPStatus.FORBIDDEN, "the token is missing, or of another run; open the whole address "
                                                   "that was printed")
        if url.path == "/":
            return HttpResponse(HTTPStatus.OK, self._headers(host), self._page)
        if headers.get("Origin") != f"http://{host}":
            return _sentence(HTTPStatus.FORBIDDEN, "the socket is for the page that is served here alone")
        if headers.get("Upgrade", "").lower() != "websocket":
            return _sentence(HTTPStatus.UPGRADE_REQUIRED, "this is the page's socket, for a browser that has WebSocket")
        return None

    @staticmethod
    def refuse_method() -> HttpResponse:
        """Answer a request of another method."""
        answer = _sentence(HTTPStatus.METHOD_NOT_ALLOWED, "the page is there to be read; take GET or HEAD")
        return answer._replace(headers={**answer.headers, "Allow": ", ".join(METHODS)})

    def _headers(self, host: str) -> dict[str, str]:
        socket = "'self'" if host.startswith("[") else f"'self' ws://{host}"  # a policy has no word for [::1]
        policy = (f"default-src 'none'; {self._sources}; connect-src {socket}; img-src data:; base-uri 'none'; "
                  "form-action 'none'; frame-ancestors 'none'")
        return {"Content-Type": "text/html; charset=utf-8", "Content-Security-Policy": policy, **_ALWAYS}


_ALWAYS = {"X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer", "Cache-Control": "no-store",
           "Cross-Origin-Resource-Policy": "same-origin"}


def _text(status: HTTPStatus, text: str) -> HttpResponse:
    return HttpResponse(status, {"Content-Type": "text/plain; charset=utf-8", **_ALWAYS}, text.encode())


def _sentence(status: HTTPStatus, sentence: str) -> HttpResponse:
    return _text(status, f"{sentence}\n")


def _hash(inline: bytes) -> str:
    return f"'sha256-{b64encode(sha256(inline).digest()).decode()}'"


LONGEST = 4096  # bytes of a message
REACH = 10.0  # m from 0, in each axis: `master.steered` goes no further
SLIDERS = ("delay", "jitter", "loss", "k_e")

class MessageShape(NamedTuple):
    """Shape of a page's message: its fields, and those that it must have."""

    fields: Mapping[str, Check] = {}
    needed: Sequence[str] = ()


HAND = MessageShape({"to": optional(list_of(real, most=MOST_AXES))}, ("to",))
SHAPES = {
    "hand": HAND,
    "turn": MessageShape({"law": text, **dict.fromkeys(SLIDERS, real)}),
    "clutch": MessageShape({"open": truth}, ("open",)),
    "scale": MessageShape({"to": real}, ("to",)),
    "policy": MessageShape({"takes": truth}, ("takes",)),
    "again": MessageShape(),
}


class Garbage(Misshapen):
    """Refusal of data that are no message of a page. `kind`: the mistake in a word, so that each is reported once."""

    def __init__(self, kind: str, sentence: str) -> None:
        super().__init__(sentence)
        self.kind = kind


def read(data: str | bytes, shapes: Mapping[str, MessageShape] = SHAPES) -> dict[str, Any]:
    """Read the message in `data`, of one of these shapes by its type. Raises `Garbage`."""
    if isinstance(data, bytes):
        raise Garbage("binary", "a message is a text in JSON, not bytes")
    try:
        message = parse(data)
    except Misshapen as error:
        raise Garbage("json", f"a message is an object in JSON: {error}") from None
    kind = message.get("type") if isinstance(message, dict) else None
    if not isinstance(kind, str) or kind not in shapes:
        raise Garbage("type", f"a message has a type, one of {', '.join(shapes)}")
    shape, needed = shapes[kind]
    unknown = next((key for key in message if key != "type" and key not in shape), None)
    if unknown is not None:
        raise Garbage(kind, f"a message {kind!r} has no {unknown[:40]!r}; it may have: {', '.join(shape) or 'nothing'}")
    try:
        record({key: shape[key] for key in needed}, shape)(message, "the message")
    except Misshapen as error:
        raise Garbage(kind, str(error)) from None
    return message  # type: ignore[no-any-return]  # an object, as its shape says


def hand_position(to: Sequence[float], axes: int) -> tuple[float, ...]:
    """Check a position (m, per axis) to which a page moves the hand. Raises `Garbage`."""
    if len(to) != axes or not all(abs(x) <= REACH for x in to):
        raise Garbage("place", f"the hand goes to {number_of(axes, 'number')} in m, each at most {REACH:g} from 0")
    return tuple(map(float, to))


def sentence_message(level: str, sentence: str) -> str:
    """Write the message with a sentence for people; `level`: info, warn or error."""
    return json.dumps({"type": "said", "level": level, "text": sentence})


MOST = 200  # messages a second
SECONDS = 5  # that a page may go on beyond it, one after the other
GARBAGE = 20  # messages that are none, and the page is closed


class Allowance:
    """Allowance of one page: 200 messages a second, and few that no page would send. Times are in s."""

    def __init__(self) -> None:
        self.dropped = 0  # messages beyond `MOST`
        self._since: float | None = None  # when this second began
        self._count = 0  # in this second
        self._beyond = 0  # seconds, one after the other, in which there were too many
        self._kinds: set[str] = set()  # of garbage
        self._garbage = 0

    def takes(self, now: float) -> bool:
        """Count a message; True if there is room for it."""
        if self._since is None or now - self._since >= 1.0:
            follows = self._since is not None and now - self._since < 2.0
            self._beyond = self._beyond + 1 if follows and self._count > MOST else 0
            self._since, self._count = now, 0
        self._count += 1
        if self._count > MOST:
            self.dropped += 1
            return False
        return True

    @property
    def begins(self) -> bool:
        """True at the first message without room: a page is warned once, however long it goes on."""
        return self.dropped == 1

    @property
    def floods(self) -> bool:
        """True if the page has sent too much for `SECONDS`."""
        return self._beyond >= SECONDS

    def garbage(self, kind: str) -> bool:
        """Count a message that is none; True if it is the first of its kind."""
        self._garbage += 1
        first = kind not in self._kinds
        self._kinds.add(kind)
        return first

    @property
    def talks_nonsense(self) -> bool:
        """True if the page has sent too much garbage."""
        return self._garbage >= GARBAGE


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
    """Session behind the server, which gives and takes messages. `page`: one page, the same while it is open."""

    def greeting(self) -> list[str]:
        """The messages for a page that has just been opened."""
        ...

    def hear(self, page: ServerConnection, message: dict[str, Any]) -> None:
        """Take a message of a page, of a right shape. Raises `Garbage` or `Refused`."""
        ...

    def forget(self, page: ServerConnection) -> None:
        """Forget a page that was closed."""
        ...


class PageConnection(ServerConnection):
    """A connection, from its first byte on: a method that is answered, and frames that a page may send."""

    clients: Clients  # set by the class that `Clients` makes

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin, as a stranger."""
        super().connection_made(transport)
        self.allowed, self.heads = Allowance(), False
        self._method: bytes | None = b""  # so far; None: it is known
        self._deaf = False  # further bytes are dropped
        self.clients.add_stranger(self)

    def connection_lost(self, exc: Exception | None) -> None:
        """End."""
        self.clients.forget(self)
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Take bytes, some at a time, since the first of many frames may end the connection."""
        if self._method is not None:
            data = self._after_method(data)
        for start in range(0, len(data), PIECE):
            if self._deaf:
                return
            super().data_received(data[start:start + PIECE])

    def process_event(self, event: Any) -> None:
        """Take a frame. A part of a message or a control frame, of which a page sends none, counts as a message."""
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
        """Return the bytes of a GET request; a request of another method is answered here, and no bytes remain."""
        assert self._method is not None
        self._method += data
        method, blank, _ = self._method[:LONGEST_METHOD].partition(b" ")
        if not blank and len(self._method) < LONGEST_METHOD and b"\n" not in self._method:
            return b""
        data, self._method = self._method, None
        self.heads = method == b"HEAD"
        if method.replace(b"-", b"x").isalpha() and method.decode() not in METHODS:  # or the head of a longer one
            self._deaf = True
            self.transport.write(_response(*Requests.refuse_method()).serialize())
            self.transport.write_eof()
            return b""
        return b"GET" + data[len(method):] if self.heads else data


class Clients:
    """Server of the page, with a socket for each page that is open. `now`: the clock, s.

    A message to all pages is made once. A page that reads too slowly loses pictures, never the others; its backlog is
    bounded. One that sends too much, or nonsense, is warned, and then closed. A connection without the token is one of
    at most `STRANGERS`, and for `STRANGE` seconds. `shapes`: of the messages of a page, each of at most `longest`
    bytes; `most`: pages at once.
    """

    def __init__(self, requests: Requests, host: Host, now: Callable[[], float], *,
                 shapes: Mapping[str, MessageShape] = SHAPES, longest: int = LONGEST, most: int = PAGES) -> None:
        self._requests, self._host, self.now = requests, host, now
        self._shapes, self._longest, self._most = shapes, longest, most
        self._server: Server | None = None
        self._pages: set[PageConnection] = set()
        self._strangers: dict[PageConnection, None] = {}  # oldest first

    def __len__(self) -> int:
        return len(self._pages)

    @property
    def waiting(self) -> int:
        """The most bytes that wait for a page."""
        return max(map(_waiting, self._pages), default=0)

    def add_stranger(self, connection: PageConnection) -> None:
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
        """Listen on this machine; return the port, which the system chooses if it is 0. Raises `Refused`."""
        quiet = logging.getLogger("teleop.page")
        quiet.addHandler(logging.NullHandler())
        quiet.propagate = False  # whatever a stranger sends is no line on this terminal
        connection = type("PageConnection", (PageConnection,), {"clients": self})
        try:
            self._server = await serve(
                self._open, HOST, port, process_request=self._request, compression=None, max_size=self._longest,
                max_queue=16, write_limit=BEHIND, open_timeout=STRANGE, close_timeout=LEAVE, ping_interval=10.0,
                ping_timeout=10.0, server_header=None, logger=quiet, create_connection=connection, backlog=ACCEPTED)
        except (OSError, OverflowError) as error:
            why = getattr(error, "strerror", None) or error
            raise Refused(f"cannot listen on {HOST}:{port} ({why}); give another port with --port, or leave it out for "
                          "one that is free") from error
        bound: int = self._server.sockets[0].getsockname()[1]
        return bound

    async def close(self, why: str) -> None:
        """Close all pages, and listen no more."""
        if self._server is not None:
            await asyncio.gather(*[page.close(AWAY, why) for page in self._pages])
            self._server.close()
            await self._server.wait_closed()

    def show(self, text: str) -> None:
        """Send all pages a picture; a page that is behind gets none."""
        broadcast([page for page in self._pages if _waiting(page) < BEHIND], text)

    def tell(self, text: str) -> None:
        """Send all pages a message that none may miss; a page that is lost is given up."""
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
        if len(self._pages) >= self._most:
            await page.close(FULL, f"{number_of(self._most, 'page is', 'pages are')} open already; close one of them")
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
            self._host.forget(page)

    async def _hear(self, page: PageConnection) -> None:
        allowed = page.allowed
        async for data in page:
            if not allowed.takes(self.now()):
                if allowed.begins:
                    self._tell(page, sentence_message(
                        "warn", f"this page says more than {MOST} messages a second; the rest is dropped"))
                if allowed.floods:
                    await page.close(POLICY, f"more than {MOST} messages a second, for {SECONDS} s")
                    return
                await asyncio.sleep(SLOWER)
                continue
            try:
                self._host.hear(page, read(data, self._shapes))
            except Garbage as garbage:
                if allowed.garbage(garbage.kind):
                    self._tell(page, sentence_message("error", f"not understood: {garbage}"))
                if allowed.talks_nonsense:
                    await page.close(POLICY, f"{GARBAGE} messages that are none")
                    return
            except Refused as refused:
                self._tell(page, sentence_message("error", str(refused)))


def _waiting(page: ServerConnection) -> int:
    """Bytes that the page has not taken yet, beyond what the system holds for it."""
    return page.transport.get_write_buffer_size()


def _response(status: HTTPStatus, headers: dict[str, str], body: bytes, *, without_body: bool = False) -> Response:
    return Response(status.value, status.phrase, Headers({
        **headers, "Content-Length": str(len(body)), "Connection": "close"}), b"" if without_body else body)
