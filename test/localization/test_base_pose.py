"""The base where the camera is known, and a pose that a user tells."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import PoseRecord, invert_transform, make_transform, perturb_transform
from infomap_ros.localization.dead_reckoning import DeadReckoningConfig, base_in_map, user_base
from infomap_ros.localization.localizer import Localizer
from infomap_ros.localization.localizer_config import LocalizerConfig

from .room_views import CAMERA, STEP, looking, view

T_BASE_CAMERA = make_transform(
    Rotation.from_euler("xyz", (-1.9, 0.1, -1.4)).as_matrix(), (0.3, 0.1, 0.8)
)
PLANE = np.diag([0.04, 0.04, 0.0, 0.0, 0.0, 0.01])


def test_the_covariance_of_the_base_is_that_of_sampled_poses() -> None:
    rng = np.random.default_rng(3)
    factor = 0.004 * rng.normal(size=(6, 6))
    covariance = factor @ factor.T
    exact = DeadReckoningConfig(kinematics_position_sigma=1e-6, kinematics_rotation_sigma=1e-6)
    T_map_camera = perturb_transform(np.eye(4), [3.0, -1.0, 0.5, 0.3, -0.2, 2.0])
    record = PoseRecord(7, "map", T_map_camera, covariance)
    base = base_in_map(record, T_BASE_CAMERA, "base_link", exact)
    assert_allclose(base.transform @ T_BASE_CAMERA, T_map_camera, atol=1e-12)
    assert (base.stamp, base.frame_id, base.child_frame_id) == (7, "map", "base_link")
    T_camera_base, errors = invert_transform(T_BASE_CAMERA), []
    for draw in rng.multivariate_normal(np.zeros(6), covariance, 20000):
        true = perturb_transform(T_map_camera, draw) @ T_camera_base
        turn = Rotation.from_matrix(true[:3, :3] @ base.transform[:3, :3].T).as_rotvec()
        errors.append(np.concatenate([true[:3, 3] - base.transform[:3, 3], turn]))
    sampled = np.cov(np.array(errors).T)
    scale = np.sqrt(np.outer(np.diag(sampled), np.diag(sampled)))
    assert_allclose(base.covariance / scale, sampled / scale, atol=0.03)
    assert base.twist_covariance is not None
    assert (np.diag(base.twist_covariance) > 1e3).all()


def test_who_points_at_a_plan_leaves_height_and_tilt() -> None:
    tilted = perturb_transform(np.eye(4), [1.0, 2.0, 0.4, 0.1, -0.05, 0.0])
    pointed = make_transform(Rotation.from_euler("z", 1.2).as_matrix(), (5.0, -3.0, 0.0))
    placed = user_base(PoseRecord(0, "map", pointed, PLANE), tilted)
    assert_allclose(placed[:3, 3], (5.0, -3.0, 0.4))
    assert_allclose(placed[2, :3], tilted[2, :3])
    assert np.arctan2(placed[1, 0], placed[0, 0]) == pytest.approx(1.2)
    whole = PoseRecord(0, "map", pointed, np.diag([0.04] * 6))
    assert_allclose(user_base(whole, tilted), pointed)


def test_a_lost_camera_goes_on_from_where_it_is_told() -> None:
    poses = [looking((-0.5 + 0.05 * i, 0.2, 0.1), 0.05 * i - 0.3, 0.05) for i in range(6)]
    localizer = Localizer(CAMERA, LocalizerConfig(), None, poses[0])
    for i, pose in enumerate(poses):
        localizer.locate(view((i + 1) * STEP, pose, seed=i))
    localizer._lose()
    assert localizer.is_lost
    told = perturb_transform(poses[-1], [0.03, -0.02, 0.0, 0.0, 0.0, 0.02])
    with pytest.raises(InvalidInputError, match=r"max_position_sigma 0\.3 m"):
        localizer.place_camera(told, np.diag([0.25] * 3 + [0.01] * 3))
    assert localizer.is_lost
    localizer.place_camera(told, np.diag([1e-3, 1e-3, 0.0, 0.0, 0.0, 1e-3]))
    assert not localizer.is_lost
    assert_allclose(localizer.last_pose, told, atol=1e-6)
    found = localizer.locate(view(7 * STEP, poses[-1], seed=9))
    assert found.state == "tracking"
    assert_allclose(found.T_map_camera, poses[-1], atol=0.02)
