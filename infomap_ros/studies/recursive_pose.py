"""Statistics of a pose that is measured again and again."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import check_transform, make_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.filter.lie import nearest_rotation


class RecursivePose:
    """Mean and covariance of repeatedly measured poses, one at a time.

    Equation (15) of doi:10.1177/0278364905051774, corrected: the newest deviation weighs 1/(i+1)
    there, but it must be 1/i for the covariance of the i+1 measurements, as the deviation is taken
    from the mean that already holds the newest one. The mean of the rotation's elements is
    projected onto the rotations.
    """

    def __init__(self) -> None:
        self.count = 0
        self._mean = np.zeros(12)
        self._covariance = np.zeros((12, 12))

    def add(self, transform: ArrayLike) -> None:
        """Take one more measured transform, shape (4, 4)."""
        matrix = check_transform(transform)
        new = np.concatenate([matrix[:3, 3], matrix[:3, :3].ravel()])
        i = self.count
        self._mean = (i * self._mean + new) / (i + 1)
        off = new - self._mean
        if i > 0:
            self._covariance = i / (i + 1) * self._covariance + np.outer(off, off) / i
        self.count = i + 1

    @property
    def mean(self) -> FloatArray:
        """Mean transform, shape (4, 4).

        Raises:
            InvalidInputError: nothing was measured yet.
        """
        if self.count == 0:
            raise InvalidInputError("RecursivePose", "has no measurement yet")
        return make_transform(nearest_rotation(self._mean[3:].reshape(3, 3)), self._mean[:3])

    @property
    def covariance(self) -> FloatArray:
        """Covariance of one measurement, of (x, y, z, rotation), shape (6, 6).

        Rotation errors are about the parent's axes (docs/conventions.md). Of fewer than two
        measurements it is unknown: NaN.
        """
        if self.count < 2:
            return np.full((6, 6), np.nan)
        # dR = skew(theta) R: theta is half the antisymmetric part of dR R^T.
        rotation = self.mean[:3, :3]
        over = np.zeros((6, 12))
        over[:3, :3] = np.eye(3)
        for k, (i, j) in enumerate(((2, 1), (0, 2), (1, 0))):
            part = np.zeros((3, 3))
            part[i], part[j] = 0.5 * rotation[j], -0.5 * rotation[i]
            over[3 + k, 3:] = part.ravel()
        return np.asarray(over @ self._covariance @ over.T)
