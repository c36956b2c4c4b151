"""Devices and robots as they are typed: `NAME`, `NAME:ARGUMENT`, or a file of the user's own, `FILE.py:CLASS`.

A name is one of `teleop.scene.device_names`. A file may have its class left out, where it has one device. What the text
names is made by `make(scene)`, or with an argument by `make(scene, argument)`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from inspect import isclass
from pathlib import Path
from typing import Any

from teleop.errors import Refused, enumerated, nearest
from teleop.live.devices.guarded_device import LiveDevice
from teleop.live.devices.opening import METHODS, PAGE, opened
from teleop.naming import find
from teleop.scene.device_names import KINDS, known_devices
from teleop.scene.library import own_module, prefer_bundled
from teleop.scene.scene import Scene


@dataclass(frozen=True)
class NamedDevice:
    """What makes the device that a text names. `argument`: what stood behind the name; None: nothing did."""

    text: str
    make: Callable[..., LiveDevice]
    argument: str | None = None

    def open(self, scene: Scene) -> LiveDevice:
        """The device for this scene, opened and looked at as every device is. Raises `Refused`."""
        return opened(self.make, scene, *([] if self.argument is None else [self.argument]), name=self.text)


def named(e: str, text: str) -> NamedDevice:
    """What `text` names for the end `e`, "m" or "s"; nothing is opened yet. Raises `Refused`.

    >>> named("s", "simulated").make.__name__, named("m", "csv:reach.csv").argument
    ('SimulatedSlave', 'reach.csv')
    """
    kind = KINDS[e]
    name, colon, rest = text.partition(":")
    if name.endswith(".py"):
        maker, colon, argument = rest.partition(":")
        return NamedDevice(text, _in_file(e, name, maker), argument if colon else None)
    if colon and not rest:
        raise Refused(f"{kind.option} {text} has nothing behind its colon; write {name}, or {name}:ARGUMENT")
    other = KINDS["ms"[e == "m"]]
    if name not in (there := known_devices(e)) and name in known_devices("ms"[e == "m"]):
        raise Refused(f"{name} is a {other.word}, and this end takes a {kind.word}; give it to the other end by "
                      f"{other.option} {text}, or take one of {', '.join(there)} here")
    prefer_bundled()  # the parts that it imports must be ours
    try:
        make = find(kind.word, kind.group, kind.built_in, name)
    except ImportError as error:
        raise Refused(f"the {kind.word} {name} cannot be loaded from {there.get(name, 'its package')}: {error}; "
                      "install what it needs") from error
    return NamedDevice(text, make, rest if colon else None)


def _in_file(e: str, file: str, name: str) -> Callable[..., LiveDevice]:
    """The class, or the function, `name` of a file; without a name its one class with the methods of a device."""
    word, option = KINDS[e].word, KINDS[e].option
    module = own_module(Path(file), f"a {word}", f"{option} FILE.py names a file with a {word} of your own, "
                        f"{option} FILE.py:CLASS one of several in it")
    there: dict[str, Any] = {key: thing for key, thing in vars(module).items() if isclass(thing)
                             and thing.__module__ == module.__name__ and all(hasattr(thing, each) for each in METHODS)}
    if name:
        found: Callable[..., LiveDevice] | None = getattr(module, name, None)
        if found is None:
            raise Refused(f"{file} has no {name!r}; {nearest(name, there) if there else f'it has no {word}'}")
        return found
    if not there:
        raise Refused(f"{file} has no {word}: a class with read(k) and hold(force), see {PAGE}")
    if len(there) > 1:
        raise Refused(f"{file} has {len(there)} devices; name one of them, "
                      f"{enumerated([f'{file}:{each}' for each in there], 'or')}")
    made: Callable[..., LiveDevice] = next(iter(there.values()))
    return made
