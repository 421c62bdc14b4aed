"""How a wheeled robot stands on rough ground, without dynamics."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from infomap_ros.errors import RobotModelError
from infomap_ros.geometry import invert_transform, make_transform, transform_points
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.simulation.body.robot import RobotState
from infomap_ros.simulation.worlds.terrain import Terrain

import mujoco  # isort: skip  # after the backend has been chosen

WHEEL_SUFFIX = "_wheel"
_SETTLING_STEPS = 4


class Chassis:
    """Wheels of a robot and the pose in which they stand on a terrain.

    Args:
        model: the compiled world.
        data: its state; the robot is moved by it.
        robot: the robot in it; links named ``*_wheel`` are its wheels.
        prefix: as given to `robot.add_robot`.

    Raises:
        RobotModelError: the robot has fewer than three wheels.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        robot: RobotState,
        prefix: str = "rover/",
    ) -> None:
        names = [model.body(index).name for index in range(model.nbody)]
        self.wheels = tuple(
            name[len(prefix) :]
            for name in names
            if name.startswith(prefix) and name.endswith(WHEEL_SUFFIX)
        )
        if len(self.wheels) < 3:
            raise RobotModelError(f"the robot has {len(self.wheels)} wheels, expected at least 3")
        robot.place(np.eye(4), {})
        self._axles = np.stack([robot.frame(wheel)[:3, 3] for wheel in self.wheels])
        first_geom = int(model.body(prefix + self.wheels[0]).geomadr[0])
        self.wheel_radius = float(model.geom_size[first_geom, 0])

    def rest(self, terrain: Terrain, x: float, y: float, heading: float) -> FloatArray:
        """Pose in which the wheels stand on the ground, in the least squares sense.

        Args:
            terrain: the ground.
            x: of the base's origin [m].
            y: of the base's origin [m].
            heading: yaw [rad].

        Returns:
            ``T_world_base``, shape (4, 4).
        """
        axles = self._axles - self._axles.mean(axis=0)
        turn = Rotation.from_euler("z", heading).as_matrix()
        pose = make_transform(turn, (x, y, float(terrain.height((x, y))) + self.wheel_radius))
        for _ in range(_SETTLING_STEPS):
            world = transform_points(pose, self._axles)
            gap = terrain.height(world[:, :2]) + self.wheel_radius - world[:, 2]
            design = np.column_stack([np.ones(len(axles)), axles[:, :2]])
            lift, slope_x, slope_y = np.linalg.lstsq(design, gap, rcond=None)[0]
            tilt = Rotation.from_euler("yx", (-np.arctan(slope_x), np.arctan(slope_y)))
            pose[:3, :3] = pose[:3, :3] @ tilt.as_matrix()
            pose[2, 3] += lift
        return pose

    def wheel_turn(self, previous: FloatArray, present: FloatArray) -> dict[str, float]:
        """Turn of each wheel [rad] on the way between two base poses, without slip."""
        local = transform_points(invert_transform(previous) @ present, self._axles) - self._axles
        return {
            f"{wheel}_joint": float(way[0] / self.wheel_radius)
            for wheel, way in zip(self.wheels, local, strict=True)
        }
