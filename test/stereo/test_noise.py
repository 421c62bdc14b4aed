"""Range statistics against sampling, kernels against plain formulas."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.geometry import PinholeCamera, StereoRig
from infomap_ros.stereo import StereoConfig, noise
from infomap_ros.stereo.images import RowBands
from infomap_ros.stereo.noise import (
    match_terms,
    range_from_disparity,
    sigma_from_quality,
    sigma_from_terms,
)
from infomap_ros.stereo.quality import MatchQuality
from infomap_ros.stereo.range_cloud import assemble

CONFIG = StereoConfig(min_depth=0.1, max_depth=1000.0)
OFFSET = 12.0


@pytest.fixture(autouse=True)
def _many_are_kept(monkeypatch):
    monkeypatch.setattr(noise, "_MAX_RELATIVE_SIGMA", 0.3)


def convert(disparity, sigma):
    """Depth and its variance for disparities of any number, by the code under test."""
    left = PinholeCamera(len(disparity), 1, 400.0, 400.0, 0.0, 0.0)
    right = PinholeCamera(len(disparity), 1, 400.0, 400.0, OFFSET, 0.0)
    planes = (np.full((1, len(disparity)), s) for s in (True,))
    rig = StereoRig(left, right, 0.2)
    values = (
        np.asarray(a, np.float32)[None] for a in (disparity, np.broadcast_to(sigma, len(disparity)))
    )
    return range_from_disparity(rig, CONFIG, *planes, *values, RowBands(1))


@pytest.mark.parametrize("ratio", [0.02, 0.1, 0.15])
def test_depth_is_unbiased_and_its_variance_right_to_second_order(rng, ratio):
    true_shifted = 10.0
    sigma = ratio * true_shifted
    samples = rng.normal(true_shifted, sigma, 400_000)
    ranges = convert(samples - OFFSET, sigma)
    good = np.isfinite(ranges.depth)
    depth = ranges.depth[good].astype(np.float64)
    true = 400.0 * 0.2 / true_shifted
    naive = np.mean(80.0 / samples[samples > 1.0]) / true - 1.0
    bias = depth.mean() / true - 1.0
    assert abs(bias) < max(0.35 * abs(naive), 3.0 * depth.std() / true / np.sqrt(depth.size))
    predicted = convert([true_shifted - OFFSET], sigma).variance[0, 0]
    assert depth.var() == pytest.approx(predicted, rel=0.02 + 10.0 * ratio**2)


def test_a_first_order_range_would_be_biased_at_this_distance(rng):
    samples = rng.normal(10.0, 1.5, 400_000)
    assert np.mean(80.0 / samples[samples > 1.0]) / 8.0 - 1.0 > 0.02


def test_pixels_beyond_the_largest_relative_sigma_are_dropped():
    ranges = convert([10.0 - OFFSET, 10.0 - OFFSET], [2.9, 3.1])
    assert np.isfinite(ranges.depth[0, 0])
    assert np.isnan(ranges.depth[0, 1])


def test_disparities_at_or_beyond_infinity_are_dropped():
    ranges = convert([-OFFSET, -OFFSET - 3.0], 0.1)
    assert np.isnan(ranges.depth).all()


def test_covariance_of_points_matches_sampled_points(rng):
    camera = PinholeCamera(640, 480, 400.0, 410.0, 300.0, 250.0)
    depth = np.full((480, 640), np.nan, np.float32)
    variance = np.full_like(depth, 0.05**2)
    depth[30, 600] = 2.0
    image = np.zeros((480, 640), np.uint8)
    packed = assemble(camera, depth, variance, 0.5, image, RowBands(480, 2))
    found = packed[30, 600, 4:][[0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(3, 3)
    z = rng.normal(2.0, 0.05, 200_000)
    u = rng.normal(600.0, 0.5, z.size)
    v = rng.normal(30.0, 0.5, z.size)
    points = np.column_stack([z * (u - 300.0) / 400.0, z * (v - 250.0) / 410.0, z])
    expected = np.cov(points.T)
    np.testing.assert_allclose(found, expected, rtol=0.02, atol=2e-5)


def test_sigma_kernel_is_the_power_law_within_one_percent(rng):
    planes = [np.exp(rng.uniform(-2.0, 8.0, (50, 60))).astype(np.float32) for _ in range(4)]
    quality = MatchQuality(*planes)
    exact = sigma_from_terms(match_terms(quality), CONFIG)
    found = sigma_from_quality(quality, CONFIG, RowBands(50, 2))
    np.testing.assert_allclose(found, exact, rtol=0.01)


def test_sigma_is_never_below_its_floor():
    sharp = (np.full((4, 5), value, np.float32) for value in (0.0, 0.0, 1e6, 1e8))
    sigma = sigma_from_quality(MatchQuality(*sharp), StereoConfig(), RowBands(4))
    np.testing.assert_array_equal(sigma, np.float32(0.05))
