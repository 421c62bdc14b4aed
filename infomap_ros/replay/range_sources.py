"""Images of a bag into range clouds: by a stereo pair or by a depth camera."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from typing import Protocol

from infomap_ros.errors import CalibrationError, InfomapError
from infomap_ros.geometry import CameraCalibration, CameraInfoRecord, ImageRecord
from infomap_ros.geometry.pairing import StampPairing
from infomap_ros.replay.range_meters import DepthMeter, Measurement, StereoMeter
from infomap_ros.replay.reader import BagRecord
from infomap_ros.replay.topics import DepthTopics, StereoTopics
from infomap_ros.stereo import DepthCameraConfig, StereoConfig


class RangeSource(Protocol):
    """Turns the records of its topics into measurements.

    Attributes:
        topics: what it wants.
        image_topic: of which each message should become a measurement.
        dropped: images that did not, by reason.
    """

    topics: tuple[str, ...]
    image_topic: str
    dropped: Counter[str]

    def add(self, entry: BagRecord) -> Measurement | None:
        """Take a record; returns the measurement that it completes, if any."""

    def finish(self) -> None:
        """Count what is left over at the end."""


class StereoSource:
    """Pairs images by stamp, rectifies raw ones and matches them; see `RangeSource`."""

    def __init__(
        self,
        topics: StereoTopics,
        config: StereoConfig,
        *,
        rectify: bool,
        pairing_tolerance: float = 0.0,
    ) -> None:
        """Prepare.

        Args:
            topics: of the pair.
            config: of the sensor.
            rectify: whether the images are raw.
            pairing_tolerance: largest difference of the two stamps of a pair [s].
        """
        self.topics, self.image_topic = topics.names, topics.left_image
        self.dropped: Counter[str] = Counter()
        self._names, self._meter = topics, StereoMeter(config, rectify=rectify)
        self._pairing: StampPairing[ImageRecord, ImageRecord] = StampPairing(
            round(pairing_tolerance * 1e9)
        )
        self._calibrations: dict[str, CameraCalibration] = {}

    def add(self, entry: BagRecord) -> Measurement | None:
        """See `RangeSource.add`."""
        record = entry.record
        if isinstance(record, CameraInfoRecord):
            self._calibrations[entry.topic] = record.calibration
            return None
        if not isinstance(record, ImageRecord):
            return None
        is_left = entry.topic == self._names.left_image
        add = self._pairing.add_first if is_left else self._pairing.add_second
        pair = add(record)
        return None if pair is None else _guarded(self.dropped, lambda: self._measure(*pair))

    def _measure(self, *pair: ImageRecord) -> Measurement:
        names = self._names.left_info, self._names.right_info
        missing = [name for name in names if name not in self._calibrations]
        if missing:
            raise CalibrationError(f"no camera info on {', '.join(missing)} yet")
        return self._meter.measure(pair, [self._calibrations[name] for name in names])

    def finish(self) -> None:
        """See `RangeSource.finish`."""
        self._pairing.clear()
        if self._pairing.unpaired:
            self.dropped["image without its partner"] = self._pairing.unpaired


class DepthSource:
    """Depth images with their camera info; see `RangeSource`."""

    def __init__(self, topics: DepthTopics, config: DepthCameraConfig) -> None:
        self.topics: tuple[str, ...] = (topics.depth, topics.info)
        self.image_topic = topics.depth
        self.dropped: Counter[str] = Counter()
        self._meter = DepthMeter(config)
        self._calibration: CameraCalibration | None = None

    def add(self, entry: BagRecord) -> Measurement | None:
        """See `RangeSource.add`."""
        record = entry.record
        if isinstance(record, CameraInfoRecord):
            self._calibration = record.calibration
            return None
        if not isinstance(record, ImageRecord):
            return None
        return _guarded(self.dropped, lambda: self._measure(record))

    def _measure(self, depth: ImageRecord) -> Measurement:
        if self._calibration is None:
            raise CalibrationError("no camera info yet")
        return self._meter.measure([depth], [self._calibration])

    def finish(self) -> None:
        """See `RangeSource.finish`; nothing can be left over."""


def _guarded(dropped: Counter[str], work: Callable[[], Measurement]) -> Measurement | None:
    try:
        return work()
    except InfomapError as error:
        dropped[str(error)] += 1
        return None


def measure_all(
    entries: Iterator[BagRecord], source: RangeSource
) -> Iterator[BagRecord | Measurement]:
    """Replace the images among records by what they measure; the order in time stays."""
    for entry in entries:
        if entry.topic not in source.topics:
            yield entry
        elif (measurement := source.add(entry)) is not None:
            yield measurement
    source.finish()
