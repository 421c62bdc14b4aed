"""The parameters of fiducial_localization's own.

Kernels of localization that are ready before the first image.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import ClassVar

import cv2
import numpy as np

from infomap_ros.geometry import PinholeCamera, StereoRig
from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.localization.fiducials.range_view import DepthView, StereoView
from infomap_ros.localization.localizer import Localizer
from infomap_ros.stereo import DepthCameraSensor, StereoConfig, StereoRangeSensor


@dataclass(frozen=True)
class FiducialLocalizationConfig:
    """What fiducial_localization listens to, and how it tells what it finds.

    Raises:
        ConfigError: a value is out of its range.
    """

    source: str = parameter(
        "stereo",
        "A pair of cameras, or a depth camera with the image that is registered to it "
        "(depth/image_rect and rgb/image_rect).",
        choices=("stereo", "depth"),
    )
    rectify: bool = parameter(
        False, "Listen to image_raw and rectify, instead of listening to image_rect."
    )
    motion: str = parameter(
        "auto",
        "What the camera's motion is expected from. odometry: odom, with joint_states and "
        "robot_description; without them nothing is located, and where there is no target the "
        "map begins where odometry does. none: the images alone. auto: "
        "odometry where odom and robot_description are published, else imu where tf says where on "
        "the camera it is.",
        choices=("auto", "odometry", "none"),
    )
    start_tilt: ClassVar[float] = 0.0
    """How far the camera looks down at the beginning, where neither odometry nor target say what
    is up [rad].
    """
    pairing_tolerance: float = parameter(
        0.0,
        "Largest difference between the stamps of a pair; 0 for cameras that share a trigger.",
        unit="s",
        low=0.0,
        high=1.0,
    )
    queue_size: int = setting(
        3, "Pairs that wait for the worker at most; for one more, all give way.", low=1, high=1000
    )
    use_map: bool = parameter(
        False,
        "Choose fiducials by their certainty in the shared map, f(P) of eq. (19), once map_updates "
        "have arrived; otherwise by the range's own sigma.",
    )
    use_detections: bool = parameter(
        False,
        "Take tags from detections, as apriltag_ros publishes them of the rectified left image (or "
        "of rgb/image_rect), and do not look for them.",
    )
    follow_alignment: bool = parameter(
        False,
        "Move the map where map_alignment says: teammates that see this robot's tags, or a user. "
        "With team_key, only what is signed with it on map_alignment_signed is taken.",
    )
    state_file: str = parameter(
        "",
        "What is known of the map is written here, so that the node can go on in the same map "
        "after a restart, relative to the working directory; empty for no file.",
    )
    save_period: float = setting(
        30.0, "Time between two writings of state_file.", unit="s", low=0.1, high=3600.0
    )
    resume: bool = parameter(
        False,
        "Go on in the map of state_file, where there is one: from where odometry has come to "
        "since, or without odometry as soon as a known place or the target is seen again.",
    )

    def __post_init__(self) -> None:
        check_config(self)


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
