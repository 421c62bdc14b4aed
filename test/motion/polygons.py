"""Points in polygons by the angle under which the corners are seen: slow and obvious."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.robot.robot_model import RobotModel


def winding_inside(points: FloatArray, corners: Sequence[Sequence[float]]) -> np.ndarray:
    """Whether the polygon winds around each of some points, shape (N, 2) -> (N,)."""
    total = np.zeros(len(points))
    ahead = np.roll(np.asarray(corners, dtype=float), -1, axis=0)
    for (ax, ay), (bx, by) in zip(corners, ahead, strict=True):
        turn = np.arctan2(by - points[:, 1], bx - points[:, 0])
        turn -= np.arctan2(ay - points[:, 1], ax - points[:, 0])
        total += np.remainder(turn + np.pi, 2.0 * np.pi) - np.pi
    return np.abs(total) > np.pi


def footprint_points(robot: RobotModel, joints: dict[str, float], spacing: float = 0.02):
    """Points of all collision shapes seen from above, base frame, shape (P, 2) [m]."""
    points = []
    for placed in robot.solids_in(robot.base_frame, joints):
        reach = placed.solid.bounding_radius
        steps = np.arange(-reach, reach + spacing, spacing)
        grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
        own = grid[placed.solid.signed_distance(grid) <= 0.0]
        points.append(own @ placed.transform[:3, :3].T + placed.transform[:3, 3])
    flat = np.concatenate(points)[:, :2]
    return np.unique(np.round(flat / spacing).astype(int), axis=0) * spacing


def placed(points: FloatArray, x: float, y: float, yaw: float) -> FloatArray:
    """Points of the base frame where the base is, shape (P, 2)."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    return points @ np.array([[cos, sin], [-sin, cos]]) + (x, y)
