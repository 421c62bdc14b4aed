"""What stereo_range measures with: a pair of cameras, or a depth camera in its place."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from infomap_ros.errors import FrameError, MalformedMessageError
from infomap_ros.geometry import (
    CameraCalibration,
    CameraInfoRecord,
    ImageRecord,
    PinholeCamera,
    StereoRig,
    rig_from_calibrations,
)
from infomap_ros.nodes.range_outputs import Measurement
from infomap_ros.replay.messages import IMAGE
from infomap_ros.replay.pixels import intensity_pixels
from infomap_ros.stereo import (
    DepthCameraConfig,
    DepthCameraSensor,
    StereoConfig,
    StereoRangeSensor,
    StereoRectifier,
    is_rectified,
)

_DEPTH_ENCODINGS = ("32FC1", "16UC1", "mono16")


class RangeSource(Protocol):
    """Measures range from one image of each of its topics.

    Attributes:
        image_topics: one or two.
        info_topics: their camera infos; of a single one the calibration is used for all images.
    """

    image_topics: tuple[str, ...]
    info_topics: tuple[str, ...]

    def measure(
        self, images: tuple[ImageRecord, ...], infos: tuple[CameraInfoRecord, ...]
    ) -> Measurement:
        """Measure; the stamp and frame are those of the first image.

        Raises:
            InfomapError: images or calibrations cannot be used.
        """

    def warm_up(self) -> None:
        """Use every kernel once, so that it is compiled."""


@dataclass(frozen=True, eq=False)
class _Tools:
    left: CameraCalibration
    right: CameraCalibration
    sensor: StereoRangeSensor
    rectifier: StereoRectifier | None


class StereoSource:
    """A pair of cameras; see `RangeSource`.

    Args:
        config: of the sensor.
        rectify: the images are raw.
    """

    def __init__(self, config: StereoConfig, rectify: bool) -> None:
        kind = "image_raw" if rectify else "image_rect"
        self.image_topics: tuple[str, ...] = (f"left/{kind}", f"right/{kind}")
        self.info_topics: tuple[str, ...] = ("left/camera_info", "right/camera_info")
        self._config = config
        self._rectify = rectify
        self._tools: _Tools | None = None

    def measure(
        self, images: tuple[ImageRecord, ...], infos: tuple[CameraInfoRecord, ...]
    ) -> Measurement:
        """See `RangeSource.measure`."""
        for image, info in zip(images, infos, strict=True):
            check_frame(image, info)
        tools = self._tools_for(infos[0].calibration, infos[1].calibration)
        left, right = intensity_pixels(images[0]), intensity_pixels(images[1])
        if tools.rectifier is not None:
            left, right = tools.rectifier.rectify(left, right)
        cloud = tools.sensor.measure(left, right)
        search = tools.sensor.search
        return Measurement(
            images[0].stamp,
            images[0].frame_id,
            cloud,
            tools.sensor.rig,
            (float(search.minimum), float(search.maximum)),
        )

    def warm_up(self) -> None:
        """See `RangeSource.warm_up`."""
        camera = PinholeCamera(160, 40, 100.0, 100.0, 79.5, 19.5)
        noise = np.random.default_rng(0).integers(0, 256, (40, 164), dtype=np.uint8)
        left, right = noise[:, 4:], noise[:, :160]
        sensor = StereoRangeSensor(StereoRig(camera, camera, 0.1), self._config)
        sensor.measure(left, right)
        sensor.measure(np.stack([left] * 3, axis=-1), np.stack([right] * 3, axis=-1))

    def _tools_for(self, left: CameraCalibration, right: CameraCalibration) -> _Tools:
        """Sensor and rectifier of this calibration, made anew when it changes."""
        tools = self._tools
        if tools is None or (tools.left, tools.right) != (left, right):
            raw = self._rectify and not (is_rectified(left) and is_rectified(right))
            rectifier = StereoRectifier(left, right) if raw else None
            rig = rig_from_calibrations(left, right)
            tools = _Tools(left, right, StereoRangeSensor(rig, self._config), rectifier)
            self._tools = tools
        return tools


class DepthSource:
    """A depth camera, with a registered colour image where that is wanted; see `RangeSource`.

    Args:
        config: of the sensor.
        color: wait for the colour image of each depth image.
    """

    def __init__(self, config: DepthCameraConfig, color: bool) -> None:
        self.image_topics: tuple[str, ...] = (
            "depth/image_rect",
            *(("rgb/image_rect",) if color else ()),
        )
        self.info_topics: tuple[str, ...] = ("depth/camera_info",)
        self._config = config

    def measure(
        self, images: tuple[ImageRecord, ...], infos: tuple[CameraInfoRecord, ...]
    ) -> Measurement:
        """See `RangeSource.measure`."""
        depth = images[0]
        check_frame(depth, infos[0])
        if depth.encoding not in _DEPTH_ENCODINGS:
            expected = ", ".join(_DEPTH_ENCODINGS)
            problem = f"encoding '{depth.encoding}' of a depth image, expected {expected}"
            raise MalformedMessageError(IMAGE, problem)
        color = intensity_pixels(images[1]) if len(images) > 1 else None
        sensor = DepthCameraSensor(infos[0].calibration.rectified_camera(), self._config)
        return Measurement(depth.stamp, depth.frame_id, sensor.measure(depth.pixels, color))

    def warm_up(self) -> None:
        """See `RangeSource.warm_up`."""
        sensor = DepthCameraSensor(PinholeCamera(32, 24, 30.0, 30.0, 15.5, 11.5), self._config)
        sensor.measure(np.full((24, 32), 1.0, np.float32))


def check_frame(image: ImageRecord, info: CameraInfoRecord) -> None:
    """Make sure that an image says in which frame it is, and that its camera info agrees.

    Raises:
        FrameError: it does not.
    """
    if not image.frame_id:
        raise FrameError("image without frame_id")
    if info.frame_id not in ("", image.frame_id):
        raise FrameError(f"image in frame '{image.frame_id}', camera info in '{info.frame_id}'")


def seconds_to_warm_up(source: RangeSource) -> float:
    """Warm a source up; returns how long it took [s]."""
    start = time.monotonic()
    source.warm_up()
    return time.monotonic() - start
