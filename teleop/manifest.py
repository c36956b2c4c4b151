"""What both ends of a live run must agree on, as text: the first exchange compares it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from teleop.law import law_name

if TYPE_CHECKING:
    from teleop.scene import Scene


def manifest(scene: Scene) -> dict[str, str]:
    """Every part of the scene, every knob, and what the files behind it hold; see `Scene.manifest`."""
    from teleop.packet import VERSION

    parts = {name: getattr(scene, name) for name in scene.__dataclass_fields__ if name not in ("name", "knobs")}
    fixed = {
        **parts, "wire version": VERSION, "scene": scene.name, "law": f"{law_name(scene.law)} {scene.law}",
        "packet_size": scene.wire_size, "law source": _own_source(scene.law),
    }
    paths = {str(value): fingerprint(value) for value in scene.knobs.values()}
    texts = {key: fingerprint(value) for key, value in {**scene.knobs, **fixed}.items()}
    for path, content in paths.items():
        if content != path:  # the same file may lie elsewhere on the other machine
            texts = {key: text.replace(path, content) for key, text in texts.items()}
    return texts


def fingerprint(value: object) -> str:
    """A knob as text; a file by its name and what is in it."""
    from os import PathLike

    if not isinstance(value, PathLike):
        return str(value)
    from hashlib import sha256
    from pathlib import Path

    path = Path(value)
    return f"{path.name} ({sha256(path.read_bytes()).hexdigest()[:12]})"


def _own_source(law: object) -> str:
    """What stands in the file of a law that does not come with this package; built-in ones go by version."""
    from pathlib import Path

    from teleop import __version__
    from teleop.law import BUILT_IN

    if law_name(law) in BUILT_IN:
        return __version__
    end: Any = getattr(type(law), "slave", None) or type(law).force  # type: ignore[attr-defined]  # one of both
    source = Path(end.__code__.co_filename)
    return fingerprint(source) if source.is_file() else "not in a file"
