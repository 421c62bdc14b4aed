"""Errors that scans share enter the map once, against the covariance written out in full."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import PinholeCamera, PoseUncertainty, make_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.correction.correctable_map import CorrectableMap
from infomap_ros.mapping.voxels.surface_kernels import NOTHING, add_observations, inflation
from infomap_ros.team.replica import MapReplica
from infomap_ros.team.update import MapUpdate

CAMERA = PinholeCamera(60, 48, 150.0, 150.0, 29.5, 23.5)
WALL = CAMERA.back_project(np.full((48, 60), 1.025))
RANGE = 0.004
CONFIG = VoxelMapConfig(default_sigma=RANGE, error_correlation=1.0)
HERE = np.eye(4)


def along_z(sigma: float) -> FloatArray:
    """Covariance of a pose that is uncertain along the camera's axis, across the wall."""
    return np.diag([0.0, 0.0, sigma**2, 0.0, 0.0, 0.0])


def pose(clock: float, drift: float, white: float = 0.0, offset: float = 0.0) -> PoseUncertainty:
    return PoseUncertainty(along_z(drift), along_z(white), along_z(offset), clock)


def wall_map(poses: list[PoseUncertainty]) -> VoxelMap:
    voxel_map = VoxelMap(CONFIG)
    for known in poses:
        voxel_map.integrate(WALL, HERE, None, known, CAMERA)
    return voxel_map


def claimed(voxel_map: VoxelMap, relative: bool = True) -> float:
    """Variance across the wall of what lies before the camera [m^2]."""
    indices, _, covariances = voxel_map.gaussians(relative)
    inner = (indices[:, 2] == 20) & (np.abs(indices[:, :2] + 0.5) < 2.0).all(axis=1)
    assert inner.sum() == 16
    return float(np.median(covariances[inner, 2, 2]))


def true_variance(poses: list[PoseUncertainty]) -> float:
    """Of the mean of ranges that weighs each by its information, by a double sum."""
    drifts = [np.sqrt(known.drift[2, 2]) for known in poses]
    variances = [RANGE**2 + known.drift[2, 2] + known.white[2, 2] for known in poses]
    total, weights = 0.0, [1.0 / variance for variance in variances]
    for j, one in enumerate(poses):
        for k, other in enumerate(poses):
            shared = drifts[j] * drifts[k] * np.exp(-abs(one.clock - other.clock))
            total += weights[j] * weights[k] * (variances[j] if j == k else shared)
    return float(total / sum(weights) ** 2)


def test_a_camera_at_rest_is_no_surer_of_a_wall_than_of_its_pose():
    voxel_map = VoxelMap(CONFIG)
    for _ in range(100):
        voxel_map.integrate(WALL, HERE, None, along_z(0.02), CAMERA)
    assert np.sqrt(claimed(voxel_map)) == pytest.approx(np.hypot(0.02, RANGE / 10.0), rel=1e-3)


def test_a_camera_that_moves_far_between_scans_is():
    voxel_map = VoxelMap(CONFIG)
    for k in range(16):
        aside = make_transform(np.eye(3), [30.0 * (k % 2), 0.0, 0.0])
        voxel_map.integrate(WALL, aside, None, along_z(0.02), CAMERA)
    assert np.sqrt(claimed(voxel_map)) == pytest.approx(np.hypot(0.02, RANGE) / 8**0.5, rel=1e-3)


PATTERNS = {
    "drift over many correlation times": [pose(0.1 * k, 0.02) for k in range(80)],
    "slow drift": [pose(0.01 * k, 0.01, 0.002) for k in range(50)],
    "white": [pose(0.0, 0.0, 0.01) for _ in range(30)],
    "mixture": [pose(0.3 * k, 0.002 * (k % 7), 0.003 * (k % 3)) for k in range(60)],
    "at rest": [pose(2.0, 0.02, 0.001) for _ in range(40)],
    "a visit after a gap": [pose(0.02 * k + (5.0 if k > 20 else 0.0), 0.01) for k in range(40)],
    "one exact among many": [pose(0.1 * k, 0.03 if k != 4 else 0.0) for k in range(9)],
    "backwards in long steps": [pose(50.0 - 1.5 * k, 0.02) for k in range(20)],
    "one scan": [pose(3.0, 0.02, 0.01)],
}


@pytest.mark.parametrize("name", PATTERNS)
def test_the_variance_is_that_of_the_double_sum(name):
    poses = PATTERNS[name]
    assert claimed(wall_map(poses)) == pytest.approx(true_variance(poses), rel=2e-3)


def test_scans_that_come_late_are_nearly_accounted_for(rng):
    poses = [pose(0.1 * k, 0.02) for k in range(60)]
    expected = true_variance(poses)
    delayed = sorted(poses, key=lambda known: known.clock + rng.uniform(0.0, 0.5))
    assert claimed(wall_map(delayed)) == pytest.approx(expected, rel=0.1)
    assert claimed(wall_map(poses[::-1])) == pytest.approx(expected, rel=0.4)


