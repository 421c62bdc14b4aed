"""Records of images become what is seen in them: range, or views to locate the camera by.

Views for localization from the images of one moment.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Protocol

from infomap_ros.errors import BagError, InfomapError
from infomap_ros.geometry import CameraInfoRecord, ImageRecord, Record
from infomap_ros.localization.fiducials.range_view import DepthView, RangeView, StereoView
from infomap_ros.pipeline.image_synchronizer import ImageSet, ImageSynchronizer, intensity_pixels
from infomap_ros.pipeline.range_estimator import (
    DepthRangeEstimator,
    PairRectifier,
    RangeEstimator,
    RangeMeasurement,
    measure_pair,
)
from infomap_ros.stereo import DepthCameraConfig, StereoConfig


@dataclass(frozen=True, eq=False)
class FramedView:
    """A view with its origin.

    Attributes:
        stamp: of the first image [ns].
        frame_id: optical frame of the camera.
        view: image and range.
        measurement: the dense range cloud, None where it was not wanted. The view of a stereo pair
            does not use it.
    """

    stamp: int
    frame_id: str
    view: RangeView
    measurement: RangeMeasurement | None = None


class ViewEstimator(Protocol):
    """Makes a view of the images of one moment."""

    def measure(self, images: ImageSet) -> FramedView:
        """The view; its stamp and frame are those of the first image.

        Raises:
            InfomapError: images or calibrations cannot be used.
        """


class StereoViewEstimator:
    """Views of a pair of cameras, left and right.

    Args:
        config: of the dense sensor.
        rectify: the images are raw.
        is_dense: whether the dense range cloud is wanted.
    """

    def __init__(self, config: StereoConfig, *, rectify: bool, is_dense: bool = False) -> None:
        self._is_dense = is_dense
        self._pairs = PairRectifier(config, rectify=rectify)

    def measure(self, images: ImageSet) -> FramedView:
        """Rectify a pair; without the dense range cloud nothing is matched yet.

        Raises:
            InfomapError: images or calibrations cannot be used.
        """
        left, right, sensor = self._pairs.prepare(images)
        view = StereoView(images.stamp, left, right, sensor)
        measurement = None
        if self._is_dense:
            measurement = measure_pair(images, left, right, sensor)
        return FramedView(view.stamp, images.frame_id, view, measurement)


class DepthViewEstimator:
    """Views of a depth camera with an image that is registered to it.

    Args:
        config: of the depth camera.
    """

    def __init__(self, config: DepthCameraConfig) -> None:
        self._depth = DepthRangeEstimator(config)

    def measure(self, images: ImageSet) -> FramedView:
        """Depth and image of one moment, in this order.

        Raises:
            BagError: there is no image beside the depth.
            InfomapError: images or calibrations cannot be used.
        """
        if len(images.images) < 2:
            raise BagError(
                "a depth camera without a registered image cannot be followed: poses are needed "
                "(a topic, or of a folder poses.txt, lines of t x y z qx qy qz qw)"
            )
        measurement = self._depth.measure(replace(images, images=images.images[:1]))
        view = DepthView(measurement.stamp, intensity_pixels(images.images[1]), measurement.cloud)
        return FramedView(measurement.stamp, measurement.frame_id, view, measurement)


Seen = RangeMeasurement | FramedView
_UNUSED = {"no partner": "image without its partner", "no camera info": "no camera info"}


@dataclass(frozen=True)
class ImageSources:
    """Names of the sources of records from which images come.

    Attributes:
        images: one or two.
        infos: their camera infos; a single one is for all images.
    """

    images: tuple[str, ...]
    infos: tuple[str, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """All of them."""
        return self.images + self.infos


class Perception:
    """Pairs images and has them measured.

    Args:
        sources: of the images.
        estimator: of range, or of views.
        tolerance: largest difference between the stamps of a pair [s].

    Attributes:
        sources: as above.
        dropped: images that were not used, by reason.
    """

    def __init__(
        self,
        sources: ImageSources,
        estimator: RangeEstimator | ViewEstimator,
        tolerance: float = 0.0,
    ) -> None:
        self.sources, self.dropped = sources, Counter[str]()
        self._estimator = estimator
        counts = len(sources.images), len(sources.infos)
        self._images = ImageSynchronizer(*counts, tolerance, on_drop=self._drop)

    def see(self, records: Iterator[tuple[str, Record]]) -> Iterator[Record | Seen]:
        """Replace images among records by what is seen in them; the order in time stays.

        Args:
            records: with the names of their sources, in order of time.
        """
        for source, record in records:
            yield from self.add(source, record)
        yield from self._measure(self._images.finish())

    def add(self, source: str, record: Record) -> Iterator[Record | Seen]:
        """Take the record that came next from a source; gives what is seen, or it itself."""
        if source not in self.sources.names:
            yield record
            return
        if isinstance(record, ImageRecord):
            complete = self._images.add_image(self.sources.images.index(source), record)
        elif isinstance(record, CameraInfoRecord):
            complete = self._images.add_info(self.sources.infos.index(source), record)
        else:
            return
        yield from self._measure(complete)

    def _measure(self, complete: list[ImageSet]) -> Iterator[Seen]:
        for images in complete:
            try:
                seen = self._estimator.measure(images)
            except InfomapError as error:
                self.dropped[str(error)] += 1
            else:
                yield seen

    def _drop(self, reason: str) -> None:
        self.dropped[_UNUSED.get(reason, reason)] += 1
