"""Robots and coal's view of them, for tests."""

from __future__ import annotations

from collections.abc import Mapping

import coal
import numpy as np
import pinocchio

from infomap_ros.geometry.resources import find_share
from infomap_ros.motion.collision.body import CollisionBody
from infomap_ros.motion.robot.robot_model import RobotModel


def rover() -> RobotModel:
    return RobotModel.from_urdf(
        find_share("config/rover.urdf"), camera_frame="left_camera_optical_frame"
    )


def compared_pairs(body: CollisionBody) -> tuple[tuple[str, str], ...]:
    """Names of the links that are compared with each other."""
    return tuple((body.links[a], body.links[b]) for a, b in body.arrays.pairs)


class CoalBody:
    """The collision shapes of a robot as coal's own objects, placed by Pinocchio."""

    def __init__(self, robot: RobotModel, urdf: str) -> None:
        self.robot = robot
        self.geometry = pinocchio.buildGeomFromUrdfString(
            robot.model, urdf, pinocchio.GeometryType.COLLISION
        )
        self.links = [
            str(robot.model.frames[item.parentFrame].name) for item in self.geometry.geometryObjects
        ]

    def place(
        self, joints: Mapping[str, float], T_map_base: np.ndarray
    ) -> list[tuple[str, coal.CollisionGeometry, coal.Transform3s]]:
        model = self.robot.model
        data = model.createData()
        q = self.robot.mechanism.configuration(
            {joint.name: 0.0 for joint in self.robot.joints} | dict(joints),
            self.robot.mechanism.indices,
        )
        pinocchio.forwardKinematics(model, data, q)
        base = model.frames[model.getFrameId(self.robot.base_frame)]
        T_root_base = (data.oMi[base.parentJoint] * base.placement).homogeneous
        T_map_root = T_map_base @ np.linalg.inv(T_root_base)
        placed = []
        for link, item in zip(self.links, self.geometry.geometryObjects, strict=True):
            pose = T_map_root @ (data.oMi[item.parentJoint] * item.placement).homogeneous
            placed.append((link, item.geometry, coal.Transform3s(pose[:3, :3], pose[:3, 3])))
        return placed


def distance(first: tuple, second: tuple) -> float:
    """coal's distance of two placed shapes [m]; not positive where they touch."""
    return coal.distance(
        first[1], first[2], second[1], second[2], coal.DistanceRequest(), coal.DistanceResult()
    )
