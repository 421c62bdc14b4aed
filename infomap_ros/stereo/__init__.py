"""Rectified pair -> disparity -> range image with variance -> points with 3x3 covariance."""

from infomap_ros.stereo.config import StereoConfig
from infomap_ros.stereo.depth_camera import DepthCameraConfig, DepthCameraSensor
from infomap_ros.stereo.range_cloud import PACKED_FIELDS, RangeCloud
from infomap_ros.stereo.rectification import (
    StereoRectifier,
    is_rectified,
    rectify_calibrations,
)
from infomap_ros.stereo.sensor import StereoRangeSensor

__all__ = [
    "PACKED_FIELDS",
    "DepthCameraConfig",
    "DepthCameraSensor",
    "RangeCloud",
    "StereoConfig",
    "StereoRangeSensor",
    "StereoRectifier",
    "is_rectified",
    "rectify_calibrations",
]