def test_a_clock_that_begins_again_is_followed():
    poses = [pose(clock, 0.02) for clock in [90.0] * 10 + [0.0] * 40]
    assert claimed(wall_map(poses)) == pytest.approx(true_variance(poses), rel=2e-3)


@settings(deadline=None)
@given(
    st.lists(
        st.tuples(st.floats(-20.0, 20.0), st.floats(1e-4, 0.5), st.floats(0.0, 1.0)),
        min_size=1,
        max_size=25,
    )
)
def test_sharing_never_makes_surer_and_never_less_sure_than_to_share_all(scans):
    rows = NOTHING[None].copy()
    one = np.zeros(1, np.int64)
    for clock, sigma, share in scans:
        weight = 1.0 / sigma**2
        information = np.array([[weight, 0, 0, weight, 0, weight, 0, 0, 0]], np.float32)
        shares = np.array([[np.sqrt(share) * sigma * weight, 0.0]], np.float32)
        add_observations(rows, one, one, information, shares, float(np.float32(clock)), 0, 1)
    total = sum(1.0 / sigma**2 for _, sigma, _ in scans)
    roots = [np.sqrt(share) / sigma for _, sigma, share in scans]
    whole = 1.0 + (sum(roots) ** 2 - sum(root**2 for root in roots)) / total
    assert 1.0 <= inflation(rows[0]) <= whole * (1.0 + 1e-4)


@pytest.mark.parametrize("step", [0.0, 0.1, 50.0])
def test_what_noise_chose_is_in_all_scans_whatever_their_clocks(step):
    """Of v = r / k + white of each scan all have 0.15 r / k in common, and no more."""
    scans, white, voxel_map = 40, 0.0005, VoxelMap(replace(CONFIG, error_correlation=0.0))
    for k in range(scans):
        voxel_map.integrate(WALL, HERE, None, pose(step * k, 0.0, white), CAMERA)
    voxels, pixels = np.unique(
        np.floor(WALL[..., :2].reshape(-1, 2) / CONFIG.voxel_size), axis=0, return_counts=True
    )
    of_mean = RANGE**2 / pixels[(np.abs(voxels + 0.5) < 2.0).all(axis=1)]
    expected = (of_mean + white**2) / scans + 0.15 * of_mean * (1.0 - 1.0 / scans)
    assert claimed(voxel_map) == pytest.approx(np.median(expected), rel=0.01)


def test_scans_with_an_error_in_common_come_in_any_order(rng):
    fewer = [WALL[:, :30], WALL[:24], WALL, WALL[12:36]]
    camera, found = CAMERA, []
    for order in ([0, 1, 2, 3], [3, 1, 0, 2], [2, 3, 1, 0]):
        voxel_map = VoxelMap(replace(CONFIG, error_correlation=0.2))
        for i in order:
            part = np.full_like(WALL, np.nan)
            part[: fewer[i].shape[0], : fewer[i].shape[1]] = fewer[i]
            voxel_map.integrate(part, HERE, None, pose(0.0, 0.0, 0.001 * (i + 1)), camera)
        indices, _, covariances = voxel_map.gaussians()
        found.append(covariances[np.lexsort(indices.T)])
    np.testing.assert_allclose(found[1], found[0], rtol=1e-5, atol=1e-12)
    np.testing.assert_allclose(found[2], found[0], rtol=1e-5, atol=1e-12)


def ridge(rng: np.random.Generator, sigma: float) -> tuple[FloatArray, FloatArray]:
    """A camera's look, shape (144, 180, 3), at a right angle, and the outward normals of its faces.

    The ridge is at (0, 0, 1), along y but for a little, so that it passes voxels in all places.
    """
    camera = PinholeCamera(180, 144, 150.0, 150.0, 89.5, 71.5)
    turn = Rotation.from_rotvec([0.1, 0.05, 0.3]).as_matrix()
    normals = np.array([[-1.0, 0.0, -1.0], [1.0, 0.0, -1.0]]) / np.sqrt(2.0) @ turn.T
    rays = camera.back_project(np.ones((144, 180))).astype(np.float64)
    depths = normals[:, 2] / (rays @ normals.T)
    depths = np.where(depths > 0.0, depths, -np.inf).max(axis=2)
    return rays * (depths + rng.normal(0.0, sigma, depths.shape))[..., None], normals


def test_looks_from_one_place_do_not_make_sure_of_a_ridge(rng):
    """The points of a voxel with a ridge have their mean within the solid, in each look."""
    camera, sigma = PinholeCamera(180, 144, 150.0, 150.0, 89.5, 71.5), 0.002
    voxel_map = VoxelMap(VoxelMapConfig(default_sigma=sigma, error_correlation=0.0))
    for k in range(50):
        points, normals = ridge(rng, sigma)
        voxel_map.integrate(points, HERE, None, pose(float(k), 0.0), camera)
    _, means, covariances = voxel_map.gaussians()
    along = np.cross(*normals) / np.linalg.norm(np.cross(*normals))
    from_tip = means - [0.0, 0.0, 1.0]
    across = np.linalg.norm(from_tip - np.outer(from_tip @ along, along), axis=1)
    near = (across < 0.03) & (np.abs(from_tip @ along) < 0.3)
    distances = from_tip[near] @ normals.T
    face = distances.argmax(axis=1)  # of a convex solid the greater is the distance
    faced = normals[face]
    variances = np.einsum("ni,nij,nj->n", faced, covariances[near], faced)
    errors = distances[np.arange(len(face)), face] / np.sqrt(variances)
    assert near.sum() > 20
    assert np.mean(errors**2) < 2.0


