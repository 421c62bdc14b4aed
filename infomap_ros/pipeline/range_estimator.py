"""Range clouds from the images of one moment.

Is what two cameras show a stereo pair? Notices what calibration and matcher cannot.

A pair that is none may still be matched, to depths that are wrong. So a few dozen corners of each
pair are matched freely, also off their row and to the wrong side, and images are compared with
those before them. A fault that lasts has a name; measurements are held back until it is gone.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import MalformedMessageError, SensorFaultError
from infomap_ros.geometry import (
    CameraCalibration,
    PinholeCamera,
    PointCloudRecord,
    StereoRig,
    rig_from_calibrations,
)
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.messages import IMAGE
from infomap_ros.messages.clouds import round_correlation
from infomap_ros.pipeline.image_synchronizer import ImageSet, intensity_pixels
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

Gray = NDArray[np.uint8]

COVERED = "{} camera shows nothing: is its lens covered?"
FROZEN = "{} image is frozen"
SAME = "left and right image are the same"
SWAPPED = "left and right camera are swapped"
ROWS_OFF = "rows of left and right image differ"
LATE = "{} image is older than its stamp"
FLICKER = "exposure flickers"
UNLIKE = "left and right image do not show the same"

_WINDOW, _FAULTY = 5, 3
"""Pairs that are looked back at, and how many of them make a fault. It is gone with the last."""

_WIDTH = 320  # of the images in which corners are matched [px]; larger ones are reduced
_CORNERS, _FEWEST = 24, 8  # that are looked for, and without which nothing is said
_SIDE, _ROWS = 11, 4  # of a patch, and how far off its row it is looked for [px, reduced]
_COLUMNS = 56, 96  # how far to the right and to the left: 0.22 m of a baseline of 0.1 m are 96 px
_ALIKE, _UNIQUE = 0.9, 0.05  # least correlation of a match, and its lead over the second best
_LEAST_SIGNAL = 4.0
"""Standard deviation of a patch, in those of the noise. Two images, each with noise of its own,
correlate by 1 - 1 / r^2 where a patch varies r times as much as the noise: `_ALIKE` at r = 3.2."""
_LEAST_NOISE = 1.0  # gray levels; what is clipped or drawn has none
_MOST_ROWS_OFF = 1.0  # median of corners [px]; a rectified pair has 0.2
_MOST_LEFT = 1.0  # parallax to the wrong side [px], median of corners; at infinity it is 0
_SAME_SHARE = 0.95  # of pixels that are equal to the last bit; noise of two cameras leaves 0.3
_LEAST_CONTRAST = 4.0  # standard deviation of the gray levels of an image that shows something
_FLICKER, _TURNS = 0.2, 4  # changes of the log of brightness to and fro, and how many make a fault
_LATE_HISTORY, _LATE_MOTION = 12, 1.5  # pairs, and rms difference of motion [px] that tells
_LATE_RATIO = 0.3  # of the differences with and without one image's delay


class _Matches(NamedTuple):
    """Corners, those that look alike somewhere, and where those do that do so in one place."""

    corners: int
    alike: int
    disparity: NDArray[np.float64]
    rows: NDArray[np.float64]


class StereoHealth:
    """Watches the pairs of one stereo rig in order of time."""

    def __init__(self) -> None:
        self._recent: deque[list[str]] = deque(maxlen=_WINDOW)
        self._last: tuple[Gray, Gray] | None = None
        self._brightness: deque[float] = deque(maxlen=_WINDOW * 2)
        self._motion: deque[FloatArray] = deque(maxlen=_LATE_HISTORY)
        self.fault = ""

    def check(
        self, left: Gray, right: Gray, rig: StereoRig, raw: tuple[Gray, ...] | None = None
    ) -> None:
        """Look at the next pair.

        Args:
            left: rectified image, shape (H, W), or (H, W, 3) RGB.
            right: rectified image, likewise.
            rig: of the two.
            raw: the two as the cameras gave them, if they were rectified.

        Raises:
            SensorFaultError: most of the last pairs have a fault; names it.
        """
        scale = min(1.0, _WIDTH / left.shape[1])
        pair = _reduced(left, scale), _reduced(right, scale)
        one, other = raw or (left, right)
        same = one.shape == other.shape and np.mean(one[::2] == other[::2]) > _SAME_SHARE
        self._recent.append(self._faults_of(*pair, rig, scale, same=bool(same)))
        self._last = pair
        counts = Counter(fault for faults in self._recent for fault in faults)
        if counts[self.fault] == 0:
            found = counts.most_common(1)
            self.fault = found[0][0] if found and found[0][1] >= _FAULTY else ""
        if self.fault:
            raise SensorFaultError(self.fault)

    def _faults_of(
        self, left: Gray, right: Gray, rig: StereoRig, scale: float, *, same: bool
    ) -> list[str]:
        """What is wrong with a pair; the first is the reason for the others."""
        contrast = [_contrast(image) for image in (left, right)]
        if min(contrast) < _LEAST_CONTRAST <= max(contrast):
            return [COVERED.format(("left", "right")[int(np.argmin(contrast))])]
        if same and min(contrast) >= _LEAST_CONTRAST:
            return [SAME]
        if frozen := self._frozen(left, right):
            return [frozen]
        faults = [*self._late(left, right, scale), *self._flicker(left, right)]
        matches = _match(left, right)
        if matches.corners < 2 * _FEWEST:
            return faults
        if matches.alike < 0.1 * matches.corners:
            return [*faults, UNLIKE]
        if len(matches.rows) < _FEWEST:
            return faults
        if abs(float(np.median(matches.rows))) / scale > _MOST_ROWS_OFF:
            return [*faults, ROWS_OFF]
        parallax = matches.disparity / scale - (rig.left.cx - rig.right.cx)
        if float(np.median(parallax)) < -_MOST_LEFT:
            return [*faults, SWAPPED]
        return faults

    def _frozen(self, left: Gray, right: Gray) -> str:
        """The side that shows what it did before, while the other one does not."""
        if self._last is None:
            return ""
        same = [
            bool(np.array_equal(now, before))
            for now, before in zip((left, right), self._last, strict=True)
        ]
        return FROZEN.format(("right", "left")[same[0]]) if same[0] != same[1] else ""

    def _flicker(self, left: Gray, right: Gray) -> list[str]:
        """Whether the images become brighter and darker by turns."""
        mean = 0.5 * (cv2.mean(left)[0] + cv2.mean(right)[0])
        self._brightness.append(float(np.log(mean + 1.0)))
        steps = np.diff(np.array(self._brightness))
        turns = (steps[1:] * steps[:-1] < 0.0) & (
            np.minimum(np.abs(steps[1:]), np.abs(steps[:-1])) > _FLICKER
        )
        return [FLICKER] if turns.sum() >= _TURNS else []

    def _late(self, left: Gray, right: Gray, scale: float) -> list[str]:
        """Whether one camera moves as the other one did a pair ago."""
        if self._last is None:
            return []
        steps = zip(self._last, (left, right), strict=True)
        self._motion.append(np.array([_shift(*step) for step in steps]) / scale)
        if len(self._motion) < _LATE_HISTORY:
            return []
        both = np.array(self._motion)
        now = np.square(both[1:, 0] - both[1:, 1]).mean()
        if now < 0.5 * _LATE_MOTION**2:
            return []
        for side, other, name in ((1, 0, "right"), (0, 1, "left")):
            delayed = np.square(both[1:, side] - both[:-1, other]).mean()
            if delayed < _LATE_RATIO**2 * now:
                return [LATE.format(name)]
        return []


def _reduced(image: Gray, scale: float) -> Gray:
    gray = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) if image.ndim == 3 else image
    if scale == 1.0:
        return np.asarray(gray, np.uint8)
    size = round(gray.shape[1] * scale), round(gray.shape[0] * scale)
    return np.asarray(cv2.resize(gray, size, interpolation=cv2.INTER_AREA), np.uint8)


def _shift(before: Gray, now: Gray) -> FloatArray:
    """How far the image as a whole has moved, (x, y) [px]; of a quarter of it, to be quick."""
    small = [
        cv2.resize(image, (80, 60), interpolation=cv2.INTER_AREA).astype(np.float32)
        for image in (before, now)
    ]
    moved, _ = cv2.phaseCorrelate(small[0], small[1], _HANNING)
    return np.array([moved[0] * before.shape[1] / 80.0, moved[1] * before.shape[0] / 60.0])


_HANNING = cv2.createHanningWindow((80, 60), cv2.CV_32F)


def _match(left: Gray, right: Gray) -> _Matches:
    """Corners of the left image, wherever near they are in the right one.

    What sticks out of the noise of its image counts alone: noise has corners, too, on a plain wall.
    """
    half, disparity, rows, count, alike = _SIDE // 2, [], [], 0, 0
    height, width = left.shape
    small = cv2.resize(left, (width // 2, height // 2), interpolation=cv2.INTER_AREA)
    corners = cv2.goodFeaturesToTrack(small, _CORNERS, 0.03, 8)  # a patch need not be centered
    least = _LEAST_SIGNAL * max(_noise(left), _noise(right), _LEAST_NOISE)
    for x, y in [] if corners is None else (2.0 * corners.reshape(-1, 2) + 0.5).astype(int):
        if not (half + _ROWS <= y < height - half - _ROWS and half <= x < width - half):
            continue
        patch = left[y - half : y + half + 1, x - half : x + half + 1]
        if _contrast(patch) < least:
            continue
        first, end = max(x - half - _COLUMNS[1], 0), min(x + half + _COLUMNS[0] + 1, width)
        band = right[y - half - _ROWS : y + half + _ROWS + 1, first:end]
        score = cv2.matchTemplate(band, patch, cv2.TM_CCOEFF_NORMED)
        count += 1
        _, best, _, (column, row) = cv2.minMaxLoc(score)
        if best < _ALIKE:
            continue
        alike += 1
        if row in (0, 2 * _ROWS):
            continue
        peak = score[row - 1 : row + 2, column].copy()
        score[:, max(column - 3, 0) : column + 4] = -1.0
        if float(score.max()) > best - _UNIQUE:
            continue
        bend = peak[0] - 2.0 * peak[1] + peak[2]
        fine = 0.5 * (peak[0] - peak[2]) / bend if bend < 0.0 else 0.0
        rows.append(row - _ROWS + float(fine))
        disparity.append(float(x - half - first - column))
    return _Matches(count, alike, np.array(disparity), np.array(rows))


def _contrast(image: Gray) -> float:
    """Standard deviation of the gray levels."""
    return float(cv2.meanStdDev(image)[1][0, 0])


def _noise(image: Gray) -> float:
    """Standard deviation of the noise of an image (Immerkaer 1996), from its calmest quarter."""
    rough = np.abs(cv2.filter2D(image, cv2.CV_16S, _ROUGHNESS)[::3, ::3])
    return float(np.quantile(rough, 0.25)) / (0.319 * 6.0)  # of a Gaussian; norm of the kernel


_ROUGHNESS = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)


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
