"""Scans are known as well as the keyframes that they hang on, once those are corrected."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import PinholeCamera, invert_transform, perturb_transform
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.correction.correctable_map import CorrectableMap, KeyframeCovariances

POSES = np.stack([perturb_transform(np.eye(4), 0.3 * i * np.ones(6)) for i in range(3)])
STAMPS = np.array([10, 20, 30])


def covariance(rng: np.random.Generator, size: float) -> np.ndarray:
    root = size * rng.normal(size=(6, 6))
    return root @ root.T


def test_a_scan_of_a_keyframe_is_known_as_that(rng: np.random.Generator) -> None:
    then, now = (np.stack([covariance(rng, s)] * 3) for s in (0.1, 0.01))
    known = KeyframeCovariances()
    known.receive_poses(30, STAMPS, POSES, then)
    known.receive_poses(40, STAMPS, POSES, now)
    assert_allclose(known.of_scan(20, POSES[1], then[1]), now[1], atol=1e-12)


def test_what_the_motion_from_the_keyframe_adds_stays(rng: np.random.Generator) -> None:
    then, now = (np.stack([covariance(rng, s)] * 3) for s in (0.1, 0.01))
    added, scan = covariance(rng, 0.005), POSES[1].copy()
    scan[:3, 3] += (0.4, -0.2, 0.1)
    errors = rng.multivariate_normal(np.zeros(6), now[1], 200_000)
    short = 1e-3 * errors  # first order: many small errors of the keyframe, seen at the scan
    moved = [perturb_transform(POSES[1], error) for error in short[:400]]
    T_keyframe_scan = invert_transform(POSES[1]) @ scan
    shifts = np.array([(pose @ T_keyframe_scan)[:3, 3] - scan[:3, 3] for pose in moved])
    lever = np.linalg.lstsq(short[:400], shifts, rcond=None)[0].T
    over = np.vstack([lever, np.eye(6)[3:]])
    known = KeyframeCovariances()
    known.receive_poses(30, STAMPS, POSES, then)
    known.receive_poses(40, STAMPS, POSES, now)
    found = known.of_scan(25, scan, over @ then[1] @ over.T + added)
    assert_allclose(found, over @ now[1] @ over.T + added, rtol=2e-3, atol=1e-6)


def test_a_scan_before_all_keyframes_hangs_on_the_first(rng: np.random.Generator) -> None:
    then = np.stack([covariance(rng, 0.1) for _ in range(3)])
    known = KeyframeCovariances()
    known.receive_poses(30, STAMPS, POSES, then)
    known.receive_poses(40, STAMPS, POSES, 0.01 * then)
    assert_allclose(known.of_scan(5, POSES[0], then[0]), 0.01 * then[0], atol=1e-12)


def test_without_news_or_without_a_covariance_it_stays_as_it_was(
    rng: np.random.Generator,
) -> None:
    known = KeyframeCovariances()
    assert known.of_scan(5, POSES[0], np.eye(6)) is None
    known.receive_poses(30, STAMPS, POSES, np.stack([covariance(rng, 0.1)] * 3))
    assert known.of_scan(10, POSES[0], None) is None


def test_a_covariance_that_is_none_is_refused() -> None:
    known = KeyframeCovariances()
    with pytest.raises(InvalidInputError, match="covariance of a keyframe"):
        known.receive_poses(30, STAMPS, POSES, np.stack([-np.eye(6)] * 3))
    with pytest.raises(InvalidInputError, match="keyframe covariances"):
        known.receive_poses(30, STAMPS, POSES, np.stack([np.eye(6)] * 2))


def test_a_map_that_is_corrected_is_as_sure_as_its_keyframes() -> None:
    camera = PinholeCamera(32, 24, 30.0, 30.0, 15.5, 11.5)
    wall = camera.back_project(np.full((24, 32), 1.5))
    correctable = CorrectableMap(VoxelMap(VoxelMapConfig(voxel_size=0.1)))
    wrong = perturb_transform(np.eye(4), [0.2, 0.1, 0.3, 0.0, 0.0, 0.0])
    unsure, sure = 0.04 * np.eye(6), 0.0001 * np.eye(6)
    correctable.integrate(7, wall, wrong, pose_covariance=unsure, camera=camera)
    correctable.receive_poses(8, [7], [wrong], [unsure])
    correctable.receive_poses(9, [7], [np.eye(4)], [sure])
    assert correctable.correct() is not None
    expected = VoxelMap(VoxelMapConfig(voxel_size=0.1))
    expected.integrate(wall, np.eye(4), None, sure, camera)
    for found, right in zip(correctable.voxel_map.gaussians(), expected.gaussians(), strict=True):
        assert_allclose(found, right, rtol=0.05, atol=1e-4)
