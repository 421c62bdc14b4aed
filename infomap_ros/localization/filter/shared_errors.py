"""What the errors of successive poses have in common, from the filter's joint covariance.

Clones of earlier errors stay in the state. The error of the pose that was given at an earlier image
and that of the same pose as it is known now have the same covariance with the present error, as an
optimal estimate's error is orthogonal to all that was measured (B. D. O. Anderson, J. B. Moore,
"Optimal Filtering", Prentice-Hall 1979, section 7.2). So the joint covariance of the present error
and the clones is that of the errors of poses as they were given:

offset  what the present error shares with that of the first pose. In invariant errors it is one
        error of the map's frame, which nothing within the scene can reduce.
drift   a share s of what remains. Of three poses k, k-1 and an earlier one r, with covariances c of
        what remains, a first-order Gauss-Markov process in white noise has the drift
        ``c(k, k-1) c(k-1, r) / c(k, r)`` at k-1 (exact, also where its variance changes).
clock   advances by ``-ln c(k, k-1) / (s sqrt(c(k, k) c(k-1, k-1)))``.

Offset and covariance are exact. Approximated are: the form of the drift's covariance, that of what
remains; its share at k, that at k-1; the decay, one for position and rotation, measured by the mean
squared displacement of points at `_RANGE` from the camera, wherever that is; and a place to which
the camera comes back after a long path counts as a new one, as the clock cannot run back. Where a
camera rests, or has only odometry, nothing is approximated: the error of the last pose remains.

Pose errors of the filter's kind and of the package's convention, and poses that are measured.

The filter's error of a pose (R, p) is (xi, theta) with ``R_true = Exp(theta) R`` and
``p_true = Exp(theta) p + J(theta) xi``; that of docs/conventions.md is (dt, theta) with
``p_true = p + dt``. To first order ``dt = xi - skew(p) theta``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry import PoseUncertainty
from infomap_ros.geometry.pose_uncertainty import CORRELATION_ANGLE, CORRELATION_LENGTH
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.filter.invariant_state import InvariantState
from infomap_ros.localization.filter.lie import exponential, left_jacobian, logarithm, skews
from infomap_ros.localization.filter.motion_prior import MotionPrior


def pose_from_invariant(poses: FloatArray) -> FloatArray:
    """Derivative of (dt, theta) by (xi, theta), shape (K, 6, 6), at poses, shape (K, 4, 4)."""
    over = np.broadcast_to(np.eye(6), (len(poses), 6, 6)).copy()
    over[:, :3, 3:] = -skews(poses[:, :3, 3])
    return over


def invariant_from_pose(poses: FloatArray) -> FloatArray:
    """Derivative of (xi, theta) by (dt, theta), shape (K, 6, 6), at poses, shape (K, 4, 4)."""
    over = np.broadcast_to(np.eye(6), (len(poses), 6, 6)).copy()
    over[:, :3, 3:] = skews(poses[:, :3, 3])
    return over


def pose_covariances(poses: FloatArray, covariances: FloatArray) -> FloatArray:
    """Covariances by convention, shape (K, 6, 6), from those of the filter's errors."""
    over = pose_from_invariant(poses)
    result = over @ covariances @ over.transpose(0, 2, 1)
    return np.asarray(0.5 * (result + result.transpose(0, 2, 1)))


def invariant_difference(first: FloatArray, second: FloatArray) -> FloatArray:
    """(xi, theta) that moves the second pose to the first, shape (6,)."""
    theta = logarithm(first[:3, :3] @ second[:3, :3].T)
    shift = first[:3, 3] - exponential(theta) @ second[:3, 3]
    return np.concatenate([np.linalg.solve(left_jacobian(theta), shift), theta])


def square_root(covariance: FloatArray) -> FloatArray:
    """A matrix L with ``L L^T = covariance``, which may be singular."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def most_redundant(stamps: NDArray[np.int64], poses: FloatArray) -> int:
    """Index of the pose whose neighbors in time are nearest to each other, never an end."""
    order = np.argsort(stamps)
    ordered = poses[order]
    away = np.linalg.norm(ordered[2:, :3, 3] - ordered[:-2, :3, 3], axis=1)
    turned = ordered[2:, :3, :3] @ ordered[:-2, :3, :3].transpose(0, 2, 1)
    angle = np.linalg.norm(logarithm(turned), axis=1)
    return int(order[1 + np.argmin(away + angle)])


CLONES = 4
"""Number of clones in the filter's state."""

_FIRST, _LAST, _REFERENCE, _NEWER = range(CLONES)
_RANGE = CORRELATION_LENGTH / CORRELATION_ANGLE  # [m] where turns displace as much as shifts
_FORGOTTEN = 5.0  # largest advance of the clock: less than 1 % of the drift is left
_TINY = 1e-12  # share of a covariance that is rounding


