"""The robot on the page: its collision shapes where they are, and what its camera sees."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from infomap_ros.errors import InfomapError
from infomap_ros.geometry import PinholeCamera
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion import RobotModel
from infomap_ros.viewer.colors import CAMERA_WAY, ROBOT
from infomap_ros.viewer.shapes import draw_solid, draw_way, frustum, place

_LEAST_STEP = 0.02  # of the camera's way: points closer than this are left out [m]
_LONGEST_WAY = 4000  # points of the camera's way that are kept


class RobotLayer:
    """Draws the robot, its camera, and the way that this has come.

    Args:
        viser: the server.
    """

    def __init__(self, viser: Any) -> None:
        self._scene = viser.scene
        self._robot: RobotModel | None = None
        self._parts: list[Any] = []
        self._camera: Any = None
        self._way: list[FloatArray] = []

    def show(self, robot: RobotModel, T_map_base: FloatArray, joints: Mapping[str, float]) -> None:
        """Place the robot.

        Args:
            robot: that it is.
            T_map_base: pose of its base, shape (4, 4).
            joints: positions by name [rad or m].
        """
        if robot is not self._robot:
            self._make(robot)
        try:
            solids = robot.solids_in(robot.base_frame, joints)
        except InfomapError:  # a joint has not been heard of yet
            return
        for part, solid in zip(self._parts, solids, strict=True):
            place(part, T_map_base @ solid.transform)

    def show_camera(self, T_map_camera: FloatArray, camera: PinholeCamera | None) -> None:
        """Place the camera: a pyramid along its optical axis, and the way that it has come.

        Args:
            T_map_camera: of its optical frame, shape (4, 4).
            camera: tells how far the pyramid opens; None where that is not known.
        """
        if self._camera is None:
            self._camera = frustum(self._scene, "/camera", camera, CAMERA_WAY)
        place(self._camera, T_map_camera)
        here = T_map_camera[:3, 3].copy()
        if self._way and np.linalg.norm(here - self._way[-1]) < _LEAST_STEP:
            return
        self._way.append(here)
        if len(self._way) > _LONGEST_WAY:
            self._way = [*self._way[: _LONGEST_WAY // 2 : 2], *self._way[_LONGEST_WAY // 2 :]]
        draw_way(self._scene, "/camera_way", self._way, CAMERA_WAY)

    def _make(self, robot: RobotModel) -> None:
        """Make the parts of the robot, all at the origin."""
        for part in self._parts:
            part.remove()
        self._robot, self._parts = robot, []
        for number, shape in enumerate(robot.shapes):
            self._parts.append(draw_solid(self._scene, f"/robot/{number}", shape, ROBOT))
