"""Scenes that a stored folder names: opening a folder of others runs no code of theirs and reads no other file.

A folder says which scene was run, with which knobs. A scene that is installed may be made again from that. A scene or a
law in a file of its own is code, and a knob or an effect that names a file has this machine read it: all of these only
for a reader who says that the folder is to be trusted.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import UnionType
from typing import get_args

from teleop.errors import Refused
from teleop.scene.loading import load_scene
from teleop.scene.scene import Scene

CURE = "if the folder and that file are your own, or you have read them, add --trust (from Python trust=True)"


def stored_scene(name: str, knobs: Mapping[str, object], *, trust: bool) -> Scene:
    """The scene that a folder names, made again. Raises `Refused`, without `trust` also as the module has it."""
    if not trust:
        check_installed(name)
        _check_no_file(name, knobs)
    return load_scene(name, **knobs)


def asks_for_trust(name: str, knobs: Mapping[str, object]) -> bool:
    """True if a folder of this scene is opened with `trust` alone."""
    try:
        check_installed(name)
        _check_no_file(name, knobs)
    except Refused:
        return True
    return False


def check_installed(name: str) -> None:
    """Refuse a scene that is not installed, neither built in nor of a plug-in."""
    from teleop.scene.library import known_scenes

    if name not in known_scenes():
        raise Refused(f"the folder names the scene {name!r}, which is a file with code and none of those installed "
                      f"here, so it is not run; {CURE}")


def _check_no_file(name: str, knobs: Mapping[str, object]) -> None:
    from teleop.scene.knobs import knobs_of
    from teleop.scene.library import import_bundled, scene_function
    from teleop.scene.own_law import file_named

    kinds = {key: get_args(declaration.kind) if isinstance(declaration.kind, UnionType) else (declaration.kind,)
             for key, declaration in knobs_of(scene_function(name)).items()}
    for key, value in knobs.items():
        if isinstance(value, str) and file_named(value):  # of a law, whatever its knob is called
            raise Refused(f"the folder's scene {name} has {key}={value[:200]}, which is a file with code, so it is not "
                          f"run; {CURE}")
        if Path in kinds.get(key, ()) or (key == "hand" and key not in kinds) or (
                key == "link" and import_bundled("channel.link").names_a_file(str(value))):
            raise Refused(f"the folder's scene {name} has {key}={str(value)[:200]}, which names a file of this "
                          f"machine, so it is not read; {CURE}")
