"""Finds fiducials that move too slowly to be seen from one image to the next.

Of a fiducial that stands still, the innovations of different images are independent; of one that
moves they point the same way. Their decaying sum tells the two apart long before a single one does
(whiteness test: Y. Bar-Shalom, X.-R. Li, T. Kirubarajan, "Estimation with Applications to Tracking
and Navigation", Wiley 2001, section 5.4.2).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from infomap_ros.geometry.transforms import FloatArray


class DriftWatch:
    """Decaying sums of the normalized innovations of fiducials.

    Args:
        memory: share of a sum that is left after one more image, within [0, 1).
        gate: probability within which the sum of a fiducial that stands still lies.
    """

    def __init__(self, memory: float, gate: float) -> None:
        self.memory = memory
        self._limit = float(chdtri(3, 1.0 - gate))
        self._sums: dict[int, FloatArray] = {}
        self._variances: dict[int, float] = {}

    def add(self, ids: NDArray[np.int64], innovations: FloatArray) -> None:
        """Take the innovations of one image.

        Args:
            ids: of the fiducials, shape (M,).
            innovations: each with unit covariance, shape (M, 3).
        """
        for number, innovation in zip(ids.tolist(), innovations, strict=True):
            before = self._sums.get(number, np.zeros(3))
            self._sums[number] = self.memory * before + innovation
            variance = self._variances.get(number, 0.0)
            self._variances[number] = self.memory**2 * variance + 1.0

    def is_drifting(self, ids: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Whether fiducials move, shape (M,); those never seen do not."""
        return np.array([self._distance(number) > self._limit for number in ids.tolist()], bool)

    def _distance(self, number: int) -> float:
        """Squared distance of a fiducial's sum from zero."""
        if number not in self._sums:
            return 0.0
        total = self._sums[number]
        return float(total @ total) / self._variances[number]

    def forget(self, ids: NDArray[np.int64]) -> None:
        """Forget fiducials."""
        for number in ids.tolist():
            self._sums.pop(number, None)
            self._variances.pop(number, None)

    def clear(self) -> None:
        """Forget all fiducials."""
        self._sums.clear()
        self._variances.clear()
