"""Images of a bag into what a meter makes of them: of a stereo pair or of a depth camera."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import Generic, Protocol, TypeVar

from infomap_ros.errors import CalibrationError, InfomapError
from infomap_ros.geometry import CameraCalibration, CameraInfoRecord, ImageRecord
from infomap_ros.geometry.pairing import StampPairing
from infomap_ros.replay.bags.reader import BagRecord
from infomap_ros.replay.bags.topics import DepthTopics, StereoTopics

Result = TypeVar("Result")
Result_co = TypeVar("Result_co", covariant=True)


class Meter(Protocol[Result_co]):
    """Makes something of the images of one moment."""

    def measure(
        self, images: Sequence[ImageRecord], calibrations: Sequence[CameraCalibration]
    ) -> Result_co:
        """Raises an `InfomapError` where images or calibrations cannot be used."""


class RangeSource(Protocol[Result_co]):
    """Turns the records of its topics into what its meter makes of them: measurements, views.

    Attributes:
        topics: what it wants.
        image_topic: of which each message should become a measurement.
        dropped: images that did not, by reason.
    """

    topics: tuple[str, ...]
    image_topic: str
    dropped: Counter[str]

    def add(self, entry: BagRecord) -> Result_co | None:
        """Take a record; returns the measurement that it completes, if any."""

    def finish(self) -> None:
        """Count what is left over at the end."""


class StereoSource(Generic[Result]):
    """Pairs images by stamp and has them measured; see `RangeSource`.

    Args:
        topics: of the pair.
        meter: of pairs.
        pairing_tolerance: largest difference of the two stamps of a pair [s].
    """

    def __init__(
        self, topics: StereoTopics, meter: Meter[Result], pairing_tolerance: float = 0.0
    ) -> None:
        self.topics, self.image_topic = topics.names, topics.left_image
        self.dropped: Counter[str] = Counter()
        self._names, self._meter = topics, meter
        self._pairing: StampPairing[ImageRecord, ImageRecord] = StampPairing(
            round(pairing_tolerance * 1e9)
        )
        self._calibrations: dict[str, CameraCalibration] = {}

    def add(self, entry: BagRecord) -> Result | None:
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

    def _measure(self, *pair: ImageRecord) -> Result:
        names = self._names.left_info, self._names.right_info
        missing = [name for name in names if name not in self._calibrations]
        if missing:
            raise CalibrationError(f"no camera info on {', '.join(missing)} yet")
        return self._meter.measure(pair, [self._calibrations[name] for name in names])

    def finish(self) -> None:
        """See `RangeSource.finish`."""
        _finish_pairing(self._pairing, self.dropped)


class DepthSource(Generic[Result]):
    """Depth images with their camera info; see `RangeSource`.

    Args:
        topics: of the camera; where a colour image is among them, each depth image waits for its
            own.
        meter: of depth images, or of depth and colour image.
        pairing_tolerance: largest difference of the stamps of depth and colour image [s].
    """

    def __init__(
        self, topics: DepthTopics, meter: Meter[Result], pairing_tolerance: float = 0.0
    ) -> None:
        self.topics, self.image_topic = topics.names, topics.depth
        self.dropped: Counter[str] = Counter()
        self._names, self._meter = topics, meter
        self._pairing: StampPairing[ImageRecord, ImageRecord] = StampPairing(
            round(pairing_tolerance * 1e9)
        )
        self._calibration: CameraCalibration | None = None

    def add(self, entry: BagRecord) -> Result | None:
        """See `RangeSource.add`."""
        record = entry.record
        if isinstance(record, CameraInfoRecord):
            self._calibration = record.calibration
            return None
        if not isinstance(record, ImageRecord):
            return None
        images = self._complete(entry.topic, record)
        return None if images is None else _guarded(self.dropped, lambda: self._measure(images))

    def _complete(self, topic: str, image: ImageRecord) -> tuple[ImageRecord, ...] | None:
        if self._names.color is None:
            return (image,)
        is_depth = topic == self._names.depth
        return self._pairing.add_first(image) if is_depth else self._pairing.add_second(image)

    def _measure(self, images: tuple[ImageRecord, ...]) -> Result:
        if self._calibration is None:
            raise CalibrationError("no camera info yet")
        return self._meter.measure(images, [self._calibration])

    def finish(self) -> None:
        """See `RangeSource.finish`."""
        _finish_pairing(self._pairing, self.dropped)


def _finish_pairing(pairing: StampPairing[ImageRecord, ImageRecord], dropped: Counter[str]) -> None:
    pairing.clear()
    if pairing.unpaired:
        dropped["image without its partner"] = pairing.unpaired


def _guarded(dropped: Counter[str], work: Callable[[], Result]) -> Result | None:
    try:
        return work()
    except InfomapError as error:
        dropped[str(error)] += 1
        return None


def measure_all(
    entries: Iterator[BagRecord], source: RangeSource[Result]
) -> Iterator[BagRecord | Result]:
    """Replace the images among records by what is made of them; the order in time stays."""
    for entry in entries:
        if entry.topic not in source.topics:
            yield entry
        elif (measurement := source.add(entry)) is not None:
            yield measurement
    source.finish()
