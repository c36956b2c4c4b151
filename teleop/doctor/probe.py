"""`python -m teleop.doctor.probe`: what this machine gives a live end, measured in a process like one; JSON on stdout.

The timer is that of an end, without its work: first as all processes are scheduled, then with real-time
scheduling where the system gives it. The datagrams go over loopback, through the sockets of an end.
"""

from __future__ import annotations

import json
import socket
import time
from typing import Any

from teleop.live.net.wire import ROOM, STAMP, Wire
from teleop.live.process.realtime import ask
from teleop.live.process.ticker import Alarm
from teleop.live.records.end_result import lateness, spread_us

DT_NS = 1_000_000  # the tick of every scene that comes with the package
TICKS = 900  # of each measurement of the timer
TRIPS = 3000  # round trips
MOST = 4000  # datagrams that are sent to see how many the receive buffer holds
SIZE = 100  # bytes of a datagram, as those of a law in one axis
GIVE_UP_NS = 50_000_000  # after which a datagram over loopback is lost


def timer() -> dict[str, Any]:
    """Tell how late the ticks of a second are, us; `left_out`: those that never ran, as the next was due by then."""
    ran: list[int] = []
    late: list[float] = []
    start_ns = time.monotonic_ns() + 5 * DT_NS
    alarm = Alarm()
    alarm.set(start_ns, DT_NS)
    while not ran or ran[-1] < TICKS - 1:
        alarm.wait()
        since = time.monotonic_ns() - start_ns
        ran.append(since // DT_NS)
        late.append(float(since % DT_NS))
    return {"ticks": ran[-1] + 1, "left_out": ran[-1] + 1 - len(ran), "late_us": spread_us(lateness(ran, late, DT_NS))}


def loopback() -> dict[str, Any]:
    """Round trips between two sockets of this process (us), how many were lost, and what the receive buffer holds."""
    wire, peer = _wire(), _wire()
    try:
        wire.peer, peer.peer = peer.sock.getsockname(), wire.sock.getsockname()
        data, trips, lost = bytes(SIZE), [], 0
        for _ in range(TRIPS):
            began = time.monotonic_ns()
            wire.send(data)
            if _arrives(peer, began):
                peer.send(data)
            if _arrives(wire, began):
                trips.append(float(time.monotonic_ns() - began))
            else:
                lost += 1
        wire.send(data)
        stamps = any(kind == STAMP for _, kind, _ in _ancillary_data(peer.sock))
        for _ in range(MOST):
            wire.send(data)
        held = 0
        while peer.receive() is not None:
            held += 1
        return {"sent": TRIPS, "lost": lost, "round_trip_us": spread_us(trips), "stamps": stamps,
                "buffer": {"asked": ROOM, "given": peer.sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF),
                           "holds": held, "of": MOST}}
    finally:
        wire.sock.close()
        peer.sock.close()


def _wire() -> Wire:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.bind(("127.0.0.1", 0))
    return Wire(sock, None)


def _arrives(wire: Wire, began: int) -> bool:
    """True if a datagram comes before it counts as lost."""
    while wire.receive() is None:
        if time.monotonic_ns() - began > GIVE_UP_NS:
            return False
    return True


def _ancillary_data(sock: socket.socket) -> list[Any]:
    """Ancillary data that the kernel gives with a datagram."""
    try:
        return sock.recvmsg(SIZE, 64)[1]
    except OSError:  # it did not come
        return []


def measure() -> dict[str, Any]:
    """Measure all of it, as JSON can hold it; where the loopback failed, its `error`."""
    ordinary, first = timer(), None
    try:
        over = loopback()
    except OSError as error:
        over = {"error": error.strerror or str(error)}
    granted = ask()
    if granted.priority is not None:
        first = timer()
    return {"scheduler": granted.scheduler, "memory": granted.memory, "ordinary": ordinary, "realtime": first,
            "loopback": over}


if __name__ == "__main__":
    print(json.dumps(measure()))
