"""What is told of the robot's poses, with made-up errors."""

from __future__ import annotations

import numpy as np

from infomap_ros.geometry import PoseRecord, invert_transform, make_transform, perturb_transform
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.pipeline.range_estimator import RangeMeasurement
from infomap_ros.pipeline.scan_synchronizer import Scan
from infomap_ros.simulation.exploring.truth import PoseAudit, mean_nees
from infomap_ros.simulation.exploring.visible_surface import map_errors, surface_coverage
from infomap_ros.simulation.simulator import Simulator
from infomap_ros.simulation.worlds.builder import World

T_WORLD_MAP = make_transform(np.diag([-1.0, -1.0, 1.0]), (1.5, 0.4, 0.3))
ERROR = np.array([0.02, -0.01, 0.005, 0.003, -0.002, 0.01])


class Still:
    """A simulator whose camera stands still."""

    def __init__(self, pose: np.ndarray) -> None:
        self._pose = pose

    def true_camera_pose(self) -> np.ndarray:
        return self._pose


def audited(covariance: np.ndarray) -> PoseAudit:
    """An audit of one scan whose pose is wrong by `ERROR`."""
    believed = make_transform(np.eye(3), (0.4, -0.3, 0.9))
    truth = T_WORLD_MAP @ perturb_transform(believed, ERROR)
    simulator: Simulator = Still(truth)  # type: ignore[assignment]
    audit = PoseAudit(simulator, T_WORLD_MAP)
    audit.image_taken(7)
    audit.scan_fused(scan_from(PoseRecord(7, "map", believed, covariance)))
    return audit


def scan_from(pose: PoseRecord) -> Scan[RangeMeasurement]:
    return Scan(None, pose)  # type: ignore[arg-type]


def test_errors_are_those_of_the_pose_in_the_map() -> None:
    (pose,) = audited(np.eye(6)).poses
    np.testing.assert_allclose(pose.error, ERROR, atol=1e-12)
    assert pose.pose.stamp == 7


def test_normalized_error_counts_standard_deviations() -> None:
    (pose,) = audited(np.diag((0.5 * ERROR) ** 2)).poses
    assert abs(pose.nees - 6 * 4.0) < 1e-9
    assert mean_nees([pose, pose]) == 4.0
    assert mean_nees([]) is None


def test_figures_are_in_meters_and_radians() -> None:
    figures = audited(np.diag(ERROR**2)).figures()
    assert figures["pose_error_end"] == figures["pose_error_rms"] == 0.02291
    assert figures["pose_turn_rms"] == 0.01063


def test_maps_are_compared_in_the_frame_in_which_they_were_made(world: World) -> None:
    rng = np.random.default_rng(1)
    surface, normals = world.surface.samples(0.05, rng)
    near = (np.abs(surface[:, :2]) < 1.5).all(axis=1) & (normals[:, 2] > 0.8)
    points = surface[near] @ T_WORLD_MAP[:3, :3] - invert_back()
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.1, max_range=5.0))
    for _ in range(2):
        voxel_map.integrate(points, np.eye(4))
    right = map_errors(voxel_map, world, T_WORLD_MAP)
    assert np.median(right.distances) < 0.01
    assert np.median(map_errors(voxel_map, world).distances) > 0.1
    assert surface_coverage(voxel_map, points) > 0.9


def invert_back() -> np.ndarray:
    """Origin of the world in the map, as taken off above, shape (3,)."""
    return -invert_transform(T_WORLD_MAP)[:3, 3]
