"""Robots whose pose errors drift map one wall: the sum of their maps is as sure as it may be."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import PoseUncertainty, make_transform, transform_points
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.team.config import TeamConfig
from infomap_ros.team.member import TeamMember
from infomap_ros.team.replica import MapReplica, moved_map
from infomap_ros.team.wire import decode_update

RANGE = 0.004
DEPTH = 1.025
CONFIG = VoxelMapConfig(default_sigma=RANGE, error_correlation=1.0)
SIDE = np.linspace(0.003, 0.047, 6)
WALL = np.stack([*np.meshgrid(SIDE, SIDE), np.full((6, 6), DEPTH)], axis=-1).reshape(-1, 3)
VOXEL = (0, 0, 20)
LONG_AGO = 100.0  # [s]
Robot = tuple[int, float, float, float]
"""Scans, clock between two of them, sigma of the drift and of the offset [m]."""


def along_z(sigma: float) -> FloatArray:
    return np.diag([0.0, 0.0, sigma**2, 0.0, 0.0, 0.0])


def mapped(robot: Robot, rng: np.random.Generator) -> VoxelMap:
    """The wall as one robot sees it, all its errors drawn."""
    scans, step, drift, offset = robot
    own = VoxelMap(CONFIG)
    own.track_changes(True)
    decay, error, shift = np.exp(-step), rng.normal(0.0, drift), rng.normal(0.0, offset)
    for k in range(scans):
        if k:
            error = decay * error + rng.normal(0.0, drift * np.sqrt(1.0 - decay**2))
        seen = WALL + np.array([0.0, 0.0, shift + error + rng.normal(0.0, RANGE)])
        known = PoseUncertainty(along_z(drift), offset=along_z(offset), clock=step * k)
        own.integrate(seen, np.eye(4), None, known)
    return own


def merged(robots: list[VoxelMap]) -> MapReplica:
    """What somebody holds who hears all robots tell what they saw."""
    replica = MapReplica(CONFIG)
    for number, own in enumerate(robots):
        member = TeamMember(number, 1, 100, CONFIG, TeamConfig())
        member.begin(own)
        for rows in member.updates(own, LONG_AGO):
            replica.apply(decode_update(rows))
    return replica


def surface(voxel_map: VoxelMap) -> tuple[float, float]:
    """Mean and variance along the wall's normal."""
    indices, means, covariances = voxel_map.gaussians()
    (row,) = np.flatnonzero((indices == VOXEL).all(axis=1))
    return float(means[row, 2]), float(covariances[row, 2, 2])


CASES: dict[str, list[Robot]] = {
    "alike": [(12, 0.1, 0.004, 0.002), (12, 0.1, 0.004, 0.002)],
    "one rests, one moves": [(20, 0.0, 0.006, 0.0), (8, 1.0, 0.003, 0.0)],
    "one is placed badly": [(8, 1.0, 0.002, 0.006), (16, 0.2, 0.004, 0.001)],
}


@pytest.mark.parametrize("case", CASES)
def test_the_merged_map_is_as_wrong_as_it_says(case: str, rng: np.random.Generator) -> None:
    runs, errors, best = 150, [], []
    for _ in range(runs):
        parts = [mapped(robot, rng) for robot in CASES[case]]
        mean, variance = surface(merged(parts).voxel_map)
        alone = np.array([surface(part) for part in parts])
        weights = 1.0 / alone[:, 1]
        best.append(float(weights @ (alone[:, 0] - DEPTH) / weights.sum()))
        errors.append((mean - DEPTH, variance))
        assert variance == pytest.approx(1.0 / weights.sum(), rel=0.13)  # steps of sigma: 6 %
    wrong, claimed = np.array(errors).T
    band = 1.96 * np.sqrt(2.0 / runs)
    assert abs(np.mean(wrong**2 / claimed) - 1.0) < band
    assert np.std(wrong) == pytest.approx(np.std(best), rel=0.03)


def test_when_a_robot_is_better_placed_than_it_was_all_is_told_again() -> None:
    own = VoxelMap(CONFIG)
    own.track_changes(True)
    member = TeamMember(0, 1, 100, CONFIG, TeamConfig())
    member.begin(own)
    replica = MapReplica(CONFIG)
    beside = WALL + np.array([0.5, 0.0, 0.0])
    for k, (points, offset) in enumerate([(WALL, 0.02), (beside, 0.02), (beside, 0.005)]):
        known = PoseUncertainty(along_z(0.001), offset=along_z(offset), clock=5.0 * k)
        own.integrate(points, np.eye(4), None, known)
        for rows in member.updates(own, LONG_AGO + k):
            replica.apply(decode_update(rows))
        told, expected = (np.sqrt(surface(one)[1]) for one in (replica.voxel_map, own))
        assert told == pytest.approx(expected, rel=0.07)
        assert told > 0.95 * offset


def test_what_is_told_of_a_surface_is_told_once() -> None:
    """The error of the map as a whole does not count as news."""
    own = mapped((5, 0.5, 0.003, 0.02), np.random.default_rng(3))
    member = TeamMember(0, 1, 100, CONFIG, TeamConfig(bandwidth=0.02))
    member.begin(own)
    assert member.updates(own, LONG_AGO)
    own.mark_changed(0, 10**6)
    assert not member.updates(own, LONG_AGO + 60.0)


def test_a_moved_map_tells_the_error_that_all_of_it_shares() -> None:
    """Whoever hears it knows the moved surface no better than the robot knew where its map is."""
    own = VoxelMap(CONFIG)
    turned = np.diag([0.0, 0.0, 0.02**2, 0.0, 0.03**2, 0.0])
    own.integrate(WALL, np.eye(4), None, PoseUncertainty(along_z(0.001), offset=turned))
    move = make_transform(Rotation.from_euler("z", 90.0, degrees=True).as_matrix(), [0.5, 3.0, 0.2])
    moved = moved_map(own, move)
    (_, means, before), (_, places, after) = own.gaussians(), moved.gaussians()
    assert len(means) == 1
    np.testing.assert_allclose(places, transform_points(move, means), atol=1e-6)
    expected = move[:3, :3] @ before @ move[:3, :3].T
    np.testing.assert_allclose(after, expected, rtol=1e-3, atol=1e-9)
    told = surface_of(merged([moved]).voxel_map)
    sigmas = [np.sqrt(np.linalg.eigvalsh(each)[0, -1]) for each in (told, after)]
    assert sigmas[0] == pytest.approx(sigmas[1], rel=0.07)
    assert sigmas[0] == pytest.approx(np.hypot(0.05 / 12**0.5, 0.03 * 1.025), rel=0.07)


def surface_of(voxel_map: VoxelMap) -> FloatArray:
    """Covariances of all surface points."""
    return voxel_map.gaussians()[2]
