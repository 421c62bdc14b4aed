"""Which camera an organized cloud was made with."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry.camera import PinholeCamera

_SAMPLES_PER_SIDE = 64
_LEAST_SAMPLES = 20
_TOLERANCE = 0.1  # [px]


def fit_pinhole_camera(points: ArrayLike) -> PinholeCamera | None:
    """Find the pinhole camera of which pixel (u, v) sees ``points[v, u]``.

    A cloud made from a depth image obeys ``u = fx x / z + cx`` and ``v = fy y / z + cy`` in every
    pixel, so that the four numbers follow from it to about 1e-4 px.

    Args:
        points: organized, shape (H, W, 3), optical frame [m]; NaN = no measurement.

    Returns:
        The camera; None where the pixels are not those of a pinhole camera (a laser scanner, an
        unrectified image) or where too few were measured to tell.

    Raises:
        InvalidInputError: the cloud is not organized.
    """
    cloud = np.asarray(points)
    if cloud.ndim != 3 or cloud.shape[-1] != 3:
        raise InvalidInputError("points", f"shape {cloud.shape}, expected (H, W, 3)")
    height, width = cloud.shape[:2]
    row_step, column_step = (max(1, size // _SAMPLES_PER_SIDE) for size in (height, width))
    v, u = np.mgrid[0:height:row_step, 0:width:column_step]
    sample = cloud[v, u].astype(np.float64)
    with np.errstate(invalid="ignore"):
        seen = np.isfinite(sample).all(axis=-1) & (sample[..., 2] > 0.0)
    slopes = sample[seen][:, :2] / sample[seen][:, 2:]
    horizontal, vertical = _fit_line(slopes[:, 0], u[seen]), _fit_line(slopes[:, 1], v[seen])
    if horizontal is None or vertical is None:
        return None
    return PinholeCamera(
        width, height, horizontal[0], vertical[0], cx=horizontal[1], cy=vertical[1]
    )


def _fit_line(slopes: NDArray[np.float64], pixels: NDArray[np.int64]) -> tuple[float, float] | None:
    """Focal length and principal point with ``pixels = focal * slopes + center``, if any."""
    if len(slopes) < _LEAST_SAMPLES or np.ptp(pixels) < 2:
        return None
    design = np.stack([slopes, np.ones_like(slopes)], axis=-1)
    (focal, center), _, rank, _ = np.linalg.lstsq(design, pixels.astype(np.float64))
    if rank < 2 or focal <= 0.0:
        return None
    worst = np.abs(design @ (focal, center) - pixels).max()
    return (float(focal), float(center)) if worst <= _TOLERANCE else None
