"""Side view of a MuJoCo model: outlines of its geometry once, and where they are at the positions of a row.

The picture's plane is upright: its second direction is the world's z, its first the horizontal one in which the robot
reaches furthest from its base in the pose that it begins in. A row has the positions of the scene's axes. Where those
are joints they are the pose. Where they are translations of an end effector, the joints that carry it are found from
the pose before, by damped least squares (Wampler, "Manipulator inverse kinematic solutions based on vector formulations
and damped least-squares methods", IEEE Trans. Systems, Man and Cybernetics 16 (1986)).
"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, pi, sin, sqrt
from typing import TYPE_CHECKING, Any

from teleop.scene.library import import_bundled
from teleop.scene.scene import Scene

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

DIRECTIONS = 48  # of the sphere: of a mesh the vertices that are furthest in one of them
ROUND = 12  # points of a cylinder's edge
STEPS, CLOSE = 20, 1e-5  # of least squares; m
LONGEST = 0.1  # m of a step: where a robot cannot reach, a longer one would swing it to and fro
DAMPING = 1e-4  # m^2, beside J J^T
SHOWN = 3  # groups of geoms that a viewer of MuJoCo shows unless it is asked for others
ROOM = 1.5  # of the view beside what it has to show


class SideView:
    """Side view of the model in `robot` (`mujoco` or `mujoco:FILE`) as it stands in a scene. Raises `Refused`.

    `shapes`, for the page: points (m, of the geom's frame) that a disc of `radius` is swept around; `world`: what
    stands still, in the picture's own frame; the view, of the pose that the model begins in.
    """

    def __init__(self, scene: Scene, robot: str) -> None:
        import mujoco
        import numpy as np

        load = import_bundled("slave.mujoco_model").load
        self._mujoco, self._model = mujoco, load(scene, robot.partition(":")[2] or None)
        model = self._model.model
        self._data = mujoco.MjData(model)
        self._data.qpos[:] = self._model.qpos
        self._joints = [int(model.jnt_dofadr[joint]) for joint in self._model.robot.joints]
        self._places = [int(model.jnt_qposadr[joint]) for joint in self._model.robot.joints]
        mujoco.mj_kinematics(model, self._data)
        self._flat = (int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_HFIELD))  # without an end to draw
        geoms = sorted(self._model.robot.geoms)
        roots = {int(model.body_rootid[body]) for body in model.geom_bodyid[geoms]}
        self._geoms = [n for n in geoms if model.geom_group[n] < SHOWN and model.geom_rgba[n, 3] > 0] or geoms
        base = np.mean([self._data.xpos[root] for root in roots], axis=0)
        far = max((self._data.geom_xpos[n] - base for n in self._geoms), key=lambda way: float(np.hypot(*way[:2])))
        along = far[:2] / max(float(np.hypot(*far[:2])), 1e-9) if np.hypot(*far[:2]) > 1e-6 else np.array([1.0, 0.0])
        self._plane: NDArray[np.float64] = np.array([[*along, 0.0], [0.0, 0.0, 1.0]])
        self._target = None if self._model.tip is None else self._data.xpos[self._model.tip].copy()
        self.shapes = self._outlines()

    def poses(self, m: Sequence[float], s: Sequence[float]) -> list[list[list[float]]]:
        """Poses of all outlines, as six numbers each: two rows of a rotation and the place in the picture.

        Of the robot at the slave's positions `s`; where the axes are joints, of its picture at the master's, `m`, too.
        """
        return [self._pose(positions) for positions in ([s] if self._model.tip is not None else [s, m])]

    def _outlines(self) -> dict[str, Any]:
        import numpy as np

        points = [_points(self._mujoco, self._model.model, n) for n in self._geoms]
        seen = np.array([(low, high) for low, high in (self._box(n, outline) for n, outline in
                                                      zip(self._geoms, points, strict=True))])
        low, high = seen[:, 0].min(axis=0), seen[:, 1].max(axis=0)
        world = [(n, *_points(self._mujoco, self._model.model, n)) for n in range(self._model.model.ngeom)
                 if int(self._model.model.geom_bodyid[n]) == 0 and self._model.model.geom_type[n] not in self._flat]
        return {"shapes": [{"radius": radius, "points": np.round(at, 5).tolist()} for radius, at in points],
                "world": [{"radius": radius, "points": self._seen(n, at).round(5).tolist()} for n, radius, at in world],
                "middle": ((low + high) / 2.0).round(5).tolist(), "span": float(ROOM * max(high - low))}

    def _pose(self, positions: Sequence[float]) -> list[list[float]]:
        self._place(positions)
        return [[round(float(number), 5) for number in
                 [*(self._plane @ self._data.geom_xmat[n].reshape(3, 3)).ravel(),
                  *(self._plane @ self._data.geom_xpos[n])]] for n in self._geoms]

    def _place(self, positions: Sequence[float]) -> None:
        """Bring the model to the positions of the scene's axes."""
        import numpy as np

        model, data = self._model.model, self._data
        if self._target is None:
            data.qpos[self._model.places] = positions
            self._mujoco.mj_kinematics(model, data)
            return
        target = self._target.copy()
        for i, at, zero in zip(self._model.axes, positions, self._model.zero, strict=True):
            if i < len(target):  # its turns are not seen
                target[i] = at + zero
        jacobian = np.zeros((3, model.nv))
        for _ in range(STEPS):
            self._mujoco.mj_kinematics(model, data)
            error = target - data.xpos[self._model.tip]
            if float(np.abs(error).max()) < CLOSE:
                return
            self._mujoco.mj_comPos(model, data)
            self._mujoco.mj_jacBody(model, data, jacobian, None, self._model.tip)
            error *= min(1.0, LONGEST / float(np.linalg.norm(error)))
            of = jacobian[:, self._joints]
            data.qpos[self._places] += of.T @ np.linalg.solve(of @ of.T + DAMPING * np.eye(3), error)

    def _box(self, n: int, outline: tuple[float, NDArray[np.float64]]) -> tuple[Any, Any]:
        radius, seen = outline[0], self._seen(n, outline[1])
        return seen.min(axis=0) - radius, seen.max(axis=0) + radius

    def _seen(self, n: int, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points of a geom in the picture, as the model stands."""
        seen: NDArray[np.float64] = (
            points @ self._data.geom_xmat[n].reshape(3, 3).T + self._data.geom_xpos[n]) @ self._plane.T
        return seen


def _points(mujoco: Any, model: Any, n: int) -> tuple[float, NDArray[np.float64]]:
    """Radius and points of a geom, m: their hull, with a disc of that radius swept around it, is its outline."""
    import numpy as np

    kind, (a, b, c) = int(model.geom_type[n]), model.geom_size[n].tolist()
    kinds = mujoco.mjtGeom
    if kind == kinds.mjGEOM_SPHERE:
        return a, np.zeros((1, 3))
    if kind == kinds.mjGEOM_CAPSULE:
        return a, np.array([[0.0, 0.0, -b], [0.0, 0.0, b]])
    if kind == kinds.mjGEOM_CYLINDER:
        edge = [(a * cos(2.0 * pi * i / ROUND), a * sin(2.0 * pi * i / ROUND)) for i in range(ROUND)]
        return 0.0, np.array([[x, y, z] for x, y in edge for z in (-b, b)])
    if kind == kinds.mjGEOM_ELLIPSOID:
        return 0.0, _sphere() * [a, b, c]
    if kind == kinds.mjGEOM_MESH:
        mesh = int(model.geom_dataid[n])
        first = int(model.mesh_vertadr[mesh])
        vertices = model.mesh_vert[first:first + int(model.mesh_vertnum[mesh])].astype(float)
        return 0.0, vertices[np.unique((vertices @ _sphere().T).argmax(axis=0))]
    return 0.0, np.array([[x, y, z] for x in (-a, a) for y in (-b, b) for z in (-c, c)])  # a box


def _sphere() -> NDArray[np.float64]:
    """Points all over a unit sphere, on a spiral of golden turns."""
    import numpy as np

    z = np.linspace(1.0, -1.0, DIRECTIONS)
    turn = pi * (3.0 - sqrt(5.0)) * np.arange(DIRECTIONS)
    return np.stack([np.sqrt(1.0 - z * z) * np.cos(turn), np.sqrt(1.0 - z * z) * np.sin(turn), z], axis=1)
