"""A depth camera in place of the stereo pair.

Noise along the ray is ``sigma_z = base + linear z + quadratic z^2``. For structured light the
quadratic part dominates, as for stereo; Nguyen, Izadi and Lovell (2012, DOI
10.1109/3DIMPVT.2012.84) measured ``0.0012 + 0.0019 (z - 0.4)^2`` m for a Kinect, and about 0.8 px
across the ray, with a term that grows hyperbolically towards grazing incidence; the quadratic
growth is derived by Khoshelham and Elberink (2012, DOI 10.3390/s120201437). For time of flight
use a small quadratic part. The defaults are Nguyen's, and his grazing term is applied with the
slope of the depth image.

By REP 117 a depth of +inf says that nothing is within the camera's range, -inf that something is
too near, NaN nothing. Where +inf is, the cloud has a point far beyond the range of any map, which
frees space as other points beyond a map's range do; `range_image` has none.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import ConfigError, InvalidInputError
from infomap_ros.geometry import PinholeCamera
from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.stereo.images import RowBands, check_image, check_size
from infomap_ros.stereo.range_cloud import RangeCloud, assemble, mark_correlation

_MILLIMETER = np.float32(1e-3)
_BEYOND = np.float32(2000.0)  # depth of what has no return [m]: twice the largest range of a map
_BEYOND_VARIANCE = np.float32(4e4)  # a tenth of that, squared [m^2]
_SIGMA_LINEAR = 0.0  # growth of the depth noise with (z - _SIGMA_DEPTH)
_SIGMA_DEPTH = 0.4  # depth at which the noise is smallest [m]
# Depth noise that surfaces seen at an angle add: this times z^-1/2 [m^1/2], times
# (angle / (pi/2 - angle))^2 between ray and surface normal.
_SIGMA_GRAZING = 0.0001
_QUANTIZATION = 0.001  # step of the depth values, whose rounding error is added [m]
_PIXEL_SIGMA = 0.8  # of the ray across the image [px]
_MAX_GRAZING_ANGLE = 1.4  # from the normal, beyond which a surface is dropped [rad]
_EDGE_WINDOW = 3  # within which pixels with a depth jump are dropped, odd [px]
_EDGE_THRESHOLD = 0.05  # depth range within it that is a jump, as a share of the depth


@dataclass(frozen=True)
class DepthCameraConfig:
    """Noise model and filters of `DepthCameraSensor`.

    Raises:
        ConfigError: a value is out of range, or two values contradict each other.
    """

    min_depth: float = parameter(0.4, "Nearer depths are dropped.", unit="m", low=0.0)
    max_depth: float = parameter(8.0, "Farther depths are dropped.", unit="m", low=0.01)
    sigma_base: float = parameter(0.0012, "Depth noise at 0.4 m.", unit="m", low=1e-5, high=1.0)
    sigma_quadratic: float = parameter(
        0.0019,
        "Growth of the depth noise with (z - 0.4 m)^2.",
        unit="1/m",
        low=0.0,
        high=1.0,
    )
    error_correlation: float = setting(
        0.3,
        "Mean correlation of the depth errors of two pixels of one surface patch.",
        low=0.0,
        high=1.0,
    )

    def __post_init__(self) -> None:
        check_config(self)
        if self.max_depth <= self.min_depth:
            raise ConfigError("max_depth", self.max_depth, f"more than min_depth {self.min_depth}")


class DepthCameraSensor:
    """Turns depth images into clouds with covariances.

    Attributes:
        camera: the undistorted camera of the depth image.
        config: parameters.
    """

    def __init__(self, camera: PinholeCamera, config: DepthCameraConfig | None = None) -> None:
        self.camera = camera
        self.config = config or DepthCameraConfig()
        self._bands = RowBands(camera.height)

    def measure(self, depth: ArrayLike, color: ArrayLike | None = None) -> RangeCloud:
        """Convert a depth image.

        Args:
            depth: z of every pixel, shape (H, W): float32 or float64 [m], NaN, 0 or -inf
                where not measured, +inf where nothing is within range; or uint16 [mm], 0 where
                not measured.
            color: image registered to the depth image, shape (H, W) or (H, W, 3) RGB, uint8.

        Returns:
            Organized cloud in the camera's optical frame; `disparity` is None.

        Raises:
            InvalidInputError: wrong type or shape.
            CalibrationError: an image does not have the camera's size.
        """
        meters = self._meters(depth)
        if color is None:
            image = np.full(meters.shape, 255, np.uint8)
        else:
            image = check_image(color, self.camera, "color image")
        kept, variance = self._noise(meters)
        is_beyond = kept == _BEYOND
        variance[is_beyond] = _BEYOND_VARIANCE
        packed = assemble(self.camera, kept, variance, _PIXEL_SIGMA, image, self._bands)
        kept[is_beyond] = np.nan
        return RangeCloud(
            camera=self.camera,
            packed=mark_correlation(packed, self.config.error_correlation),
            range_image=kept,
            error_correlation=self.config.error_correlation,
            colors=image if image.ndim == 3 else None,
        )

    def _meters(self, depth: ArrayLike) -> NDArray[np.float32]:
        """Depth in m, shape (H, W): 0 where there is none or it is out of range, or `_BEYOND`."""
        values = np.asarray(depth)
        if values.ndim != 2:
            raise InvalidInputError("depth image", f"shape {values.shape}, expected (H, W)")
        check_size(values.shape, self.camera, "depth image")
        if values.dtype == np.uint16:
            meters = values * _MILLIMETER
        elif values.dtype in (np.float32, np.float64):
            meters = values.astype(np.float32)
        else:
            raise InvalidInputError(
                "depth image", f"dtype {values.dtype}, expected float32 [m] or uint16 [mm]"
            )
        good = (meters >= self.config.min_depth) & (meters <= self.config.max_depth)
        kept = np.where(good, meters, np.float32(0.0)).astype(np.float32)
        kept[meters == np.inf] = _BEYOND
        return kept

    def _noise(self, depth: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Depth with edges dropped (NaN) and its variance [m^2], both shape (H, W)."""
        config, camera = self.config, self.camera
        window = np.ones((_EDGE_WINDOW, _EDGE_WINDOW), np.uint8)
        low, high = cv2.erode(depth, window), cv2.dilate(depth, window)
        smooth = cv2.blur(depth, (3, 3))
        kept, variance = np.empty_like(depth), np.empty_like(depth)
        _depth_noise(
            depth,
            smooth,
            (low > 0.0) & (high - low < _EDGE_THRESHOLD * depth),
            (camera.fx, camera.fy, camera.cx, camera.cy),
            (config.sigma_base, _SIGMA_LINEAR, config.sigma_quadratic, _SIGMA_DEPTH),
            (_SIGMA_GRAZING, _MAX_GRAZING_ANGLE, _QUANTIZATION**2 / 12.0),
            kept,
            variance,
        )
        return kept, variance


