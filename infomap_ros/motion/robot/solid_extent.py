"""Axis-aligned extent of placed solids."""

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
