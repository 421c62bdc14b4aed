"""The place where a robot begins: its operator has seen that nothing stands there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from infomap_ros.geometry import Cylinder, PlacedSolid, make_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.terrain.terrain import Terrain
from infomap_ros.motion.arm.camera_heights import camera_heights, robot_bottom
from infomap_ros.motion.base.standing_ground import with_standing_ground
from infomap_ros.motion.base.vehicle import Vehicle
from infomap_ros.motion.robot.robot_model import RobotModel

_ABOVE = 0.1  # the highest camera [m]


@dataclass(frozen=True, eq=False)
class ClearStart:
    """Space about the first place of the base that is declared clear, and its ground even.

    A robot sees neither the ground under and next to it nor the space about its arm. Without such
    a declaration it could move nothing. What the map knows there counts for more.

    Attributes:
        T_map_base: first pose of the base, shape (4, 4).
        radius: about the base's origin [m].
    """

    T_map_base: FloatArray
    radius: float

    def space(self, robot: RobotModel) -> PlacedSolid:
        """The clear space: from the ground to above the highest camera, map frame."""
        height = camera_heights(robot)[1] + _ABOVE
        center = make_transform(np.eye(3), (0.0, 0.0, robot_bottom(robot) + 0.5 * height))
        return PlacedSolid(Cylinder(self.radius, height), self.T_map_base @ center, "start")

    def ground(self, terrain: Terrain, vehicle: Vehicle) -> Terrain:
        """The terrain with the plane of the wheels where the map knows no ground."""
        extent = np.abs(vehicle.undercarriage.outline).max()
        reach = max(self.radius - float(extent), 0.0)
        return with_standing_ground(terrain, vehicle, self.T_map_base, reach)
