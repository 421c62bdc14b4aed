"""One look at the scene: an image, and the range of those of its pixels that are asked for."""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import PinholeCamera, float_array
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.fiducials.depth_sampling import sample_inverse_depths
from infomap_ros.localization.fiducials.sparse_stereo import SparseStereoConfig, match_pixels
from infomap_ros.stereo import RangeCloud, StereoRangeSensor
from infomap_ros.stereo.images import check_image, gray


class RangeView(Protocol):
    """What localization sees of one moment.

    Attributes:
        stamp: of the image [ns].
        camera: of the rectified left image; points are in its optical frame.
        image: rectified left image, gray, shape (H, W), uint8.
        has_cloud: whether `cloud` is at hand without further work.
        disparity_unit: inverse depth that one pixel of disparity is worth [1/(m px)]; 0 where range
            does not come from disparities.
    """

    @property
    def stamp(self) -> int:
        """See the class."""

    @property
    def camera(self) -> PinholeCamera:
        """See the class."""

    @property
    def image(self) -> NDArray[np.uint8]:
        """See the class."""

    @property
    def has_cloud(self) -> bool:
        """See the class."""

    @property
    def disparity_unit(self) -> float:
        """See the class."""

    def inverse_depths(self, pixels: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Measure 1/z at pixels.

        Args:
            pixels: (u, v), anywhere between pixel centers, shape (N, 2) [px].

        Returns:
            Inverse depths and their standard deviations, shape (N,) each [1/m]; NaN where there
            is no measurement.

        Raises:
            InvalidInputError: the pixels have another shape.
        """

    def cloud(self) -> RangeCloud:
        """The dense range cloud; worked out when it is first asked for."""


class StereoView:
    """A rectified stereo pair; see `RangeView`.

    Args:
        stamp: of the left image [ns].
        left: rectified image, shape (H, W) or (H, W, 3) RGB, uint8.
        right: as `left`.
        sensor: measures the dense cloud; gives the rig, the searched disparities and the noise.
        sparse: how single pixels are matched; defaults where None.

    Raises:
        InvalidInputError: an image has the wrong type or number of channels.
        CalibrationError: an image does not have its camera's size.
    """

    def __init__(
        self,
        stamp: int,
        left: ArrayLike,
        right: ArrayLike,
        sensor: StereoRangeSensor,
        sparse: SparseStereoConfig | None = None,
    ) -> None:
        self.stamp = stamp
        self._left = check_image(left, sensor.rig.left, "left image")
        self._right = check_image(right, sensor.rig.right, "right image")
        self.image = gray(self._left)
        self._right_gray = gray(self._right)
        self._sensor = sensor
        self._sparse = sparse or SparseStereoConfig()
        self._cloud: RangeCloud | None = None

    @property
    def camera(self) -> PinholeCamera:
        """The left camera."""
        return self._sensor.rig.left

    @property
    def has_cloud(self) -> bool:
        """Whether the dense cloud was asked for before."""
        return self._cloud is not None

    @property
    def disparity_unit(self) -> float:
        """Of the rig."""
        return 1.0 / (self._sensor.rig.left.fx * self._sensor.rig.baseline)

    def inverse_depths(self, pixels: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """See `RangeView.inverse_depths`; searches from infinity to the sensor's nearest depth."""
        rig = self._sensor.rig
        search = (math.floor(-rig.principal_offset) - 2, self._sensor.search.maximum)
        disparities, sigmas = match_pixels(
            self.image,
            self._right_gray,
            check_pixels(pixels),
            search,
            self._sparse,
        )
        unit = self.disparity_unit
        return (disparities + rig.principal_offset) * unit, sigmas * unit

    def cloud(self) -> RangeCloud:
        """The cloud of the whole matcher, in the frame of the left camera."""
        if self._cloud is None:
            self._cloud = self._sensor.measure(self._left, self._right)
        return self._cloud


class DepthView:
    """An image with a registered range cloud, as of a depth camera; see `RangeView`.

    Args:
        stamp: of the image [ns].
        image: registered to the cloud, shape (H, W) or (H, W, 3) RGB, uint8.
        cloud: organized by the same camera.

    Raises:
        InvalidInputError: the image has the wrong type or number of channels.
        CalibrationError: the image does not have the cloud's size.
    """

    def __init__(self, stamp: int, image: ArrayLike, cloud: RangeCloud) -> None:
        self.stamp = stamp
        self.image = gray(check_image(image, cloud.camera, "image"))
        self._cloud = cloud

    @property
    def camera(self) -> PinholeCamera:
        """The camera of image and cloud."""
        return self._cloud.camera

    @property
    def has_cloud(self) -> bool:
        """True."""
        return True

    @property
    def disparity_unit(self) -> float:
        """0: what its ranges come from is not known."""
        return 0.0

    def inverse_depths(self, pixels: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """See `RangeView.inverse_depths`; a plane through the neighbors."""
        return sample_inverse_depths(self._cloud, check_pixels(pixels))

    def cloud(self) -> RangeCloud:
        """The cloud that was given."""
        return self._cloud


def check_pixels(pixels: ArrayLike, name: str = "pixels") -> FloatArray:
    """Return pixels as an array, shape (N, 2), float64.

    Raises:
        InvalidInputError: they have another shape.
    """
    places = float_array(pixels, name)
    if places.size == 0:
        return np.zeros((0, 2))
    if places.ndim != 2 or places.shape[1] != 2:
        raise InvalidInputError(name, f"shape {places.shape}, expected (N, 2)")
    return places
