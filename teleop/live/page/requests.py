"""Who may ask for what: the page at `/`, its socket at `/ws`, both with the token of the address that was printed.

Only a browser on this machine, or behind `ssh -L`, whose port may be another: so the host must be a name of this
machine, which a page of another site cannot have (DNS rebinding), and a socket must be opened by a page of the same
host and port.
"""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import Mapping
from hashlib import sha256
from hmac import compare_digest
from http import HTTPStatus
from typing import NamedTuple
from urllib.parse import parse_qs, urlsplit

METHODS = ("GET", "HEAD")
HOST = "127.0.0.1"  # where the page listens
_HOST = re.compile(r"(127\.0\.0\.1|localhost|\[::1\])(:\d{1,5})?", re.IGNORECASE)
_INLINE = {"script-src": re.compile(rb"<script[^>]*>(.*?)</script>", re.DOTALL),
           "style-src": re.compile(rb"<style[^>]*>(.*?)</style>", re.DOTALL)}


class Answer(NamedTuple):
    """An answer over HTTP."""

    status: HTTPStatus
    headers: dict[str, str]
    body: bytes


class Requests:
    """`page`: the one file that there is. `token`: a part of its address."""

    def __init__(self, page: bytes, token: str) -> None:
        self._page, self._token = page, token.encode()
        self._sources = "; ".join(f"{kind} {' '.join(map(_hash, form.findall(page))) or chr(39) + 'none' + chr(39)}"
                                  for kind, form in _INLINE.items())

    def answer(self, target: str, headers: Mapping[str, str]) -> Answer | None:
        """The answer to a GET of `target`; None: the socket may be opened. Each name in `headers` has one value."""
        host = headers.get("Host", "")
        if not _HOST.fullmatch(host):
            return _sentence(HTTPStatus.FORBIDDEN, "this page is for this machine alone; open the address that "
                                                   "`teleop demo --page` printed, from elsewhere through ssh -L")
        try:
            asked = urlsplit(target)
            given = parse_qs(asked.query, max_num_fields=10).get("token", [""])[-1]
        except ValueError:
            return _sentence(HTTPStatus.BAD_REQUEST, "this is no address; open the one that was printed")
        if asked.path not in ("/", "/ws"):
            return _sentence(HTTPStatus.NOT_FOUND, "there is nothing here but the page; open the address printed")
        if not compare_digest(given.encode(errors="surrogatepass"), self._token):
            return _sentence(HTTPStatus.FORBIDDEN, "the token is missing, or of another run; open the whole address "
                                                   "that `teleop demo --page` printed")
        if asked.path == "/":
            return Answer(HTTPStatus.OK, self._headers(host), self._page)
        if headers.get("Origin") != f"http://{host}":
            return _sentence(HTTPStatus.FORBIDDEN, "the socket is for the page that is served here alone")
        if headers.get("Upgrade", "").lower() != "websocket":
            return _sentence(HTTPStatus.UPGRADE_REQUIRED, "this is the page's socket, for a browser that has WebSocket")
        return None

    @staticmethod
    def of_method() -> Answer:
        """The answer to a request of another method."""
        answer = _sentence(HTTPStatus.METHOD_NOT_ALLOWED, "the page is there to be read; take GET or HEAD")
        return answer._replace(headers={**answer.headers, "Allow": ", ".join(METHODS)})

    def _headers(self, host: str) -> dict[str, str]:
        socket = "'self'" if host.startswith("[") else f"'self' ws://{host}"  # a policy has no word for [::1]
        policy = (f"default-src 'none'; {self._sources}; connect-src {socket}; img-src data:; base-uri 'none'; "
                  "form-action 'none'; frame-ancestors 'none'")
        return {"Content-Type": "text/html; charset=utf-8", "Content-Security-Policy": policy, **_ALWAYS}


_ALWAYS = {"X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer", "Cache-Control": "no-store",
           "Cross-Origin-Resource-Policy": "same-origin"}


def _sentence(status: HTTPStatus, sentence: str) -> Answer:
    return Answer(status, {"Content-Type": "text/plain; charset=utf-8", **_ALWAYS}, f"{sentence}\n".encode())


def _hash(inline: bytes) -> str:
    return f"'sha256-{b64encode(sha256(inline).digest()).decode()}'"
