"""A map whose frame is put elsewhere goes on as if it had always been there."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import compose_poses, perturb_transform
from infomap_ros.localization.localizer import Localizer
from infomap_ros.localization.target.target import TargetRefusal

from .room_views import CAMERA, STEP, looking, view

T_NEW_OLD = perturb_transform(np.eye(4), [3.0, -1.0, 0.5, 0.3, -0.2, 2.0])
POSES = [looking((-0.5 + 0.05 * i, 0.2, 0.1), 0.05 * i - 0.3, 0.05) for i in range(10)]
NOTHING = np.zeros((6, 6))
BEGIN = np.diag([1e-4, 2e-4, 3e-4, 1e-5, 2e-5, 3e-5])


def begun(T_map_camera: np.ndarray, covariance: np.ndarray = NOTHING) -> Localizer:
    return Localizer(CAMERA, None, None, T_map_camera, covariance)


def follow(localizer: Localizer, first: int, last: int) -> list:
    views = [view((i + 1) * STEP, POSES[i], seed=i) for i in range(first, last)]
    return [localizer.locate(each) for each in views]


def test_it_goes_on_as_one_that_began_there() -> None:
    moved, always = begun(POSES[0]), begun(T_NEW_OLD @ POSES[0])
    follow(moved, 0, 6)
    follow(always, 0, 6)
    moved.move_map(T_NEW_OLD, NOTHING)
    for one, other in zip(follow(moved, 6, 10), follow(always, 6, 10), strict=True):
        assert one.state == other.state == "tracking"
        assert_allclose(one.T_map_camera, other.T_map_camera, atol=1e-7)
        assert_allclose(one.covariance, other.covariance, rtol=1e-3, atol=1e-10)
    for one, other in (
        (moved.fiducials(), always.fiducials()),
        (moved.keyframes(), always.keyframes()),
    ):
        assert_allclose(one.covariances, other.covariances, rtol=1e-3, atol=1e-10)
    assert_allclose(moved.fiducials().positions, always.fiducials().positions, atol=1e-6)
    assert_allclose(moved.keyframes().transforms, always.keyframes().transforms, atol=1e-7)


def test_the_error_of_the_move_is_one_that_all_share(rng: np.random.Generator) -> None:
    root = 0.01 * rng.normal(size=(6, 6))
    covariance = root @ root.T
    localizer = begun(POSES[0], BEGIN)
    *_, last = follow(localizer, 0, 5)
    before = localizer.keyframes()
    localizer.move_map(T_NEW_OLD, covariance)
    after = localizer.keyframes()
    for pose, told, moved_pose, moved_told in zip(
        before.transforms, before.covariances, after.transforms, after.covariances, strict=True
    ):
        expected = compose_poses(T_NEW_OLD, covariance, pose, told)
        assert_allclose(moved_pose, expected[0], atol=1e-12)
        assert_allclose(moved_told, expected[1], rtol=1e-9, atol=1e-15)
    assert last.T_map_camera is not None and last.covariance is not None
    expected = compose_poses(T_NEW_OLD, covariance, last.T_map_camera, last.covariance)
    assert_allclose(localizer._filter.pose[0], expected[0], atol=1e-12)
    assert_allclose(localizer._filter.pose[1], expected[1], rtol=1e-9, atol=1e-15)
    (next_one,) = follow(localizer, 5, 6)
    assert next_one.state == "tracking"  # what it sees does not change by the frame's error


def test_the_map_of_a_target_stays() -> None:
    class Nowhere:
        def detect(self, view: object) -> TargetRefusal:
            return TargetRefusal("not in view")

    with pytest.raises(InvalidInputError, match="target"):
        Localizer(CAMERA, None, Nowhere()).move_map(T_NEW_OLD, NOTHING)
