"""What the filter remembers of its fiducials besides where they are."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.filter.sight import BoolArray

# Finds fiducials that move too slowly to be seen from one image to the next.
#
# Of a fiducial that stands still, the innovations of different images are independent; of one that
# moves they point the same way. Their decaying sum tells the two apart long before a single one
# does (whiteness test: Y. Bar-Shalom, X.-R. Li, T. Kirubarajan, "Estimation with Applications to
# Tracking and Navigation", Wiley 2001, section 5.4.2).


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


_FAR = 10.0  # [standard deviations], beyond which an innovation counts as this large

IntArray = NDArray[np.int64]


class FiducialHistory:
    """How often and when fiducials served, and whether they are to be trusted.

    Args:
        drift_memory: of the watch for fiducials that move slowly.
        drift_gate: likewise.
    """

    def __init__(self, drift_memory: float, drift_gate: float) -> None:
        self._updates = 0
        self._last: dict[int, int] = {}
        self._times: dict[int, int] = {}
        self._contested: IntArray = np.zeros(0, np.int64)
        self._watch = DriftWatch(drift_memory, drift_gate)

    def begin(self, ids: IntArray) -> None:
        """Fiducials that are new."""
        for number in ids.tolist():
            self._times[number], self._last[number] = 1, self._updates

    def agreed(self, known: IntArray, members: BoolArray, innovations: FloatArray) -> None:
        """An image on whose pose some of the known fiducials agreed.

        Args:
            known: ids, shape (M,).
            members: which agreed, shape (M,).
            innovations: with unit covariance, shape (M, 3).
        """
        self._updates += 1
        for number in known[members].tolist():
            self._times[number] += 1
            self._last[number] = self._updates
        self._watch.add(known, np.clip(innovations, -_FAR, _FAR))
        self._contested = np.setdiff1d(self._contested, known[members])

    def contradicted(self, known: IntArray) -> None:
        """An image whose known fiducials contradict each other."""
        self._contested = np.union1d(self._contested, known)

    def is_trusted(self, ids: IntArray) -> BoolArray:
        """Whether fiducials stand still as far as known, shape (M,)."""
        return ~self._watch.is_drifting(ids)

    def is_contested(self, ids: IntArray) -> BoolArray:
        """Whether fiducials took part in the last contradiction, shape (M,)."""
        return np.isin(ids, self._contested)

    def is_established(self, ids: IntArray) -> BoolArray:
        """Whether fiducials have served since they were new, shape (M,)."""
        return np.array([self._times[number] > 1 for number in ids.tolist()], bool)

    def least_useful(self, ids: IntArray, count: int) -> IntArray:
        """Those of the fiducials that served least often, of these the longest ago, (count,).

        Landmarks, whose ids are negative, come last.
        """
        order = sorted(ids.tolist(), key=lambda n: (n < 0, self._times[n], self._last[n]))
        return np.array(order[:count], np.int64)

    def forget(self, ids: IntArray) -> None:
        """Forget fiducials."""
        for number in ids.tolist():
            del self._times[number], self._last[number]
        self._watch.forget(ids)
        self._contested = np.setdiff1d(self._contested, ids)

    def state(self) -> dict[str, NDArray[Any]]:
        """All but what is known of slow motion, for `resume`."""
        ids = np.array(list(self._times), np.int64)
        rows = [[self._times[number], self._last[number]] for number in self._times]
        return {
            "history_ids": ids,
            "history_served": np.array(rows, np.int64).reshape(-1, 2),
            "history_contested": self._contested.copy(),
            "history_updates": np.array(self._updates),
        }

    def resume(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Take up a state."""
        for number, (times, last) in zip(
            state["history_ids"].tolist(), state["history_served"].tolist(), strict=True
        ):
            self._times[number], self._last[number] = times, last
        self._contested = np.array(state["history_contested"], np.int64)
        self._updates = int(state["history_updates"])
