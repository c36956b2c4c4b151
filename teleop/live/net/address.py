"""Addresses as people type them, and the sockets behind them."""

from __future__ import annotations

import socket

from teleop.errors import Refused

Address = tuple[str, int]


def address(text: str, option: str) -> Address:
    """`HOST:PORT` (or `:PORT`, meaning loopback) resolved to an IPv4 address and a port. Raises `Refused`."""
    host, colon, port = text.rpartition(":")
    if not colon or not port.isdecimal() or int(port) > 65535:
        raise Refused(f"{option} takes HOST:PORT, not {text!r}; write for example {option} 127.0.0.1:9001")
    try:
        found = socket.getaddrinfo(host or "127.0.0.1", int(port), socket.AF_INET, socket.SOCK_DGRAM)
    except (OSError, UnicodeError) as error:  # a name that cannot even be asked for is no OSError
        why = getattr(error, "strerror", None) or "it is no host's name"
        raise Refused(f"{option} names the host {host!r}, which is not known here ({why}); try its number") from error
    return str(found[0][4][0]), int(found[0][4][1])


def peer_address(text: str) -> Address:
    """The address of --peer, which has to be one that can be sent to. Raises `Refused`."""
    found = address(text, "--peer")
    if found[1] == 0:
        raise Refused("--peer needs the port that the other side listens on, not 0; for example --peer 127.0.0.1:9001")
    return found


def bound(at: Address, option: str) -> socket.socket:
    """A UDP socket bound to an address; port 0 takes any free one. Raises `Refused`."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        sock.bind(at)
    except OSError as error:
        sock.close()
        raise Refused(
            f"cannot listen on {at[0]}:{at[1]} ({error.strerror}); another program has that port, or the address is "
            f"not this machine's: give another with {option}, for example {option} {at[0]}:0 for any free one"
        ) from error
    return sock


def towards(peer: Address) -> socket.socket:
    """A UDP socket, on any free port, from which this peer can be reached."""
    return bound(("127.0.0.1" if peer[0].startswith("127.") else "0.0.0.0", 0), "--peer")


def shown(at: tuple[str, int]) -> str:
    """An address as it is typed."""
    return f"{at[0]}:{at[1]}"
