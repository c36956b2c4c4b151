"""The command `teleop list`: everything that has a name, with its knobs, for a person and as JSON."""

from __future__ import annotations

import re
from argparse import Namespace
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from teleop.errors import Refused, closest, nearest
from teleop.kind import kinds
from teleop.knob import Declared
from teleop.law import BUILT_IN, find_law, known_laws, messages
from teleop.law.offers import CONDITIONS, claims_of, seed_energy, stores
from teleop.naming import DEVICE_KINDS, known_devices
from teleop.scene.catalogue import Named, UnknownName, device_line, find, names
from teleop.scene.knobs import COMMON
from teleop.scene.library import ROOT
from teleop.scene.loading import load_scene
from teleop.scene.playout import Playout
from teleop.stages.order import AFTER_LAW, BEFORE_LAW
from teleop.terminal.answer import Answer
from teleop.terminal.table import si

Rows = list[dict[str, Any]]  # one named cell beside the other, all rows alike; None is an empty one

HEADINGS = {"estimators": "velocity estimators", "around": "stages around a law"}  # where it is not the kind itself
MEANINGS = {  # of knobs that declare nothing, by their type
    "Law": "control law: direct, pfra, wave, one of a plug-in, or FILE.py:CLASS; with stages 'deadband(0.1) | wave'",
    "OnePortLaw": "law that renders by itself: virtual_coupling, virtual_wall, one of a plug-in, or FILE.py:CLASS",
    "Playout": "zero, hold, integral, energy, scaled:RATE, or fixed:SECONDS from sending to playing",
    "VelocityEstimator": "backward_difference(), low_pass(cutoff=30), end_fit(noise=6e-5), levant(L=1) and others",
}
PLAYOUTS = (
    ("zero", "the newest message that has come; in a gap the law is told that there is none, and a wave law plays zero",
     "E_link >= 0 with a law of waves, over any link; a steady force fades with loss"),
    ("hold", "the newest message that has come; in a gap the last one again",
     "nothing: it is active, and E_link may fall below zero"),
    ("integral", "of waves what is owed of their integral, evenly over the time that is missing, within their energy",
     "E_link >= 0 over any link, and a steady force that stays"),
    ("integral:TARGET", "the same with a queue of TARGET s at least, which delays and smooths",
     "the same"),
    ("energy", "of waves what is owed of their integral at once, within their energy",
     "E_link >= 0 over any link; a steady force fades with jitter"),
    ("scaled:RATE", "the newest wave, in a gap the last one again, times sqrt(1 - RATE)",
     "E_link >= 0 without loss where the delay grows by RATE s a second at most; a steady force fades"),
    ("fixed:SECONDS", "each message this long after it was sent, late ones never; gaps as with zero",
     "order, a constant delay, and E_link >= 0 with a law of waves"),
    ("fixed:SECONDS:GAPS", "the same; in a gap what GAPS plays there: hold, integral, energy or scaled:RATE",
     "order, a constant delay, and what GAPS claims"),
)


def command(args: Namespace) -> Answer:
    """List everything by name, a table of one kind, or the knobs of one name. Raises `Refused`."""
    if args.name is None:
        return _overview()
    if args.name in TABLES:
        rows, after = TABLES[args.name]()
        return Answer("\n".join([f"{HEADINGS.get(args.name, args.name)}", _aligned(rows), *after]), {args.name: rows})
    try:
        entry = find(args.name)
    except UnknownName as unknown:
        if rows := _devices_called(args.name):
            return Answer(_aligned(rows), {"found": rows})
        if closest(args.name, TABLES):
            raise Refused(f"{unknown.subject}; {nearest(args.name, TABLES)}") from None
        if not unknown.is_close:
            raise Refused(f"{unknown}; and the kinds {', '.join(TABLES)}") from None
        raise
    return Answer("\n\n".join(map(_text, entry)), {"found": [_document(one) for one in entry]})


