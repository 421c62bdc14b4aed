"""One explanation of an image: a pose, the fiducials that agree on it, and how plausible it is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from infomap_ros.geometry import invert_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.filter.config import FiducialFilterConfig
from infomap_ros.localization.filter.invariant_state import InvariantState
from infomap_ros.localization.filter.lie import left_jacobian, logarithm
from infomap_ros.localization.filter.motion_prior import MotionPrior
from infomap_ros.localization.filter.shared_errors import square_root
from infomap_ros.localization.filter.sight import (
    BoolArray,
    Correction,
    Measured,
    Sight,
    correct,
    innovations_from,
)

_ROUNDS = 6
_FREE = 1e4  # by which the prior's covariance is multiplied where the images go against it
_LEAST = 3  # fiducials with which a group may begin


@dataclass(frozen=True, eq=False)
class Expectation:
    """The state with a motion after it, linearized at a pose after the motion.

    Attributes:
        T_map_camera: the pose, shape (4, 4).
        shift: expected error of the motion there, shape (6,).
        motion_covariance: of the motion, shape (6, 6).
        noise: how errors of the motion enter all errors, shape (n, 6).
    """

    T_map_camera: FloatArray
    shift: FloatArray
    motion_covariance: FloatArray
    noise: FloatArray

    @classmethod
    def at(cls, state: InvariantState, prior: MotionPrior, pose: FloatArray) -> Expectation:
        """The expectation linearized at a pose, shape (4, 4)."""
        motion = invert_transform(state.T_map_camera) @ pose
        expected = prior.T_before_after
        turned = logarithm(expected[:3, :3] @ motion[:3, :3].T)
        # So that correcting the pose by it gives the expected pose, however far off that is.
        moved = np.linalg.solve(left_jacobian(turned), expected[:3, 3] - motion[:3, 3])
        shift = np.concatenate([moved, turned])
        noise = state.motion_noise(pose, state.T_map_camera[:3, :3])
        return cls(pose, shift, prior.covariance, noise)

    def sight(self, state: InvariantState, indices: NDArray[np.int64], measured: Measured) -> Sight:
        """What is known of the fiducials of these indices before the image."""
        rows = state.fiducial_rows(indices).ravel()
        noise = self.noise[rows] - np.tile(self.noise[:3], (len(indices), 1))
        covariance, theta_d = state.apparent_covariance(indices, self.T_map_camera)
        covariance += noise @ self.motion_covariance @ noise.T
        theta_d = theta_d + self.noise[3:6] @ self.motion_covariance @ noise.T
        rotation, position = self.T_map_camera[:3, :3], self.T_map_camera[:3, 3]
        return Sight(
            measured,
            rotation,
            (state.positions[indices] - position) @ rotation,
            noise @ self.shift,
            self.noise[3:6] @ self.shift,
            covariance,
            theta_d,
        )


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A pose with the fiducials that agree on it.

    Attributes:
        expectation: linearized at about this pose.
        members: fiducials of the image that agree, shape (M,).
        correction: by the members.
        degrees_of_freedom: number of the members' values.
        motion_nis: squared distance of the motion from its prior, six degrees of freedom.
        innovations: of all fiducials against the members, with unit covariance, shape (M, 3).
        undecided: those that agree, but would agree elsewhere too, shape (M,).
    """

    expectation: Expectation
    members: BoolArray
    correction: Correction
    degrees_of_freedom: int
    motion_nis: float
    innovations: FloatArray
    undecided: BoolArray

    @property
    def rejected(self) -> BoolArray:
        """Those that contradict the members, shape (M,)."""
        return np.asarray(~(self.members | self.undecided))

    @property
    def count(self) -> int:
        """Number of members."""
        return int(np.count_nonzero(self.members))

    def has_plausible_residuals(self, config: FiducialFilterConfig) -> bool:
        """Whether the fiducials agree as well as their noise lets expect."""
        limit = chdtri(self.degrees_of_freedom, 1.0 - config.joint_gate)
        residual = self.correction.nis - self.motion_nis
        return bool(residual <= limit)

    def has_plausible_motion(self, config: FiducialFilterConfig) -> bool:
        """Whether the motion agrees with its prior."""
        return bool(self.motion_nis <= chdtri(6, 1.0 - config.joint_gate))


