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

from infomap_ros.geometry.transforms import FloatArray, check_covariance

CORRELATION_LENGTH = 1.0
"""Way over which the error of a pose decorrelates where nobody says how it does [m].

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

    Raises:
        InvalidInputError: a part is no covariance.
    """

    drift: FloatArray
    white: FloatArray = field(default_factory=_no_covariance)
    offset: FloatArray = field(default_factory=_no_covariance)
    clock: float = 0.0

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


def _separation(first: FloatArray, second: FloatArray) -> float:
    """How far two poses are apart, in correlation lengths."""
    way = float(np.linalg.norm(second[:3, 3] - first[:3, 3]))
    turn = float(Rotation.from_matrix(first[:3, :3].T @ second[:3, :3]).magnitude())
    return way / CORRELATION_LENGTH + turn / CORRELATION_ANGLE
