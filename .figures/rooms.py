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
    {"__main__": "the commands", "master": "hands", "slave": "robots, contacts", "channel": "effects, the relay",
     "doctor": "what is installed", "bench": "what it costs", "report": "a stored run again",
     "export": "for other tools", "completion": "of what is typed"},
    {"studies": "laws side by side", "checks": "check_law", "people": "experiments"},
    {"analysis": "stability, Z-width", "sweeps": "runs of one scene", "live": "clocks and sockets"},
    {"emit": "an end as C"},
    {"terminal": "options and tables", "protocol": "bytes in, force out"},
    {"simulation": "the tick"},
    {"scene": "what a scene is"},
    {"laws": "one law, one file", "stages": "device, law, motor"},
    {"law": "what a law is asked"},
    {"physics": "bodies and contact", "naming": "parts by name", "knob": "unit and bounds",
     "kind": "waves among fields", "storage": "files from others"},
    {"errors": "one sentence each", "version": "which release"},
)
"""Rooms by floor, the highest first, each with what it is for; a room may import from the floors below its own."""

COLOURS = {
    "user": ("what a user adds to", {"scenarios", "master", "slave", "channel", "laws", "stages"}),
    "live": ("live", {"live", "protocol"}),
    "time": ("virtual time, answers", {"simulation", "sweeps", "analysis", "checks"}),
}
OTHER = "all", "shared by all"
LIGHT = {"page": "#ffffff", "floor": "#f6f8fa", "edge": "#b8c0c8", "arrow": "#7b8794", "name": "#1d2733",
         "word": "#47525e", "user": "#dbe9f6", "live": "#e3f1de", "time": "#fdebd2", "all": "#f0f0f0"}
DARK = {"page": "#0d1117", "floor": "#161b22", "edge": "#4a5561", "arrow": "#8a95a3", "name": "#f0f3f6",
        "word": "#b6c0ca", "user": "#1c3a5a", "live": "#21412a", "time": "#4d3a1a", "all": "#2b323b"}
WIDTH, WIDE, HIGH = 640, 146, 50  # px: of the picture, narrow enough to be read on a phone; of a room
LINE, FLOOR, MOST = 66, 84, 4  # px: from line to line of a floor; from floor to floor; rooms in a line


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
    """The picture as SVG, in the colours that the reader's screen asks for, light or dark."""
    there = rooms()
    place: dict[str, tuple[float, int]] = {}  # the middle of a room's upper edge
    boxes, y = [], 10
    for floor in FLOORS:
        lines = _lines([room for room in floor if room in there])
        high = HIGH + LINE * (len(lines) - 1) + 16
        boxes.append(f'<rect class="floor" x="6" y="{y}" width="{WIDTH - 12}" height="{high}" rx="6"/>')
        for n, line in enumerate(lines):
            place |= {room: (x, y + 8 + LINE * n) for room, x in zip(line, _middles(len(line)), strict=True)}
        y += high + FLOOR - HIGH - 16
    height = y + 52
    level = {room: n for n, floor in enumerate(FLOORS) for room in floor}
    known = {pair for pair in imports() if place.keys() >= set(pair)}
    down = {(a, b) for a, b in known if level[a] < level[b]}
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" width="{WIDTH}" height="{height}" '
        f'font-family="Helvetica, Arial, sans-serif" font-size="14" text-anchor="middle">',
        "<title>Rooms of bilateral-teleop by floor, and what each imports</title>",
        f"<style>{_style(LIGHT)}@media (prefers-color-scheme: dark) {{{_style(DARK)}}}</style>",
        f'<rect class="page" width="{WIDTH}" height="{height}"/>',
        '<marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="6" markerHeight="6" orient="auto">'
        '<path class="tip" d="M0 0 8 4 0 8z"/></marker>',
        *boxes,
        *(_arrow(place[a], place[b]) for a, b in sorted(_reduced(down))),
        *(_arrow(place[a], place[b], up=True) for a, b in sorted(known - down)),
        *(line for floor in FLOORS for room, what in floor.items() if room in place
          for line in _box(room, what, *place[room])),
    ]
    for n, (colour, what) in enumerate([*((colour, what) for colour, (what, _) in COLOURS.items()), OTHER]):
        x, top = 16 + (0, 176, 252, 460)[n], y + 4
        lines.append(f'<rect class="{colour}" x="{x}" y="{top}" width="16" height="16" rx="3"/>'
                     f'<text class="word" style="text-anchor:start" x="{x + 23}" y="{top + 13}">{escape(what)}</text>')
    return "\n".join([*lines, "</svg>", ""])


def _style(colours: dict[str, str]) -> str:
    """What each class is drawn with."""
    rooms = "".join(f".{name}{{fill:{colours[name]};stroke:{colours['edge']}}}" for name in (*COLOURS, OTHER[0]))
    plain = "".join(f".{name}{{fill:{colours[name]}}}" for name in ("page", "floor", "name", "word"))
    ways = f".way{{fill:none;stroke:{colours['arrow']}}}.tip{{fill:{colours['arrow']}}}.up{{stroke:#e53935}}"
    return rooms + plain + ways


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


def _lines(floor: list[str]) -> list[list[str]]:
    """The rooms of one floor in lines of at most `MOST`."""
    return [floor[n:n + MOST] for n in range(0, len(floor), MOST)]


def _middles(count: int) -> Iterable[float]:
    """The middles of the rooms of one line."""
    step = WIDE + (10 if count == MOST else 30)
    return [(WIDTH - (count - 1) * step) / 2 + n * step for n in range(count)]


def _box(room: str, what: str, middle: float, top: int) -> Iterator[str]:
    colour = next((colour for colour, (_, members) in COLOURS.items() if room in members), OTHER[0])
    yield f'<rect class="{colour}" x="{middle - WIDE / 2:g}" y="{top}" width="{WIDE}" height="{HIGH}" rx="8"/>'
    yield (f'<text class="name" x="{middle:g}" y="{top + 22}" font-size="17" font-weight="bold">{escape(room)}</text>'
           f'<text class="word" x="{middle:g}" y="{top + 41}">{escape(what)}</text>')


def _arrow(a: tuple[float, int], b: tuple[float, int], *, up: bool = False) -> str:
    """A curve from the foot of a room to the head of one below; from its head, if the other stands above."""
    x0, x1 = a[0], b[0]
    y0, y1 = a[1] + (0 if up else HIGH), b[1] + (HIGH if up else 0)
    bend = (y1 - y0) / 2
    tip = "way up" if up else 'way" marker-end="url(#tip)'
    way = f"M{x0:g} {y0} C{x0:g} {y0 + bend:g} {x1:g} {y1 - bend:g} {x1:g} {y1}"
    return f'<path class="{tip}" stroke-width="1.4" d="{way}"/>'


if __name__ == "__main__":
    raise SystemExit(main())
