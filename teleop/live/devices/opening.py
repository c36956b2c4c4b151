"""Devices and robots as they are typed, `NAME`, `NAME:ARGUMENT` or `FILE.py:CLASS`, and how a live end opens them.

A name is one of `teleop.naming`. A file with one device needs no class. The device is made by
`make(scene)`, or with an argument by `make(scene, argument)`. Its author's first mistake is refused with a sentence.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from inspect import Signature, isclass, iscoroutinefunction, signature
from pathlib import Path
from traceback import extract_tb
from typing import TYPE_CHECKING, Any, NoReturn

from teleop.errors import DeviceError, Refused, enumerated, nearest, number
from teleop.live.devices.guarded_device import LiveDevice, let_go
from teleop.naming import DEVICE_KINDS, find, known_devices
from teleop.scene.library import own_module, prefer_bundled
from teleop.scene.loading import load_scene
from teleop.scene.scene import Scene, both_ends

if TYPE_CHECKING:
    from teleop.live.devices.device_watchdog import DeviceWatchdog

METHODS = {"read": "k", "hold": "force"}  # and what each is called with
PAGE = "teleop/live/devices/README.md"


def open_device(make: Callable[..., LiveDevice], scene: Scene, *argument: str, name: str = "") -> LiveDevice:
    """The device that `make(scene)` gives, or `make(scene, argument)`, if one was typed behind a name.

    `name`: under which it was typed; left out: that of `make`. Raises `Refused` if there is no device, or a live end
    cannot drive it.
    """
    if not callable(make):
        raise Refused(f"end_main is given what makes the device of a scene, a class or a function, and was given "
                      f"{_describe(make)} itself; write for example end_main(\"s\", {type(make).__name__}); see "
                      f"{PAGE}")
    if name:
        _check_argument(make, name, *argument)
    name = getattr(make, "__name__", type(make).__name__)
    _check_call(make, name, "scene", *["argument"][:len(argument)])
    try:
        device = make(scene, *argument)
    except Refused:
        raise
    except (DeviceError, OSError) as error:
        raise Refused(f"the device cannot be opened: {str(error) or type(error).__name__}") from error
    except (Exception, SystemExit) as error:
        at = extract_tb(error.__traceback__)[-1]
        raise Refused(f"{name}(scene), which makes the device, raised {type(error).__name__}: {error} "
                      f"({at.filename}:{at.lineno})") from error
    for method, parameter in METHODS.items():
        function = getattr(device, method, None)
        if not callable(function) or isclass(device):
            raise Refused(f"{name}(scene) gave {_describe(device)}, which has no {method}({parameter}); a device is an "
                          f"object with read(k) and hold(force): see {PAGE}")
        called = f"{type(device).__name__}.{method}"
        if iscoroutinefunction(function):
            raise Refused(f"{called} is a coroutine, which nobody awaits; write def {method}(self, {parameter}), "
                          f"without async, that returns at once: see {PAGE}")
        _check_call(function, called, parameter)
    if (watchdog := getattr(device, "watchdog", None)) is not None:
        from teleop.live.devices.device_watchdog import DeviceWatchdog

        if not isinstance(watchdog, DeviceWatchdog):
            raise Refused(f"a device's watchdog is a DeviceWatchdog, not {_describe(watchdog)}; write for example "
                          f"watchdog = DeviceWatchdog(open=\"my_arm:zeroing\"), and see {PAGE}")
    if (deadline := getattr(device, "deadline", None)) is not None:
        number("a device's deadline", deadline, above=0.0, unit="s")
    return device


def close(device: object) -> str | None:
    """Have a device closed that can be, after it was driven; why that failed, None if it did not."""
    try:
        function = getattr(device, "close", None)
        if callable(function):
            function()
    except Exception as error:
        return f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    return None


def _check_argument(make: Any, name: str, *argument: str) -> None:
    """Refuse a name that was typed with an argument that it does not take, or without one that it needs."""
    takes, short = _signature(make), name.removesuffix(f":{''.join(argument)}") if argument else name
    if takes is None or _binds(takes, 1 + len(argument)) is None:
        return
    if argument and _binds(takes, 1) is None:
        raise Refused(f"{short} takes nothing behind its name, and {argument[0]!r} stood there; write {short}")
    if not argument and _binds(takes, 2) is None:
        raise Refused(f"{short} opens what stands behind its name, its {list(takes.parameters)[1]}, and there is "
                      f"nothing; write {short}:{list(takes.parameters)[1].upper()}")


def _signature(function: Any) -> Signature | None:
    try:
        return signature(function)
    except (TypeError, ValueError):  # of a compiled extension
        return None


def _binds(takes: Signature, count: int) -> TypeError | None:
    """Why a call with so many arguments does not fit; None if it does."""
    try:
        takes.bind(*[None] * count)
    except TypeError as error:
        return error
    return None


def _check_call(function: Any, name: str, *arguments: str) -> None:
    """Refuse what cannot be called with these arguments, as far as its signature can be told."""
    takes = _signature(function)
    if takes is not None and (error := _binds(takes, len(arguments))) is not None:
        short = name.rpartition(".")[2]
        raise Refused(f"{name} is called as {short}({', '.join(arguments)}), and cannot be: {error}; it is written as "
                      f"{short}{takes}")


def _describe(thing: object) -> str:
    return f"the class {thing.__name__}" if isclass(thing) else repr(thing)[:99]


@dataclass(frozen=True)
class NamedDevice:
    """Maker of the device that a text names. `argument`: the text behind the name and its colon, if there is one."""

    text: str
    make: Callable[..., LiveDevice]
    argument: str | None = None

    def open(self, scene: Scene) -> LiveDevice:
        """The device for this scene, opened and looked at as every device is. Raises `Refused`."""
        return open_device(self.make, scene, *([] if self.argument is None else [self.argument]), name=self.text)


def find_device(e: str, text: str) -> NamedDevice:
    """Find the device that `text` names for the end `e`, "m" or "s", without opening it. Raises `Refused`.

    >>> find_device("s", "simulated").make.__name__, find_device("m", "csv:reach.csv").argument
    ('SimulatedSlave', 'reach.csv')
    """
    kind = DEVICE_KINDS[e]
    name, colon, rest = text.partition(":")
    if name.endswith(".py"):
        maker, colon, argument = rest.partition(":")
        return NamedDevice(text, _in_file(e, name, maker), argument if colon else None)
    if colon and not rest:
        raise Refused(f"{kind.option} {text} has nothing behind its colon; write {name}, or {name}:ARGUMENT")
    peer_kind = DEVICE_KINDS["ms"[e == "m"]]
    if name not in (known := known_devices(e)) and name in known_devices("ms"[e == "m"]):
        raise Refused(f"{name} is a {peer_kind.word}, and this end takes a {kind.word}; give it to the other end by "
                      f"{peer_kind.option} {text}, or take one of {', '.join(known)} here")
    prefer_bundled()  # the parts that it imports must be ours
    try:
        make = find(kind.word, kind.group, kind.built_in, name)
    except ImportError as error:
        raise Refused(f"the {kind.word} {name} cannot be loaded from {known.get(name, 'its package')}: {error}; "
                      "install what it needs") from error
    return NamedDevice(text, make, rest if colon else None)


def _in_file(e: str, file: str, name: str) -> Callable[..., LiveDevice]:
    """The class, or the function, `name` of a file; without a name its one class with the methods of a device."""
    word, option = DEVICE_KINDS[e].word, DEVICE_KINDS[e].option
    module = own_module(Path(file), f"a {word}", f"{option} FILE.py names a file with a {word} of your own, "
                        f"{option} FILE.py:CLASS one of several in it")
    classes: dict[str, Any] = {key: value for key, value in vars(module).items() if isclass(value)
                               and value.__module__ == module.__name__ and all(hasattr(value, m) for m in METHODS)}
    if name:
        make: Callable[..., LiveDevice] | None = getattr(module, name, None)
        if make is None:
            raise Refused(f"{file} has no {name!r}; {nearest(name, classes) if classes else f'it has no {word}'}")
        return make
    if not classes:
        raise Refused(f"{file} has no {word}: a class with read(k) and hold(force), see {PAGE}")
    if len(classes) > 1:
        raise Refused(f"{file} has {len(classes)} devices; name one of them, "
                      f"{enumerated([f'{file}:{each}' for each in classes], 'or')}")
    only: Callable[..., LiveDevice] = next(iter(classes.values()))
    return only


def watchdog_of(e: str, text: str, scene: str, knobs: Mapping[str, str]) -> DeviceWatchdog:
    """The watchdog that `--watchdog` starts for the device `text` of the end `e`, in this scene with these knobs.

    It opens the device by the same name a second time, so it is for hardware that two processes may open. A device that
    only one may open names another way to its motor, by an attribute `watchdog`.

    >>> watchdog_of("s", "my_arm:/dev/ttyACM0", "hard_wall", {}).open
    'teleop.live.devices.opening:zeroing'
    """
    from teleop.live.devices.device_watchdog import DeviceWatchdog

    file, colon, rest = text.partition(":")
    name = f"{Path(file).absolute()}{colon}{rest}" if file.endswith(".py") else text
    return DeviceWatchdog(open=f"{__name__}:{zeroing.__name__}", arguments=(e, text, scene, json.dumps(dict(knobs))),
                          device=f"{DEVICE_KINDS[e].word} {name}")


def zeroing(e: str, text: str, scene: str, knobs: str) -> Callable[[], None]:
    """Open the device in the watchdog process; the function returned has it hold nothing. Raises `Refused`."""
    loaded = both_ends(load_scene(scene, **json.loads(knobs)))
    device, zero = find_device(e, text).open(loaded), (0.0,) * loaded.axes
    return lambda: let_go(device, zero)


def pointer(scene: Scene) -> NoReturn:
    """Mouse, finger or pen in a browser, by `teleop demo SCENE --page`."""
    raise _browser_refusal(scene, "a pointer drags the master's handle")


def gamepad(scene: Scene) -> NoReturn:
    """A gamepad's stick in a browser, by `teleop demo SCENE --page`."""
    raise _browser_refusal(scene, "a gamepad's stick moves the hand, and its first button is the clutch")


def _browser_refusal(scene: Scene, what: str) -> Refused:
    return Refused(f"{what} on the page of a live run, which finds it in the browser; type `teleop demo {scene.name} "
                   "--page`, and leave the device out")
