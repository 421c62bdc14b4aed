"""Images of one moment with their calibrations, out of streams that come when they like.

Pixels of image records as the stereo sensor wants them: gray or RGB of 8 bit.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import FrameError, InvalidInputError
from infomap_ros.geometry import CameraCalibration, CameraInfoRecord, ImageRecord
from infomap_ros.geometry.records import Record
from infomap_ros.pipeline.clock_jumps import ClockGate

First = TypeVar("First", bound=Record)
Second = TypeVar("Second", bound=Record)
Either = TypeVar("Either", bound=Record)
Other = TypeVar("Other", bound=Record)


class StampPairing(Generic[First, Second]):
    """Match each record of one stream with the one of the other that was taken with it.

    What was taken together comes in the same order on both streams. So what came before a matched
    pair can never be paired any more and is dropped, whatever its stamp says: a stamp that is
    wrong, or a clock that jumps, costs the records that have it and no others.

    Args:
        tolerance: largest difference of the two stamps [ns]; 0 pairs equal stamps only.
        capacity: how many unpaired records of each stream are kept.

    Attributes:
        unpaired: how many records were dropped without a partner so far.
    """

    def __init__(self, tolerance: int = 0, capacity: int = 10) -> None:
        self._tolerance = tolerance
        self._capacity = capacity
        self._first: deque[First] = deque()
        self._second: deque[Second] = deque()
        self.unpaired = 0

    def add_first(self, record: First) -> tuple[First, Second] | None:
        """Add a record of the first stream; returns the pair that it completes, if any."""
        partner = self._take_partner(record, self._first, self._second)
        return None if partner is None else (record, partner)

    def add_second(self, record: Second) -> tuple[First, Second] | None:
        """Add a record of the second stream; returns the pair that it completes, if any."""
        partner = self._take_partner(record, self._second, self._first)
        return None if partner is None else (partner, record)

    def clear(self) -> int:
        """Forget all unpaired records, for example when the clock jumped; returns how many."""
        count = len(self._first) + len(self._second)
        self._first.clear()
        self._second.clear()
        self.unpaired += count
        return count

    def _take_partner(
        self, record: Either, earlier: deque[Either], others: deque[Other]
    ) -> Other | None:
        """The nearest in time among the others, or none: then the record waits.

        Of several with the same difference the one that came first is meant: a bag that starts
        again has each stamp twice.
        """
        gaps = [abs(other.stamp - record.stamp) for other in others]
        nearest = min(gaps, default=self._tolerance + 1)
        if nearest > self._tolerance:
            self._keep(record, earlier)
            return None
        self.unpaired += len(earlier)
        earlier.clear()
        for _ in range(gaps.index(nearest)):
            others.popleft()
            self.unpaired += 1
        return others.popleft()

    def _keep(self, record: Either, queue: deque[Either]) -> None:
        queue.append(record)
        if len(queue) > self._capacity:
            queue.popleft()
            self.unpaired += 1


Images = tuple[ImageRecord, ...]


@dataclass(frozen=True, eq=False)
class ImageSet:
    """Images of one moment with the camera infos.

    Attributes:
        images: one or two, of the cameras in their order.
        infos: of the cameras; a single one is for all images.
    """

    images: Images
    infos: tuple[CameraInfoRecord, ...]

    @property
    def stamp(self) -> int:
        """Of the first image [ns]."""
        return self.images[0].stamp

    @property
    def frame_id(self) -> str:
        """Optical frame of the first image."""
        return self.images[0].frame_id

    @property
    def calibrations(self) -> tuple[CameraCalibration, ...]:
        """Of the cameras.

        Raises:
            FrameError: an image does not say in which frame it is, or its camera info contradicts.
        """
        for image, info in zip(self.images, self.infos, strict=False):
            if not image.frame_id:
                raise FrameError("image without frame_id")
            if info.frame_id not in ("", image.frame_id):
                text = f"image in frame '{image.frame_id}', camera info in '{info.frame_id}'"
                raise FrameError(text)
        return tuple(info.calibration for info in self.infos)


class ImageSynchronizer:
    """Pairs the images of two streams, or takes those of one, and waits for the camera infos.

    Images pair in the order in which they come, so when the clock jumps back (a bag that loops),
    only with images from the same side of the jump. A set of images passes once its stamp is to
    be believed; see `ClockGate`.

    Args:
        images: number of image streams, one or two.
        infos: number of streams of camera infos.
        tolerance: largest difference between the stamps of a pair [s].
        capacity: images that wait for the camera infos at most.
        on_drop: called with the reason for each image that is dropped.
        clock: of the machine [s]; None where images come faster than they were taken.
        witness: stamp to which another stream has come [ns], None where nothing is known.
    """

    def __init__(
        self,
        images: int,
        infos: int,
        tolerance: float = 0.0,
        capacity: int = 4,
        on_drop: Callable[[str], None] = lambda _: None,
        clock: Callable[[], float] | None = None,
        witness: Callable[[], int | None] = lambda: None,
    ) -> None:
        self._is_pair, self._on_drop = images == 2, on_drop
        self._pairs: StampPairing[ImageRecord, ImageRecord]
        self._pairs = StampPairing(round(tolerance * 1e9))
        self._gate: ClockGate[Images] = ClockGate(lambda reason, _: on_drop(reason), clock)
        self._witness = witness
        self._infos: list[CameraInfoRecord | None] = [None] * infos
        self._uncalibrated: deque[Images] = deque(maxlen=capacity)

    def add_info(self, camera: int, info: CameraInfoRecord) -> list[ImageSet]:
        """Add a camera info; returns the images that waited for it, in their order."""
        self._infos[camera] = info
        waiting, self._uncalibrated = self._uncalibrated, deque(maxlen=self._uncalibrated.maxlen)
        return [complete for images in waiting for complete in self._calibrated(images)]

    def add_image(self, camera: int, image: ImageRecord) -> list[ImageSet]:
        """Add an image; returns the images of the moment that it completes, if any."""
        images = self._pair(camera, image) if self._is_pair else (image,)
        passed = [] if images is None else self._gate.add(images[0].stamp, images)
        return [done for each, _ in passed for done in self._calibrated(each)] or self.ask_witness()

    def ask_witness(self) -> list[ImageSet]:
        """The images whose stamp the other stream agrees with by now."""
        stamp = self._witness()
        passed = [] if stamp is None else self._gate.agree(stamp)
        return [done for each, _ in passed for done in self._calibrated(each)]

    def finish(self) -> list[ImageSet]:
        """End of the data: returns the images that no later ones contradict any more.

        What still waits is dropped.
        """
        rest = [done for each, _ in self._gate.finish() for done in self._calibrated(each)]
        for _ in range(self._pairs.clear()):
            self._on_drop("no partner")
        for _ in self._uncalibrated:
            self._on_drop("no camera info")
        self._uncalibrated.clear()
        return rest

    def _pair(self, camera: int, image: ImageRecord) -> Images | None:
        before = self._pairs.unpaired
        pair = self._pairs.add_second(image) if camera else self._pairs.add_first(image)
        for _ in range(self._pairs.unpaired - before):
            self._on_drop("no partner")
        return pair

    def _calibrated(self, images: Images) -> list[ImageSet]:
        infos = tuple(info for info in self._infos if info is not None)
        if len(infos) == len(self._infos):
            return [ImageSet(images, infos)]
        if len(self._uncalibrated) == self._uncalibrated.maxlen:
            self._on_drop("no camera info")
        self._uncalibrated.append(images)
        return []


_TO_RGB = {
    "rgb8": None,
    "bgr8": cv2.COLOR_BGR2RGB,
    "rgba8": cv2.COLOR_RGBA2RGB,
    "bgra8": cv2.COLOR_BGRA2RGB,
}
_SAME_LAYOUT = {"8UC1": "mono8", "8UC3": "bgr8", "8UC4": "bgra8", "16UC1": "mono16"}
_SIXTEEN_BIT = {"rgb16": "rgb8", "bgr16": "bgr8", "rgba16": "rgba8", "bgra16": "bgra8"}


def intensity_pixels(image: ImageRecord) -> NDArray[np.uint8]:
    """Gray or RGB pixels of 8 bit, shape (H, W) or (H, W, 3).

    Images of 16 bit lose their lower byte, whatever their content, so that the same brightness is
    the same number in both images of a pair and in every frame.

    Raises:
        InvalidInputError: the encoding is not that of a brightness or color image.
    """
    encoding = _SAME_LAYOUT.get(image.encoding, image.encoding)
    pixels: NDArray[Any] = image.pixels
    if encoding == "mono16" or encoding in _SIXTEEN_BIT:
        pixels = (pixels >> 8).astype(np.uint8)
        encoding = _SIXTEEN_BIT.get(encoding, "mono8")
    if encoding == "mono8":
        return pixels
    if encoding not in _TO_RGB:
        raise InvalidInputError("image", f"encoding '{image.encoding}' is not gray or color")
    conversion = _TO_RGB[encoding]
    return pixels if conversion is None else np.asarray(cv2.cvtColor(pixels, conversion), np.uint8)
