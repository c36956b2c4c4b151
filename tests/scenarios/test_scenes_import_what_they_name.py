"""A scene pays only for what it names: each runs in a fresh interpreter, and what it loaded is looked at."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from channel.link import EFFECTS
from slave.moving import Moving
from teleop import Scene, load_scene
from teleop.law import BUILT_IN
from teleop.scene.library import ROOT, built_in_scenes

DICE = {"bernoulli", "duplicate", "gamma", "gilbert_elliott", "normal", "uniform"}  # effects that throw them
NEVER = {"asyncio", "socket", "select", "msgpack", "matplotlib", "scipy", "difflib", "importlib.metadata",
         "concurrent.futures", "subprocess", "teleop.live", "teleop.protocol.packet", "teleop.protocol.endpoint",
         "teleop.protocol.session", "teleop.terminal.plotting", "teleop.scene.catalogue", "teleop.checks.law",
         "channel.relay"}
ENVIRONMENTS = {"slave.wall", "slave.tissue", "slave.hunt_crossley", "slave.moving", "slave.standard_linear_solid"}
ESTIMATORS = {f"teleop.stages.velocity.{name}"
              for name in ("adaptive_window", "backward_difference", "levant", "low_pass")}
DEVICES = {"teleop.stages.device", "teleop.stages.passivity_controller"}
BODIES = {f"teleop.physics.{name}" for name in ("implicit", "sdirk", "relaxing", "carried", "contact")}
REFERENCES = {"master.recording"}  # the other references share a file with the grip
ALIVE = {"socket", "select", "msgpack", "teleop.live",
         "teleop.protocol.packet", "teleop.protocol.endpoint", "teleop.protocol.session"}  # of NEVER, at a live end
NEVER_LIVE = NEVER - ALIVE | {"teleop.live.devices.device_watchdog", "teleop.live.turning", "teleop.live.page",
                              "teleop.protocol.secure.secure_link", "teleop.stages.velocity", "teleop.terminal.answer"}
CODE = """
import sys, json
from importlib import import_module
code = import_module(sys.argv[1] + ".__main__").main(sys.argv[2:])
print(json.dumps([code, *sys.modules]))
"""


def knobs_of(name: str, folder: Path) -> dict[str, str]:
    """What the scene must be given, and a short run."""
    (folder / "delivery").write_text("".join(f"{ms}\n" for ms in range(1, 50)))
    needed = {"up": str(folder / "delivery"), "down": str(folder / "delivery")} if name == "lte" else {}
    return {"duration": "0.02", **needed}


def loaded_by(name: str, knobs: dict[str, str], folder: Path) -> set[str]:
    settings = [part for key, value in knobs.items() for part in ("--set", f"{key}={value}")]
    return loaded(["teleop", "run", name, *settings, "--json"], folder, 0)


def loaded(words: list[str], folder: Path, exit_code: int) -> set[str]:
    """The modules that a program has loaded when it ends with this code."""
    done = subprocess.run(
        [sys.executable, "-c", CODE, *words], cwd=folder, text=True, check=True, capture_output=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    code, *modules = json.loads(done.stdout.splitlines()[-1])
    assert code == exit_code, done.stderr
    return set(modules)


def effects(link: Any) -> set[str]:
    return set() if link is None else {type(effect).__module__ for way in (0, 1) for effect in link.in_direction(way)}


def homes(table: dict[str, str], names: set[str] | None = None) -> set[str]:
    return {where.partition(":")[0] for name, where in table.items() if names is None or name in names}


def named_by(scene: Scene) -> set[str]:
    """The modules, out of those that a scene may leave out, that this one names."""
    reference = scene.reference
    parts: set[Any] = {type(scene.laws[0]), type(reference) if reference else None, *map(type, scene.environments)}
    devices = [device for device in (scene.device_m, scene.device_s) if device is not None]
    parts |= {type(device.velocity) for device in devices if device.velocity is not None}
    parts |= {type(one.environment) for one in scene.environments if isinstance(one, Moving)}
    modules = {part.__module__ for part in parts if part is not None}
    thrown = effects(scene.link) & homes(EFFECTS, DICE)
    return (
        (modules & (homes(BUILT_IN) | ENVIRONMENTS | REFERENCES | ESTIMATORS))
        | ({"slave"} if scene.slave is not None and any(scene.environments) else set())
        | ({"teleop.stages.device"} if devices else set())
        | ({"teleop.stages.passivity_controller"} if scene.passivity else set())
        | bodies(scene, modules)
        | effects(scene.link)
        | ({"channel"} if scene.link is not None else set())
        | ({"numpy.random"} if thrown else set())
        | ({"teleop.stages.watchdog"} if scene.watchdog else set())
        | ({"teleop.stages.force_cap"} if scene.cap else set())
        # only a law that reads the hand's force has use for the observer
        | ({"teleop.stages.observer"} if scene.observer and type(scene.laws[0]).__name__ == "PFRA" else set())
    )


def bodies(scene: Scene, modules: set[str]) -> set[str]:
    """What moves the bodies of the scene, beyond what is linear."""
    rubs = any(body is not None and body.friction > 0.0
               for body in (*scene.per_axis("master"), *scene.per_axis("slave")))
    return (
        ({"teleop.physics.contact"} if "slave.wall" in modules else set())
        | ({"teleop.physics.relaxing"} if "slave.standard_linear_solid" in modules or scene.electrical else set())
        | ({"teleop.physics.carried"} if "slave.moving" in modules else set())
        | ({"teleop.physics.implicit", "teleop.physics.sdirk"} if rubs or "slave.hunt_crossley" in modules else set())
    )


OPTIONAL = homes(EFFECTS) | homes(BUILT_IN) | ENVIRONMENTS | REFERENCES | ESTIMATORS | DEVICES | BODIES | {
    "channel", "slave", "numpy.random", "teleop.stages.watchdog", "teleop.stages.force_cap", "teleop.stages.observer",
}


@pytest.mark.parametrize("name", [
    name if name in ("canonical", "pose", "stick_slip") else pytest.param(name, marks=pytest.mark.full)
    for name in built_in_scenes()])
def test_a_built_in_scene(name: str, tmp_path: Path) -> None:
    knobs = knobs_of(name, tmp_path)
    modules = loaded_by(name, knobs, tmp_path)
    assert modules & OPTIONAL == named_by(load_scene(name, **knobs))
    assert not modules & NEVER


@pytest.mark.parametrize("name", ["hard_wall", pytest.param("canonical", marks=pytest.mark.full)])
@pytest.mark.parametrize("start", [("master", "--peer=127.0.0.1:9"), ("slave", "--listen=127.0.0.1:0")])
def test_a_live_end_loaded_the_catalogue_and_the_process_of_a_watchdog(start: tuple[str, str], name: str, tmp_path: Path
                                                                       ) -> None:
    end, where = start  # where nobody answers
    modules = loaded([end, name, where, "--wait=0.05", "--no-realtime"], tmp_path, 2)
    assert "teleop.live.driving" in modules
    guard = {"teleop.stages.watchdog", "teleop.stages.force_cap"}  # of every live end
    assert modules & OPTIONAL == named_by(load_scene(name)) | guard
    assert not modules & NEVER_LIVE


@pytest.mark.parametrize("name", ["virtual_coupling", pytest.param("virtual_wall", marks=pytest.mark.full)])
def test_a_one_port_scene_with_all_that_a_device_may_have(name: str, tmp_path: Path) -> None:
    knobs = {"duration": "0.02", "cap": "0.8", "f_max": "3", "b_e": "0.8"}
    modules = loaded_by(name, knobs, tmp_path)
    assert {"teleop.stages.passivity_controller", "teleop.stages.force_cap", "teleop.physics.relaxing"} <= modules
    assert modules & OPTIONAL == named_by(load_scene(name, **knobs))


@pytest.mark.parametrize(("change", "gained", "lost"), [
    ({"link": "bernoulli(0.1)"}, {"channel.bernoulli", "numpy.random"}, {"channel.gamma"}),
    ({"law": "pfra", "observer": "none"}, {"teleop.laws.pfra"}, {"teleop.stages.observer"}),
    pytest.param({"law": "pfra"}, {"teleop.laws.pfra", "teleop.stages.observer"}, set(), marks=pytest.mark.full),
])
def test_a_knob_turned(change: dict[str, str], gained: set[str], lost: set[str], tmp_path: Path) -> None:
    modules = loaded_by("canonical", {"duration": "0.02", **change}, tmp_path)
    assert gained <= modules
    assert not lost & modules
