"""Predicted pose covariances against a naive oracle, closed forms, and what must hold of them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import (
    OdometryRecord,
    PinholeCamera,
    StereoRig,
    invert_transform,
    make_transform,
    skew,
)
from infomap_ros.geometry.transforms import perturb_transform
from infomap_ros.localization.dead_reckoning import DeadReckoning, DeadReckoningConfig
from infomap_ros.localization.prediction.error_prediction import (
    PIXEL_SIGMA,
    ErrorPrediction,
    ErrorPredictionConfig,
    Paths,
)
from infomap_ros.mapping import VoxelMap, VoxelMapConfig

CAMERA = PinholeCamera(512, 384, 340.0, 340.0, 255.5, 191.5)
RIG = StereoRig(CAMERA, CAMERA, 0.12)
SIGMA = 0.3 / (340.0 * 0.12)  # of the inverse depth, at the default disparity sigma [1/m]
FORWARD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
START = make_transform(FORWARD, (0.0, 0.0, 0.8))
BEFORE = np.diag([4e-4, 4e-4, 4e-4, 1e-5, 1e-5, 4e-5])
CONFIG = ErrorPredictionConfig(waypoints=3)


def ahead(distance: float = 1.0, yaw: float = 0.0) -> np.ndarray:
    turn = Rotation.from_euler("z", yaw).as_matrix()
    return np.array([make_transform(turn @ FORWARD, (distance, 0.1 * distance, 0.8))])


def wall(count: int, distance: float = 3.0, seed: int = 1) -> np.ndarray:
    """Points on a wall ahead, all in view from anywhere near the start."""
    rng = np.random.default_rng(seed)
    across = rng.uniform(-0.35, 0.35, (count, 2)) * distance
    return np.column_stack([np.full(count, distance), across[:, 0], 0.8 + 0.6 * across[:, 1]])


def spread(points: np.ndarray, variance: float = 4e-4) -> np.ndarray:
    return np.tile(variance * np.eye(3), (len(points), 1, 1))


def end(
    points: np.ndarray, covariances: np.ndarray, poses: np.ndarray, before: np.ndarray = BEFORE
) -> np.ndarray:
    lengths = np.linalg.norm(poses[:, :3, 3] - START[:3, 3], axis=1)
    prediction = ErrorPrediction(RIG, CONFIG)
    return prediction.predict(START, before, Paths(poses, lengths), (points, covariances))


def measurement(T_map_camera: np.ndarray, point: np.ndarray) -> np.ndarray:
    x, y, z = (invert_transform(T_map_camera) @ [*point, 1.0])[:3]
    return np.array([CAMERA.fx * x / z + CAMERA.cx, CAMERA.fy * y / z + CAMERA.cy, 1.0 / z])


def naive_end(points: np.ndarray, covariances: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """All poses and points in one state, measured one after the other; numerical derivatives."""
    shared = min(4e-4, float(np.linalg.eigvalsh(covariances).min())) if len(points) else 4e-4
    steps, count = CONFIG.waypoints, len(points)
    covariance = np.zeros((6 + 3 * count, 6 + 3 * count))
    covariance[:6, :6] = BEFORE - np.diag([shared] * 3 + [0.0] * 3) + 1e-8 * np.eye(6)
    for n in range(count):
        place = slice(6 + 3 * n, 9 + 3 * n)
        covariance[place, place] = covariances[n] - (shared - 1e-8) * np.eye(3)
    turn = Rotation.from_matrix(pose[:3, :3] @ START[:3, :3].T).as_rotvec()
    offset = pose[:3, 3] - START[:3, 3]
    length, angle, motion = np.linalg.norm(offset), np.linalg.norm(turn), DeadReckoningConfig()
    position = motion.position_per_meter**2 * length / steps
    rotation = motion.rotation_per_meter**2 * length + motion.rotation_per_radian**2 * angle
    noise = np.diag([position] * 3 + [rotation / steps] * 3) + 1e-8 * np.eye(6)
    here = START
    for k in range(1, steps + 1):
        share = k / steps
        there = make_transform(
            Rotation.from_rotvec(share * turn).as_matrix() @ START[:3, :3],
            START[:3, 3] + share * offset,
        )
        over = np.eye(len(covariance))
        step = invert_transform(here) @ there
        for i, delta in enumerate(1e-6 * np.eye(6)):
            moved = perturb_transform(here, delta) @ step
            over[:6, i] = (
                np.append(
                    moved[:3, 3] - there[:3, 3],
                    Rotation.from_matrix(moved[:3, :3] @ there[:3, :3].T).as_rotvec(),
                )
                / 1e-6
            )
        covariance = over @ covariance @ over.T
        covariance[:6, :6] += noise
        here = there
        for n in range(count):
            slopes = np.zeros((3, len(covariance)))
            for i, delta in enumerate(1e-6 * np.eye(6)):
                upper = measurement(perturb_transform(here, delta), points[n])
                lower = measurement(perturb_transform(here, -delta), points[n])
                slopes[:, i] = (upper - lower) / 2e-6
            for i, delta in enumerate(1e-6 * np.eye(3)):
                upper, lower = (measurement(here, points[n] + s * delta) for s in (1, -1))
                slopes[:, 6 + 3 * n + i] = (upper - lower) / 2e-6
            noise_z = np.diag([PIXEL_SIGMA**2, PIXEL_SIGMA**2, SIGMA**2])
            gain = covariance @ slopes.T @ np.linalg.inv(slopes @ covariance @ slopes.T + noise_z)
            covariance = covariance - gain @ slopes @ covariance
    covariance[:3, :3] += shared * np.eye(3)
    return covariance[:6, :6]


def test_as_one_filter_over_all_poses_and_points() -> None:
    points, pose = wall(5), ahead(0.9, 0.15)
    covariances = spread(points) + 2e-4 * np.diag([3.0, 1.0, 0.5])
    np.testing.assert_allclose(
        end(points, covariances, pose)[0], naive_end(points, covariances, pose[0]), rtol=2e-4,
        atol=1e-9,
    )  # fmt: skip


def test_without_fiducials_it_is_dead_reckoning() -> None:
    nothing = np.empty((0, 3)), np.empty((0, 3, 3))
    pose = ahead(1.2)
    predicted = end(*nothing, pose, np.zeros((6, 6)))[0]
    reckoning = DeadReckoning(DeadReckoningConfig())
    for share in np.linspace(0.0, 1.0, CONFIG.waypoints + 1):
        place = make_transform(np.eye(3), START[:3, 3] + share * (pose[0, :3, 3] - START[:3, 3]))
        record = reckoning.add(OdometryRecord(1 + int(1e9 * share), "odom", place, None, "base"))
    assert record.covariance is not None
    np.testing.assert_allclose(predicted, record.covariance, rtol=1e-3, atol=2e-7)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.integers(1, 8), st.integers(0, 10**6), st.floats(0.1, 2.0), st.floats(-0.2, 0.2))
def test_one_more_fiducial_never_makes_it_worse(
    count: int, seed: int, distance: float, yaw: float
) -> None:
    points = wall(count + 1, seed=seed)
    variances = np.random.default_rng(seed).uniform(1e-4, 1e-2, count + 1)
    covariances = variances[:, None, None] * np.eye(3)
    fewer = end(points[:-1], covariances[:-1], ahead(distance, yaw))[0]
    more = end(points, covariances, ahead(distance, yaw))[0]
    assert np.linalg.eigvalsh(fewer - more)[0] > -1e-9
    assert np.trace(more) < np.trace(fewer)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.integers(1, 8), st.integers(0, 10**6), st.floats(0.1, 1.0))
def test_better_fiducials_never_make_it_worse(count: int, seed: int, share: float) -> None:
    points = wall(count, seed=seed)
    worse = end(points, spread(points, 4e-3), ahead(1.0, 0.1))[0]
    better = end(points, spread(points, share * 4e-3), ahead(1.0, 0.1))[0]
    assert np.linalg.eigvalsh(worse - better)[0] > -1e-9


def test_nearer_fiducials_are_better() -> None:
    far, near = (wall(12, distance) for distance in (5.5, 2.0))
    traces = [np.trace(end(each, spread(each), ahead(0.4))[0]) for each in (far, near)]
    assert traces[1] < 0.8 * traces[0]


def test_fiducials_behind_the_camera_or_a_wall_do_not_count() -> None:
    points = wall(6)
    drift = end(np.empty((0, 3)), np.empty((0, 3, 3)), ahead())[0]
    behind = end(points * (-1.0, 1.0, 1.0), spread(points), ahead())[0]
    np.testing.assert_allclose(behind, drift, rtol=1e-6, atol=1e-12)
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.1, max_range=5.0))
    y, z = np.meshgrid(np.arange(-2.0, 2.0, 0.04), np.arange(-1.0, 2.5, 0.04))
    screen = np.column_stack([np.full(y.size, 2.0), y.ravel(), z.ravel()])
    for _ in range(3):
        voxel_map.integrate(screen, np.eye(4))
    prediction = ErrorPrediction(RIG, CONFIG)
    path = Paths(ahead(), np.linalg.norm(ahead()[:, :3, 3] - START[:3, 3], axis=1))
    hidden = prediction.predict(START, BEFORE, path, (points, spread(points)), (), voxel_map)[0]
    np.testing.assert_allclose(hidden, drift, rtol=1e-6, atol=1e-12)


def test_points_of_the_surface_hold_the_path_together_but_tell_nothing_of_the_map() -> None:
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.1, max_range=8.0))
    y, z = np.meshgrid(np.arange(-2.0, 2.0, 0.04), np.arange(-1.0, 2.5, 0.04))
    for _ in range(3):
        voxel_map.integrate(
            np.column_stack([np.full(y.size, 3.0), y.ravel(), z.ravel()]), np.eye(4)
        )
    path = Paths(ahead(), np.linalg.norm(ahead()[:, :3, 3] - START[:3, 3], axis=1))
    none = np.empty((0, 3)), np.empty((0, 3, 3))
    prediction = ErrorPrediction(RIG, CONFIG)
    new = prediction.surface_points(voxel_map)
    tied = prediction.predict(START, BEFORE, path, none, new, voxel_map)[0]
    drift = prediction.predict(START, BEFORE, path, none)[0]
    grown = [np.trace((each - BEFORE)[:3, :3]) for each in (drift, tied)]
    assert grown[1] < 0.3 * grown[0]
    over = np.eye(6)
    over[:3, 3:] = -skew(ahead()[0, :3, 3] - START[:3, 3])
    assert np.linalg.eigvalsh(tied - over @ BEFORE @ over.T)[0] > 0.0


def test_many_paths_at_once_are_as_one_by_one() -> None:
    points = wall(6)
    poses = np.concatenate(
        [ahead(distance, yaw) for distance in (0.2, 1.0) for yaw in (-0.3, 0.0, 2.0)]
    )
    together = end(points, spread(points), poses)
    for pose, covariance in zip(poses, together, strict=True):
        alone = end(points, spread(points), pose[None])[0]
        np.testing.assert_allclose(covariance, alone, rtol=1e-9, atol=1e-15)


def test_a_part_of_many_fiducials_stands_for_all() -> None:
    points = wall(60)
    config = ErrorPredictionConfig(waypoints=3, fiducials=30)
    path = Paths(ahead(0.5), np.array([0.5]))
    fiducials = points, spread(points)
    part = ErrorPrediction(RIG, config).predict(START, BEFORE, path, fiducials)[0]
    every = ErrorPrediction(RIG, ErrorPredictionConfig(waypoints=3, fiducials=60))
    whole = every.predict(START, BEFORE, path, fiducials)[0]
    assert 0.8 < np.trace(part) / np.trace(whole) < 1.25


def test_shapes_that_do_not_fit_are_refused() -> None:
    prediction = ErrorPrediction(RIG)
    with pytest.raises(InvalidInputError, match="lengths"):
        Paths(ahead(), np.ones(2))
    with pytest.raises(InvalidInputError, match="covariances"):
        prediction.predict(START, BEFORE, Paths(ahead(), np.ones(1)), (wall(2), spread(wall(3))))
