"""What a relay that is called by hand has in place of its sockets."""

from __future__ import annotations


class NoSocket:
    """In place of a socket that nothing goes through."""

    def fileno(self) -> int:
        return -1


class NoWire:
    """A wire as far as a relay that is called by hand needs one."""

    def __init__(self, peer: tuple[str, int] | None) -> None:
        self.peer, self.sock = peer, NoSocket()
