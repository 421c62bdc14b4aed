"""How the maps of two robots lie to each other: from a common target, or from seeing each other.

An alignment is ``T_a_b``, the frame of map b in map a, with a covariance in the frame of map a.
Several are fused by least squares on SE(3); one that contradicts the others is found by its
normalized distance (chi-square with six degrees of freedom), before anything is merged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import check_covariance, check_transform, compose_poses
from infomap_ros.geometry.transforms import FloatArray, perturb_transform
from infomap_ros.localization.target.target import invert_pose

CONTRADICTION = 22.5
"""Squared normalized distance of six numbers that one in a thousand honest pairs exceeds."""

_ITERATIONS = 10
_ROUNDING = 1e-15  # relative size below which an eigenvalue may be none


@dataclass(frozen=True, eq=False)
class Alignment:
    """Where map b is in map a.

    Attributes:
        T_a_b: shape (4, 4).
        covariance: in the frame of map a, shape (6, 6).

    Raises:
        InvalidInputError: the pose is not rigid or the covariance is none.
    """

    T_a_b: FloatArray
    covariance: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_a_b", check_transform(self.T_a_b, "T_a_b"))
        object.__setattr__(self, "covariance", check_covariance(self.covariance, 6))

    def inverse(self) -> Alignment:
        """Where map a is in map b."""
        return Alignment(*invert_pose(self.T_a_b, self.covariance))

    def then(self, following: Alignment) -> Alignment:
        """Chain ``T_a_b`` and ``T_b_c`` to ``T_a_c``; their errors are independent."""
        first, second = (self.T_a_b, self.covariance), (following.T_a_b, following.covariance)
        return Alignment(*compose_poses(*first, *second))


def align_by_sighting(base_a: Alignment, other: Alignment, base_b: Alignment) -> Alignment:
    """Alignment of the maps of two robots of which one sees the other's tags.

    Args:
        base_a: robot a's base in map a.
        other: robot b's base in robot a's base frame, as `RobotSighting` tells.
        base_b: robot b's base in map b, at the same stamp.
    """
    return base_a.then(other).then(base_b.inverse())


def has_scale(alignment: Alignment) -> bool:
    """Whether every direction has an error, so that two such alignments can be weighed."""
    values = np.linalg.eigvalsh(alignment.covariance)
    return bool(values[0] > _ROUNDING * values[-1])


def squared_distance(first: Alignment, second: Alignment) -> float:
    """How far apart two independent alignments of the same maps are, squared, in sigmas.

    Raises:
        InvalidInputError: both are exact, so that no difference has a scale.
    """
    error = _difference(first.T_a_b, second.T_a_b)
    total = first.covariance + second.covariance
    if np.linalg.eigvalsh(total)[0] <= 0.0:
        raise InvalidInputError("covariance", "the sum of both is singular")
    return float(error @ np.linalg.solve(total, error))


@dataclass(frozen=True, eq=False)
class FusedAlignment:
    """What several alignments say together.

    Attributes:
        alignment: their weighted mean, of those that agree.
        agreeing: which ones took part, shape (N,).
        is_consistent: whether more than half of them do.
    """

    alignment: Alignment
    agreeing: NDArray[np.bool_]
    is_consistent: bool


def fuse_alignments(
    alignments: Sequence[Alignment], contradiction: float = CONTRADICTION
) -> FusedAlignment:
    """Fuse independent alignments of the same two maps.

    The one with which most others agree leads; those that contradict it are left out.

    Args:
        alignments: at least one, with covariances that are not singular.
        contradiction: squared normalized distance above which two contradict each other.

    Raises:
        InvalidInputError: there is none, or one has a covariance that is singular.
    """
    if not alignments:
        raise InvalidInputError("alignments", "is empty")
    if not all(map(has_scale, alignments)):
        raise InvalidInputError("alignments", "one has a singular covariance")
    apart = np.array(
        [[0.0 if a is b else squared_distance(a, b) for b in alignments] for a in alignments]
    )
    agree = apart <= contradiction
    leader = int(np.lexsort((apart.sum(axis=1), -agree.sum(axis=1)))[0])
    mask = agree[leader]
    used = [one for one, fits in zip(alignments, mask, strict=True) if fits]
    fused = _mean(used, alignments[leader].T_a_b)
    return FusedAlignment(fused, mask, 2 * int(mask.sum()) > len(alignments))


def _mean(alignments: Sequence[Alignment], start: FloatArray) -> Alignment:
    """Weighted least squares on SE(3)."""
    weights = [np.linalg.inv(one.covariance) for one in alignments]
    information = np.sum(weights, axis=0)
    pose = start
    for _ in range(_ITERATIONS):
        errors = [_difference(pose, one.T_a_b) for one in alignments]
        pull = np.sum([w @ e for w, e in zip(weights, errors, strict=True)], axis=0)
        step = np.linalg.solve(information, pull)
        pose = perturb_transform(pose, step)
        if np.abs(step).max() < 1e-12:
            break
    return Alignment(pose, np.linalg.inv(information))


def _difference(first: FloatArray, second: FloatArray) -> FloatArray:
    """Pose error, shape (6,), that takes the first pose to the second."""
    turn = Rotation.from_matrix(second[:3, :3] @ first[:3, :3].T).as_rotvec()
    return np.concatenate([second[:3, 3] - first[:3, 3], turn])
