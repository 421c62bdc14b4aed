"""How uncertain a camera's pose is, in parts that differ in what they share with other poses.

A covariance says how wrong one pose may be, not what its error has in common with that of the next.
Ten scans from one place share the error of their pose, so together they are no better placed than
one of them. Three parts say so:

offset  one error for all poses of a map: of its target, or of its origin
drift   an error that decays: that of two poses correlates by ``exp(-|difference of their clocks|)``
        (a Gauss-Markov process of first order)
white   an error of its own for each pose

The sum of the three is the covariance of the pose.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from infomap_ros.geometry.transforms import FloatArray, check_covariance, check_transform, skew

CORRELATION_LENGTH = 1.0
"""Distance over which the error of a pose decorrelates where nobody says how it does [m].

After about the distance to what it sees a camera is located by other surfaces than before.
"""

CORRELATION_ANGLE = 0.5
"""Likewise for turning [rad]: about half the field of view of a usual camera."""


def _no_covariance() -> FloatArray:
    return np.zeros((6, 6))


@dataclass(frozen=True, eq=False)
class PoseUncertainty:
    """Covariance of a pose in its parts, convention of `geometry.transforms`.

    Attributes:
        drift: shape (6, 6).
        white: shape (6, 6).
        offset: shape (6, 6).
        clock: dimensionless, never decreasing from one pose to the next.
        origin: names the origin of the map that the pose is in; 0 where it is not known. Poses
            with different names are not in one map, whatever their frame is called.

    Raises:
        InvalidInputError: a part is no covariance.
    """

    drift: FloatArray
    white: FloatArray = field(default_factory=_no_covariance)
    offset: FloatArray = field(default_factory=_no_covariance)
    clock: float = 0.0
    origin: int = 0

    def __post_init__(self) -> None:
        for name in ("drift", "white", "offset"):
            object.__setattr__(self, name, check_covariance(getattr(self, name), 6, name))

    @property
    def covariance(self) -> FloatArray:
        """Of the pose in the map, shape (6, 6): the sum of the parts."""
        return self.drift + self.white + self.offset

    def correlation(self, other: PoseUncertainty) -> float:
        """How the drift of this pose correlates with that of another one, in [0, 1]."""
        return math.exp(-abs(self.clock - other.clock))

    def with_covariance(self, covariance: ArrayLike) -> PoseUncertainty:
        """The same pose when its covariance, shape (6, 6), has become another.

        Offset and clock stay. Drift and white noise share in what is left as they did before.

        Raises:
            InvalidInputError: it is no covariance.
        """
        total = check_covariance(covariance, 6, "covariance")
        inverse = np.linalg.pinv(self.drift + self.white, hermitian=True)
        of_drift, of_white = np.trace(inverse @ self.drift), np.trace(inverse @ self.white)
        share = of_drift / (of_drift + of_white) if of_white > 0.0 else 1.0
        left = positive_part(total - self.offset)
        kept = self.offset, self.clock, self.origin
        return PoseUncertainty(share * left, (1.0 - share) * left, *kept)

    def offset_at_origin(self, position: ArrayLike) -> FloatArray:
        """The offset told for the map's origin, shape (6, 6); `position` is the camera's [m]."""
        over = np.eye(6)
        over[:3, 3:] = skew(position)
        return np.asarray(over @ self.offset @ over.T)


def point_covariances(offset: FloatArray, points: FloatArray) -> FloatArray:
    """What an error of the map as a whole does to points.

    Args:
        offset: its covariance at the origin of the map, shape (6, 6).
        points: shape (N, 3), map frame [m].

    Returns:
        Shape (N, 3, 3) [m^2].
    """
    jacobians = np.zeros((len(points), 3, 6))
    jacobians[:, range(3), range(3)] = 1.0
    x, y, z = points.T
    jacobians[:, 0, 4], jacobians[:, 0, 5] = z, -y
    jacobians[:, 1, 3], jacobians[:, 1, 5] = -z, x
    jacobians[:, 2, 3], jacobians[:, 2, 4] = y, -x
    return np.asarray(jacobians @ offset @ jacobians.transpose(0, 2, 1))


def positive_part(matrix: FloatArray) -> FloatArray:
    """The nearest positive semidefinite matrix to a symmetric one, shape (n, n)."""
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


class MotionClock:
    """The clock of poses that come with nothing but a covariance.

    Nobody says what their errors share. They are taken as shared in whole while the camera rests,
    and to decorrelate as it moves.
    """

    def __init__(self) -> None:
        self._last: FloatArray | None = None
        self._time = 0.0

    def at(self, T_map_camera: ArrayLike) -> float:
        """Reading at the next pose, shape (4, 4)."""
        pose = np.asarray(T_map_camera, dtype=np.float64)
        if self._last is not None:
            self._time += _separation(self._last, pose)
        self._last = pose.copy()
        return self._time

    def uncertainty(self, covariance: ArrayLike, T_map_camera: ArrayLike) -> PoseUncertainty:
        """That of the next pose, shape (4, 4), of which only the covariance, (6, 6), is known.

        Raises:
            InvalidInputError: the pose or its covariance is none.
        """
        drift = check_covariance(covariance, 6, "pose_covariance")
        return PoseUncertainty(drift, clock=self.at(check_transform(T_map_camera, "T_map_sensor")))


def _separation(first: FloatArray, second: FloatArray) -> float:
    """How far two poses are apart, in correlation lengths."""
    distance = float(np.linalg.norm(second[:3, 3] - first[:3, 3]))
    turn = float(Rotation.from_matrix(first[:3, :3].T @ second[:3, :3]).magnitude())
    return distance / CORRELATION_LENGTH + turn / CORRELATION_ANGLE
