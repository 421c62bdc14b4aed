"""What a camera measures of fiducials: pixels and inverse depths, with their noise."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import PinholeCamera, float_array
from infomap_ros.geometry.transforms import FloatArray

# Largest sigma / rho of a point: beyond it a Gaussian in space says nothing true.
_LARGEST_RATIO = 0.3


@dataclass(frozen=True, eq=False)
class FiducialObservations:
    """Fiducials seen in one view.

    A fiducial is measured as (u, v, rho) with the inverse depth rho = 1/z, because that is where
    the noise of stereo is Gaussian: ``rho = (d + principal_offset) / (fx * baseline)``. The noise
    of u, v and rho is independent.

    Attributes:
        ids: shape (N,), int64, each at most once.
        pixels: (u, v), shape (N, 2) [px].
        pixel_sigmas: standard deviation of u and of v, shape (N,) [px].
        inverse_depths: 1/z, shape (N,) [1/m]; NaN where no range was measured.
        inverse_depth_sigmas: standard deviation of 1/z, shape (N,) [1/m]; NaN likewise.

    Raises:
        InvalidInputError: lengths differ, an id occurs twice, a pixel or its sigma is not finite,
            or a sigma is not positive.
    """

    ids: NDArray[np.int64]
    pixels: FloatArray
    pixel_sigmas: FloatArray
    inverse_depths: FloatArray
    inverse_depth_sigmas: FloatArray

    def __post_init__(self) -> None:
        ids = float_array(self.ids, "ids", np.int64)
        if ids.ndim != 1:
            raise InvalidInputError("ids", f"shape {ids.shape}, expected (N,)")
        object.__setattr__(self, "ids", ids)
        shapes = {"pixels": (len(ids), 2)}
        for name in ("pixels", "pixel_sigmas", "inverse_depths", "inverse_depth_sigmas"):
            values = float_array(getattr(self, name), name)
            expected = shapes.get(name, (len(ids),))
            if values.shape != expected:
                raise InvalidInputError(name, f"shape {values.shape}, expected {expected}")
            object.__setattr__(self, name, values)
        self._check_contents()

    def _check_contents(self) -> None:
        if len(np.unique(self.ids)) != len(self.ids):
            raise InvalidInputError("ids", "hold an id twice")
        if not np.isfinite(self.pixels).all():
            raise InvalidInputError("pixels", "hold NaN or infinity")
        if not ((self.pixel_sigmas > 0.0) & np.isfinite(self.pixel_sigmas)).all():
            raise InvalidInputError("pixel_sigmas", "are not all positive and finite")
        sigmas = self.inverse_depth_sigmas[self.has_range]
        if not ((sigmas > 0.0) & np.isfinite(sigmas)).all():
            raise InvalidInputError("inverse_depth_sigmas", "are not all positive and finite")

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def has_range(self) -> NDArray[np.bool_]:
        """Fiducials whose inverse depth was measured, shape (N,)."""
        return np.asarray(np.isfinite(self.inverse_depths))

    def select(self, mask: ArrayLike) -> FiducialObservations:
        """Some of the observations.

        Args:
            mask: shape (N,), bool, or indices, shape (M,).
        """
        chosen = np.asarray(mask)
        return FiducialObservations(
            self.ids[chosen],
            self.pixels[chosen],
            self.pixel_sigmas[chosen],
            self.inverse_depths[chosen],
            self.inverse_depth_sigmas[chosen],
        )

    def corrected(self, camera: PinholeCamera, calibration: FloatArray) -> FiducialObservations:
        """What would have been measured with an exact calibration.

        Args:
            camera: that measured them.
            calibration: (o, s, e), shape (3,): inverse depths are measured as ``(1 + s)/z + o``,
                and the focal lengths are (1 + e) times the camera's.
        """
        offset, scale, focal = calibration.tolist()
        center = np.array([camera.cx, camera.cy])
        return replace(
            self,
            pixels=center + (self.pixels - center) / (1.0 + focal),
            inverse_depths=(self.inverse_depths - offset) / (1.0 + scale),
        )

    def points(self, camera: PinholeCamera) -> FloatArray:
        """Points in the camera frame, shape (N, 3) [m].

        NaN without range, and where the sigma of the inverse depth is above 0.3 of it.
        Depth is freed of its second-order bias, ``z = (1 - r^2) / rho`` with ``r = sigma / rho``,
        as ranges of the stereo sensor are (docs/results/stereo_noise.md).
        """
        return self._depths()[0][:, None] * self._rays(camera)

    def covariances(self, camera: PinholeCamera) -> FloatArray:
        """Covariances of `points`, shape (N, 3, 3) [m^2]; NaN where they are.

        ``var(z) m m^T + (z pixel_sigma)^2 diag(1/fx^2, 1/fy^2, 0)`` with the ray m, where
        ``var(z) = z^2 r^2 (1 + 2 r^2)``.
        """
        depths, variances = self._depths()
        rays = self._rays(camera)
        covariances = variances[:, None, None] * rays[:, :, None] * rays[:, None, :]
        across = np.square(depths * self.pixel_sigmas)
        covariances[:, 0, 0] += across / camera.fx**2
        covariances[:, 1, 1] += across / camera.fy**2
        return np.asarray(covariances)

    def _depths(self) -> tuple[FloatArray, FloatArray]:
        """Depths [m] and their variances [m^2], shape (N,) each."""
        near = self.inverse_depths > self.inverse_depth_sigmas / _LARGEST_RATIO
        inverse = np.where(near, self.inverse_depths, np.nan)
        ratio = np.square(self.inverse_depth_sigmas / inverse)
        depths = (1.0 - ratio) / inverse
        return depths, depths * depths * ratio * (1.0 + 2.0 * ratio)

    def _rays(self, camera: PinholeCamera) -> FloatArray:
        """Rays (x/z, y/z, 1), shape (N, 3)."""
        across = (self.pixels - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
        return np.column_stack([across, np.ones(len(self))])


def no_observations() -> FiducialObservations:
    """Observations of nothing."""
    nothing = np.zeros(0)
    return FiducialObservations(np.zeros(0, np.int64), np.zeros((0, 2)), nothing, nothing, nothing)
