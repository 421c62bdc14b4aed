from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.geometry import PinholeCamera, StereoRig
from infomap_ros.stereo import StereoConfig
from infomap_ros.stereo.images import RowBands
from infomap_ros.stereo.sensor import drop_inconsistent, drop_speckles, edge_free

INVALID = -16


def rig(offset: float = 0.0) -> StereoRig:
    left = PinholeCamera(640, 480, 300.0, 300.0, 320.0, 240.0)
    right = PinholeCamera(640, 480, 300.0, 300.0, 320.0 + offset, 240.0)
    return StereoRig(left, right, 0.1)


def naive_left_right(disparity, tolerance):
    """Pixel by pixel: is a nearer surface seen at the same place of the right image?"""
    height, width = disparity.shape
    kept = np.full_like(disparity, INVALID)
    for v in range(height):
        targets = [u - (int(d) + 8) // 16 for u, d in enumerate(disparity[v])]
        for u in range(width):
            d = disparity[v, u]
            if d <= INVALID or not 0 <= targets[u] < width:
                continue
            rivals = [
                disparity[v, i]
                for i in range(width)
                if targets[i] == targets[u] and disparity[v, i] > INVALID
            ]
            if d >= max(rivals) - 16 * tolerance:
                kept[v, u] = d
    return kept


@pytest.mark.parametrize("tolerance", [1, 3])
def test_left_right_check_agrees_with_the_obvious_one(rng, tolerance):
    disparity = rng.integers(-20, 320, (12, 50)).astype(np.int16)
    found = drop_inconsistent(disparity, INVALID, tolerance, RowBands(12, 2))
    np.testing.assert_array_equal(found, naive_left_right(disparity, tolerance))


def test_left_right_check_drops_the_hidden_background():
    disparity = np.full((1, 60), 5 * 16, np.int16)
    disparity[0, 30:40] = 15 * 16  # covers columns 15 to 24 of the right image
    found = drop_inconsistent(disparity, INVALID, 1, RowBands(1))
    hidden = np.flatnonzero((found[0] == INVALID) & (np.arange(60) >= 5))
    np.testing.assert_array_equal(hidden, np.arange(20, 30))


def test_speckles_smaller_than_the_limit_go():
    disparity = np.full((40, 40), 64, np.int16)
    disparity[5:8, 5:8] = 400
    disparity[20:32, 20:32] = 400
    drop_speckles(disparity, INVALID, StereoConfig(speckle_size=100))
    assert (disparity[5:8, 5:8] == INVALID).all()
    assert (disparity[20:32, 20:32] == 400).all()


def test_edges_agree_with_the_obvious_window(rng):
    disparity = (rng.integers(0, 27, (30, 40)) + 330 * (np.arange(40) > 19)).astype(np.int16)
    disparity[18:, :8] //= 3
    disparity[10, 20] = INVALID
    config = StereoConfig(max_grazing_angle=1.4)
    found = edge_free(disparity, INVALID, config, rig(offset=3.0))
    expected = np.zeros((30, 40), bool)
    for v in range(3, 27):
        for u in range(3, 37):
            window = disparity[v - 2 : v + 3, u - 2 : u + 3]
            steep = 4 * np.tan(1.4) / 300.0 * (window.min() / 16 + 3.0)
            jump = np.clip(steep, 1.0, 2.0)
            expected[v, u] = window.min() > INVALID and np.ptp(window) / 16 < jump
    np.testing.assert_array_equal(found, expected)
    assert 0 < expected.sum() < expected.size


@pytest.mark.parametrize("angle", [0.0, 1.0, 1.35])
@pytest.mark.parametrize("offset", [0.0, 12.0])
def test_a_plane_seen_at_a_believable_angle_has_no_edges(angle, offset):
    """The floor 2.5 m away, seen at an angle from its normal, by intersecting every ray."""
    pair = rig(offset)
    v, u = np.mgrid[0:480, 0:640].astype(float)
    normal = np.array((0.0, -np.sin(angle), -np.cos(angle)))
    rays = np.stack(((u - 320.0) / 300.0, (v - 240.0) / 300.0, np.ones_like(u)), axis=-1)
    depth = normal[2] * 2.5 / (rays @ normal)
    disparity = np.round(16.0 * (300.0 * 0.1 / depth - offset)).astype(np.int16)
    found = edge_free(disparity, -(2**15), StereoConfig(), pair)
    assert found[220:260, 300:340].all()


def test_a_small_jump_far_away_is_an_edge():
    """From 3.0 to 3.6 m, 1.7 px, over 4 px as a matcher joins them: a wall that is not there."""
    near, far = 300.0 * 0.1 / 3.0, 300.0 * 0.1 / 3.6
    row = np.interp(np.arange(640), (318, 322), (near, far))
    disparity = np.tile(np.round(16.0 * row).astype(np.int16), (480, 1))
    found = edge_free(disparity, INVALID, StereoConfig(), rig())
    assert not found[:, 319:322].any()
    assert found[10:-10, 10:315].all() and found[10:-10, 326:-10].all()
