"""A process that this one starts and watches: its events are lines of JSON, and so are the orders that it takes."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any

from teleop.errors import Refused
from teleop.scene.library import ROOT

START_TIMEOUT = 15.0  # s for a process to come up
LONGEST_LINE = 1 << 20  # bytes of an event; a longer line is a scene's own print
STDERR_BYTES = 1 << 16  # bytes, the last ones, of what a process writes to its standard error
UNREAD = 1 << 16  # bytes of orders that a process has not read; what would come on top of it is dropped


Tell = Callable[[dict[str, Any]], None]


def arguments_of(scene: str, seed: int, knobs: Mapping[str, str], *, realtime: bool) -> list[str]:
    """Arguments that each of the three processes of a run is started with."""
    options = [scene, "--seed", str(seed)]
    for key, value in knobs.items():
        options += ["--link", value] if key == "link" else ["--set", f"{key}={value}"]
    return options if realtime else [*options, "--no-realtime"]


class Child:
    """Child process that is watched; its orders, if it takes any, are lines of JSON on its standard input."""

    def __init__(self, name: str, process: asyncio.subprocess.Process) -> None:
        self.name, self.process = name, process
        self.listening: asyncio.Future[int] = asyncio.get_running_loop().create_future()
        self.listening.add_done_callback(lambda port: port.exception())  # there may be no task left that waits for it
        self.done: dict[str, Any] | None = None
        self.realtime: dict[str, str] | None = None  # what the system gave it

    @classmethod
    async def start(cls, name: str, arguments: Sequence[str], *, orders: bool = False,
                    program: Sequence[str] = ()) -> Child:
        """Start `python -m name arguments`, found beside this package whatever the current folder holds.

        `orders`: it takes orders. `program`: what is started in place of `python -m`, with the name as its argument.
        """
        path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
        process = await asyncio.create_subprocess_exec(
            *(program or (sys.executable, "-P", "-m")), name, *arguments, "--json",
            stdin=asyncio.subprocess.PIPE if orders else asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE, env={**os.environ, "PYTHONPATH": path},
            limit=LONGEST_LINE, start_new_session=True,  # Ctrl-C reaches them through us, once
            preexec_fn=_die_with_parent,
        )
        return cls(name, process)

    async def watch(self, tell: Tell) -> tuple[int, str]:
        """Read its events until it ends, and `tell` them; its exit code and its last output on stderr."""
        assert self.process.stdout is not None
        assert self.process.stderr is not None
        trouble = asyncio.create_task(_last_of(self.process.stderr))
        async for line in _lines(self.process.stdout):
            event = _event(line)
            if event["event"] == "listening" and not self.listening.done():
                self.realtime = event["realtime"]
                self.listening.set_result(event["port"])
            elif event["event"] == "done":
                self.done = event["summary"]
            elif event["event"] is not None:
                tell(event)
        errors = (await trouble).decode(errors="replace").strip()
        code = await self.process.wait()
        if not self.listening.done():
            self.listening.set_exception(self.failed(code, errors))
        return code, errors

    def order(self, order: Mapping[str, Any]) -> None:
        """Write an order. One that it does not take, having ended or standing still, is dropped."""
        to = self.process.stdin
        if to is None or to.is_closing() or self.process.returncode is not None:
            return
        if to.transport.get_write_buffer_size() < UNREAD:
            to.write(json.dumps(order).encode() + b"\n")

    async def port(self) -> int:
        """The port that it listens on, as soon as it does. Raises `Refused` if it never does."""
        try:
            return await asyncio.wait_for(asyncio.shield(self.listening), START_TIMEOUT)
        except TimeoutError:
            raise Refused(f"the {self.name} did not come up in {START_TIMEOUT:g} s; give this machine some rest, and "
                          "try again") from None

    def failed(self, code: int, errors: str) -> Refused:
        """Refusal that says why it ended with `code`; `errors`: its last output on stderr."""
        how = f"was ended by the signal {_signal(-code)}" if code < 0 else f"ended with exit code {code}"
        return Refused(errors.removeprefix("teleop: ") or f"the {self.name} {how} and no word")

    def interrupt(self, name: str = "SIGTERM") -> None:
        """Ask it to stop cleanly, with the signal that asked us."""
        if self.process.returncode is None:
            self.process.send_signal(getattr(signal, name, signal.SIGTERM))


def _signal(number: int) -> str:
    """Name of a signal, or its number where it has none."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return str(number)


async def _lines(stream: asyncio.StreamReader) -> AsyncIterator[bytes]:
    """The lines of a stream, without those longer than `LONGEST_LINE`."""
    while True:
        try:
            line = await stream.readline()
        except ValueError:  # too long, and thrown away
            continue
        if not line:
            return
        yield line


async def _last_of(stream: asyncio.StreamReader) -> bytes:
    """The last `STDERR_BYTES` bytes of a stream, which is read to its end."""
    last = b""
    while part := await stream.read(STDERR_BYTES):
        last = (last + part)[-STDERR_BYTES:]
    return last


def _event(line: bytes) -> dict[str, Any]:
    """The event in a line; a scene's own prints are none."""
    try:
        event = json.loads(line)
    except ValueError:
        event = None
    return event if isinstance(event, dict) and "event" in event else {"event": None}


def _die_with_parent() -> None:
    """Have the system end this process, cleanly, should the demo be killed; only Linux can."""
    import ctypes

    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(1, signal.SIGTERM)  # PR_SET_PDEATHSIG