def _overview() -> Answer:
    all_names = names()
    blocks = [f"{HEADINGS.get(kind, kind)}\n{_aligned(_rows(lines), heading=False)}"
              for kind, lines in all_names.items()]
    others = ", ".join(kind for kind in TABLES if kind not in all_names)
    last = f"`teleop list NAME` shows the knobs of one of them; `teleop list KIND` all that there is of {others}."
    return Answer("\n\n".join([*blocks, last]), {kind: _rows(lines) for kind, lines in all_names.items()})


def _rows(lines: Mapping[str, str]) -> Rows:
    return [{"name": name, "meaning": line} for name, line in lines.items()]


def _kind_of(kind: str) -> tuple[Rows, list[str]]:
    return _rows(names()[kind]), ["`teleop list NAME` shows the knobs of one of them."]


def _metrics() -> tuple[Rows, list[str]]:
    from teleop.simulation.metrics import METRICS

    rows = [{"name": name, "unit": one.unit, "meaning": one.meaning, "needs": one.needs or "nothing"}
            for name, one in METRICS.items()]
    return rows, ["in summary.json of a run that has what each needs; in sweeps by --metrics NAME,NAME",
                  "one of your own is a Python function of a Result: sweep(..., metrics=[mine]), see "
                  "scenarios/examples/metric.py"]


def _playouts() -> tuple[Rows, list[str]]:
    rows = [{"name": name, "plays": plays, "claims": claims} for name, plays, claims in PLAYOUTS]
    return rows, ["set with: --set playout=fixed:0.1, in every scene with a link; in a scene of your own "
                  "playout=Fixed(0.1, gaps=Integral()); a scene that names none has integral where its messages have "
                  "waves and its link loses or jitters, and live, and zero elsewhere"]


def _stages() -> tuple[Rows, list[str]]:
    before, after = ([{"name": place.name, "ends": place.ends, "does": place.what, "named_by": place.field}
                      for place in places] for places in (BEFORE_LAW, AFTER_LAW))
    law = {"name": "(law)", "ends": "both", "does": "answers with its force and its message", "named_by": "law=Wave()"}
    return [*before, law, *after], [
        "in the order of a tick, a stage that a scene does not name is not there: see `teleop show tick SCENE`",
        "device_m is that of the master, device_s that of the slave; `teleop list SCENE` has the knobs of a scene"]


def _devices_called(name: str) -> Rows:
    """The device and the robot of this name."""
    return [{"name": f"{kind.option} {name}", "meaning": device_line(e, name, place)}
            for e, kind in DEVICE_KINDS.items() if (place := known_devices(e).get(name)) is not None]


def _devices(e: str) -> tuple[Rows, list[str]]:
    kind = DEVICE_KINDS[e]
    rows = [{"name": name, "meaning": device_line(e, name, place)} for name, place in known_devices(e).items()]
    program = "master" if e == "m" else "slave"
    return rows, [f"set with: python -m {program} SCENE {kind.option} NAME, or NAME:ARGUMENT where it opens something",
                  f"one of your own is a class with read(k) and hold(force): {kind.option} FILE.py:CLASS, or an entry "
                  f"point of the group {kind.group}; `teleop check {kind.word} NAME` tries it"]


def _bodies() -> tuple[Rows, list[str]]:
    from teleop.simulation.integrators.methods import METHODS
    from teleop.simulation.integrators.stepped import EXACT

    exact = {"name": EXACT, "order": None, "method": "the scene's own: in closed form, or to its tolerance"}
    rows = [{"name": f"{one.name}:N", "order": one.order, "method": one.label} for one in METHODS]
    return [exact, *rows], ["set with: teleop run SCENE --bodies semi_implicit_euler:40, with 40 sub-steps a tick; "
                            "`teleop precision` compares all"]


