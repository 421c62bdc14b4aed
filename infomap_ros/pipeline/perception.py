"""Records of images become what is seen in them: range, or views to locate the camera by."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

from infomap_ros.errors import InfomapError
from infomap_ros.geometry import CameraInfoRecord, ImageRecord, Record
from infomap_ros.pipeline.image_synchronizer import ImageSet, ImageSynchronizer
from infomap_ros.pipeline.range_estimator import RangeEstimator, RangeMeasurement
from infomap_ros.pipeline.view_estimator import FramedView, ViewEstimator

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
