"""Range clouds from the images of one moment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import MalformedMessageError
from infomap_ros.geometry import (
    CameraCalibration,
    PinholeCamera,
    PointCloudRecord,
    StereoRig,
    rig_from_calibrations,
)
from infomap_ros.messages import IMAGE
from infomap_ros.messages.clouds import round_correlation
from infomap_ros.pipeline.image_synchronizer import ImageSet
from infomap_ros.pipeline.pixels import intensity_pixels
from infomap_ros.pipeline.stereo_health import StereoHealth
from infomap_ros.stereo import (
    DepthCameraConfig,
    DepthCameraSensor,
    RangeCloud,
    StereoConfig,
    StereoRangeSensor,
    StereoRectifier,
    is_rectified,
)
from infomap_ros.stereo.images import check_size

DEPTH_ENCODINGS = ("32FC1", "16UC1", "mono16")


@dataclass(frozen=True, eq=False)
class RangeMeasurement:
    """A range cloud with its origin.

    Attributes:
        stamp: of the first image [ns].
        frame_id: optical frame of the cloud.
        cloud: what was measured.
        rig: the stereo rig; None for a depth camera.
        search: smallest and largest disparity that was searched [px].
    """

    stamp: int
    frame_id: str
    cloud: RangeCloud
    rig: StereoRig | None = None
    search: tuple[float, float] = (0.0, 0.0)

    @property
    def record(self) -> PointCloudRecord:
        """The cloud as a message would carry it; its numbers are not copied."""
        cloud = self.cloud
        points, covariances = cloud.organized_points, cloud.covariance_triangles
        correlation = round_correlation(cloud.error_correlation)
        return PointCloudRecord(
            self.stamp, self.frame_id, points, covariances, error_correlation=correlation
        )


class RangeEstimator(Protocol):
    """Measures range from the images of one moment."""

    def measure(self, images: ImageSet) -> RangeMeasurement:
        """Measure; the stamp and frame are those of the first image.

        Raises:
            InfomapError: images or calibrations cannot be used.
        """

    def warm_up(self) -> None:
        """Use every kernel once, so that it is compiled."""


@dataclass(frozen=True, eq=False)
class _Tools:
    calibrations: tuple[CameraCalibration, ...]
    sensor: StereoRangeSensor
    rectifier: StereoRectifier | None


class PairRectifier:
    """Makes rectified pairs, and the sensor for them, from images and their calibrations.

    Pairs are watched: while cameras have a fault (`StereoHealth`), nothing is prepared.

    Args:
        config: of the sensor.
        rectify: the images are raw.
    """

    def __init__(self, config: StereoConfig, *, rectify: bool) -> None:
        self._config, self._rectify = config, rectify
        self._tools: _Tools | None = None
        self._health = StereoHealth()

    def prepare(
        self, images: ImageSet
    ) -> tuple[NDArray[np.uint8], NDArray[np.uint8], StereoRangeSensor]:
        """Rectified left and right image and the sensor; the left image may be RGB.

        Raises:
            SensorFaultError: what the last images show is no stereo pair.
            InfomapError: images or calibrations cannot be used.
        """
        tools = self._tools_for(images.calibrations)
        left, right = raw = tuple(intensity_pixels(image) for image in images.images)
        if tools.rectifier is not None:
            left, right = tools.rectifier.rectify(left, right, gray_right=True)
        rig = tools.sensor.rig
        for image, camera, name in ((left, rig.left, "left"), (right, rig.right, "right")):
            check_size(image.shape, camera, f"{name} image")
        self._health.check(left, right, rig, raw)
        return left, right, tools.sensor

    def _tools_for(self, calibrations: tuple[CameraCalibration, ...]) -> _Tools:
        """Sensor and rectifier of these cameras, made anew when they change."""
        if self._tools is None or self._tools.calibrations != calibrations:
            left, right = calibrations
            raw = self._rectify and not (is_rectified(left) and is_rectified(right))
            sensor = StereoRangeSensor(rig_from_calibrations(left, right), self._config)
            rectifier = StereoRectifier(left, right) if raw else None
            self._tools = _Tools(calibrations, sensor, rectifier)
            self._health = StereoHealth()
        return self._tools


def measure_pair(
    images: ImageSet, left: NDArray[np.uint8], right: NDArray[np.uint8], sensor: StereoRangeSensor
) -> RangeMeasurement:
    """Measure a pair that `PairRectifier.prepare` has rectified."""
    search = (float(sensor.search.minimum), float(sensor.search.maximum))
    cloud = sensor.measure(left, right)
    return RangeMeasurement(images.stamp, images.frame_id, cloud, sensor.rig, search)


class StereoRangeEstimator:
    """Measures by a pair of cameras, left and right; see `RangeEstimator`.

    Args:
        config: of the sensor.
        rectify: the images are raw.
    """

    def __init__(self, config: StereoConfig, *, rectify: bool) -> None:
        self._config = config
        self._pairs = PairRectifier(config, rectify=rectify)

    def measure(self, images: ImageSet) -> RangeMeasurement:
        """See `RangeEstimator.measure`."""
        return measure_pair(images, *self._pairs.prepare(images))

    def warm_up(self) -> None:
        """See `RangeEstimator.warm_up`."""
        camera = PinholeCamera(160, 40, 100.0, 100.0, 79.5, 19.5)
        noise = np.random.default_rng(0).integers(0, 256, (40, 164), dtype=np.uint8)
        left, right = noise[:, 4:], noise[:, :160]
        sensor = StereoRangeSensor(StereoRig(camera, camera, 0.1), self._config)
        sensor.measure(left, right)
        sensor.measure(np.stack([left] * 3, axis=-1), np.stack([right] * 3, axis=-1))


class DepthRangeEstimator:
    """Measures by a depth camera, with a registered color image if there is one.

    See `RangeEstimator`.

    Args:
        config: of the sensor.
    """

    def __init__(self, config: DepthCameraConfig) -> None:
        self._config = config
        self._sensor: DepthCameraSensor | None = None
        self._calibration: CameraCalibration | None = None

    def measure(self, images: ImageSet) -> RangeMeasurement:
        """See `RangeEstimator.measure`."""
        depth, calibrations = images.images[0], images.calibrations
        if depth.encoding not in DEPTH_ENCODINGS:
            expected = ", ".join(DEPTH_ENCODINGS)
            problem = f"encoding '{depth.encoding}' of a depth image, expected {expected}"
            raise MalformedMessageError(IMAGE, problem)
        if self._sensor is None or self._calibration != calibrations[0]:
            self._calibration = calibrations[0]
            self._sensor = DepthCameraSensor(self._calibration.rectified_camera(), self._config)
        color = intensity_pixels(images.images[1]) if len(images.images) > 1 else None
        return RangeMeasurement(
            depth.stamp, depth.frame_id, self._sensor.measure(depth.pixels, color)
        )

    def warm_up(self) -> None:
        """See `RangeEstimator.warm_up`."""
        sensor = DepthCameraSensor(PinholeCamera(32, 24, 30.0, 30.0, 15.5, 11.5), self._config)
        sensor.measure(np.full((24, 32), 1.0, np.float32))
