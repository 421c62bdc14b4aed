"""The two faces of a thin wall, each seen from its own side."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from infomap_ros.geometry import PinholeCamera
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.voxels.surface import side_of

from .scenes import look_at

CAMERA = PinholeCamera(120, 90, 100.0, 100.0, 59.5, 44.5)
SIZE, SIGMA = 0.05, 0.06
FACES = (0.0, 0.12)


@cache
def wall() -> VoxelMap:
    """A wall of 12 cm that eight looks from each side have seen, with noise of half as much."""
    rng, voxel_map = np.random.default_rng(3), VoxelMap(VoxelMapConfig(voxel_size=SIZE))
    for _ in range(8):
        for face, side in zip(FACES, (-1.0, 1.0), strict=True):
            position = np.array([face + side * rng.uniform(2.0, 2.5), *rng.uniform(-0.3, 0.3, 2)])
            pose = look_at(position, np.array([face, *rng.uniform(-0.2, 0.2, 2)]))
            rays = CAMERA.back_project(np.ones((90, 120))) @ pose[:3, :3].T
            depth = (face - position[0]) / rays[..., 0] + rng.normal(0.0, SIGMA, (90, 120))
            covariances = np.broadcast_to(np.eye(3) * SIGMA**2, (90, 120, 3, 3))
            voxel_map.integrate(
                CAMERA.back_project(depth), pose, covariances, camera=CAMERA, error_correlation=0.0
            )
    return voxel_map


@pytest.mark.parametrize("face", FACES)
def test_each_face_is_found_where_it_is(face):
    _, means, _ = wall().gaussians()
    inner = (np.abs(means[:, 1:]) < 0.5).all(axis=1) & (np.abs(means[:, 0] - face) < 0.06)
    assert abs(np.mean(means[inner, 0]) - face) < 0.005


@pytest.mark.parametrize("face", FACES)
def test_no_face_has_holes(face):
    _, means, _ = wall().gaussians()
    near = means[np.abs(means[:, 0] - face) < 0.06]
    cells = {tuple(cell) for cell in np.floor(near[:, 1:] / SIZE).astype(int).tolist()}
    wanted = {(j, k) for j in range(-10, 10) for k in range(-10, 10)}
    assert len(wanted - cells) <= 0.02 * len(wanted)


def test_the_sides_survive_a_file(tmp_path):
    wall().save(tmp_path / "wall.map")
    for a, b in zip(
        wall().gaussians(), VoxelMap.load(tmp_path / "wall.map").gaussians(), strict=True
    ):
        np.testing.assert_array_equal(a, b)


def test_opposite_normals_have_different_sides(rng):
    for normal in rng.normal(size=(100, 3)):
        assert side_of(*normal) != side_of(*-normal)
    for axis in np.eye(3):  # noise of ten degrees does not split a wall or a floor
        for bent in axis + rng.uniform(-0.1, 0.1, (50, 3)):
            assert side_of(*bent) == side_of(*axis)
