from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.geometry import PinholeCamera
from infomap_ros.stereo import PACKED_FIELDS, DepthCameraSensor


@pytest.fixture
def cloud(rng):
    camera = PinholeCamera(32, 24, 40.0, 40.0, 16.0, 12.0)
    depth = np.full((24, 32), 2.0, np.float32)
    depth[3:9, 4:20] = 0.0
    colors = rng.integers(0, 256, (24, 32, 3)).astype(np.uint8)
    return DepthCameraSensor(camera).measure(depth, colors)


def test_views_and_copies_agree_with_the_packed_channels(cloud):
    assert cloud.packed.shape == (24, 32, len(PACKED_FIELDS))
    np.testing.assert_array_equal(cloud.organized_points[cloud.valid], cloud.points)
    np.testing.assert_array_equal(cloud.organized_covariances[cloud.valid], cloud.covariances)
    assert np.shares_memory(cloud.organized_points, cloud.packed)
    assert np.shares_memory(cloud.covariance_triangles, cloud.packed)
    upper = cloud.covariances[:, *np.triu_indices(3)]
    np.testing.assert_array_equal(cloud.covariance_triangles[cloud.valid], upper)


def test_colors_are_packed_as_point_cloud_viewers_read_them(cloud):
    packed = np.ascontiguousarray(cloud.packed[..., PACKED_FIELDS.index("rgb")])
    blue_green_red = packed.view(np.uint8).reshape(24, 32, 4)
    np.testing.assert_array_equal(blue_green_red[..., 2::-1], cloud.colors)
    assert (blue_green_red[..., 3] == round(100.0 * cloud.error_correlation)).all()


def test_density_counts_measured_pixels(cloud):
    assert cloud.density == pytest.approx(len(cloud.points) / (24 * 32))
