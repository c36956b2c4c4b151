"""Digests of what the stack answers, to hold beside those of another worktree: has a change of shape changed a number?

    python -m tests.digests TREE

runs every case by this worktree's code and by that of TREE, and prints the cases that differ; exit code 1 if any do.
Cases: traces and summaries of scenes, laws, stages and links in virtual time, the figures of sweeps in every engine,
and the JSON of commands, without times and versions. `--tick` compares the generated text of the ticks too.
"""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
from argparse import ArgumentParser
from collections.abc import Callable, Iterator
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

ROOT = Path(__file__).parents[1]
ROUGH = "delay(0.02) | uniform(0.015) | bernoulli(0.05)"
SCENES = ("arm", "beating_heart", "bench_top", "blackout", "burst_loss", "canonical", "encoder_wall", "free_motion",
          "hard_wall", "jittery_wan", "leader_follower", "local", "pose", "recorded_reach", "relaxing_tissue", "rubber",
          "satellite", "soft_tissue", "stick_slip", "virtual_coupling", "virtual_wall")
LAWS = ("direct", "four_channel", "iss", "model_mediated", "p_d", "pd_d", "pfra", "pp", "pspm", "tdpa", "two_layer",
        "wave", "wave_filter", "wave_matched", "wave_position", "wave_prediction", "wave_scaled",
        "guard | direct", "virtual_coupling | p_d", "deadband(0.1) | wave", "guard | deadband(0.1) | pp")
KNOBS: dict[str, dict[str, Any]] = {  # of hard_wall
    "rough": {"link": ROUGH}, "zero": {"link": ROUGH, "playout": "zero"}, "hold": {"link": ROUGH, "playout": "hold"},
    "energy": {"link": ROUGH, "playout": "energy"}, "fixed": {"link": ROUGH, "playout": "fixed:0.04"},
    "skipping": {"left_out": 0.2}, "skipping, rough": {"left_out": 0.2, "link": ROUGH},
    "deadband": {"deadband": 0.05}, "deadband, rough, skipping": {"deadband": 0.05, "link": ROUGH, "left_out": 0.1},
    "scaled": {"scale_x": 0.5, "scale_f": 2.0, "link": ROUGH}, "clutch": {"clutch_ramp": 0.05},
    "bounded": {"x_limit": 0.04}, "capped": {"f_max": 2.0, "slew": 50.0, "v_max": 0.05, "power": 0.01},
    "free": {"timeout": None, "f_max": None, "slew": None, "observer": None, "energy": False},
    "no wall": {"k_e": 0.0, "d_e": 0.0}, "slow": {"delay": 0.5}, "coarse": {"dt": 0.004},
}
IN_SWEEPS = ("canonical", "hard_wall", "arm", "pose", "leader_follower", "blackout", "virtual_wall", "encoder_wall",
             "soft_tissue", "stick_slip")
COMMANDS = (
    "list --json", "list laws --json", "list hard_wall --json", "show tick hard_wall", "show tick arm --end m",
    "manifest hard_wall --json", "stability canonical --json", "passivity canonical --json",
    "passivity virtual_wall --json", "zwidth virtual_wall --quick --json", "zwidth virtual_coupling --json",
    "precision canonical --json", "run hard_wall --json", "run arm --json",
    "sweep canonical --grid delay=0.01,0.1 --grid law=wave,direct --seeds 3 --json", "matrix --json",
    "compare --laws wave,pp --links 'delay(0.05)' --json", "tune wave --scene canonical --budget 60 --json",
)
TIMES = frozenset(("run_time", "time", "versions", "command", "seconds", "rows_per_second", "elapsed", "workers"))


def plain_cases(duration: float) -> Iterator[tuple[str, str, dict[str, Any], int]]:
    """Name, scene, knobs and seed of each run."""
    for name in SCENES:
        yield f"scene {name}", name, {"duration": duration}, 0
    for law in LAWS:
        yield f"law {law}", "hard_wall", {"law": law, "duration": duration}, 1
        yield f"law {law}, rough", "hard_wall", {"law": law, "duration": duration, "link": ROUGH, "left_out": 0.1}, 2
    for name, knobs in KNOBS.items():
        yield f"hard_wall {name}", "hard_wall", {"duration": duration, **knobs}, 3


def without_times(document: Any) -> Any:
    """A JSON document without what differs from run to run."""
    if isinstance(document, dict):
        return {key: without_times(value) for key, value in document.items() if key not in TIMES}
    return [without_times(each) for each in document] if isinstance(document, list) else document


