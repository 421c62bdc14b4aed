"""What a prediction of pose errors starts from: ways, and what is known of the fiducials."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import float_array
from infomap_ros.geometry.transforms import FloatArray

FLOOR = 1e-8
"""Smallest variance: (0.1 mm)^2, (0.1 mrad)^2."""


@dataclass(frozen=True, eq=False)
class Ways:
    """Ways whose ends are judged; what is seen from them is as if they were straight.

    Attributes:
        ends: ``T_map_camera`` at the ends, shape (M, 4, 4).
        lengths: shape (M,) [m]; drift follows them.

    Raises:
        InvalidInputError: shapes do not fit.
    """

    ends: FloatArray
    lengths: FloatArray

    def __post_init__(self) -> None:
        ends, lengths = float_array(self.ends, "ends"), float_array(self.lengths, "lengths")
        if lengths.ndim != 1 or ends.shape != (len(lengths), 4, 4):
            raise InvalidInputError("ways", f"ends {ends.shape} with lengths {lengths.shape}")
        object.__setattr__(self, "ends", ends)
        object.__setattr__(self, "lengths", lengths)


def checked_points(positions: ArrayLike, covariances: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Fiducials' positions (N, 3) and covariances (N, 3, 3) as arrays.

    Raises:
        InvalidInputError: shapes do not fit, or a number is not finite.
    """
    points = float_array(positions, "fiducial positions").reshape(-1, 3)
    spreads = float_array(covariances, "fiducial covariances").reshape(-1, 3, 3)
    if len(points) != len(spreads):
        raise InvalidInputError("fiducials", f"{len(points)} positions, {len(spreads)} covariances")
    if not (np.isfinite(points).all() and np.isfinite(spreads).all()):
        raise InvalidInputError("fiducials", "hold NaN or infinity")
    return points, spreads


def shared_variance(before: FloatArray, spreads: FloatArray) -> float:
    """Variance of position that pose and fiducials have in common, at most [m^2].

    Both were estimated together, so a shift of the whole map is an error of all of them, which no
    sighting of them makes smaller: the smallest variance of any in any direction stands for it.
    """
    blocks = np.concatenate([before[None, :3, :3], spreads])
    return max(0.0, float(np.linalg.eigvalsh(blocks)[:, 0].min()))


def own_informations(spreads: FloatArray, shared: float) -> FloatArray:
    """Inverse of what each fiducial's covariance (N, 3, 3) holds beyond the shared variance."""
    own = spreads - shared * np.eye(3) + FLOOR * np.eye(3)
    return np.asarray(np.linalg.inv(own)) if len(own) else spreads
