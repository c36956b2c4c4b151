"""Manifest of a live run, on which both ends must agree, as text: the first exchange compares it."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from shlex import quote
from typing import TYPE_CHECKING, Any

from teleop.errors import Refused, plural
from teleop.law import innermost, is_built_in, law_name

if TYPE_CHECKING:
    from teleop.scene.scene import Scene

EVERY, TICK_0 = "@every", "@tick 0"  # entries of a manifest that tell and are not compared
INSECURE = "@insecure"  # one that a relay adds: the link leaves its machine without keys, as it was asked to let it
MOST_EVERY = 1000  # ticks of the grid to one of an end
MOST_CLOCK_NS = 1 << 61  # 73 years of a monotonic clock
LONGEST = 300  # characters of an entry, and of what a sentence shows of one: sixteen axes have to fit a datagram
LONGEST_LAW = 1500  # of the law's, whose numbers of each axis a sentence names
_CURES = {
    "wire version": "install the same release of bilateral-teleop at both ends",
    "scene": "start both ends with the same scene",
    "law": "start both ends with the same --set law=NAME and the same law.* knobs",
    "law source": "install the same release, and the same file of the law, at both ends",
    "mode": "start both ends with --lockstep, or neither",
    "seed": "start both ends with the same --seed",
}
_MADE = frozenset((  # the parts of a scene, which its knobs make
    "master", "slave", "hand", "environment", "link", "playout", "watchdog", "cap", "device_m", "device_s", "passivity",
    "electrical", "scaling", "frame", "axes", "names", "units", "left_out_m", "left_out_s", "start_m", "start_s",
    "packet_size",
))
_OF_AXES = frozenset(("axes", "names", "units"))
_FIELD = re.compile(r"\b(\w+)=(-?[\w.+-]+)(?=[,)])")  # of a law without stages, as its dataclass is shown


def manifest_of(scene: Scene) -> dict[str, str]:
    """The entries on which both ends of a live run of `scene` must agree, as text by name.

    Every part of the scene, every knob, and the contents of the files behind them: a scene or a law of the user's own
    is compared by its source, a recorded motion by its content. Raises `Refused` if such a file cannot be read.
    """
    from teleop.protocol.packet import VERSION

    parts = {name: getattr(scene, name) for name in scene.__dataclass_fields__
             if name not in ("name", "knobs", "own_law")}
    fixed = {
        **parts, "wire version": VERSION, "scene": scene.name, "law": f"{law_name(scene.laws[0])} {scene.law}",
        "packet_size": scene.wire_size, "law source": _own_source(scene.laws[0]),
    }
    paths = {str(value): fingerprint(value) for value in scene.knobs.values()}
    texts = {key: fingerprint(value) for key, value in {**scene.knobs, **fixed}.items()}
    for path, content in paths.items():
        if content != path:  # the same file may lie elsewhere on the other machine
            texts = {key: text.replace(path, content) for key, text in texts.items()}
    return {key: text if len(text) <= (LONGEST_LAW if key == "law" else LONGEST) else _digested(text)
            for key, text in texts.items()}


def _digested(text: str) -> str:
    """A text that has no room in the first exchange: how it begins, and a digest of all of it."""
    from hashlib import sha256

    return f"{text[: LONGEST - 20]}... ({sha256(text.encode()).hexdigest()[:12]})"


def live_manifest(scene: Scene) -> dict[str, str]:
    """The same of two ends that go by the clock: `manifest_of` and the mode."""
    return {**manifest_of(scene), "mode": "live"}


def fingerprint(value: object) -> str:
    """A knob as text, as it is typed; a file by its name and what is in it.

    Raises `Refused` if that file cannot be read.
    """
    from os import PathLike

    if isinstance(value, tuple) and value and all(isinstance(each, str | int | float) for each in value):
        return ",".join(map(str, value))
    if not isinstance(value, PathLike):
        if isinstance(value, tuple) and value and {type(each) for each in value} <= {int, float}:
            return ",".join(map(str, value))  # as it is typed
        return str(value)
    from hashlib import sha256
    from pathlib import Path

    from teleop.storage.files import read_bytes

    path = Path(value)
    try:
        content = read_bytes(path)
    except OSError as error:
        raise Refused(f"{path} cannot be read ({error.strerror or error}), and both ends compare what it holds; give "
                      "the path of a file") from None
    return f"{path.name} ({sha256(content).hexdigest()[:12]})"


def _own_source(law: object) -> str:
    """Fingerprint of the file of a law from outside this package; the version for a built-in one."""
    from pathlib import Path

    from teleop.version import __version__

    if is_built_in(law):
        return __version__
    wrapped = innermost(type(law))
    end: Any = getattr(wrapped, "slave", None) or wrapped.force  # one of both
    source = Path(end.__code__.co_filename)
    return fingerprint(source) if source.is_file() else "not in a file"


def manifest_difference(mine: Mapping[str, str], theirs: Mapping[str, str]) -> str | None:
    """The sentence that names the first entry in which two manifests differ and what to do, or None.

    Wire version, scene and law come first, for the rest follows from them; then the order of `mine`. How many more
    differ is said of those alone that do not follow from another: a knob changes the part that it sets too.
    "Here" is the end of `mine`: call it the other way round for the peer's sentence.

    >>> manifest_difference({"k_e": "50000.0"}, {"k_e": "2000.0"})
    'k_e is 50000.0 here and 2000.0 there: start both ends with the same --set k_e=50000.0'
    """
    names = dict.fromkeys([*_CURES, *mine, *theirs])
    apart = [name for name in names if mine.get(name) != theirs.get(name)]
    if not apart:
        return None
    name, *rest = _causes(apart)
    own_text, peer_text = ((end.get(name, "missing") or "empty")[:LONGEST] for end in (mine, theirs))
    if name == "law" and (knob := _law_difference(mine.get(name, ""), theirs.get(name, ""))) is not None:
        name, own_text, peer_text = knob
        cure = f"start both ends with the same --set {name}={own_text}"
    elif name in _CURES:
        cure = _CURES[name]
    elif name in _OF_AXES:
        cure = "start both ends with the same file of the scene, and the same knobs"
    elif name in mine and name in theirs:
        cure = f"start both ends with the same --set {name}={quote(mine[name][:LONGEST])}"
    elif name in _any_scenes():
        cure = f"start both ends with the same --set {name}={quote((mine.get(name) or theirs[name])[:LONGEST])}"
    else:
        cure = "install the same release, and the same scene file, at both ends"
    others = f" ({len(rest)} more {plural(len(rest), 'differs', 'differ')})" if rest else ""
    return f"{name} is {own_text} here and {peer_text} there{others}: {cure}"


def _any_scenes() -> Iterable[str]:
    """The knobs that any scene takes: they are in a manifest where they were typed."""
    from teleop.scene.knobs import COMMON

    return COMMON


def _law_difference(mine: str, theirs: str) -> tuple[str, str, str] | None:
    """The knob `law.NAME` in which two laws of one kind differ, and its numbers here and there, one for each axis."""
    if "|" in mine or _without_numbers(mine) != _without_numbers(theirs):
        return None
    fields = [_FIELD.findall(text) for text in (mine, theirs)]
    for name in dict.fromkeys(name for name, _ in fields[0]):
        values = [[value for each, value in end if each == name] for end in fields]
        texts = [each[0] if len(set(each)) == 1 else ",".join(each) for each in values]
        if texts[0] != texts[1]:
            return f"law.{name}", texts[0][:LONGEST], texts[1][:LONGEST]
    return None


def _without_numbers(law: str) -> tuple[str, frozenset[str]]:
    """Name and classes of a law in a manifest: each class once, also where each axis has its own law."""
    return law.partition(" ")[0], frozenset(re.findall(r"\b\w+(?=\()", law))


def _causes(apart: list[str]) -> list[str]:
    """Entries among `apart` that differ by themselves and follow from no other."""
    if apart[0] in ("wire version", "scene"):
        return apart[:1]
    follow = {"law source"} if "law" in apart else set()
    if "mode" in apart:
        follow.add("seed")  # only in lockstep do the ends have to agree on it
    if any(name not in _CURES and name not in _MADE for name in apart):
        follow |= _MADE
    return [name for name in apart if name not in follow]


def parted(payload: object) -> tuple[dict[str, str], dict[str, int]]:
    """Split a manifest into the compared entries and the whole numbers beside them."""
    assert isinstance(payload, dict)
    extras = {}
    for name in (EVERY, TICK_0, INSECURE):
        text = payload.get(name, "")
        digits = text.removeprefix("-")
        if digits.isascii() and digits.isdigit() and len(text) < 20:
            extras[name] = int(text)
    if not 1 <= extras.get(EVERY, 1) <= MOST_EVERY:
        del extras[EVERY]
    if abs(extras.get(TICK_0, 0)) > MOST_CLOCK_NS:
        del extras[TICK_0]
    return {name: text for name, text in payload.items() if name not in (EVERY, TICK_0, INSECURE)}, extras