TABLES: dict[str, Callable[[], tuple[Rows, list[str]]]] = {
    "scenes": partial(_kind_of, "scenes"), "laws": lambda: law_rows(names()["laws"]),
    **{kind: partial(_kind_of, kind) for kind in ("around", "effects", "estimators")},
    "metrics": _metrics, "playout": _playouts, "stages": _stages, "bodies": _bodies,
    "devices": partial(_devices, "m"), "robots": partial(_devices, "s"),
}


def _text(entry: Named) -> str:
    """Text on one name: a line, its knobs, how they are set."""
    lines = [f"{entry.kind} {entry.name}" + (f": {entry.meaning}" if entry.meaning else "")]
    if entry.knobs:
        lines += [_aligned(_knob_rows(entry.knobs)), f"  set with: {entry.how}"]
    if entry.kind == "law":
        words, _ = law_words(entry.made)
        lines += ["", "what it sends, claims and keeps", *words] if words else []
    if entry.kind == "scene":
        common = {name: one for name, one in COMMON.items() if name not in entry.knobs}
        lines += ["", "knobs of every scene, beside --seed N, which keys every random draw of the link",
                  _aligned(_knob_rows(common)), "  set with: --set NAME=VALUE"]
    return "\n".join(lines)


def _document(entry: Named) -> dict[str, Any]:
    document = {"kind": entry.kind, "name": entry.name, "meaning": entry.meaning, "set_with": entry.how,
            "knobs": [_knob(name, one) for name, one in entry.knobs.items()]}
    if entry.kind == "law":
        document |= law_words(entry.made)[1]
    if entry.kind == "scene":
        document["of_every_scene"] = [_knob(name, one) for name, one in COMMON.items() if name not in entry.knobs]
    return document


def _knob(name: str, entry: Declared) -> dict[str, Any]:
    knob = entry.knob
    default = entry.default
    plain = default if isinstance(default, bool | int | float | str | None) else _default(default)
    return {"name": name, "type": _kind(entry.kind), "default": None if default is ... else plain,
            "must_be_given": default is ..., "unit": knob.unit, "meaning": meaning_of(entry),
            "low": knob.low, "above": knob.above, "high": knob.high, "choices": list(knob.choices)}


def _knob_rows(knobs: Mapping[str, Declared]) -> Rows:
    return [{"knob": name, "type": _kind(one.kind), "default": _default(one.default), "": _remark(one)}
            for name, one in knobs.items()]


