"""A Franka arm by pylibfranka: `franka:HOST`, seven joint torques or a force at its hand, from a process of its own.

    python -m slave bench_top --set axes=3 --robot "franka:172.16.0.2?axes=xyz" --listen 0.0.0.0:9001

The robot wants a torque every millisecond, and pylibfranka's calls wait for that with the interpreter's lock held, so
they would stop a tick. A process beside the end makes them; the two share a page of memory. It holds zero when the end
has renewed no force for 0.1 s, is stopped or gone; and should the process itself be gone, the robot stops by itself
after 20 packets without an answer.
"""

from __future__ import annotations

import gc
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from importlib.util import find_spec
from mmap import mmap
from time import monotonic, monotonic_ns, sleep
from typing import Any

from teleop.errors import DeviceError, Refused, number_of
from teleop.live.devices.device_watchdog import memory_page, module_path
from teleop.live.devices.settings import axes_of, for_each, numbers, one_of, settings_of, within
from teleop.live.process.realtime import run_first
from teleop.protocol.endpoint import Axes, Reading
from teleop.protocol.guard import DEADLINE
from teleop.scene.scene import Scene

if find_spec("pylibfranka") is None:  # the process alone loads it
    raise ImportError("a Franka is reached by pylibfranka, which is not installed; type pip install "
                      "'bilateral-teleop[franka]', or pip install pylibfranka")
EXAMPLE = "franka:172.16.0.2"
JOINTS = 7
SIZE = 4096  # bytes of the page: whole numbers, then reals, then a sentence
BEAT, ORDERS, STATES, STAMP, LEAVING, TROUBLE = range(6)  # whole numbers
COMMAND, X, V = 32, 48, 64  # where the reals of each begin
TEXT = 1024  # bytes before the sentence
LAPSE_NS = 100_000_000  # a force that was not renewed is let go of
STALE_NS = 20_000_000  # a state is no longer where the arm is
START_S, END_S = 20.0, 3.0  # for the robot to be reached, and for the process to end
AGAIN_S = 0.25  # between two attempts to go on after a lost connection
TRIES = 1000  # to read a state that is being written
SLEW = 0.9  # N m in a millisecond; the robot takes 1 at most
PRIORITY = 80  # asked for under SCHED_FIFO
READERS = {"axes": axes_of, "limit": numbers, "damping": within(0.0, 20.0), "realtime": one_of("enforce", "ignore")}
LIMIT = {True: 20.0, False: 10.0}  # N at the hand, N m at a joint: chosen, not the robot's own


