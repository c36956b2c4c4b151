"""Command `teleop manifest`, for an end in another language, beside `teleop/protocol/WIRE.md`.

The entries on which the ends have to agree, the numbers of a message in their places, and examples as bytes.
"""

from __future__ import annotations

import inspect
import re
from argparse import Namespace
from collections.abc import Mapping
from hashlib import sha256
from itertools import pairwise
from pathlib import Path
from typing import Any

from msgpack import packb

from teleop.errors import Refused
from teleop.kind import kinds
from teleop.law import messages
from teleop.protocol.manifest import live_manifest
from teleop.protocol.packet import VERSION, Echo, Kind, Layout, Packet, encode
from teleop.protocol.session import Session
from teleop.scene.loading import live_knobs, load_scene
from teleop.scene.scene import Scene, both_ends
from teleop.simulation.structure import structure_of
from teleop.stages.watchdog import Watchdog
from teleop.storage.files import replacing
from teleop.terminal.answer import Answer, titled
from teleop.terminal.options import knobs_from

SESSION, NUMBER = 0x0123456789ABCDEF, 1000  # of the examples
SENT_NS, ECHO = 5_000_000_000, Echo(4_900_000_000, 1_000_000)
_OF_RAD = {"m": "rad", "m/s": "rad/s", "N": "N m", "N/s": "N m/s", "N/m": "N m/rad"}
_COMMENT = re.compile(r"\s+(\w+)\s*:[^#]*#\s*(.*)")


def packed(manifest: Mapping[str, str]) -> bytes:
    """The entries as a map of msgpack, as a HELLO and a WELCOME carry it; an end may add "@" entries of its own."""
    data: bytes = packb(dict(manifest))
    return data


def message_numbers(scene: Scene, e: str) -> list[dict[str, Any]]:
    """The numbers of a message that the end `e` sends, in their order in the packet.

    Of each: `place` from 0; `axis`, its name, "" of a number that is one for all axes; `name`; `kind` as in
    `teleop.kind`, or "integral"; `says`, the law's own comment on the field, or what the number is, with its unit.
    """
    law, end = scene.laws[0], "master" if e == "m" else "slave"
    kind = messages(law, scene.dt_ns / 1e9)[0 if e == "m" else 1]
    layout = Layout(kind, scene.axes, couples=hasattr(law, f"{end}_sums"))
    field_kinds, comments, names = kinds(kind), _comments(kind), scene.axis_names
    # Numbers that tell themselves apart are laid out as an end would, and looked for where they have come.
    probes = [kind(*[float(1000 * i + n) for n in range(len(kind._fields))]) for i in range(scene.axes)]
    numbers: list[dict[str, Any]] = []
    for value in layout.flat(tuple(probes)):
        i, n = divmod(int(value), 1000)
        name = kind._fields[n]
        says = comments.get(name, "")
        numbers.append({"axis": names[i], "name": name, "kind": field_kinds[name],
                        "says": says if scene.axis_units[i] == "m" else _in_rad(says)})
    once = {one["name"] for one in numbers} - {one["name"] for one in numbers if one["axis"] != names[0]}
    for one in numbers:
        if scene.axes > 1 and one["name"] in once:
            one["axis"] = ""
    if structure_of(scene).has.integral:
        for axis in names:
            numbers += [{"axis": axis, "name": "U", "kind": "integral",
                         "says": "integral of the waves sent, s sqrt(W)"},
                        {"axis": axis, "name": "E", "kind": "integral", "says": "their energy, J"}]
        numbers.append({"axis": "", "name": "T", "kind": "integral", "says": "the time over which they were sent, s"})
    return [{"place": i, **one} for i, one in enumerate(numbers)]


