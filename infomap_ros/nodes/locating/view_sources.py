"""What fiducial_localization looks with: a pair of cameras, or a depth camera with an image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from infomap_ros.geometry import CameraInfoRecord, ImageRecord
from infomap_ros.localization.fiducials.sparse_stereo import SparseStereoConfig
from infomap_ros.nodes.ranging.range_sources import check_frame
from infomap_ros.replay.measuring.view_meters import DepthViewMeter, FramedView, StereoViewMeter
from infomap_ros.stereo import DepthCameraConfig, StereoConfig


@dataclass(frozen=True)
class ViewSource:
    """Makes a view of the images of one moment.

    Attributes:
        image_topics: two.
        info_topics: their camera infos; of a single one the calibration is used for both.
        meter: that makes views.
    """

    image_topics: tuple[str, ...]
    info_topics: tuple[str, ...]
    meter: StereoViewMeter | DepthViewMeter

    @classmethod
    def of_stereo(
        cls, config: StereoConfig, sparse: SparseStereoConfig, *, rectify: bool
    ) -> ViewSource:
        """A pair of cameras; `rectify` if the images are raw."""
        kind = "image_raw" if rectify else "image_rect"
        return cls(
            (f"left/{kind}", f"right/{kind}"),
            ("left/camera_info", "right/camera_info"),
            StereoViewMeter(config, rectify=rectify, sparse=sparse),
        )

    @classmethod
    def of_depth(cls, config: DepthCameraConfig) -> ViewSource:
        """A depth camera with the image that is registered to it."""
        images = ("depth/image_rect", "rgb/image_rect")
        return cls(images, ("depth/camera_info",), DepthViewMeter(config))

    def view(self, images: Sequence[ImageRecord], infos: Sequence[CameraInfoRecord]) -> FramedView:
        """The view; its stamp and frame are those of the first image.

        Raises:
            InfomapError: images or calibrations cannot be used.
        """
        for image, info in zip(images, infos, strict=False):  # the second may share one info
            check_frame(image, info)
        return self.meter.measure(images, [info.calibration for info in infos])
