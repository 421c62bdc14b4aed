"""Gains by voxel, and what views share."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import PinholeCamera, make_transform
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.voxels.keys import unpack
from infomap_ros.mapping.voxels.window import UNKNOWN_QUANTA
from infomap_ros.views.information.view_information import (
    VoxelGains,
    expected_information,
    view_gains,
)
from infomap_ros.views.information.view_query import InformationConfig

from . import naive
from .voxels import map_of

CAMERA = PinholeCamera(64, 48, 50.0, 50.0, 31.5, 23.5)
FORWARD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


@pytest.fixture(scope="module")
def cluttered() -> VoxelMap:
    rng = np.random.default_rng(8)
    quanta = rng.choice([UNKNOWN_QUANTA, -20, -20, -6, 2, 20], (40, 40, 40))
    return map_of(quanta, (0, -24, -16), VoxelMapConfig(voxel_size=0.1))


def test_sum_is_the_information_of_the_view(cluttered: VoxelMap) -> None:
    config = InformationConfig(ray_spacing=0.02)
    region = np.array([[0.3, -1.0, -1.0], [2.4, 1.0, 1.0]])
    for turn, box in (([0.0, 0.2, 0.1], None), ([0.4, 0.0, -0.5], region)):
        pose = make_transform(Rotation.from_rotvec(turn).as_matrix() @ FORWARD, (1.0, 0.0, 0.2))
        gains = view_gains(cluttered, pose, CAMERA, 2.5, config, box)
        bits = expected_information(cluttered, pose, CAMERA, 2.5, config=config, region=box)[0]
        assert gains.total == pytest.approx(bits, rel=1e-5)
        assert (np.diff(gains.keys) > 0).all() and (gains.gains > 0.0).all()


def test_each_voxel_gets_its_own_gain() -> None:
    """In clear view, with rays much closer than voxels, a voxel's gain is that of its state."""
    rng = np.random.default_rng(2)
    quanta = rng.choice([UNKNOWN_QUANTA, -20, -8, -3, 0], (24, 24, 24))
    m = map_of(quanta, (0, -8, -8), VoxelMapConfig(voxel_size=0.1))
    config = InformationConfig(ray_spacing=0.004, min_range=0.0)
    pose = make_transform(FORWARD, (0.13, 0.22, 0.31))
    gains = view_gains(m, pose, CAMERA, 2.0, config)
    ratios = []
    for key, gain in zip(gains.keys.tolist(), gains.gains, strict=True):
        place = (np.array(unpack(key)) + 0.5) * 0.1
        offset = place - pose[:3, 3]
        distance = float(np.linalg.norm(offset))
        if 0.8 < distance < 1.8 and abs(offset[1:]).max() < 0.35 * offset[0]:
            known, log_odds = m.is_known(place[None])[0], m.log_odds(place[None])[0]
            full = naive.voxel_gain(m, known, log_odds, config)
            ratios.append(gain / (full * naive.observed_share(m, distance, config)))
    assert len(ratios) > 500 and np.mean(ratios) == pytest.approx(1.0, abs=0.01)
    assert min(ratios) > 0.6 and max(ratios) < 1.4  # a step is as long as a voxel


def test_views_count_what_they_share_once(cluttered: VoxelMap) -> None:
    poses = [make_transform(FORWARD, (0.5, y, 0.2)) for y in (0.0, 0.4)]
    first, second = (view_gains(cluttered, pose, CAMERA, 2.5) for pose in poses)
    assert first.beyond(first) == pytest.approx(0.0, abs=1e-9)
    both = first.joined(second)
    assert both.total == pytest.approx(first.total + second.beyond(first), rel=1e-12)
    assert max(first.total, second.total) < both.total < first.total + second.total
    assert 0.0 < second.beyond(first) < second.total
    away = make_transform(Rotation.from_rotvec([0, 0, np.pi]).as_matrix() @ FORWARD, (3.5, 0, 0.2))
    nothing = VoxelGains(np.empty(0, np.int64), np.empty(0))
    assert first.beyond(nothing) == first.total
    assert view_gains(cluttered, away, CAMERA, 2.5).beyond(first) > 0.0


def test_shared_gains_are_the_smaller_of_the_two() -> None:
    a = VoxelGains(np.array([1, 4, 9]), np.array([1.0, 2.0, 3.0]))
    b = VoxelGains(np.array([2, 4, 9]), np.array([5.0, 1.0, 7.0]))
    assert a.beyond(b) == pytest.approx(1.0 + 1.0 + 0.0)
    joined = a.joined(b)
    np.testing.assert_array_equal(joined.keys, [1, 2, 4, 9])
    np.testing.assert_array_equal(joined.gains, [1.0, 5.0, 2.0, 7.0])


def test_a_wide_view_of_the_unknown_outgrows_the_first_table() -> None:
    m = VoxelMap(VoxelMapConfig(voxel_size=0.05))
    config = InformationConfig(ray_spacing=0.05)
    gains = view_gains(m, np.eye(4), CAMERA, 5.0, config)
    bits = expected_information(m, np.eye(4), CAMERA, 5.0, config=InformationConfig(0.01))[0]
    assert len(gains.keys) > 50_000
    assert gains.total == pytest.approx(bits, rel=1e-4)