def describe(scene: Scene) -> dict[str, Any]:
    """Describe manifest and messages of a scene that runs live by the clock, as JSON; the watchdog's times in s."""
    manifest = live_manifest(scene)
    sent = {"forth": message_numbers(scene, "m"), "back": message_numbers(scene, "s")}
    watchdog: Watchdog | None = scene.watchdog
    examples = {}
    for kind, numbers in zip((Kind.FORTH, Kind.BACK), sent.values(), strict=True):
        payload = tuple([i / 8 for i in range(len(numbers))])
        packet = Packet(kind, SESSION, NUMBER, SENT_NS, ECHO, payload)
        examples[kind.name.lower()] = encode(packet, scene.wire_size).hex()
    hello = Session(master=True, manifest=manifest, number=SESSION)
    examples["hello"] = hello.due(SENT_NS)[0].hex()
    return {
        "scene": scene.name, "wire_version": VERSION, "tick_ns": scene.dt_ns, "ticks": scene.ticks,
        "packet_bytes": scene.wire_size, "hello_bytes": len(examples["hello"]) // 2,
        "axes": [{"name": name, "unit": unit} for name, unit in zip(scene.axis_names, scene.axis_units, strict=True)],
        "E_in": scene.energy and not any(one["kind"] == "integral" for one in sent["forth"]),
        "watchdog": None if watchdog is None else {name: getattr(watchdog, name)
                                                   for name in ("timeout", "ramp", "settle", "age")},
        **sent, "manifest": manifest, "sha256": sha256(packed(manifest)).hexdigest(),
        "manifest_hex": packed(manifest).hex(), "examples": examples,
    }


def command(args: Namespace) -> Answer:
    """Describe an end in another language, and write its manifest to a file if asked to. Raises `Refused`."""
    knobs = live_knobs(args.scene, knobs_from(args))
    document = describe(scene := both_ends(load_scene(args.scene, **knobs)))
    if args.write is not None:
        path = Path(args.write)
        try:
            with replacing(path) as file:
                file.write(packed(document["manifest"]))
        except OSError as error:
            raise Refused(f"{path} cannot be written ({error.strerror or error}); name a file in a folder that is "
                          "there") from None
        document["path"] = str(path)
    return Answer("\n".join(_lines(scene, document)), document)


def _lines(scene: Scene, document: Mapping[str, Any]) -> list[str]:
    """The same for a person."""
    lines = [
        titled(scene), "",
        f"wire version  {document['wire_version']}",
        f"tick          {document['tick_ns']} ns, {document['ticks']} of them from tick 0",
        f"packet        {document['packet_bytes']} bytes, exactly, of FORTH and of BACK",
        f"HELLO         {document['hello_bytes']} bytes at least",
        f"manifest      {len(document['manifest'])} entries, sha256 of their map {document['sha256']}",
        f"E_in          {'the energy put into the link so far, J, or nil' if document['E_in'] else 'nil'}",
    ]
    for way, ends in (("forth", "FORTH, master to slave"), ("back", "BACK, slave to master")):
        lines += ["", f"{ends}: the payload is an array of {len(document[way])} float64"]
        rows = [(str(one["place"]), one["axis"] or "all", one["name"], one["kind"], one["says"])
                for one in document[way]]
        widths = [max(len(row[i]) for row in rows) for i in range(4)]
        lines += ["  " + "  ".join([*(text.ljust(width) for text, width in zip(row, widths, strict=False)), row[4]])
                  for row in rows]
    lines += ["", "manifest (text, all of it compared)"]
    width = max(map(len, document["manifest"]))
    lines += [f"  {name.ljust(width)}  {text}" for name, text in document["manifest"].items()]
    for way in ("forth", "back"):
        lines += ["", f"a {way.upper()} of tick {NUMBER} in session {SESSION:#018x}, its numbers 0, 0.125, 0.25 ..",
                  *_hex(document["examples"][way])]
    if "path" in document:
        lines += ["", f"written to {document['path']}: the map as msgpack, as HELLO and WELCOME carry it"]
    return lines


def _hex(digits: str) -> list[str]:
    """Bytes in hex, 32 in a line."""
    cuts = [*range(0, len(digits), 64), len(digits)]
    return [f"  {digits[a:b]}" for a, b in pairwise(cuts)]


def _in_rad(says: str) -> str:
    """Comment of a law's file on a field, with its unit for an axis of rad: laws are written for m."""
    what, comma, unit = says.rpartition(", ")
    return what + comma + _OF_RAD.get(unit, unit)


def _comments(kind: type[Any]) -> dict[str, str]:
    """Comment of the law's file behind each field, which has the unit."""
    try:
        lines = inspect.getsource(kind).splitlines()
    except (OSError, TypeError):  # it was not made in a file
        return {}
    return {match[1]: match[2].strip() for line in lines if (match := _COMMENT.fullmatch(line))}
