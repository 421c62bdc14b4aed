"""What an uncertain pose costs in bits, against scans that are merged into a map."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.geometry import PinholeCamera
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.views.information.view_information import ExpectedInformation
from infomap_ros.views.information.view_query import InformationConfig
from infomap_ros.views.ranking.rating import pose_information_loss, range_variance
from infomap_ros.views.situation import Situation

CAMERA = PinholeCamera(320, 240, 480.0, 480.0, 159.5, 119.5)
SENSOR = InformationConfig(range_noise=0.004, pixel_angle=1.0 / 480.0)
MAX_RANGE = 4.0


def wall_map(sigma: float, voxel_size: float) -> VoxelMap:
    """One scan of a wall at half the range, with a pose of this sigma along each axis."""
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=voxel_size, max_range=MAX_RANGE))
    distance = 0.5 * MAX_RANGE
    points = CAMERA.back_project(np.full((CAMERA.height, CAMERA.width), distance))
    lateral, along = (1e-4) ** 2, (SENSOR.range_noise * distance**2) ** 2
    covariances = np.tile(np.diag([lateral, lateral, along]), (*points.shape[:2], 1, 1))
    pose = np.diag([max(sigma, 1e-6) ** 2] * 3 + [1e-12] * 3)
    middle = np.eye(4)
    middle[2, 3] = 0.3 * voxel_size  # the wall is in the middle of its voxels, not between two
    voxel_map.integrate(points, middle, covariances, pose_covariance=pose, camera=CAMERA)
    return voxel_map


def entropy_bits(voxel_map: VoxelMap) -> float:
    """Of the surface's Gaussians along the wall's normal, less a constant for each voxel."""
    variances = voxel_map.gaussians()[2][:, 2, 2]
    return float(0.5 * np.log2(variances).sum())


def situation(sigma: float, voxel_size: float) -> Situation:
    covariance = np.diag([sigma**2] * 3 + [0.0] * 3)
    grid = VoxelMap(VoxelMapConfig(voxel_size=voxel_size, max_range=MAX_RANGE))
    return Situation(grid, CAMERA, MAX_RANGE, np.eye(4), covariance)


@pytest.mark.parametrize("voxel_size", [0.05, 0.1])
@pytest.mark.parametrize("sigmas", [(0.0, 0.005), (0.005, 0.02), (0.02, 0.005)])
def test_the_loss_is_that_of_scans_merged_into_a_map(
    voxel_size: float, sigmas: tuple[float, float]
) -> None:
    before, after = sigmas
    lost = entropy_bits(wall_map(after, voxel_size)) - entropy_bits(wall_map(before, voxel_size))
    now = situation(before, voxel_size)
    growth = np.sqrt(3.0) * (after - before)  # of the root of the trace
    share = pose_information_loss(now, SENSOR, [growth])[0]
    full = ExpectedInformation(config=SENSOR).full_view(now)
    assert share * full == pytest.approx(lost, rel=0.15)


def test_the_range_variance_is_that_of_the_map() -> None:
    variances = wall_map(0.0, 0.05).gaussians()[2][:, 2, 2]
    expected = range_variance(situation(0.0, 0.05), SENSOR)
    assert np.median(variances) == pytest.approx(expected, rel=0.15)


def test_a_pose_that_gets_better_known_is_a_gain_and_the_same_one_nothing() -> None:
    loss = pose_information_loss(situation(0.02, 0.05), SENSOR, [-0.01, 0.0, 0.01])
    assert loss[0] < loss[1] == 0.0 < loss[2]


def test_finer_maps_take_a_smaller_share_for_the_same_growth() -> None:
    """By n / F: in half the voxels four times the surface, eight times the volume."""
    shares = [
        pose_information_loss(situation(0.01, size), SENSOR, [0.01])[0] for size in (0.05, 0.1)
    ]
    assert 0.4 < shares[0] / shares[1] < 0.75
