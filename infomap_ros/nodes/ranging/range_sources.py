"""What stereo_range measures with: a pair of cameras, or a depth camera in its place."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

from infomap_ros.errors import FrameError
from infomap_ros.geometry import CameraInfoRecord, ImageRecord
from infomap_ros.replay.measuring.range_meters import (
    DepthMeter,
    Measurement,
    RangeMeter,
    StereoMeter,
)
from infomap_ros.stereo import DepthCameraConfig, StereoConfig


@dataclass(frozen=True)
class RangeSource:
    """Measures range from one image of each of its topics.

    Attributes:
        image_topics: one or two.
        info_topics: their camera infos; of a single one the calibration is used for all images.
        meter: that measures.
    """

    image_topics: tuple[str, ...]
    info_topics: tuple[str, ...]
    meter: RangeMeter

    @classmethod
    def of_stereo(cls, config: StereoConfig, *, rectify: bool) -> RangeSource:
        """A pair of cameras; `rectify` if the images are raw."""
        kind = "image_raw" if rectify else "image_rect"
        return cls(
            (f"left/{kind}", f"right/{kind}"),
            ("left/camera_info", "right/camera_info"),
            StereoMeter(config, rectify=rectify),
        )

    @classmethod
    def of_depth(cls, config: DepthCameraConfig, *, color: bool) -> RangeSource:
        """A depth camera; with `color`, each depth image waits for its colour image."""
        images = ("depth/image_rect", "rgb/image_rect") if color else ("depth/image_rect",)
        return cls(images, ("depth/camera_info",), DepthMeter(config))

    def measure(
        self, images: Sequence[ImageRecord], infos: Sequence[CameraInfoRecord]
    ) -> Measurement:
        """Measure; the stamp and frame are those of the first image.

        Raises:
            InfomapError: images or calibrations cannot be used.
        """
        for image, info in zip(images, infos, strict=False):  # a colour image has no info
            check_frame(image, info)
        return self.meter.measure(images, [info.calibration for info in infos])

    def seconds_to_warm_up(self) -> float:
        """Use every kernel once; returns how long it took [s]."""
        start = time.monotonic()
        self.meter.warm_up()
        return time.monotonic() - start


def check_frame(image: ImageRecord, info: CameraInfoRecord) -> None:
    """Make sure that an image says in which frame it is, and that its camera info agrees.

    Raises:
        FrameError: it does not.
    """
    if not image.frame_id:
        raise FrameError("image without frame_id")
    if info.frame_id not in ("", image.frame_id):
        raise FrameError(f"image in frame '{image.frame_id}', camera info in '{info.frame_id}'")