def _aligned(rows: Rows, *, heading: bool = True) -> str:
    """Rows of named cells below each other, under the names."""
    cells = (["" if cell is None else str(cell) for cell in row.values()] for row in rows)
    lines = [[*rows[0]], *cells][0 if heading else 1:]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    table = ("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) for line in lines)
    return "\n".join(f"  {line}".rstrip() for line in table)


def _kind(hint: Any) -> str:
    if hint == Playout:
        return "Playout"
    text = hint if isinstance(hint, str) else getattr(hint, "__name__", None) or str(hint)
    return re.sub(r"[\w.]+\.(\w+)", r"\1", text)


def _default(default: Any) -> str:
    if default is ...:
        return "(must be given)"
    if isinstance(default, Path) and default.is_relative_to(ROOT):
        return str(default.relative_to(ROOT))
    return "none" if default is None else str(default)


def _remark(entry: Declared) -> str:
    """Unit, meaning and bounds of a knob."""
    knob = entry.knob
    ends = ((">", knob.above), (">=", knob.low), ("<=", knob.high))
    bounds = [f"{sign} {end:g}" for sign, end in ends if end is not None]
    one_of = f"one of {', '.join(knob.choices)}" if knob.choices else ""
    return ", ".join(part for part in (knob.unit, meaning_of(entry), *bounds, one_of) if part)


def meaning_of(entry: Declared) -> str:
    """Meaning of a knob: its own, or that of its type."""
    return entry.knob.meaning or MEANINGS.get(_kind(entry.kind), "")


LINKS = (("a constant 50 ms each way", "delay(0.05)"),  # over which the conditions of one law are asked for
         ("50 to 70 ms each way with 5 % loss", "delay(0.05) | uniform(0.02) | bernoulli(0.05)"))


@dataclass(frozen=True, kw_only=True)
class LawLine:
    """Messages of a law with two ends each way, "x, v, wave u"; its claims; the energy it begins with, J."""

    fwd: str
    bwd: str
    waves: bool  # is any of them a wave
    claims: Mapping[str, str]
    seed: float | None  # None: it keeps no energy

    @property
    def claimed(self) -> str:
        """The ledgers that it keeps from going below zero, each with its condition."""
        return ", ".join(f"{ledger} over {condition}" if condition != "zero in gaps" else f"{ledger} with {condition}"
                         for ledger, condition in self.claims.items()) or "nothing"


def law_line(law: Any) -> LawLine | None:
    """Line on a law; None for a one-port law, which sends and claims nothing."""
    if not hasattr(law, "master"):
        return None
    both = [kinds(message) for message in messages(law)]
    fwd, bwd = map(_fields, both)
    waves = any("wave" in one.values() for one in both)
    return LawLine(fwd=fwd, bwd=bwd, waves=waves, claims=claims_of(law), seed=seed_energy(law) if stores(law) else None)


def _fields(message: Mapping[str, str]) -> str:
    fields = [name if kind == "sample" else f"{kind} {name}" for name, kind in message.items()]
    return ", ".join(fields) or "nothing"


def law_rows(meanings: Mapping[str, str]) -> tuple[list[dict[str, Any]], list[str]]:
    """A row for each law, `meanings` by its name; one of a plug-in is not imported, so little is known of it."""
    rows: list[dict[str, Any]] = []
    for name in sorted(known_laws()):
        line = law_line(find_law(name)()) if name in BUILT_IN else None
        row: dict[str, Any] = {"name": name, "fwd": None, "bwd": None, "claims": None, "seed_energy": None}
        if line is not None:
            row |= {"fwd": line.fwd, "bwd": line.bwd, "claims": line.claimed,
                    "seed_energy": None if line.seed is None else si(line.seed, "J")}
        elif name in BUILT_IN:
            row |= {"fwd": "(one port)"}
        rows.append({**row, "meaning": meanings[name]})
    return rows, [
        "fwd is what the master sends, bwd the slave: samples, and where it says so a wave or a total.",
        "A claimed ledger does not fall below zero; E_law is what the law keeps, with the energy that it begins with.",
        "`teleop list NAME` shows the knobs of one of them, and its conditions."]


def _condition(condition: str, line: LawLine) -> str:
    """A claim's condition in words; of a law without waves nothing of how they are played."""
    words = CONDITIONS[condition]
    return words if line.waves else words.partition(", with waves")[0]


def law_words(law: Any) -> tuple[list[str], dict[str, Any]]:
    """The lines on one law after its knobs, and the same as a document; `law` is its class."""
    from teleop.simulation.notes import unmet

    try:
        made = law()
    except Exception:  # a law that has to be given numbers is known without them by its knobs alone
        return [], {}
    line = law_line(made)
    if line is None:
        return ["  one port: it sends nothing"], {}
    lines = [f"  sends fwd {line.fwd}; bwd {line.bwd}"]
    lines += [f"  claims {ledger} >= 0 {_condition(condition, line)}" for ledger, condition in line.claims.items()]
    lines += [] if line.claims else ["  claims no ledger"]
    if line.seed is not None:
        lines.append(f"  keeps energy, {si(line.seed, 'J')} to begin with, granted again with every session")
    conditions = {}
    for where, link in LINKS:
        entry = unmet(load_scene("canonical", law=made, link=link, duration=2.0))
        conditions[where] = entry
        lines += [f"  over {where}, in the scene canonical: {sentence}" for sentence in entry]
    return lines, {"sends": {"fwd": line.fwd, "bwd": line.bwd}, "claims": dict(line.claims),
                   "seed_energy": line.seed, "conditions": conditions}