def digest(*parts: bytes | str) -> str:
    """A short name for these."""
    total = sha256()
    for part in parts:
        total.update(part.encode() if isinstance(part, str) else part)
    return total.hexdigest()[:16]


def of_run(scene: str, knobs: dict[str, Any], seed: int) -> str:
    """That of one run in virtual time."""
    from teleop import load_scene, run

    result = run(load_scene(scene, **knobs), seed=seed)
    summary = json.dumps(without_times(result.summary()), sort_keys=True).replace(os.getcwd(), "")
    return digest(summary, *[part for name in sorted(result.trace) for part in (name, result.trace[name].tobytes())])


def of_sweep(scene: str, knobs: dict[str, Any], engine: str) -> str:
    """That of twelve rows with every metric, of several seeds."""
    from teleop import load_scene, sweep
    from teleop.sweeps.kernels.kernel import available

    names = sorted(available(load_scene(scene, **knobs)))
    table = sweep(scene, {"duration": [0.4]}, seeds=range(12), fixed=knobs, engine=engine, metrics=names)
    return digest(*[part for name in ("status", "ticks", *names) for part in (name, repr(list(table[name])))])


def of_tick(scene: str, knobs: dict[str, Any]) -> str:
    """That of the text of the loop and of both ends."""
    from teleop import load_scene
    from teleop.simulation.source import rendered

    made = load_scene(scene, **knobs)
    return digest(*[rendered(made, e) for e in ((None,) if made.slave is None else (None, "m", "s"))])


def of_command(line: str) -> str:
    """That of what a command prints."""
    with TemporaryDirectory() as folder:
        done = subprocess.run([sys.executable, "-m", "teleop", *shlex.split(line)], cwd=folder, text=True,
                              capture_output=True, check=False)
    try:
        return digest(str(done.returncode), json.dumps(without_times(json.loads(done.stdout)), sort_keys=True))
    except ValueError:
        return digest(str(done.returncode), done.stdout)


def cases(tick: bool, duration: float) -> Iterator[tuple[str, Callable[[], str]]]:
    """Every case, and what works its digest out."""
    for name, scene, knobs, seed in plain_cases(duration):
        yield f"run: {name}", lambda scene=scene, knobs=knobs, seed=seed: of_run(scene, knobs, seed)
        if tick:
            yield f"tick: {name}", lambda scene=scene, knobs=knobs: of_tick(scene, knobs)
    rows = [*[(name, name, {}) for name in IN_SWEEPS], *[
        (f"hard_wall {name}", "hard_wall", knobs) for name, knobs in KNOBS.items() if name != "coarse"]]
    rows += [(f"law {law}", "canonical", {"law": law, "link": ROUGH}) for law in LAWS]
    for name, scene, knobs in rows:
        for engine in ("plain", "c", "vector"):
            yield f"sweep: {name}, {engine}", lambda scene=scene, knobs=knobs, engine=engine: of_sweep(
                scene, knobs, engine)
    for line in COMMANDS:
        yield f"command: {line}", lambda line=line: of_command(line)


def main() -> int:
    """Compare this worktree with another; as a child, print the digests of one."""
    parser = ArgumentParser(prog="python -m tests.digests", description=__doc__)
    parser.add_argument("tree", nargs="?", type=Path, help="the other worktree; left out: print this one's digests")
    parser.add_argument("--only", default="", help="cases whose name contains this")
    parser.add_argument("--tick", action="store_true", help="the generated text of the ticks too")
    parser.add_argument("--duration", type=float, default=1.5, help="of each run, s; default 1.5")
    args = parser.parse_args()
    if args.tree is None:
        for name, work in cases(args.tick, args.duration):
            if args.only in name:
                try:
                    found = work()
                except Exception as error:
                    found = f"{type(error).__name__}: {error}"
                print(json.dumps([name, found]), flush=True)
        return 0
    options = ["--only", args.only, "--duration", str(args.duration), *["--tick"] * args.tick]
    running = [subprocess.Popen([sys.executable, "-P", __file__, *options], cwd=tree, stdout=subprocess.PIPE, text=True,
                                env={**os.environ, "PYTHONPATH": str(tree)}) for tree in (ROOT, args.tree.absolute())]
    here, there = [dict(map(json.loads, each.communicate()[0].splitlines())) for each in running]
    differing = [name for name in {**here, **there} if here.get(name) != there.get(name)]
    for name in differing:
        print(f"{name}: {here.get(name)} here, {there.get(name)} there")
    refused = sum(":" in value for value in here.values())
    print(f"{len(here)} cases, {len(differing)} differ, {refused} end in an error at both")
    return 1 if differing else 0


if __name__ == "__main__":
    sys.exit(main())
