"""How a live end gets its device from what its author wrote, and what it says of a first mistake in that."""

from __future__ import annotations

from collections.abc import Callable
from inspect import isclass, iscoroutinefunction, signature
from traceback import extract_tb
from typing import Any

from teleop.errors import DeviceError, Refused
from teleop.live.devices.guarded_device import LiveDevice
from teleop.live.devices.heartbeat import DeviceWatchdog
from teleop.scene.scene import Scene

METHODS = {"read": "k", "hold": "force"}  # and what each is called with
PAGE = "see teleop/live/devices/README.md"


def opened(make: Callable[[Scene], LiveDevice], scene: Scene) -> LiveDevice:
    """The device that `make(scene)` gives. Raises `Refused` if there is none, or a live end cannot drive it."""
    if not callable(make):
        raise Refused(f"end_main is given what makes the device of a scene, a class or a function, and was given "
                      f"{_shown(make)} itself; write for example end_main(\"s\", {type(make).__name__}), and {PAGE}")
    name = getattr(make, "__name__", type(make).__name__)
    _check_call(make, name, "scene")
    try:
        device = make(scene)
    except Refused:
        raise
    except (DeviceError, OSError) as error:
        raise Refused(f"the device cannot be opened: {str(error) or type(error).__name__}") from error
    except Exception as error:
        at = extract_tb(error.__traceback__)[-1]
        raise Refused(f"{name}(scene), which makes the device, raised {type(error).__name__}: {error} "
                      f"({at.filename}:{at.lineno})") from error
    for method, argument in METHODS.items():
        function = getattr(device, method, None)
        if not callable(function) or isclass(device):
            raise Refused(f"{name}(scene) gave {_shown(device)}, which has no {method}({argument}); a device is an "
                          f"object with read(k) and hold(force): {PAGE}")
        if iscoroutinefunction(function):
            raise Refused(f"{_called(device, method)} is a coroutine, which nobody awaits; write def {method}(self, "
                          f"{argument}), without async, that returns at once: {PAGE}")
        _check_call(function, _called(device, method), argument)
    watchdog = getattr(device, "watchdog", None)
    if watchdog is not None and not isinstance(watchdog, DeviceWatchdog):
        raise Refused(f"a device's watchdog is a DeviceWatchdog, not {_shown(watchdog)}; write for example "
                      f"watchdog = DeviceWatchdog(open=\"my_arm:zeroing\"), and {PAGE}")
    return device


def _check_call(function: Any, name: str, argument: str) -> None:
    """Refuse what cannot be called with one argument, as far as its signature can be told."""
    try:
        takes = signature(function)
    except (TypeError, ValueError):  # of a compiled extension
        return
    try:
        takes.bind(None)
    except TypeError as error:
        raise Refused(f"{name} is called as {name.rpartition('.')[2]}({argument}), and cannot be: {error}; it is "
                      f"written as {name.rpartition('.')[2]}{takes}") from None


def _called(device: object, method: str) -> str:
    return f"{type(device).__name__}.{method}"


def _shown(thing: object) -> str:
    return f"the class {thing.__name__}" if isclass(thing) else repr(thing)[:99]
