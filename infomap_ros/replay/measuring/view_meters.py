"""Images and their calibrations into views for localisation: the same for a bag and live topics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from infomap_ros.errors import BagError
from infomap_ros.geometry import CameraCalibration, ImageRecord, StereoRig
from infomap_ros.localization.fiducials.range_view import DepthView, RangeView, StereoView
from infomap_ros.localization.fiducials.sparse_stereo import SparseStereoConfig
from infomap_ros.replay.measuring.pixels import intensity_pixels
from infomap_ros.replay.measuring.range_meters import DepthMeter, Measurement, PairPreparation
from infomap_ros.stereo import DepthCameraConfig, StereoConfig


@dataclass(frozen=True, eq=False)
class FramedView:
    """A view with its origin.

    Attributes:
        stamp: of the first image [ns].
        frame_id: optical frame of the camera.
        view: image and range.
        rig: the stereo rig; None for a depth camera.
        search: smallest and largest disparity that the dense matcher searches [px].
    """

    stamp: int
    frame_id: str
    view: RangeView
    rig: StereoRig | None = None
    search: tuple[float, float] = (0.0, 0.0)

    def measurement(self) -> Measurement:
        """The dense range cloud with its origin, worked out when it is first asked for."""
        return Measurement(self.stamp, self.frame_id, self.view.cloud(), self.rig, self.search)


class StereoViewMeter:
    """Views of a pair of cameras, left and right.

    Args:
        config: of the dense sensor.
        rectify: the images are raw.
        sparse: how single pixels are matched.
    """

    def __init__(
        self, config: StereoConfig, *, rectify: bool, sparse: SparseStereoConfig | None = None
    ) -> None:
        self._pairs = PairPreparation(config, rectify=rectify)
        self._sparse = sparse or SparseStereoConfig()

    def measure(
        self, images: Sequence[ImageRecord], calibrations: Sequence[CameraCalibration]
    ) -> FramedView:
        """Rectify a pair; nothing is matched yet.

        Raises:
            InfomapError: images or calibrations cannot be used.
        """
        left, right, sensor = self._pairs.prepare(images, calibrations)
        view = StereoView(images[0].stamp, left, right, sensor, self._sparse)
        search = (float(sensor.search.minimum), float(sensor.search.maximum))
        return FramedView(view.stamp, images[0].frame_id, view, sensor.rig, search)


class DepthViewMeter:
    """Views of a depth camera with an image that is registered to it.

    Args:
        config: of the depth camera.
    """

    def __init__(self, config: DepthCameraConfig) -> None:
        self._meter = DepthMeter(config)

    def measure(
        self, images: Sequence[ImageRecord], calibrations: Sequence[CameraCalibration]
    ) -> FramedView:
        """Depth and image of one moment, in this order.

        Raises:
            BagError: there is no image beside the depth.
            InfomapError: images or calibrations cannot be used.
        """
        if len(images) < 2:
            raise BagError("a depth camera without a registered image cannot be followed")
        measurement = self._meter.measure(images[:1], calibrations)
        view = DepthView(measurement.stamp, intensity_pixels(images[1]), measurement.cloud)
        return FramedView(measurement.stamp, measurement.frame_id, view)
