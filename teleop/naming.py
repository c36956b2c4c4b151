"""Parts that are found by name: those built in, and those that installed packages offer as entry points.

A package of yours offers a law by `[project.entry-points."teleop.laws"]`, `mine = "my_package:MyLaw"`; an
effect by the group `teleop.effects`, a scene (its module) by `teleop.scenes`. They are listed without being imported.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any

from teleop.errors import Refused, nearest


def known(group: str, built_in: Mapping[str, str]) -> dict[str, str]:
    """Every part that can be named: `name -> "module:attribute"`, none imported."""
    from importlib.metadata import entry_points

    return {**{e.name: e.value for e in entry_points(group=group)}, **built_in}


def find(kind: str, group: str, built_in: Mapping[str, str], name: str) -> Any:
    """The part of this name, loaded now. Raises `Refused`, naming the nearest, if there is none.

    >>> find("law", "teleop.laws", {"wave": "teleop.laws.wave:Wave"}, "wave").__name__
    'Wave'
    """
    # The installed packages are looked through only for what is not built in: it costs tens of milliseconds.
    place = built_in.get(name)
    if place is None:
        places = known(group, built_in)
        if name not in places:
            raise Refused(f"there is no {kind} {name!r}; {nearest(name, places)}")
        place = places[name]
    module, _, attribute = place.partition(":")
    loaded = import_module(module)
    return getattr(loaded, attribute) if attribute else loaded


def public_name(package: str, homes: Mapping[str, Sequence[str]], name: str) -> Any:
    """A public name of a package, loaded now; `homes` has the names of each of the package's modules.

    Raises `AttributeError`, as a module does, if no module of `homes` has the name.
    """
    for module, names in homes.items():
        if name in names:
            return getattr(import_module(f"{package}.{module}"), name)
    raise AttributeError(f"module {package!r} has no attribute {name!r}", name=name, obj=import_module(package))
