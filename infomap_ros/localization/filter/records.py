"""What the fiducial filter gives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.transforms import FloatArray


@dataclass(frozen=True, eq=False)
class FilterUpdate:
    """What became of the observations of one image.

    Attributes:
        is_consistent: whether the pose was updated. False: the observations do not determine one
            pose that agrees with the expected motion; the pose is the predicted one.
        reason: why not; empty if it is consistent.
        used: ids of the fiducials that the pose rests on, shape (U,).
        rejected: ids of known fiducials that contradict them or move, shape (R,); neither used nor
            rejected are those that nothing would contradict if they were wrong.
        unknown: ids that the filter does not hold, shape (K,).
        nis: normalized innovation squared of the used ones; NaN where there was no update.
        degrees_of_freedom: number of measured values in `nis`, which is its mean if all is right.
        motion_nis: of the motion against its prior, six degrees of freedom; NaN likewise.
        prior_overruled: whether the images showed the motion prior to be wrong, as when wheels
            slip.
    """

    is_consistent: bool
    reason: str
    used: NDArray[np.int64]
    rejected: NDArray[np.int64]
    unknown: NDArray[np.int64]
    nis: float
    degrees_of_freedom: int
    motion_nis: float
    prior_overruled: bool = False


@dataclass(frozen=True, eq=False)
class KeptPoses:
    """Kept camera poses as they are known now.

    Attributes:
        stamps: shape (K,), int64 [ns], ascending.
        transforms: ``T_map_camera``, shape (K, 4, 4).
        covariances: in the map frame, shape (K, 6, 6).
    """

    stamps: NDArray[np.int64]
    transforms: FloatArray
    covariances: FloatArray

    def __len__(self) -> int:
        return len(self.stamps)


@dataclass(frozen=True, eq=False)
class Fiducials:
    """Fiducials as they are known now.

    Attributes:
        ids: shape (N,), int64.
        positions: in the map frame, shape (N, 3) [m].
        covariances: in the map frame, shape (N, 3, 3) [m^2].
    """

    ids: NDArray[np.int64]
    positions: FloatArray
    covariances: FloatArray

    def __len__(self) -> int:
        return len(self.ids)
