"""Replay of a live run as a link: what became of each message of the law, in both directions."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from hashlib import sha256
from os import PathLike, fspath
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from channel.effect import LONGEST, Effect
from channel.rng import Ints, Rng
from channel.schedule import by_time, nanoseconds
from teleop.errors import Refused
from teleop.knob import Knob
from teleop.live.records.end_result import NAMES
from teleop.live.records.inputs import ARRIVALS, ArrivalTable, read_arrivals
from teleop.live.records.reader import FILE, read_record
from teleop.live.records.record import check_one_run
from teleop.simulation.trace import far_apart
from teleop.storage.folder import is_being_written

DIGITS = 12  # of a digest


class Way(NamedTuple):
    """Direction of a run: the fate of the messages that were sent in consecutive spans of time, from 0 on."""

    span_ns: int  # of each: the sender's tick
    first: Ints  # (spans + 1,): where in `delay` those of each span begin
    delay: Ints  # ns from the span's beginning to when the receiver's tick could take it; copies too


class Ticks(NamedTuple):
    """The ticks of one end in the run."""

    span_ns: int  # of each
    ran: NDArray[np.bool_]  # was it run, for each from 0 to the last of either end


@dataclass(frozen=True, slots=True)
class RecordedTicks:
    """The ticks of `dt_ns` that an end leaves out: those whose time fell into one that it left out in the run.

    Behind the last tick of the run it begins again from tick 0. `ran`: a byte for each tick of the run.
    """

    span_ns: int
    dt_ns: int
    ran: bytes

    def left_out(self, end: int, count: int, seed: int) -> NDArray[np.bool_]:
        """For each of the ticks 0 .. count-1, is it left out. (count,)"""
        ran = np.frombuffer(self.ran, np.bool_)
        at = np.arange(count, dtype=np.int64) * self.dt_ns // self.span_ns
        out: NDArray[np.bool_] = ~ran[at % len(ran)]
        return out


@dataclass(frozen=True, slots=True)
class Recorded(Effect):
    """The link that a live run had: a packet meets what the message met that was sent at its time.

    `path` is the folder of a demo, or that of a master, with its slave's as `slave`. A packet that enters at t has the
    fate of the message of the tick in which t falls: lost, or as late as that one was taken, copies too. So a scene
    with the run's own tick has its arrivals tick by tick, and one with another tick the same delays and gaps in time.
    Behind the run's last tick it begins again from tick 0. A message that was read too late for its tick counts from
    the tick that could take it. With `left_out` the ends of the scene leave out the ticks that they left out in the
    run. `digest`: the first digits of the SHA-256 of what is replayed; given, it has to be that.
    Refused: a folder without the record of both ends, or of a run that goes on or was stepped (--lockstep).
    """

    path: Annotated[str, Knob("", "folder of a demo, or of a live master")]
    slave: Annotated[str, Knob("", "folder of the slave, where path is its master's")] = ""
    left_out: Annotated[bool, Knob("", "do the ends leave out the ticks that they left out in the run")] = True
    digest: Annotated[str, Knob("", "first digits of the SHA-256 of what is replayed; left out: any")] = ""
    _ways: tuple[Way, Way] = field(init=False, repr=False, compare=False)
    _ticks: tuple[Ticks, Ticks] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        for name in ("path", "slave"):
            value: object = getattr(self, name)
            if not isinstance(value, str | PathLike) or (name == "path" and not fspath(value)):
                raise Refused(f"{name} must name the folder of a live run, not {value!r}; write for example "
                              "recorded('runs/hard_wall-1')")
            object.__setattr__(self, name, fspath(value))
        if not isinstance(self.left_out, bool):
            raise Refused(f"left_out must be True or False, not {self.left_out!r}; write for example left_out=False")
        ways, ticks, digest = read(*folders_of(Path(self.path), Path(self.slave) if self.slave else None))
        if self.digest not in ("", digest):
            raise Refused(f"what {self.path} holds has the digest {digest}, not {self.digest!r}: its run was another; "
                          "give the folder of that run, or leave digest out")
        object.__setattr__(self, "digest", digest)
        object.__setattr__(self, "_ways", ways)
        object.__setattr__(self, "_ticks", ticks)

    def begin(self, rng: Rng) -> int:
        """The direction is all of its state."""
        return rng.direction

    def leaves_out(self, end: int, dt_ns: int) -> RecordedTicks | None:
        """Ticks of dt_ns whose time fell into a tick that the end skipped."""
        ticks = self._ticks[end]
        if not self.left_out or ticks.ran.all():
            return None
        return RecordedTicks(ticks.span_ns, dt_ns, ticks.ran.tobytes())

    def carry(self, state: int, packet: Ints, time_ns: Ints, size: int) -> tuple[Ints, Ints, int]:
        """The packets whose message came, as often as it came, and as late after they entered."""
        way = self._ways[state]
        at = time_ns // way.span_ns % (len(way.first) - 1)
        often = way.first[at + 1] - way.first[at]
        which = np.repeat(way.first[at] - np.cumsum(often) + often, often) + np.arange(often.sum())
        return *by_time(np.repeat(packet, often), np.repeat(time_ns, often) + way.delay[which]), state


def folders_of(path: Path, slave: Path | None) -> tuple[Path, Path]:
    """The folders of master and slave. Raises `Refused`."""
    if slave is not None:
        return path, slave
    if (path / FILE).is_file():
        raise Refused(f"{path} is the folder of one end, which has the arrivals of one direction; give a demo's, or "
                      "both ends' own: recorded('MASTER', 'SLAVE')")
    if not all((path / name / FILE).is_file() for name in NAMES.values()):
        raise Refused(f"{path} is no folder of a live run: there is no record of its master and its slave; give the "
                      "one that `teleop demo` printed, or both ends' own: recorded('MASTER', 'SLAVE')")
    return path / "master", path / "slave"


def read(master: Path, slave: Path) -> tuple[tuple[Way, Way], tuple[Ticks, Ticks], str]:
    """Both directions, fwd and bwd; the ticks of master and slave; the digest of it all. Raises `Refused`."""
    for folder in (master, slave):
        if is_being_written(folder):
            raise Refused(f"the run in {folder} goes on; replay it when it is over")
    stamps = tuple([_stamp(folder / name) for folder in (master, slave) for name in (FILE, ARRIVALS)])
    return _read(master, slave, stamps)


def _stamp(path: Path) -> tuple[int, ...]:
    """Stamp of a file, which changes when the file does: in a sweep each row makes the link anew."""
    try:
        status = path.stat(follow_symlinks=False)
    except OSError:  # the reader of it says why
        return ()
    return status.st_ino, status.st_size, status.st_mtime_ns


@lru_cache(maxsize=4)
def _read(master: Path, slave: Path, stamps: tuple[tuple[int, ...], ...]  # noqa: ARG001 - a key alone
          ) -> tuple[tuple[Way, Way], tuple[Ticks, Ticks], str]:
    headers: dict[str, dict[str, Any]] = {}
    ticks, arrivals = {}, {}
    for e, folder in (("m", master), ("s", slave)):
        headers[e], record, _ = read_record(folder)
        if headers[e]["mode"] == "lockstep":
            raise Refused(f"the run in {folder} went by packets (--lockstep), over a link that was drawn up front; "
                          "give that link by --link, or record a run by the clock")
        ticks[e], arrivals[e] = np.asarray(record.ticks, np.int64), read_arrivals(folder)
        if arrivals[e].header["dt_ns"] != headers[e]["dt_ns"] or not len(ticks[e]):
            raise Refused(f"{folder} holds no ticks with the arrivals beside them; give the folder as the end wrote it")
        if far_apart(record.ticks):
            raise Refused(f"the ticks in {folder} lie too far apart for a link; give the folder of a run that ran on")
    check_one_run({"m": master, "s": slave}, headers, ("scene", "knobs", "dt_ns"))
    dt_ns, every = headers["m"]["dt_ns"], {e: header.get("every", 1) for e, header in headers.items()}
    last = int(max(ticks["m"][-1], ticks["s"][-1]))  # an end that was over sooner skips all that follow
    ways = (way(dt_ns, every["m"], last, ticks["s"], arrivals["s"]),
            way(dt_ns, every["s"], last, ticks["m"], arrivals["m"]))
    ran = (_ran(dt_ns, every["m"], ticks["m"], last), _ran(dt_ns, every["s"], ticks["s"], last))
    return ways, ran, digest_of(ways, ran)


def _ran(dt_ns: int, every: int, ticks: Ints, last: int) -> Ticks:
    ran = np.zeros(last // every + 1, np.bool_)
    ran[ticks // every] = True
    return Ticks(every * dt_ns, ran)


def way(dt_ns: int, every: int, last: int, took: Ints, arrivals: ArrivalTable) -> Way:
    """Make one direction of a run whose last tick was `last`, from the receiver's ticks (n,) and its arrivals.

    What became of the last messages is not known: none came of those sent within the longest delay before the
    receiver's end. They have the fate of the first ones of the run, but come no sooner than behind that end.
    """
    span_ns, spans = every * dt_ns, last // every + 1
    packet = arrivals.packet // every
    in_time = -(-arrivals.time_ns // dt_ns) == arrivals.tick
    taken = np.where(in_time, arrivals.time_ns, (arrivals.tick - 1) * dt_ns + 1)
    delay = np.clip(taken - packet * span_ns, 0, nanoseconds(LONGEST))
    over_ns = int(took[-1]) * dt_ns
    known = (over_ns - int(delay.max(initial=0))) // span_ns
    known = min(max(known, int(packet.max(initial=-1)) + 1), spans)
    packet, delay = (each[np.lexsort((delay, packet))] for each in (packet, delay))
    tail = np.arange(known, spans if known > 0 else 0)
    which = np.searchsorted(packet, (tail - known) % max(known, 1))  # one of each is enough
    came_then = np.append(packet, -1)[which] == (tail - known) % max(known, 1)
    tail, which = tail[came_then], which[came_then]
    first = np.searchsorted(packet, np.arange(known + 1))
    packet = np.append(packet[: first[-1]], tail)
    delay = np.append(delay[: first[-1]], np.maximum(delay[which], over_ns + 1 - tail * span_ns))
    return Way(span_ns, np.searchsorted(packet, np.arange(spans + 1)).astype(np.int64), delay)


def digest_of(ways: tuple[Way, Way], ticks: tuple[Ticks, Ticks]) -> str:
    """The first digits of the SHA-256 of what is replayed."""
    digest = sha256()
    for way in ways:
        for part in (np.array([way.span_ns]), way.first, way.delay):
            digest.update(np.ascontiguousarray(part, "<i8").tobytes())
    for one in ticks:
        digest.update(one.ran.tobytes())
    return digest.hexdigest()[:DIGITS]
