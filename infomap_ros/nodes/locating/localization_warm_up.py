"""Kernels of localization that are ready before the first image."""

from __future__ import annotations

import functools

import cv2
import numpy as np

from infomap_ros.geometry import PinholeCamera, StereoRig
from infomap_ros.localization.fiducials.range_view import DepthView, StereoView
from infomap_ros.localization.localizer import Localizer
from infomap_ros.stereo import DepthCameraSensor, StereoConfig, StereoRangeSensor

_CAMERA = PinholeCamera(320, 240, 240.0, 240.0, 159.5, 119.5)
_DISPARITY, _STEP = 12, 2  # [px]
_VIEWS = 4


@functools.cache
def warm_up() -> None:
    """Follow a camera before a wall, as a stereo pair and as a depth camera would; once only."""
    rig = StereoRig(_CAMERA, _CAMERA, 0.1)
    sensor, depth_sensor = StereoRangeSensor(rig, StereoConfig()), DepthCameraSensor(_CAMERA)
    depth = np.full((_CAMERA.height, _CAMERA.width), rig.left.fx * rig.baseline / _DISPARITY)
    wall = _texture(_CAMERA.height, _CAMERA.width + _DISPARITY + _VIEWS * _STEP)
    by_stereo, by_depth = Localizer(_CAMERA), Localizer(_CAMERA)
    for number in range(_VIEWS):
        stamp, start = number * 100_000_000, number * _STEP
        left = wall[:, start : start + _CAMERA.width]
        right = wall[:, start + _DISPARITY : start + _DISPARITY + _CAMERA.width]
        by_stereo.locate(StereoView(stamp, left, right, sensor))
        by_depth.locate(DepthView(stamp, left, depth_sensor.measure(depth)))


def _texture(height: int, width: int) -> np.ndarray:
    """Gray blobs, shape (height, width), uint8."""
    noise = np.random.default_rng(1).normal(size=(height, width))
    blobs = cv2.GaussianBlur(noise, (0, 0), 2.0)
    return np.clip(128.0 + 60.0 * blobs / blobs.std(), 0.0, 255.0).astype(np.uint8)
