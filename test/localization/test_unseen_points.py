"""Fiducials are assumed where nothing is known, like those that are known, and nowhere else."""

from __future__ import annotations

import numpy as np

from infomap_ros.geometry import PinholeCamera
from infomap_ros.localization.prediction.error_prediction import unseen_points
from infomap_ros.mapping import VoxelMap, VoxelMapConfig

CAMERA = PinholeCamera(64, 48, 45.0, 45.0, 31.5, 23.5)
AHEAD = np.array([[0.0, 0.0, 1.0, 0], [-1.0, 0.0, 0.0, 0], [0.0, -1.0, 0.0, 0], [0, 0, 0, 1.0]])


def looked_ahead() -> tuple[VoxelMap, np.ndarray]:
    """A wall 2 m ahead of the origin, seen once; and its points in the map."""
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.1))
    wall = CAMERA.back_project(np.full((48, 64), 2.0))
    voxel_map.integrate(wall, AHEAD, camera=CAMERA)
    return voxel_map, wall.reshape(-1, 3) @ AHEAD[:3, :3].T


def test_they_are_where_nobody_has_looked_as_high_and_as_far_as_known_ones() -> None:
    voxel_map, wall = looked_ahead()
    points = unseen_points(np.zeros(3), wall, voxel_map, 5.0, 600)
    assert 300 < len(points) <= 600
    assert not voxel_map.is_known(points).any()
    bearings = np.degrees(np.arctan2(points[:, 1], points[:, 0]))
    around = np.histogram(bearings, bins=8, range=(-180.0, 180.0))[0]
    assert (around[[0, 1, 2, 5, 6, 7]] > 30).all()  # all directions but ahead
    flat = np.linalg.norm(points[:, :2], axis=1)
    far = np.linalg.norm(wall[:, :2], axis=1)
    assert far.min() - 1e-6 <= flat.min() and flat.max() <= far.max() + 1e-6
    assert wall[:, 2].min() - 1e-6 <= points[:, 2].min() <= points[:, 2].max()


def test_without_known_ones_nothing_is_assumed() -> None:
    voxel_map, wall = looked_ahead()
    assert unseen_points(np.zeros(3), np.zeros((0, 3)), voxel_map, 5.0, 100).shape == (0, 3)
    assert unseen_points(np.zeros(3), wall, voxel_map, 0.5, 100).shape == (0, 3)
    assert unseen_points(np.zeros(3), wall, voxel_map, 5.0, 0).shape == (0, 3)
