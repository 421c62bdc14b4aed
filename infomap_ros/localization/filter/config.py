"""Parameters of the fiducial filter.

What the fiducial filter gives.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.config import check_config, setting
from infomap_ros.geometry.transforms import FloatArray


@dataclass(frozen=True)
class FiducialFilterConfig:
    """How the fiducial filter decides, and how much it holds.

    Raises:
        ConfigError: a value is out of its range.
    """

    max_fiducials: int = setting(300, "Fiducials that are held.", low=8, high=2000)
    max_kept_poses: int = setting(60, "Camera poses that are kept.", low=2, high=1000)
    min_fiducials: int = setting(
        5, "Fiducials that must agree for the pose to be updated.", low=4, high=1000
    )
    fiducial_gate: ClassVar[float] = 0.999
    """Probability within which a fiducial's measurement must lie of what the others say."""
    joint_gate: ClassVar[float] = 0.9999
    """Probability within which all measurements together must lie of what was expected, and the
    motion of its prior.
    """
    majority: ClassVar[float] = 0.6
    """Share of the known fiducials in view that must agree, unless the others are seen to move in
    a motion that the motion prior excludes.
    """
    ambiguity: ClassVar[float] = 0.5
    """Size of a second group of fiducials that agree on another plausible motion, as a share of
    the first, from which on the motion counts as ambiguous.
    """
    overruling_share: ClassVar[float] = 0.8
    """Share of the known fiducials in view that must agree to overrule the motion prior, as when
    wheels slip.
    """
    overruling_count: ClassVar[int] = 8
    """Least number of them that were used in an earlier image."""
    overruling_sigmas: ClassVar[float] = 30.0
    """A motion that is farther from its prior than so many standard deviations does not overrule
    it.
    """
    overruling_gain: ClassVar[float] = 0.9
    """Share of the motion's variance, enlarged so that the prior agrees, which an image that
    overrules it must take away in every direction: few fiducials that leave one open do not.
    """
    min_redundancy: ClassVar[float] = 0.6
    """Share of a gross error of a fiducial's pixel that must show in the image however uncertain
    the map is, else the fiducial does not count: of m that alone tell where a place is, 1 - 1/m
    shows.
    """
    drift_memory: ClassVar[float] = 0.9
    """Share of a fiducial's summed innovations that is left after one more image."""
    drift_gate: ClassVar[float] = 0.9999
    """Probability within which that sum must lie; beyond, the fiducial counts as moving."""
    trials: ClassVar[int] = 100
    """Triples of fiducials tried to find a first pose."""
    range_certainty: ClassVar[float] = 6.0
    """Inverse depth over its standard deviation, below which a fiducial is not added."""

    def __post_init__(self) -> None:
        check_config(self)


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
