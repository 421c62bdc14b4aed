"""Scans may come in any order."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from infomap_ros.geometry import PinholeCamera, PoseUncertainty
from infomap_ros.mapping import VoxelMap, VoxelMapConfig

from .scenes import random_pose, random_scene, with_holes

CAMERA = PinholeCamera(64, 48, 50.0, 50.0, 31.5, 23.5)
SCANS = 6
INDEPENDENT = PoseUncertainty(np.zeros((6, 6)), white=np.eye(6) * 1e-5)
"""What scans share depends a little on their order if clocks go back."""


@cache
def scans(seed: int) -> list[tuple[np.ndarray, np.ndarray, np.ndarray, PoseUncertainty]]:
    """Points, pose, point covariances and pose covariance of some looks around one scene."""
    rng = np.random.default_rng(seed)
    scene, looks = random_scene(rng), []
    for _ in range(SCANS):
        pose = random_pose(rng)
        points = with_holes(scene.points(CAMERA, pose), rng, 0.1)
        points = points * rng.normal(1.0, 0.003, (*points.shape[:2], 1)).astype(np.float32)
        variance = np.nan_to_num((0.005 * points[..., 2]) ** 2, nan=1.0)
        covariances = variance[..., None, None] * np.eye(3, dtype=np.float32)
        looks.append((points, pose, covariances, INDEPENDENT))
    return looks


@cache
def map_of(seed: int, order: tuple[int, ...], with_camera: bool, threads: int) -> VoxelMap:
    config = VoxelMapConfig(voxel_size=0.06, max_range=2.5, threads=threads)
    voxel_map = VoxelMap(config)
    for i in order:
        points, pose, covariances, pose_covariance = scans(seed)[i]
        voxel_map.integrate(
            points, pose, covariances, pose_covariance, CAMERA if with_camera else None
        )
    return voxel_map


def sorted_voxels(voxel_map: VoxelMap) -> tuple[np.ndarray, np.ndarray]:
    indices, log_odds = voxel_map.voxels()
    order = np.lexsort(indices.T)
    return indices[order], log_odds[order]


def assert_same_map(left: VoxelMap, right: VoxelMap) -> None:
    for a, b in zip(sorted_voxels(left), sorted_voxels(right), strict=True):
        np.testing.assert_array_equal(a, b)
    one = {tuple(i): (m, c) for i, m, c in zip(*left.gaussians(), strict=True)}
    other = {tuple(i): (m, c) for i, m, c in zip(*right.gaussians(), strict=True)}
    # Rounding may move a mean across the tolerance of a tenth of a voxel beyond the voxel's face.
    assert len(one.keys() ^ other.keys()) <= 0.002 * len(one)
    for index in one.keys() & other.keys():
        scale = np.trace(one[index][1])
        np.testing.assert_allclose(one[index][0], other[index][0], atol=1e-5)
        np.testing.assert_allclose(one[index][1], other[index][1], atol=1e-4 * scale)


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("with_camera", [True, False])
@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 1), order=st.permutations(range(SCANS)))
def test_any_order_gives_the_same_map(with_camera, threads, seed, order):
    reference = map_of(seed, tuple(range(SCANS)), with_camera, threads)
    shuffled = map_of(seed, tuple(order), with_camera, threads)
    assert_same_map(reference, shuffled)
    assert shuffled.known_voxels > 3000
    assert shuffled.surface_voxels > 500


@pytest.mark.parametrize("with_camera", [True, False])
def test_two_threads_see_what_one_sees(with_camera):
    order = tuple(range(SCANS))
    one, two = (map_of(0, order, with_camera, threads) for threads in (1, 2))
    indices, log_odds = sorted_voxels(one)
    other_indices, other_log_odds = sorted_voxels(two)
    np.testing.assert_array_equal(indices, other_indices)
    # Sums over a voxel that both threads meet round differently: a hit may differ by one quantum.
    differs = log_odds != other_log_odds
    assert differs.mean() < 1e-3
    assert np.abs(log_odds - other_log_odds).max() <= 0.25 * SCANS
    assert abs(one.surface_voxels - two.surface_voxels) <= 0.005 * one.surface_voxels


@pytest.mark.parametrize("with_camera", [True, False])
def test_the_same_scans_give_the_same_bits(with_camera):
    order = tuple(range(SCANS))
    map_of.cache_clear()
    states = []
    for _ in range(2):
        states.append(map_of(0, order, with_camera, 2).state())
        map_of.cache_clear()
    assert states[0].keys() == states[1].keys()
    for name, array in states[0].items():
        np.testing.assert_array_equal(array, states[1][name], err_msg=name)