@dataclass(frozen=True, eq=False)
class Group:
    """Fiducials of an image of which some are taken to agree.

    Attributes:
        indices: of the image's fiducials in the state, shape (M,).
        measured: their measurements.
        members: those that are taken to agree, shape (M,).
        admitted: those that may join them, shape (M,).
    """

    indices: NDArray[np.int64]
    measured: Measured
    members: BoolArray
    admitted: BoolArray


def examine_with_or_without_prior(
    state: InvariantState,
    expectation: Expectation,
    group: Group,
    config: FiducialFilterConfig,
) -> Hypothesis | None:
    """`examine` a group, and where the prior breaks it up once more nearly without the prior.

    Then the group is one that agrees on a motion which the prior excludes.
    """
    hypothesis = examine(state, expectation, group, config)
    if hypothesis is not None and 2 * hypothesis.count >= np.count_nonzero(group.members):
        return hypothesis
    free = replace(expectation, motion_covariance=_FREE * expectation.motion_covariance)
    without = examine(state, free, group, config)
    if without is None:
        return hypothesis
    excluded = 2.0 * chdtri(6, 1.0 - config.joint_gate)
    return replace(without, motion_nis=max(_FREE * without.motion_nis, excluded))


def examine(
    state: InvariantState,
    expectation: Expectation,
    group: Group,
    config: FiducialFilterConfig,
    least: int = _LEAST,
) -> Hypothesis | None:
    """Find out which fiducials agree with a group of them.

    Args:
        state: before the motion.
        expectation: linearized at about the pose.
        group: of fiducials.
        config: gates.
        least: number of them.

    Returns:
        The hypothesis; None where fewer agree.
    """
    measured, members = group.measured, group.members
    sight = expectation.sight(state, group.indices, measured)
    freedom = measured.present.sum(axis=1)
    gates = chdtri(freedom, 1.0 - config.fiducial_gate)
    correction: Correction | None = None
    for _ in range(_ROUNDS):
        if np.count_nonzero(members) < least:
            return None
        compared = _compared(sight, members)
        if compared is None:
            return None
        correction, innovations = compared
        used, members = members, group.admitted & ((innovations**2).sum(axis=1) <= gates)
        if np.array_equal(used, members):
            break
    assert correction is not None
    rows = state.fiducial_rows(group.indices[used]).ravel()
    noise = expectation.noise[rows] - np.tile(expectation.noise[:3], (len(rows) // 3, 1))
    return Hypothesis(
        expectation,
        used,
        correction,
        int(freedom[used].sum()),
        _motion_nis(correction, noise, expectation.motion_covariance),
        innovations,
        np.zeros(len(used), bool),
    )


def least_gain(state: InvariantState, hypothesis: Hypothesis, group: NDArray[np.int64]) -> float:
    """How much of the motion a hypothesis determines where it does least, 0 to 1.

    Args:
        state: before the motion.
        hypothesis: of an image.
        group: indices of the image's fiducials in the state, shape (M,).

    Returns:
        Smallest share, over all directions, of the motion prior's variance that the image takes
        away.
    """
    rows = state.fiducial_rows(group[hypothesis.members]).ravel()
    expectation, correction = hypothesis.expectation, hypothesis.correction
    noise = expectation.noise[rows] - np.tile(expectation.noise[:3], (len(rows) // 3, 1))
    white = correction.whitened(noise) @ square_root(expectation.motion_covariance)
    return float(np.linalg.eigvalsh(white.T @ white)[0])


def _compared(sight: Sight, members: BoolArray) -> tuple[Correction, FloatArray] | None:
    """The correction by some fiducials, and how far all are from what these say.

    None where one of them comes to lie behind the camera, or where so little is known of the pose
    that beside its covariance the noise of the image vanishes in rounding.
    """
    try:
        correction = correct(sight.select(members), np.ones(int(members.sum())))
        if correction is None:
            return None
        return correction, innovations_from(sight, members, correction)
    except np.linalg.LinAlgError:
        return None


def _motion_nis(correction: Correction, noise: FloatArray, covariance: FloatArray) -> float:
    """Squared distance of the corrected motion from its prior.

    With the motion's corrected error e, whose covariance is ``V = Q G^T S^-1 G Q``: e^T V^+ e.
    """
    turned = (correction.jacobian @ noise.reshape(-1, 3, 6)).reshape(-1, 6)
    white = correction.whitened(noise) @ covariance
    e = covariance @ turned.T @ correction.weighted
    V = white.T @ white
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    inverse = np.linalg.pinv(V / np.outer(scale, scale), rcond=1e-9, hermitian=True)
    return float((e / scale) @ inverse @ (e / scale))
