"""Coverage-guided fuzzing with atheris (libFuzzer): `python -m tests.fuzz.guided TARGET CORPUS [-runs=N ...]`.

Targets: `decode` (with `peek`), `session` (an end that meets and runs, its datagrams and its clock cut out of the
bytes), `link` (`records`, a gate, and both kinds of sealed link). The process is libFuzzer's: it ends with exit code 0
when all runs are done, otherwise it leaves the bytes that raised as `crash-...` in the folder it was called from, to be
given again in place of CORPUS.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from teleop.protocol.manifest import manifest_of

TARGETS = ("decode", "session", "link")
MS = 1_000_000


def cut(data: bytes) -> list[tuple[int, int, bytes]]:
    """Bytes as datagrams: (time step in ms, what to do with it, datagram), each behind a head of four bytes."""
    out: list[tuple[int, int, bytes]] = []
    at = 0
    while at + 4 <= len(data) and len(out) < 60:
        step, mode, size = data[at], data[at + 1], data[at + 2] << 8 | data[at + 3]
        out.append((step, mode, data[at + 4 : at + 4 + size]))
        at += 4 + size
    return out


def joined(several: list[tuple[int, int, bytes]]) -> bytes:
    """The bytes that `cut` takes apart into these."""
    return b"".join(bytes((step, mode)) + len(data).to_bytes(2, "big") + data for step, mode, data in several)


def resealed(data: bytes) -> bytes:
    """With the checksum put right: no fuzzer finds its way past one."""
    from zlib import crc32

    return data if len(data) < 10 else data[:-4] + crc32(data[:-4]).to_bytes(4, "big")


def of_decode() -> Callable[[bytes], None]:
    """Each input as it is and with its checksum put right."""
    from teleop.protocol.packet import MOST_CONTROL, Packet, Rejection, decode, encode, peek

    def one(data: bytes) -> None:
        for each in (data, resealed(data)):
            packet, (kind, seq) = decode(each, 1), peek(each)
            if isinstance(packet, Rejection):
                continue
            assert (kind, seq) == (packet.kind, packet.seq)
            # One that was written at its longest, with short numbers, may not fit when it is written anew.
            if len(each) < MOST_CONTROL // 2:
                again = decode(encode(packet), 1)
                assert isinstance(again, Packet)
                assert again._replace(payload=packet.payload) == packet

    return one


def of_session() -> Callable[[bytes], None]:
    """Ends of all kinds, fresh at every input; even modes have the checksum put right."""
    from math import isfinite

    from teleop.protocol.endpoint import Endpoint, Reading
    from teleop.protocol.session import Session
    from tests.begun import begin
    from tests.fuzz.running import CAP, fuzzed

    scene = fuzzed(1000)
    manifest, still = manifest_of(scene), Reading((0.0,), (0.0,), (0.0,))

    def fresh(e: str, running: bool) -> Session:
        return Session(master=e == "m", manifest=manifest, number=7 if e == "m" or running else None)

    parts = {(e, running): Endpoint(scene, e, fresh(e, running)) for e in "ms" for running in (False, True)}

    def one(data: bytes) -> None:
        if not data:
            return
        e, running = "ms"[data[0] & 1], bool(data[0] & 2)
        end = parts[e, running]
        session = fresh(e, running)
        now = 10**12
        # Anew, without compiling the scene's text again.
        end.__dict__.update({**plain[e, running], "session": session})
        end.inbox, end.guard, end.link, end._reception, end._origin = made(scene, e)
        if running:
            begin(session, now, now)
            session.take_data(now)
        for step, mode, each in cut(data[1:]):
            now += step * MS * (100 if mode & 2 else 1)
            session.due(now)
            shot = each if mode & 1 else resealed(each)
            replies = end.receive(shot, now)
            assert len(replies) <= 1
            assert e == "m" or sum(map(len, replies)) <= len(shot)
            if session.start_ns is not None and not session.meeting and end.force_failed is None:
                k = (now - session.start_ns) // scene.dt_ns
                if end._tick < k < 2**40 and k >= 0:
                    out = end.tick(k, now, still)
                    assert end.force_failed is not None or all(-CAP <= f <= CAP and isfinite(f) for f in out.force)

    def made(scene: Any, e: str) -> tuple[Any, ...]:
        from teleop.protocol.end_law import Origin
        from teleop.protocol.estimates import LinkEstimates
        from teleop.protocol.guard import ForceGuard
        from teleop.protocol.inbox import Inbox
        from teleop.protocol.reception import Reception

        return (Inbox(scene.playout, scene.dt_ns), ForceGuard(scene.watchdog, scene.dt_ns / 1e9),
                LinkEstimates(band_ns=scene.dt_ns // 2), Reception(scene.dt_ns / 1e9, scene.axes), Origin(scene, e))

    plain = {which: {name: value for name, value in end.__dict__.items()
                     if isinstance(value, int | float | tuple | None)} for which, end in parts.items()}
    return one


def of_link() -> Callable[[bytes], None]:
    """Records taken apart; then a gate, and the links of both ends in the middle of an association."""
    from tempfile import TemporaryDirectory

    from teleop.protocol.secure.dtls_record import records
    from teleop.protocol.secure.gate import Gate
    from teleop.protocol.secure.keys import keygen, load_key
    from teleop.protocol.secure.secure_link import SecureLink
    from tests.fuzz.running import AT

    with TemporaryDirectory() as folder:
        keys = [load_key(keygen(Path(folder) / name)[0]) for name in ("master", "slave")]
    ends: dict[str, Any] = {}
    done = 0

    def meet() -> None:
        ends.clear()
        ends["m"] = SecureLink.calling(keys[0], keys[1].fingerprint, AT["s"])
        ends["s"] = SecureLink.listening(keys[1], keys[0].fingerprint, bytes(32))
        ends["gate"] = Gate(keys[1], keys[0].fingerprint, bytes(32))
        waiting = [("s", data) for data, _ in ends["m"].due(0)]
        while waiting:
            e, data = waiting.pop(0)
            waiting += [("sm"[e == "s"], each) for each, _ in ends[e].receive(data, AT["sm"[e == "s"]], 0)[1]]

    def one(data: bytes) -> None:
        nonlocal done
        if done % 2000 == 0:
            meet()
        done += 1
        now = MS
        for step, mode, each in cut(data):
            now += step * MS
            found = records(each)
            assert found is None or each.startswith(b"".join(record.data for record in found))
            let_in, back = ends["gate"].receive(each, AT["m"], now)
            assert let_in is None
            assert sum(map(len, back)) <= len(each)
            for e in "ms":
                plain, out = ends[e].receive(each, AT["sm"[e == "s"]] if mode & 1 else ("198.51.100.7", 5000), now)
                assert plain == []
                assert sum(len(one) for one, _ in out) <= len(each)
                assert ends[e].ready

    return one


def seeds(target: str, others: list[bytes], recorded: list[bytes]) -> list[bytes]:
    """Inputs to begin with, made of honest datagrams."""
    from struct import pack

    from tests.fuzz.datagrams import BODIES, MANIFESTS, framed, packed

    if target == "decode":
        return [*others[:8], *others[-8:], *(framed(kind, body) for kind in (0, 2, 5, 6) for body in BODIES)]
    if target == "link":
        short = [pack("!BHHHIH", 22, 0xFEFF, 0, 0, 0, size) + recorded[0][13 : 13 + size] for size in range(1, 60)]
        return [*(joined([(1, 1, data)]) for data in [*short, *recorded[:40]]),
                joined([(1, i & 1, data) for i, data in enumerate(recorded[:20])])]
    few = [data for data in others if data[3] > 1][:20] + others[5:15]
    odd = [framed(kind, packed(7, 0, 0, None, each, None)) for each in MANIFESTS for kind in (2, 3)]
    lives = [few[:10], few[10:20], few[20:], odd]
    return [bytes((first,)) + joined([(1 + i % 3, 1, data) for i, data in enumerate(life)])
            for first in range(4) for life in lives]


def main(target: str, arguments: list[str]) -> None:
    """Fuzz until libFuzzer has had enough."""
    import atheris

    names = ("packet", "session", "endpoint", "inbox", "estimates", "guard", "secure")
    with atheris.instrument_imports(include=[f"teleop.protocol.{name}" for name in names]):
        one = {"decode": of_decode, "session": of_session, "link": of_link}[target]()
    atheris.Setup([sys.argv[0], *arguments], one)
    atheris.Fuzz()


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
