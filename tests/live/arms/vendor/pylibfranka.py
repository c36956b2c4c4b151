"""A stand-in of pylibfranka 0.21: the classes, methods and fields that a torque control needs, as it documents them.

The joints are free masses; the robot's own rules hold: a torque for each state, no step of a torque above 1 N m. The
name of the host decides what happens, and the file FRANKA_LOG has the newest torques.
"""

import os
import time

INERTIA = 0.5  # kg m^2 of each joint


class FrankaException(Exception):
    pass


class NetworkException(RuntimeError):
    pass


class ControlException(RuntimeError):
    pass


class RealtimeConfig:
    kEnforce, kIgnore = "enforce", "ignore"


class Errors:
    communication_constraints_violation = False
    cartesian_reflex = False


class Duration:
    def to_sec(self):
        return 0.001


class RobotState:
    def __init__(self, robot):
        self.q, self.dq = list(robot.q), list(robot.dq)
        self.last_motion_errors = robot.errors
        # Its hand is where the first three joints say, in m: the Jacobian below is that of it.
        self.O_T_EE = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, *robot.q[:3], 1.0]


class Model:
    def zero_jacobian(self, state):
        return [1.0 if row == column and row < 3 else 0.0 for column in range(7) for row in range(6)]


class Torques:
    def __init__(self, tau_J):
        assert len(tau_J) == 7
        self.tau_J, self.motion_finished = list(tau_J), False


class ActiveControlBase:
    def __init__(self, robot):
        self.robot, self.waits = robot, False

    def readOnce(self):
        robot = self.robot
        time.sleep(0.001)
        for i in range(7):
            robot.dq[i] += 0.001 * robot.tau[i] / INERTIA
            robot.q[i] += 0.001 * robot.dq[i]
        robot.states += 1
        if robot.host == "lossy" and robot.states == 300:
            robot.errors.communication_constraints_violation = True
            raise ControlException("libfranka: Move command aborted: motion aborted by reflex! "
                                   '["communication_constraints_violation"]')
        if robot.host == "reflex" and robot.states == 300:
            robot.errors.cartesian_reflex = True
            raise ControlException('libfranka: Move command aborted: motion aborted by reflex! ["cartesian_reflex"]')
        self.waits = True
        return RobotState(robot), Duration()

    def writeOnce(self, command):
        assert self.waits, "a torque answers a state"
        self.waits = False
        if any(abs(a - b) > 1.0 for a, b in zip(command.tau_J, self.robot.tau, strict=True)):
            raise ControlException('libfranka: motion aborted by reflex! ["controller_torque_discontinuity"]')
        self.robot.tau = list(command.tau_J)
        self.robot.log(command.motion_finished)


class Robot:
    def __init__(self, robot_ip_address, realtime_config=RealtimeConfig.kEnforce):
        if robot_ip_address == "refused":
            raise NetworkException("libfranka: Connection to FCI refused. Please install FCI feature or enable FCI "
                                   "mode in Desk.")
        self.host, self.errors, self.states, self.is_moving = robot_ip_address, Errors(), 0, False
        self.q, self.dq, self.tau = [0.0] * 7, [0.0] * 7, [0.0] * 7

    def load_model(self):
        return Model()

    def read_once(self):
        return RobotState(self)

    def automatic_error_recovery(self):
        self.errors = Errors()

    def start_torque_control(self):
        self.tau = [0.0] * 7
        return ActiveControlBase(self)

    def log(self, finished):
        path = os.environ.get("FRANKA_LOG")
        if path:
            with open(f"{path}.new", "w") as file:
                file.write(" ".join(map(str, [int(finished), *self.tau])))
            os.replace(f"{path}.new", path)
