"""The numbers of an end's packets (`teleop/protocol/WIRE.md`) in C: which field of a message stands in which place."""

from __future__ import annotations

from typing import Any

from teleop.law import messages
from teleop.protocol.guard import ForceGuard
from teleop.protocol.manifest import live_manifest
from teleop.protocol.packet import Layout
from teleop.protocol.session import renew_after
from teleop.scene.playout import Fixed
from teleop.scene.scene import Scene
from teleop.simulation.structure import structure_of

TEXT = """\
/* {title}: the numbers of its packets, as teleop/protocol/WIRE.md has them. Printed by `teleop emit`. */
#ifndef {upper}_WIRE_H
#define {upper}_WIRE_H
#include "{name}.h"

enum {{ /* which end it is, its axes, the numbers of a packet that comes and of one that goes, those behind the law's,
         and the bytes of a packet */
    {name}_is_master = {master}, {name}_axes = {axes}, {name}_hears = {hears}, {name}_sends = {sends},
    {name}_integrals = {integrals}, {name}_bytes = {bytes}, {name}_no_law = {upper}_LAW,
    {name}_delay = {delay} /* ticks after which a message is played; 0: the newest is */
}};
static const long long {name}_tick_ns = {tick_ns}, {name}_renew_ns = {renew_ns}; /* of silence, and a session is over */

/* What both ends have to be set up alike for: the entries of HELLO and WELCOME, a map of msgpack. */
static const unsigned char {name}_manifest[{size}] = {{
{manifest}
}};

/* The message of a packet with these numbers. */
static void {name}_take({name}_moment *m, const double *n)
{{
{take}
}}

/* The numbers of the packet with this message. */
static void {name}_give(const {name}_answer *a, double *n)
{{
{give}
}}
#endif
"""


def wire_header(scene: Scene, e: str, name: str, title: str) -> str:
    """NAME_e_wire.h."""
    from msgpack import packb

    law: Any = scene.laws[0]
    forth, back = messages(law, scene.dt_ns / 1e9)
    ways = {"m": (forth, "master"), "s": (back, "slave")}
    (tx, sender), (rx, peer) = ways[e], ways["s" if e == "m" else "m"]
    sends, hears = (Layout(kind, scene.axes, couples=hasattr(law, f"{end}_sums"))
                    for kind, end in ((tx, sender), (rx, peer)))
    delay = scene.played_as.ticks(scene.dt_ns) if isinstance(scene.played_as, Fixed) else 0
    renew_ns = renew_after(scene, ForceGuard(scene.watchdog, scene.dt_ns / 1e9).lets_go_ns)
    behind = 1 + 2 * scene.axes if structure_of(scene).has.integral else 0
    take = [f"m->rx[{i}].{field} = n[{int(place)}];"
            for i, message in enumerate(hears.messages(tuple(map(float, range(hears.width)))))
            for field, place in zip(rx._fields, message, strict=True)]
    probes = tuple([tx(*[float(i * len(tx._fields) + n) for n in range(len(tx._fields))]) for i in range(scene.axes)])
    give = []
    for place, value in enumerate(sends.flat(probes)):
        i, n = divmod(int(value), len(tx._fields))
        give.append(f"n[{place}] = a->tx[{i}].{tx._fields[n]};")
    for i in range(scene.axes) if behind else ():
        for n, field in enumerate("UE"):
            take.append(f"m->heard[{i}].{field} = n[{hears.width + 2 * i + n}];")
            give.append(f"n[{sends.width + 2 * i + n}] = a->sent[{i}].{field};")
        take.append(f"m->heard[{i}].T = n[{hears.width + behind - 1}];")
    if behind:
        give.append(f"n[{sends.width + behind - 1}] = a->sent[0].T;")
    entries: bytes = packb(dict(live_manifest(scene)))
    rows = [", ".join(map(str, entries[i:i + 24])) for i in range(0, len(entries), 24)]
    return TEXT.format(
        title=title, upper=name.upper(), name=name, master=int(e == "m"), axes=scene.axes, hears=hears.width + behind,
        sends=sends.width + behind, integrals=behind, bytes=scene.wire_size, delay=delay,
        tick_ns=scene.dt_ns, renew_ns=renew_ns, size=len(entries),
        manifest="\n".join([f"    {row}," for row in rows]), take="\n".join([f"    {line}" for line in take]),
        give="\n".join([f"    {line}" for line in give]))