@njit(nogil=True, cache=True, error_model="numpy")
def _depth_noise(  # type: ignore[no-untyped-def]
    depth, smooth, keep, camera, polynomial, limits, kept, variance
):
    base, linear, quadratic, origin = polynomial
    grazing, largest_angle, rounding = limits
    height, width = depth.shape
    for v in range(height):
        for u in range(width):
            kept[v, u] = np.nan
            variance[v, u] = np.nan
            inside = 0 < v < height - 1 and 0 < u < width - 1
            if not (inside and keep[v, u]):
                continue
            angle = _incidence(smooth, u, v, camera)
            if angle > largest_angle:
                continue
            z = depth[v, u]
            beyond = max(z - origin, 0.0)
            ratio = angle / (0.5 * np.pi - angle)
            sigma = base + linear * beyond + quadratic * beyond * beyond
            sigma += grazing / np.sqrt(z) * ratio * ratio
            kept[v, u] = z
            variance[v, u] = sigma * sigma + rounding


@njit(nogil=True, cache=True, error_model="numpy")
def _incidence(smooth, u, v, camera):  # type: ignore[no-untyped-def]
    """Angle between the ray of a pixel and the surface normal [rad], from the depth's slope."""
    fx, fy, cx, cy = camera
    z = smooth[v, u]
    z_u = 0.5 * (smooth[v, u + 1] - smooth[v, u - 1])
    z_v = 0.5 * (smooth[v + 1, u] - smooth[v - 1, u])
    a, b = (u - cx) / fx, (v - cy) / fy
    # Normal of the surface z (a, b, 1): cross product of its derivatives along u and v.
    n_x, n_y = z_u * fx, z_v * fy
    n_z = -(z + z_u * (u - cx) + z_v * (v - cy))
    along = a * n_x + b * n_y + n_z
    length = np.sqrt((n_x * n_x + n_y * n_y + n_z * n_z) * (a * a + b * b + 1.0))
    return np.arccos(min(abs(along) / length, 1.0))
