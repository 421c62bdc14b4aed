"""Another robot in the world of a simulated one: it is seen, touched, and in the way.

Each robot is simulated for itself, in a copy of the world. The others stand in it as bodies without
dynamics, which are put where their own simulations have them.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from infomap_ros.errors import RobotModelError
from infomap_ros.geometry import invert_transform, make_transform, quaternion_from_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.simulation.body.robot import attach_robot, load_robot

import mujoco  # isort: skip  # after the backend has been chosen

_NOWHERE = (0.0, 0.0, -1000.0)  # [m] until it is placed


def add_teammate(spec: mujoco.MjSpec, description: str, prefix: str, material: str = "") -> None:
    """Put another robot into a world that is being built, moved by nothing but `TeammateBody`.

    Args:
        spec: the world.
        description: URDF text of the other robot.
        prefix: of its names.
        material: name of a material of `spec` that textures it.

    Raises:
        RobotModelError: MuJoCo cannot read the description.
    """
    robot = load_robot(description)
    for joint in list(robot.joints):
        robot.delete(joint)
    root = attach_robot(spec, robot, prefix, material)
    root.mocap = True
    root.pos = _NOWHERE


class TeammateBody:
    """Places another robot in a compiled world.

    Args:
        model: the world, to which `add_teammate` has added it.
        data: state of the world.
        description: URDF text of the other robot.
        prefix: of its names.
        base_frame: link whose pose is its pose.

    Attributes:
        placement: all that `place` was told, to see whether it has moved, shape (K,).

    Raises:
        RobotModelError: it has no link `base_frame`.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        description: str,
        prefix: str,
        base_frame: str,
    ) -> None:
        self._model, self._data = model, data
        self._alone = load_robot(description).compile()
        self._posture = mujoco.MjData(self._alone)
        links = [self._alone.body(index).name for index in range(1, self._alone.nbody)]
        if base_frame not in links:
            raise RobotModelError(f"the robot '{prefix}' has no frame '{base_frame}'")
        self._base = 1 + links.index(base_frame)
        self._bodies = [0] + [int(model.body(prefix + link).id) for link in links]
        self._mocap = int(model.body_mocapid[self._bodies[1]])
        self._joints = {
            self._alone.joint(index).name: int(self._alone.joint(index).qposadr[0])
            for index in range(self._alone.njnt)
        }
        self.placement: FloatArray = np.zeros(0)

    def place(self, T_world_base: FloatArray, joints: Mapping[str, float]) -> None:
        """Put it somewhere, in a posture.

        Args:
            T_world_base: pose of its base, shape (4, 4).
            joints: positions by name [rad or m]; of joints that are not named, the last ones.

        Raises:
            RobotModelError: a joint is unknown.
        """
        for name, position in joints.items():
            if name not in self._joints:
                raise RobotModelError(f"unknown joint: {name}")
            self._posture.qpos[self._joints[name]] = position
        placement = np.concatenate([np.ravel(T_world_base), self._posture.qpos])
        if np.array_equal(placement, self.placement):
            return
        self.placement = placement
        mujoco.mj_kinematics(self._alone, self._posture)
        root = T_world_base @ invert_transform(self._link(self._base)) @ self._link(1)
        x, y, z, w = quaternion_from_transform(root)
        self._data.mocap_pos[self._mocap] = root[:3, 3]
        self._data.mocap_quat[self._mocap] = w, x, y, z
        self._bend()
        mujoco.mj_kinematics(self._model, self._data)

    def _bend(self) -> None:
        """Put every link where it is relative to the one that carries it."""
        inverse, turn = np.zeros(4), np.zeros(4)
        posture = self._posture
        for link in range(2, self._alone.nbody):
            carrier, body = int(self._alone.body_parentid[link]), self._bodies[link]
            offset = posture.xpos[link] - posture.xpos[carrier]
            mujoco.mju_negQuat(inverse, posture.xquat[carrier])
            mujoco.mju_mulQuat(turn, inverse, posture.xquat[link])
            self._model.body_pos[body] = posture.xmat[carrier].reshape(3, 3).T @ offset
            self._model.body_quat[body] = turn

    def _link(self, link: int) -> FloatArray:
        posture = self._posture
        return make_transform(posture.xmat[link].reshape(3, 3), posture.xpos[link])