class SharedErrors:
    """Divides the covariance of each pose in turn.

    Attributes:
        clock: of the last pose.
        is_corrected: whether an image or a pose has corrected the state since the last pose.

    Args:
        state: that begins: its pose has the offset alone.
        clock: at which it begins.
    """

    def __init__(self, state: InvariantState, clock: float = 0.0) -> None:
        for _ in range(CLONES - len(state.clone_rows())):
            state.add_clone()
        self.clock, self.is_corrected = clock, False
        self._share = 1.0
        self._last = 0.0  # mean square of what remained of the last pose [m^2]
        self._with_reference = 0.0  # its covariance with that of the reference [m^2]

    def following(self, state: InvariantState) -> SharedErrors:
        """For a state that begins anew and shares no errors with this one."""
        return SharedErrors(state, self.clock + _FORGOTTEN)

    def divide(
        self,
        state: InvariantState,
        motion: MotionPrior,
        *,
        is_keyframe: bool,
    ) -> PoseUncertainty:
        """The parts of the present pose's covariance.

        Args:
            state: that knows it.
            motion: since, which is no part of the state yet.
            is_keyframe: whether later poses are compared with this one.
        """
        pose, pending = state.expected(motion)
        over = pose_from_invariant(pose[None])[0]
        rows = np.arange(6)[:, None]
        crosses = over @ state.covariance(rows, state.clone_rows()[:, None, :]) @ over.T
        covariance = state.covariance(rows, rows[:, 0]) + pending
        covariance = pose_covariances(pose[None], covariance[None])[0]
        offset, remaining = _divided(covariance, crosses[_FIRST])
        shared = [_mean_square(cross) - _mean_square(offset) for cross in crosses]
        size = _mean_square(remaining)
        if not size > _TINY * _mean_square(covariance):
            size = 0.0
        self._advance(size, shared)
        self._remember(state, size, shared, is_settled=not pending.any(), is_keyframe=is_keyframe)
        white = (1.0 - self._share) * remaining
        return PoseUncertainty(self._share * remaining, white, offset, self.clock)

    def _advance(self, size: float, shared: list[float]) -> None:
        """Share of the drift, and the clock, at the next pose.

        What nothing has corrected since the last pose has the whole error of the last pose in it.
        """
        is_corrected, self.is_corrected, self._share = self.is_corrected, False, 1.0
        if size == 0.0 or self._last == 0.0:
            return
        with_last = shared[_LAST] if is_corrected else self._last
        if with_last <= 0.0:
            self.clock += _FORGOTTEN
            return
        if is_corrected and self._with_reference > 0.0 and shared[_REFERENCE] > 0.0:
            drift = with_last * self._with_reference / shared[_REFERENCE]
            self._share = min(drift / self._last, 1.0)
        step = -float(np.log(with_last / (self._share * np.sqrt(size * self._last))))
        self.clock += min(max(step, 0.0), _FORGOTTEN)

    def _remember(
        self,
        state: InvariantState,
        size: float,
        shared: list[float],
        *,
        is_settled: bool,
        is_keyframe: bool,
    ) -> None:
        """Put clones of this pose into the state, where its error is in the state as a whole."""
        is_first = self._last == 0.0 and size > 0.0
        self._last, self._with_reference = size, shared[_REFERENCE]
        if not is_settled:
            return
        state.replace_clone(_LAST)
        if is_first:
            state.replace_clone(_NEWER)
            self._with_reference, shared[_NEWER] = size, size
        if is_first or is_keyframe:
            state.replace_clone(_REFERENCE, _NEWER)
            state.replace_clone(_NEWER)
            self._with_reference = shared[_NEWER]

    def state(self) -> dict[str, NDArray[Any]]:
        """For `resume`."""
        values = [self.clock, self._share, self._last, self._with_reference]
        return {"shared_errors": np.array(values)}

    def resume(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Take up a state."""
        values = state["shared_errors"].tolist()
        self.clock, self._share, self._last, self._with_reference = values


def _mean_square(covariance: FloatArray) -> float:
    """Squared displacement of points at `_RANGE` from the camera [m^2]."""
    return float(np.trace(covariance[:3, :3]) + _RANGE**2 * np.trace(covariance[3:, 3:]))


def _divided(covariance: FloatArray, shared: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The part of a covariance, shape (6, 6), that is shared, within it; and what remains.

    Where cross-covariance and covariance are of independent errors that add up, as without an
    absolute pose, the part is the cross-covariance itself.
    """
    values, vectors = np.linalg.eigh(covariance)
    known = values > _TINY * max(values[-1], 0.0)
    root = vectors[:, known] * np.sqrt(values[known])
    inverse = vectors[:, known] / np.sqrt(values[known])
    parts, axes = np.linalg.eigh(inverse.T @ (0.5 * (shared + shared.T)) @ inverse)
    parts = np.clip(parts, 0.0, 1.0)
    axes = root @ axes
    part, rest = (axes * parts) @ axes.T, (axes * (1.0 - parts)) @ axes.T
    return 0.5 * (part + part.T), 0.5 * (rest + rest.T)
