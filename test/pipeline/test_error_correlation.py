"""The correlation of range errors travels with each cloud."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.errors import MalformedMessageError
from infomap_ros.geometry import PinholeCamera, PointCloudRecord
from infomap_ros.messages import decode_point_cloud, encode_point_cloud, encode_range_cloud
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.stereo import DepthCameraConfig, DepthCameraSensor

TYPES = RclpyMessageTypes()
CAMERA = PinholeCamera(32, 24, 30.0, 30.0, 15.5, 11.5)


@pytest.mark.parametrize("share", [0.0, 0.07, 0.38, 1.0])
def test_it_lies_beside_the_colors(share: float) -> None:
    color = np.arange(24 * 32 * 3, dtype=np.uint32).astype(np.uint8).reshape(24, 32, 3)
    sensor = DepthCameraSensor(CAMERA, DepthCameraConfig(error_correlation=share))
    cloud = sensor.measure(np.full((24, 32), 1.0, np.float32), color)
    read = decode_point_cloud(encode_range_cloud(TYPES, 1, "camera", cloud.packed))
    assert read.error_correlation == share
    np.testing.assert_array_equal(read.colors, color)
    np.testing.assert_array_equal(read.points, cloud.organized_points)


def test_other_clouds_have_a_column_or_nothing() -> None:
    points = np.ones((5, 3), np.float32)
    for share in (0.25, None):
        record = PointCloudRecord(1, "camera", points, error_correlation=share)
        assert decode_point_cloud(encode_point_cloud(TYPES, record)).error_correlation == share


def test_what_is_no_correlation_is_refused() -> None:
    record = PointCloudRecord(1, "camera", np.ones((5, 3), np.float32), error_correlation=1.5)
    with pytest.raises(MalformedMessageError, match="expected 0 to 1"):
        decode_point_cloud(encode_point_cloud(TYPES, record))