class FrankaArm:
    """A Franka arm. `push`: 1.0 at the slave, -1.0 at the master, whose motors push against the hand.

    A command is cut to `limit`. `damping` (N m s/rad) of each joint is added by the process at 1 kHz.
    """

    deadline = DEADLINE
    senses = False
    weightless = True  # the robot carries its arm itself

    def __init__(self, scene: Scene, argument: str, push: float) -> None:
        """Raises `Refused` for what it cannot drive, `DeviceError` if the robot is not reached."""
        self.host, settings = settings_of("franka", argument, READERS, EXAMPLE)
        self._axes: tuple[tuple[int, float], ...] | None = settings.get("axes")
        _check_scene(scene, self._axes)
        is_cartesian = self._axes is not None
        self._limits = for_each("franka's limit", settings.get("limit", (LIMIT[is_cartesian],)), scene.axes)
        self._push = push
        self._file = memory_page("franka")
        self._page = mmap(self._file.fileno(), SIZE)
        plain = memoryview(self._page)
        self._words, self._reals = plain.cast("q"), plain.cast("d")
        about = {"host": self.host, "page": self._file.fileno(), "end": os.getpid(), "axes": self._axes,
                 "damping": settings.get("damping", 0.0), "ignore": settings.get("realtime") == "ignore"}
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "teleop.live.devices.arms.franka", json.dumps(about)], start_new_session=True,
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, pass_fds=(self._file.fileno(),),
            env={**os.environ, "PYTHONPATH": module_path()})
        until = monotonic() + START_S
        while not self._words[STATES]:
            gone = self._process.poll() is not None
            if gone or monotonic() > until:
                why = self._trouble() or (f"its process ended with exit code {self._process.returncode}" if gone else
                                          f"it gave no state in {START_S:g} s")
                self._drop()
                raise DeviceError(f"the Franka at {self.host} cannot be driven: {why}")
            sleep(0.005)

    def read(self, k: int) -> Reading:
        """Newest state, at most some milliseconds old. Raises `DeviceError` where there is none."""
        words, reals, n = self._words, self._reals, len(self._limits)
        whole = False
        for _ in range(TRIES):
            before = words[STATES]
            x, v = tuple(reals[X:X + n]), tuple(reals[V:V + n])
            if whole := before % 2 == 0 and words[STATES] == before:
                break
        if self._process.poll() is not None:
            raise DeviceError(f"the process that drives the Franka at {self.host} ended"
                              f"{f': {self._trouble()}' if words[TROUBLE] else ''}")
        if words[TROUBLE]:
            raise DeviceError(f"the Franka at {self.host} stopped: {self._trouble()}")
        if not whole or monotonic_ns() - words[STAMP] > STALE_NS:
            raise DeviceError(f"the Franka at {self.host} gave no state for {STALE_NS / 1e6:g} ms")
        return Reading(x, v)

    def hold(self, force: Axes) -> None:
        """Hold this force (N) or these torques (N m) from the robot's next millisecond on."""
        reals, words = self._reals, self._words
        words[ORDERS] += 1  # odd while it is written
        for i, (each, most) in enumerate(zip(force, self._limits, strict=True)):
            reals[COMMAND + i] = max(-most, min(most, self._push * each))
        words[ORDERS] += 1
        words[BEAT] = monotonic_ns()
        if words[TROUBLE] and any(force):
            raise DeviceError(f"the Franka at {self.host} stopped: {self._trouble()}")

    def close(self) -> None:
        """Hold nothing, and end the motion. Raises `DeviceError` if the process does not end."""
        if self._file.closed:
            return
        self._words[LEAVING] = 1
        try:
            self._process.wait(END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
            raise DeviceError(f"the process that drives the Franka at {self.host} did not end and was killed: the "
                              "robot stops by itself") from None
        finally:
            self._drop()

    def _trouble(self) -> str:
        return bytes(self._page[TEXT:]).partition(b"\0")[0].decode(errors="replace")

    def _drop(self) -> None:
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()
        self._words.release()
        self._reals.release()
        self._file.close()


def _check_scene(scene: Scene, axes: tuple[tuple[int, float], ...] | None) -> None:
    units = set(scene.axis_units)
    if axes is None and (scene.axes != JOINTS or units != {"rad"}):
        raise Refused(f"a Franka has {JOINTS} joints, and the scene {number_of(scene.axes, 'axis', 'axes')} in "
                      f"{' and '.join(sorted(units))}; take a scene of 7 axes in rad, for example bench_top with --set "
                      "axes=7 --set units=rad, or drive its hand by ?axes=xyz")
    if axes is not None and (scene.axes != len(axes) or units != {"m"}):
        raise Refused(f"the scene has {number_of(scene.axes, 'axis', 'axes')} in {' and '.join(sorted(units))}, and "
                      f"?axes= names {len(axes)} of a Franka's hand, in m; name one for each axis of the scene")


def franka_device(scene: Scene, host: str) -> FrankaArm:
    """A Franka arm at the master's end, franka:HOST; see teleop/live/devices/arms/README.md."""
    return FrankaArm(scene, host, -1.0)


def franka_robot(scene: Scene, host: str) -> FrankaArm:
    """A Franka arm at the slave's end, franka:HOST; see teleop/live/devices/arms/README.md."""
    return FrankaArm(scene, host, 1.0)


class Driving:
    """The process's side: a torque for each state of the robot. `words` and `reals`: the page."""

    def __init__(self, words: Any, reals: Any, axes: list[list[float]] | None, damping: float,
                 clock: Callable[[], int] = monotonic_ns) -> None:
        self.words, self.reals, self.damping, self.clock = words, reals, damping, clock
        self.rows = None if axes is None else [(int(i), sign) for i, sign in axes]
        self.applied = [0.0] * JOINTS
        self.command = [0.0] * (JOINTS if self.rows is None else len(self.rows))

    def torques(self, state: Any, model: Any, *, leaves: bool) -> list[float]:
        """Publish a state, and return the torques that answer it: slewed, zero where nobody has renewed them."""
        words, reals, dq = self.words, self.reals, state.dq
        jacobian = None if self.rows is None else model.zero_jacobian(state)  # 6 x 7, by columns
        now = self.clock()
        words[STATES] += 1
        if jacobian is None:
            reals[X:X + JOINTS], reals[V:V + JOINTS] = _doubles(state.q), _doubles(dq)
        else:
            pose = state.O_T_EE
            for n, (i, sign) in enumerate(self.rows or ()):
                reals[X + n] = sign * pose[12 + i]
                reals[V + n] = sign * sum(jacobian[6 * j + i] * dq[j] for j in range(JOINTS))
        words[STAMP] = now
        words[STATES] += 1
        before = words[ORDERS]
        if before % 2 == 0:
            command = list(reals[COMMAND:COMMAND + len(self.command)])
            if words[ORDERS] == before:
                self.command = command
        if leaves or now - words[BEAT] > LAPSE_NS:
            self.command = [0.0] * len(self.command)
        if jacobian is None:
            wanted = self.command
        else:
            force = [0.0, 0.0, 0.0]
            for (i, sign), each in zip(self.rows or (), self.command, strict=True):
                force[i] = sign * each
            wanted = [sum(jacobian[6 * j + i] * force[i] for i in range(3)) for j in range(JOINTS)]
        damped = [0.0 if leaves else -self.damping * each for each in dq]
        self.applied = [was + max(-SLEW, min(SLEW, new + drag - was))
                        for was, new, drag in zip(self.applied, wanted, damped, strict=True)]
        return self.applied


def _doubles(values: Any) -> memoryview:
    from array import array

    return memoryview(array("d", values))


def main(argv: list[str]) -> int:
    """The whole process; its exit code."""
    import pylibfranka as franka

    about = json.loads(argv[0])
    for each in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(each, signal.SIG_IGN)
    with mmap(about["page"], SIZE) as page, memoryview(page) as plain, plain.cast("q") as words, (
            plain.cast("d")) as reals:
        driving = Driving(words, reals, about["axes"], about["damping"])

        def report(error: Exception) -> None:
            sentence = " ".join(str(error).split()).encode()[:SIZE - TEXT - 1]
            page[TEXT:SIZE] = sentence + bytes(SIZE - TEXT - len(sentence))
            words[TROUBLE] = 1

        def leaves() -> bool:
            return bool(words[LEAVING]) or os.getppid() != about["end"]

        try:
            robot = franka.Robot(about["host"], franka.RealtimeConfig.kIgnore if about["ignore"] else
                                 franka.RealtimeConfig.kEnforce)
            model = robot.load_model()
        except (RuntimeError, franka.FrankaException) as error:
            report(error)
            return 2
        with suppress(OSError, AttributeError):
            run_first(PRIORITY)
        gc.disable()
        while True:
            try:
                _drive(franka, robot, model, driving, leaves)
                return 0
            except (RuntimeError, franka.FrankaException) as error:
                driving.applied = [0.0] * JOINTS
                report(error)
                if leaves() or not _recovers(robot):
                    return 1
                sleep(AGAIN_S)


def _drive(franka: Any, robot: Any, model: Any, driving: Driving, leaves: Callable[[], bool]) -> None:
    """Answer each state with torques until the end leaves, which sets them to zero and ends the motion."""
    control = robot.start_torque_control()
    while True:
        state, _ = control.readOnce()
        over = leaves()
        command = franka.Torques(driving.torques(state, model, leaves=over))
        command.motion_finished = over and not any(driving.applied)
        control.writeOnce(command)
        driving.words[TROUBLE] = 0
        if command.motion_finished:
            return


def _recovers(robot: Any) -> bool:
    """Clear what a lost packet has left; a reflex, such as a collision, is left to whoever stands at the robot."""
    try:
        errors = robot.read_once().last_motion_errors
        if not errors.communication_constraints_violation:
            return False
        robot.automatic_error_recovery()
    except Exception:
        return False
    return True


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
