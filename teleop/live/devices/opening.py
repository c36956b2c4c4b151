"""How a live end gets its device from what its author wrote, and what it says of a first mistake in that."""

from __future__ import annotations

from collections.abc import Callable
from inspect import Signature, isclass, iscoroutinefunction, signature
from traceback import extract_tb
from typing import Any

from teleop.errors import DeviceError, Refused, number
from teleop.live.devices.guarded_device import LiveDevice
from teleop.live.devices.heartbeat import DeviceWatchdog
from teleop.scene.scene import Scene

METHODS = {"read": "k", "hold": "force"}  # and what each is called with
PAGE = "teleop/live/devices/README.md"


def opened(make: Callable[..., LiveDevice], scene: Scene, *argument: str, name: str = "") -> LiveDevice:
    """The device that `make(scene)` gives, or `make(scene, argument)`, if one was typed behind a name.

    `name`: under which it was typed; left out: that of `make`. Raises `Refused` if there is no device, or a live end
    cannot drive it.
    """
    if not callable(make):
        raise Refused(f"end_main is given what makes the device of a scene, a class or a function, and was given "
                      f"{_shown(make)} itself; write for example end_main(\"s\", {type(make).__name__}); see "
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
    for method, given in METHODS.items():
        function = getattr(device, method, None)
        if not callable(function) or isclass(device):
            raise Refused(f"{name}(scene) gave {_shown(device)}, which has no {method}({given}); a device is an "
                          f"object with read(k) and hold(force): see {PAGE}")
        if iscoroutinefunction(function):
            raise Refused(f"{_called(device, method)} is a coroutine, which nobody awaits; write def {method}(self, "
                          f"{given}), without async, that returns at once: see {PAGE}")
        _check_call(function, _called(device, method), given)
    watchdog = getattr(device, "watchdog", None)
    if watchdog is not None and not isinstance(watchdog, DeviceWatchdog):
        raise Refused(f"a device's watchdog is a DeviceWatchdog, not {_shown(watchdog)}; write for example "
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


def _called(device: object, method: str) -> str:
    return f"{type(device).__name__}.{method}"


def _shown(thing: object) -> str:
    return f"the class {thing.__name__}" if isclass(thing) else repr(thing)[:99]
