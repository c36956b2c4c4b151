"""What a relay that is called by hand has in place of its sockets."""

from __future__ import annotations


class NoSocket:
    """In place of a socket that nothing goes through."""

    def fileno(self) -> int:
        return -1

    def close(self) -> None:
        """Nothing to close."""


class NoWire:
    """A wire as far as a relay that is called by hand needs one. `answers`: what was sent, and where to."""

    def __init__(self, peer: tuple[str, int] | None) -> None:
        self.peer, self.sock = peer, NoSocket()
        self.answers: list[tuple[tuple[str, int], bytes]] = []
        self.closed = False

    def answer(self, data: bytes, address: tuple[str, int]) -> None:
        self.answers.append((address, data))
