"""What a range sensor saw: one point with its covariance per pixel."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry import PinholeCamera

#: Channels of `RangeCloud.packed`, in the order of the PointCloud2 fields of topic ``points2``.
PACKED_FIELDS = (
    "x",
    "y",
    "z",
    "rgb",
    "cov_xx",
    "cov_xy",
    "cov_xz",
    "cov_yy",
    "cov_yz",
    "cov_zz",
)
CORRELATION_FIELD, CORRELATION_OFFSET = "error_correlation", 15
"""Field of `RangeCloud.error_correlation` in hundredths, uint8: the byte that rgb leaves over."""
_FULL_FROM_TRIANGLE = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])


@dataclass(frozen=True, eq=False)
class RangeCloud:
    """An organized cloud in the optical frame of the (left) camera.

    The numbers live once, in `packed`, which is what the message carries; everything else is a
    view, or a copy that is made when it is asked for.

    Attributes:
        camera: the camera whose pixels the cloud is organized by.
        packed: shape (H, W, 10), float32, channels `PACKED_FIELDS`: point [m], color (bytes
            B, G, R of a little-endian float as in PCL, and `CORRELATION_FIELD` as the fourth),
            upper triangle of the covariance [m^2]. Point and covariance are NaN where nothing was
            measured. A depth camera that sees nothing within its range has a point there far beyond
            the range of any map.
        range_image: depth z, shape (H, W), float32 [m]; NaN where nothing was measured.
        error_correlation: mean correlation between the range errors of two pixels of one
            surface patch (about 5 to 15 px apart), 0 to 1. Averaging n such pixels reduces the
            variance to ``rho + (1 - rho) / n`` of one pixel's, not to ``1 / n``.
        disparity: shape (H, W), float32 [px], NaN invalid; None for a depth camera.
        disparity_sigma: predicted standard deviation of `disparity`, shape (H, W), float32
            [px], NaN invalid; None for a depth camera.
        colors: shape (H, W, 3), uint8 RGB, or None where no color image was given.
    """

    camera: PinholeCamera
    packed: NDArray[np.float32]
    range_image: NDArray[np.float32]
    error_correlation: float
    disparity: NDArray[np.float32] | None = None
    disparity_sigma: NDArray[np.float32] | None = None
    colors: NDArray[np.uint8] | None = None

    @cached_property
    def valid(self) -> NDArray[np.bool_]:
        """Pixels with a measurement, shape (H, W)."""
        return np.isfinite(self.range_image)

    @cached_property
    def points(self) -> NDArray[np.float32]:
        """Measured points in row order, shape (N, 3), float32 [m]."""
        return np.ascontiguousarray(self.packed[self.valid, :3])

    @cached_property
    def covariances(self) -> NDArray[np.float32]:
        """Covariances of `points`, shape (N, 3, 3), float32 [m^2]."""
        return self.packed[self.valid, 4:][:, _FULL_FROM_TRIANGLE]

    @property
    def organized_points(self) -> NDArray[np.float32]:
        """View of the points, shape (H, W, 3), float32 [m]; NaN where invalid."""
        return self.packed[..., :3]

    @property
    def covariance_triangles(self) -> NDArray[np.float32]:
        """View of (xx, xy, xz, yy, yz, zz), shape (H, W, 6), float32 [m^2]; NaN invalid."""
        return self.packed[..., 4:]

    @property
    def organized_covariances(self) -> NDArray[np.float32]:
        """Expanded covariances (a copy), shape (H, W, 3, 3), float32 [m^2]; NaN invalid."""
        return self.packed[..., 4:][..., _FULL_FROM_TRIANGLE]

    @property
    def density(self) -> float:
        """Share of pixels with a measurement, 0 to 1."""
        return float(self.valid.mean())


def mark_correlation(packed: NDArray[np.float32], error_correlation: float) -> NDArray[np.float32]:
    """Write `CORRELATION_FIELD` into channels of `RangeCloud.packed`, shape (H, W, 10)."""
    packed.view(np.uint8)[..., CORRELATION_OFFSET] = round(100.0 * error_correlation)
    return packed
