"""How far placed solids and a robot extend; where it can hold its camera, and how steeply."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from infomap_ros.geometry import Box, ConvexPolytope, Cylinder, PlacedSolid
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.robot.robot_model import RobotModel


def solid_extent(placed: PlacedSolid) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest coordinates of a solid in the frame in which it is placed, (3,) [m]."""
    rotation, middle, solid = placed.transform[:3, :3], placed.transform[:3, 3], placed.solid
    if isinstance(solid, Box):
        reach = np.abs(rotation) @ (0.5 * np.array(solid.size))
    elif isinstance(solid, Cylinder):
        axis = rotation[:, 2]
        reach = 0.5 * solid.length * np.abs(axis)
        reach = reach + solid.radius * np.sqrt(np.maximum(1.0 - axis**2, 0.0))
    elif isinstance(solid, ConvexPolytope):
        corners = solid.vertices @ rotation.T + middle
        return corners.min(axis=0), corners.max(axis=0)
    else:
        reach = np.full(3, solid.bounding_radius)
    return middle - reach, middle + reach


def body_extent(
    robot: RobotModel, joint_positions: Mapping[str, float]
) -> tuple[float, float, float]:
    """Radius about the base's z axis, lowest and highest z of a robot's body, base frame [m].

    Polytopes count by the spheres that hold them. A robot without solids is a point.

    Args:
        robot: the model.
        joint_positions: by name [rad or m].

    Raises:
        RobotModelError: a joint that moves a solid is missing.
    """
    return upright_extent(robot.solids_in(robot.base_frame, joint_positions))


def upright_extent(solids: Iterable[PlacedSolid]) -> tuple[float, float, float]:
    """As `body_extent`, of solids that are placed in the base frame."""
    radius, bottom, top = 0.0, 0.0, 0.0
    for placed in solids:
        low, high = quick_extent(placed)
        corners = np.maximum(np.abs(low[:2]), np.abs(high[:2]))
        radius = max(radius, float(np.hypot(*corners)))
        bottom, top = min(bottom, float(low[2])), max(top, float(high[2]))
    return radius, bottom, top


def quick_extent(placed: PlacedSolid) -> tuple[FloatArray, FloatArray]:
    """As `solid_extent`, but polytopes count by the spheres that hold them."""
    if not isinstance(placed.solid, ConvexPolytope):
        return solid_extent(placed)
    middle, reach = placed.transform[:3, 3], placed.solid.bounding_radius
    return middle - reach, middle + reach


_POSTURES = 2000
_DECIMALS = 6  # of an angle [rad]; what is beyond them is rounding
_LEAST_HEIGHT = 0.15  # [m]; nearer to rough ground the arm would touch it


def camera_heights(robot: RobotModel) -> tuple[float, float]:
    """Lowest and highest camera that the arm can hold, above the ground of a level base [m].

    Sampled over the joint limits, so a little inside of what is possible; equal where no joint
    moves the camera. The ground is taken where the lowest solid of the robot ends.
    """
    heights = _sampled_cameras(robot)[:, 2, 3] - robot_bottom(robot)
    highest = float(heights.max())
    return min(max(float(heights.min()), _LEAST_HEIGHT), highest), highest


def camera_elevations(robot: RobotModel) -> tuple[float, float]:
    """Least and greatest angle of the optical axis above the x-y plane of the base [rad].

    Sampled as `camera_heights`; equal where no joint tilts the camera.
    """
    upward = _sampled_cameras(robot)[:, 2, 2]
    angles = np.arcsin(np.clip(upward, -1.0, 1.0)).round(_DECIMALS)
    return float(angles.min()), float(angles.max())


def _sampled_cameras(robot: RobotModel) -> FloatArray:
    """Poses of the camera in random postures, always the same ones, shape (N, 4, 4)."""
    return robot.arm.camera_pose(random_postures(robot, _POSTURES, np.random.default_rng(0)))


def random_postures(robot: RobotModel, count: int, rng: np.random.Generator) -> FloatArray:
    """Positions of the arm, uniform within its limits, shape (count, n) [rad or m]."""
    chain = robot.arm
    lower, upper = np.maximum(chain.lower, -np.pi), np.minimum(chain.upper, np.pi)
    return rng.uniform(lower, upper, (count, len(chain)))


def robot_bottom(robot: RobotModel) -> float:
    """Height of the robot's lowest point in the base frame [m], the joints near zero."""
    joints = {j.name: float(np.clip(0.0, j.lower, j.upper)) for j in robot.joints}
    solids = robot.solids_in(robot.base_frame, joints)
    return min((float(solid_extent(placed)[0][2]) for placed in solids), default=0.0)