def test_what_is_shared_by_the_whole_map_is_added_when_it_is_read():
    voxel_map = wall_map([pose(0.0, 0.01, offset=0.03), pose(40.0, 0.01, offset=0.05)])
    assert claimed(voxel_map, relative=False) - claimed(voxel_map) == pytest.approx(0.05**2)
    turned = np.diag([0.0, 0.0, 0.0, 0.0, 1e-4, 0.0])
    known = PoseUncertainty(np.zeros((6, 6)), offset=turned)
    aside = make_transform(np.eye(3), [5.0, 0.0, 0.0])
    voxel_map.integrate(WALL, aside, None, known, CAMERA)
    _, means, absolute = voxel_map.gaussians()
    _, _, relative = voxel_map.gaussians(relative=True)
    expected = 1e-4 * (means[:, 0] - 5.0) ** 2  # a turn about y, about the camera
    np.testing.assert_allclose((absolute - relative)[:, 2, 2], expected, atol=1e-9)


def test_a_file_keeps_what_scans_shared_but_later_scans_share_nothing_with_them(tmp_path):
    poses = [pose(0.1 * k, 0.02, offset=0.01) for k in range(10)]
    voxel_map = wall_map(poses)
    voxel_map.save(tmp_path / "wall.map")
    loaded = VoxelMap.load(tmp_path / "wall.map")
    for one, other in zip(voxel_map.gaussians(), loaded.gaussians(), strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(voxel_map.offset, loaded.offset)
    again = [pose(0.1 * k, 0.02) for k in range(10)]
    for known in again:
        loaded.integrate(WALL, HERE, None, known, CAMERA)
    later = [pose(known.clock + 1e3, 0.02) for known in again]
    assert claimed(loaded) == pytest.approx(true_variance(poses + later), rel=2e-3)
    copy = VoxelMap.from_state(CONFIG, voxel_map.state())
    copy.integrate(WALL, HERE, None, pose(1.0, 0.02), CAMERA)
    assert claimed(copy) == pytest.approx(true_variance([*poses, pose(1.0, 0.02)]), rel=2e-3)


def test_scans_share_after_a_correction_what_they_shared_before():
    corrected = CorrectableMap(VoxelMap(CONFIG))
    wrong = make_transform(np.eye(3), [0.0, 0.0, 0.2])
    used = [pose(0.2 * k, 0.2, 0.1) for k in range(8)]
    for stamp, known in enumerate(used):
        corrected.integrate(stamp, WALL, wrong, None, known, CAMERA)
    stamps, now = list(range(8)), along_z(0.02)
    corrected.receive_poses(10, stamps, [wrong] * 8, [known.covariance for known in used])
    corrected.receive_poses(11, stamps, [HERE] * 8, [now] * 8)
    assert corrected.correct() is not None
    expected = [pose(0.2 * k, 0.02 * np.sqrt(0.8), 0.02 * np.sqrt(0.2)) for k in range(8)]
    assert claimed(corrected.voxel_map) == pytest.approx(true_variance(expected), rel=0.01)


def test_frozen_scans_share_their_errors_with_those_that_are_kept():
    corrected = CorrectableMap(VoxelMap(CONFIG))
    for stamp in range(4):
        corrected.integrate(stamp, WALL, HERE, None, pose(1.0, 0.02), CAMERA)
    store = corrected.store
    base = VoxelMap.from_state(CONFIG, store.base.state())
    for scan in list(store)[:2]:
        base.integrate(WALL, HERE, None, scan.uncertainty, CAMERA)
    again = VoxelMap.from_state(CONFIG, base.state())
    for scan in list(store)[2:]:
        again.integrate(WALL, HERE, None, scan.uncertainty, CAMERA)
    assert claimed(again) == pytest.approx(claimed(corrected.voxel_map), rel=1e-3)


def test_what_a_robot_sends_includes_what_its_scans_share():
    poses = [pose(0.05 * k, 0.02) for k in range(40)]
    replica = MapReplica(CONFIG)
    for robot in (1, 2):
        voxel_map = VoxelMap(CONFIG)
        voxel_map.track_changes(True)
        for known in poses:
            voxel_map.integrate(WALL, HERE, None, known, CAMERA)
        update = MapUpdate.of_changes(voxel_map.take_changes(), CONFIG.voxel_size, robot, 1)
        replica.apply(update)
        expected = true_variance(poses) / robot
        assert claimed(replica.voxel_map) == pytest.approx(expected, rel=0.15)
