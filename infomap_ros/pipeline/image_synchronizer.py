"""Images of one moment with their calibrations, out of streams that come when they like."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from infomap_ros.errors import FrameError
from infomap_ros.geometry import CameraCalibration, CameraInfoRecord, ImageRecord
from infomap_ros.pipeline.clock_jumps import CLOCK_JUMP, JumpingPairs

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

    When the clock jumps back (a bag that loops), images pair only with images from the same side
    of the jump.

    Args:
        images: number of image streams, one or two.
        infos: number of streams of camera infos.
        tolerance: largest difference between the stamps of a pair [s].
        capacity: images that wait for the camera infos at most.
        on_drop: called with the reason for each image that is dropped.
    """

    def __init__(
        self,
        images: int,
        infos: int,
        tolerance: float = 0.0,
        capacity: int = 4,
        on_drop: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._is_pair, self._on_drop = images == 2, on_drop
        self._pairs = JumpingPairs(round(tolerance * 1e9), CLOCK_JUMP, on_drop)
        self._infos: list[CameraInfoRecord | None] = [None] * infos
        self._uncalibrated: deque[Images] = deque(maxlen=capacity)

    def add_info(self, camera: int, info: CameraInfoRecord) -> list[ImageSet]:
        """Add a camera info; returns the images that waited for it, in their order."""
        self._infos[camera] = info
        waiting, self._uncalibrated = self._uncalibrated, deque(maxlen=self._uncalibrated.maxlen)
        return [complete for images in waiting for complete in self._calibrated(images)]

    def add_image(self, camera: int, image: ImageRecord) -> list[ImageSet]:
        """Add an image; returns the images of the moment that it completes, if any."""
        images = self._pairs.add(camera, image) if self._is_pair else (image,)
        return [] if images is None else self._calibrated(images)

    def finish(self) -> None:
        """Drop what still waits, at the end of the data."""
        self._pairs.drop_all("no partner")
        for _ in self._uncalibrated:
            self._on_drop("no camera info")
        self._uncalibrated.clear()

    def _calibrated(self, images: Images) -> list[ImageSet]:
        infos = tuple(info for info in self._infos if info is not None)
        if len(infos) == len(self._infos):
            return [ImageSet(images, infos)]
        if len(self._uncalibrated) == self._uncalibrated.maxlen:
            self._on_drop("no camera info")
        self._uncalibrated.append(images)
        return []
