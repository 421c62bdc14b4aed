"""One look at the scene: an image, and the range of those of its pixels that are asked for."""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import PinholeCamera, float_array
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.fiducials.sparse_stereo import match_pixels
from infomap_ros.stereo import RangeCloud, StereoRangeSensor
from infomap_ros.stereo.images import check_image, gray

_REACH = 2  # pixels about the nearest one that take part
_LEAST_SAMPLES = 12
# Neighbors whose inverse depth differs by a larger share belong to another surface.
_SAME_SURFACE = 0.05
_DEPTH_VARIANCE = 5  # channel (zz) of the covariance triangle


def sample_inverse_depths(cloud: RangeCloud, pixels: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Measure 1/z between pixels by a plane through the neighbors.

    The inverse depth of a plane is linear in the pixel, so the fit is exact on planes. Averaging n
    neighbors leaves ``rho + (1 - rho) / n`` of the variance, with the cloud's error correlation
    rho; what neither the plane nor the noise explains is added.

    Args:
        cloud: organized.
        pixels: (u, v), shape (N, 2) [px].

    Returns:
        Inverse depths and standard deviations, shape (N,) each [1/m]; NaN where fewer than 12 of
        the 25 neighbors, or neighbors to one side only, were measured.
    """
    height, width = cloud.range_image.shape
    inside = np.asarray(np.isfinite(pixels).all(axis=1))
    nearest = np.rint(np.where(inside[:, None], pixels, 0.0)).astype(np.int64)
    inside &= ((nearest >= _REACH) & (nearest < np.array([width, height]) - _REACH)).all(axis=1)
    inverse, sigma = np.full(len(pixels), np.nan), np.full(len(pixels), np.nan)
    if inside.any():
        inverse[inside], sigma[inside] = _fit(cloud, pixels[inside], nearest[inside])
    return inverse, sigma


def _fit(
    cloud: RangeCloud, pixels: FloatArray, nearest: NDArray[np.int64]
) -> tuple[FloatArray, FloatArray]:
    offsets = np.arange(-_REACH, _REACH + 1)
    across, down = (plane.ravel() for plane in np.meshgrid(offsets, offsets))
    columns, rows = nearest[:, :1] + across, nearest[:, 1:] + down
    depth = cloud.range_image[rows, columns].astype(np.float64)
    variance = cloud.covariance_triangles[rows, columns, _DEPTH_VARIANCE].astype(np.float64)
    values, noise = 1.0 / depth, variance / depth**4
    # Sorting puts NaN last, so that the median of those that were measured is at half their count.
    half = np.isfinite(values).sum(axis=1, keepdims=True) // 2
    middle = np.take_along_axis(np.sort(values, axis=1), half, axis=1)
    with np.errstate(invalid="ignore"):
        used = np.abs(values - middle) < _SAME_SURFACE * middle
    weights = used.astype(np.float64)
    design = np.stack(
        [np.ones_like(values), columns - pixels[:, :1], rows - pixels[:, 1:]], axis=-1
    )
    normal = np.einsum("nk,nki,nkj->nij", weights, design, design)
    sound = (weights.sum(axis=1) >= _LEAST_SAMPLES) & (np.linalg.det(normal) > 1.0)
    normal[~sound] = np.eye(3)
    values, noise = np.where(used, values, 0.0), np.where(used, noise, 0.0)
    right_side = np.einsum("nk,nki,nk->ni", weights, design, values)
    plane = np.linalg.solve(normal, right_side[..., None])[..., 0]
    spread = np.linalg.inv(normal)[:, 0, 0]
    residual = weights * (values - np.einsum("nki,ni->nk", design, plane))
    count = np.maximum(weights.sum(axis=1), _LEAST_SAMPLES)
    mean_noise = (weights * noise).sum(axis=1) / count
    rho = cloud.error_correlation
    scatter = (residual**2).sum(axis=1) / (count - 3.0)
    left_over = np.maximum(scatter - (1.0 - rho) * mean_noise, 0.0)
    total = mean_noise * (rho + (1.0 - rho) * spread) + left_over * spread
    good = sound & (plane[:, 0] > 0.0)
    return np.where(good, plane[:, 0], np.nan), np.where(good, np.sqrt(total), np.nan)


class RangeView(Protocol):
    """What localization sees of one moment.

    Attributes:
        stamp: of the image [ns].
        camera: of the rectified left image; points are in its optical frame.
        image: rectified left image, gray, shape (H, W), uint8.
        has_cloud: whether `cloud` is at hand without further work.
        disparity_unit: inverse depth that one pixel of disparity is worth [1/(m px)]; 0 where range
            does not come from disparities.
        tags: `TAG` rows of what another node has found in the image; None where nobody is asked.
    """

    tags: NDArray[np.void] | None

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

    Raises:
        InvalidInputError: an image has the wrong type or number of channels.
        CalibrationError: an image does not have its camera's size.
    """

    tags: NDArray[np.void] | None = None

    def __init__(
        self,
        stamp: int,
        left: ArrayLike,
        right: ArrayLike,
        sensor: StereoRangeSensor,
    ) -> None:
        self.stamp = stamp
        self._left = check_image(left, sensor.rig.left, "left image")
        self._right = check_image(right, sensor.rig.right, "right image")
        self.image = gray(self._left)
        self._right_gray = gray(self._right)
        self._sensor = sensor
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
            self.image, self._right_gray, check_pixels(pixels), search
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

    tags: NDArray[np.void] | None = None

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
