"""The map of the rooms, drawn from the imports: `python .figures/rooms.py` writes rooms.svg beside this file.

Each room stands on its floor, and an arrow says that a room imports another. An import that is made by way of a third
room as well is left out (the transitive reduction), so that the picture stays readable. An import that runs up would be
red. The picture is the same whenever the imports are; `tests/test_readmes.py` compares.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from html import escape
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("teleop", "master", "slave", "channel", "scenarios")
PICTURE = Path(__file__).with_name("rooms.svg")

FLOORS: tuple[dict[str, str], ...] = (
    {"scenarios": "one scene, one file"},
    {"__main__": "the commands", "doctor": "what is installed", "bench": "what it costs",
     "report": "a stored run again", "master": "hands", "slave": "robots, contacts",
     "channel": "effects, the relay"},
    {"studies": "laws side by side", "checks": "does a law keep its word"},
    {"analysis": "stability, passivity, Z-width", "sweeps": "many runs of one scene",
     "live": "sockets, timers, devices"},
    {"terminal": "options, tables, plots",
     "protocol": "bytes and now in, force out"},
    {"simulation": "the tick, in virtual time"},
    {"scene": "what a scene is"},
    {"laws": "one law, one file", "stages": "between device, law, motor"},
    {"law": "what every law is asked"},
    {"physics": "bodies and contact, exact", "naming": "parts found by name", "knob": "unit, meaning, bounds",
     "kind": "waves among fields", "storage": "files of unknown origin"},
    {"errors": "one sentence each", "version": "which release"},
)
"""Rooms by floor, the highest first, each with what it is for; a room may import from the floors below its own."""

COLOURS = {
    "#dbe9f6": ("what a user adds to", {"scenarios", "master", "slave", "channel", "laws", "stages"}),
    "#e3f1de": ("live", {"live", "protocol"}),
    "#fdebd2": ("virtual time and answers", {"simulation", "sweeps", "analysis", "checks"}),
}
OTHER = "#f0f0f0"
WIDTH, HIGH, FLOOR = 1120, 46, 86  # px: of the picture; of a room; from floor to floor


def main() -> int:
    """Write the picture."""
    PICTURE.write_text(drawn())
    return 0


def rooms() -> set[str]:
    """The rooms that there are: folders and modules of `teleop`, and the packages beside it."""
    parts = (path for path in (ROOT / "teleop").iterdir() if path.suffix == ".py" or (path / "__init__.py").is_file())
    return {path.stem for path in parts if path.stem != "__init__"} | set(PACKAGES) - {"teleop"}


def imports() -> set[tuple[str, str]]:
    """Pairs of rooms (who imports, what), also of imports inside functions and for type checkers alone."""
    public = _public()
    found = set()
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            here = _room(".".join(path.relative_to(ROOT).with_suffix("").parts))
            for name in _named(ast.parse(path.read_text()), public):
                there = _room(name)
                if here != there and "" not in (here, there):
                    found.add((here, there))
    return found


def drawn() -> str:
    """The picture as SVG."""
    there = rooms()
    floors = [{room: what for room, what in floor.items() if room in there} for floor in FLOORS]
    place = {room: (x, y) for y, floor in enumerate(floors)
             for room, x in zip(floor, _middles(len(floor)), strict=True)}
    wide = {room: _wide(len(floor)) for floor in floors for room in floor}
    known = {pair for pair in imports() if place.keys() >= set(pair)}
    down = {(a, b) for a, b in known if place[a][1] < place[b][1]}
    high = 16 + FLOOR * len(FLOORS) + 24
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {high}" width="{WIDTH}" height="{high}" '
        f'font-family="Helvetica, Arial, sans-serif" font-size="12">',
        "<title>Rooms of bilateral-teleop by floor, and what each imports</title>",
        f'<rect width="{WIDTH}" height="{high}" fill="#ffffff"/>',
        '<marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="6" markerHeight="6" orient="auto">'
        '<path d="M0 0 8 4 0 8z" fill="#8a95a3"/></marker>',
    ]
    for y in range(len(FLOORS)):
        lines.append(f'<rect x="8" y="{10 + y * FLOOR}" width="{WIDTH - 16}" height="{HIGH + 16}" rx="6" '
                     f'fill="#fafbfc" stroke="#eceff2"/>')
    lines += [_arrow(place[a], place[b]) for a, b in sorted(_reduced(down))]
    lines += [_arrow(place[a], place[b], "#c62828") for a, b in sorted(known - down)]
    lines += [line for floor in floors for room, what in floor.items()
              for line in _box(room, what, wide[room], *place[room])]
    legend = [(colour, what) for colour, (what, _) in COLOURS.items()] + [(OTHER, "shared by all")]
    for n, (colour, what) in enumerate(legend):
        x, y = 24 + 230 * n, high - 24
        lines.append(f'<rect x="{x}" y="{y}" width="14" height="14" rx="3" fill="{colour}" stroke="#b8c0c8"/>'
                     f'<text x="{x + 22}" y="{y + 11}" fill="#444">{escape(what)}</text>')
    return "\n".join([*lines, "</svg>", ""])


def _public() -> dict[str, str]:
    """The public names of `teleop`, each with the module that it comes from."""
    tree = ast.parse((ROOT / "teleop" / "__init__.py").read_text())
    return {alias.asname or alias.name: node.module for node in ast.walk(tree)
            if isinstance(node, ast.ImportFrom) and node.module for alias in node.names}


def _named(tree: ast.AST, public: dict[str, str]) -> Iterator[str]:
    """The modules of this distribution that a file imports; a public name counts as the module it comes from."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module == "teleop":
            yield from (public.get(alias.name, f"teleop.{alias.name}") for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module


def _room(module: str) -> str:
    """The room of a module; nothing for the public list itself and for what is not ours."""
    top, _, rest = module.partition(".")
    if top == "teleop":
        return rest.partition(".")[0].replace("__init__", "")
    return top if top in PACKAGES else ""


def _reduced(pairs: set[tuple[str, str]]) -> set[tuple[str, str]]:
    """The pairs that no way over a third room replaces."""
    below: dict[str, set[str]] = {}
    for a, b in pairs:
        below.setdefault(a, set()).add(b)

    def reached(room: str) -> set[str]:
        return {far for near in below.get(room, ()) for far in (near, *reached(near))}

    return {(a, b) for a, b in pairs if not any(b in reached(near) for near in below[a] - {b})}


def _wide(count: int) -> float:
    """The width of each of `count` rooms of one floor."""
    return 216.0 if count < 5 else (WIDTH - 40) / count - 12


def _middles(count: int) -> Iterable[float]:
    """The middles of the rooms of one floor."""
    step = _wide(count) + (36 if count < 5 else 12)
    return [(WIDTH - (count - 1) * step) / 2 + n * step for n in range(count)]


def _box(room: str, what: str, wide: float, middle: float, y: int) -> Iterator[str]:
    colour = next((colour for colour, (_, members) in COLOURS.items() if room in members), OTHER)
    top = 18 + y * FLOOR
    yield (f'<rect x="{middle - wide / 2:g}" y="{top}" width="{wide:g}" height="{HIGH}" rx="8" fill="{colour}" '
           f'stroke="#b8c0c8"/>')
    yield (f'<text x="{middle:g}" y="{top + 20}" text-anchor="middle" font-size="14" font-weight="bold" '
           f'fill="#1d2733">{escape(room)}</text>')
    yield f'<text x="{middle:g}" y="{top + 37}" text-anchor="middle" fill="#4a5561">{escape(what)}</text>'


def _arrow(a: tuple[float, int], b: tuple[float, int], colour: str = "#8a95a3") -> str:
    """A curve from the foot of a room to the head of one below; from its head, if the other stands above."""
    up = b[1] <= a[1]
    x0, x1 = a[0], b[0]
    y0, y1 = 18 + a[1] * FLOOR + (0 if up else HIGH), 18 + b[1] * FLOOR + (HIGH if up else 0)
    bend = (y1 - y0) / 2
    tip = ' marker-end="url(#tip)"' if not up else ""
    return (f'<path d="M{x0:g} {y0} C{x0:g} {y0 + bend:g} {x1:g} {y1 - bend:g} {x1:g} {y1}" fill="none" '
            f'stroke="{colour}" stroke-width="1.3"{tip}/>')


if __name__ == "__main__":
    raise SystemExit(main())
