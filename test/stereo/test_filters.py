from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.stereo import StereoConfig
from infomap_ros.stereo.bands import RowBands
from infomap_ros.stereo.filters import drop_inconsistent, drop_speckles, edge_free

INVALID = -16


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
    disparity = (64 + rng.integers(0, 40, (30, 40))).astype(np.int16)
    disparity[10, 20] = INVALID
    found = edge_free(disparity, INVALID, StereoConfig(edge_window=5, edge_threshold=2.0))
    expected = np.zeros((30, 40), bool)
    for v in range(3, 27):
        for u in range(3, 37):
            window = disparity[v - 2 : v + 3, u - 2 : u + 3]
            expected[v, u] = window.min() > INVALID and int(np.ptp(window)) < 32
    np.testing.assert_array_equal(found, expected)
    assert 0 < expected.sum() < expected.size
