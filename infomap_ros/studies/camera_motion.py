"""Motion of a camera from points that it has measured before and after.

`printed_motion` is eq. (14) of doi:10.1177/0278364905051774, corrected where it does not hold as
printed. `estimate_motion` weights by the covariances of both ends, leaves out what does not fit,
and gives a covariance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray
from scipy.special import chdtri

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import check_transform, float_array, make_transform, perturb_transform
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.filter.consensus import pose_of_triple, random_triples
from infomap_ros.localization.filter.lie import nearest_rotation, skews

BoolArray = NDArray[np.bool_]

_NECESSARY = 4  # points that determine the 12 unknowns of eq. (14)
_FLAT = 1e-9  # relative size of the smallest eigenvalue below which points lie in one plane
_ITERATIONS = 30
_CONVERGED = 1e-9
_SINGULAR = 1e14  # condition number from which on points count as collinear


def printed_motion(before: ArrayLike, after: ArrayLike) -> FloatArray:
    """Least squares for the motion by eq. (14).

    The printed ``u (r^T r)^-1 r^T`` inverts a singular matrix; the least-squares solution is
    ``u r^T (r r^T)^-1``. It is affine: its linear part is projected onto the rotations, and the
    translation is the one that fits best with the rotation. All points weigh the same.

    Args:
        before: points r in the camera frame before the motion, shape (N, 3) [m], N >= 4, not in
            one plane.
        after: the same points in the camera frame after the motion, shape (N, 3) [m].

    Returns:
        ``T_after_before``, shape (4, 4).

    Raises:
        InvalidInputError: shapes differ, too few points, not finite, or points in one plane.
    """
    r, u = _check_pairs(before, after, _NECESSARY)
    homogeneous = np.column_stack([r, np.ones(len(r))])
    normal = homogeneous.T @ homogeneous
    spread = np.linalg.eigvalsh(np.cov(r.T))
    if spread[0] <= _FLAT * spread[2]:
        raise InvalidInputError("before", "points lie in one plane: eq. (14) has no solution")
    g = np.linalg.solve(normal, homogeneous.T @ u).T
    rotation = nearest_rotation(g[:, :3])
    return make_transform(rotation, u.mean(axis=0) - rotation @ r.mean(axis=0))


@dataclass(frozen=True)
class MotionConfig:
    """How robustly a motion is estimated.

    Raises:
        ConfigError: a value is out of its range.
    """

    gate: float = parameter(
        0.999,
        "Probability within which a pair of points must agree with the motion.",
        low=0.5,
        high=0.999999,
    )
    certain: float = parameter(
        0.95,
        "Probability within which a pair has its full weight; beyond, it falls with the distance.",
        low=0.3,
        high=0.999999,
    )
    trials: int = parameter(200, "Triples of pairs tried for a first motion.", low=10, high=100000)
    min_pairs: int = parameter(4, "Pairs that must agree.", low=3, high=1000)

    def __post_init__(self) -> None:
        check_config(self)


@dataclass(frozen=True, eq=False)
class MotionEstimate:
    """An estimated motion.

    Attributes:
        T_after_before: the camera frame before, in the one after, shape (4, 4); None where there
            is none.
        covariance: of it, in the frame after, shape (6, 6); None likewise.
        inliers: pairs that agree with it, shape (N,).
        converged: whether it can be used.
        reason: why not; empty if it can.
    """

    T_after_before: FloatArray | None
    covariance: FloatArray | None
    inliers: BoolArray
    converged: bool
    reason: str


def estimate_motion(
    before: ArrayLike,
    covariances_before: ArrayLike,
    after: ArrayLike,
    covariances_after: ArrayLike,
    config: MotionConfig | None = None,
) -> MotionEstimate:
    """Robust weighted motion on SE(3) from points measured at both ends.

    The first motion is the best of many triples (RANSAC); then the squares of the distances,
    weighted by the covariances of both ends, are minimized by Gauss-Newton with Huber's weights
    (P. J. Huber, Ann. Math. Statist. 35(1), 1964, doi:10.1214/aoms/1177703732).

    Args:
        before: points in the camera frame before the motion, shape (N, 3) [m].
        covariances_before: of them, shape (N, 3, 3) [m^2].
        after: the same points in the camera frame after the motion, shape (N, 3) [m].
        covariances_after: of them, shape (N, 3, 3) [m^2].
        config: gates.

    Raises:
        InvalidInputError: shapes differ or a value is not finite.
    """
    config = config or MotionConfig()
    r, u = _check_pairs(before, after, 0)
    noise_r = _check_covariances(covariances_before, len(r), "covariances_before")
    noise_u = _check_covariances(covariances_after, len(r), "covariances_after")
    nothing = np.zeros(len(r), bool)
    if len(r) < config.min_pairs:
        reason = f"{len(r)} pairs of points, {config.min_pairs} needed"
        return MotionEstimate(None, None, nothing, False, reason)
    first = _first_motion(r, noise_r, u, noise_u, config)
    if first is None:
        return MotionEstimate(None, None, nothing, False, "the points lie on one line")
    return _refine(*first, (r, noise_r, u, noise_u), config)


def _refine(
    motion: FloatArray,
    inliers: BoolArray,
    pairs: tuple[FloatArray, ...],
    config: MotionConfig,
) -> MotionEstimate:
    """Gauss-Newton from a first motion and the pairs that gave it.

    A pair is an inlier where it agrees within its own noise and that of the motion so far, as the
    first motion is a poor one.
    """
    r, noise_r, u, noise_u = pairs
    gate = chdtri(3, 1.0 - config.gate)
    full = np.sqrt(chdtri(3, 1.0 - config.certain))
    for iteration in range(_ITERATIONS):
        turned = r @ motion[:3, :3].T
        off = u - turned - motion[:3, 3]
        noise = noise_u + motion[:3, :3] @ noise_r @ motion[:3, :3].T
        weight = np.linalg.inv(noise)
        distances = np.sqrt(np.maximum(_squares(off, weight), 1e-12))
        weight *= np.minimum(1.0, full / distances)[:, None, None]
        jacobian = np.concatenate([np.tile(np.eye(3), (len(r), 1, 1)), -skews(turned)], axis=2)
        weighted = (jacobian.transpose(0, 2, 1) @ weight)[inliers]
        information = (weighted @ jacobian[inliers]).sum(axis=0)
        if np.linalg.cond(information) > _SINGULAR:
            return MotionEstimate(None, None, inliers, False, "the points lie on one line")
        covariance = np.linalg.inv(information)
        step = covariance @ (weighted @ off[inliers][:, :, None]).sum(axis=0)[:, 0]
        motion = perturb_transform(motion, step)
        if iteration > 0 and np.abs(step).max() < _CONVERGED:
            break
        off = u - r @ motion[:3, :3].T - motion[:3, 3]
        unsure = noise + jacobian @ covariance @ jacobian.transpose(0, 2, 1)
        inliers = _squares(off, np.linalg.inv(unsure)) <= gate
        if np.count_nonzero(inliers) < config.min_pairs:
            return MotionEstimate(None, None, inliers, False, "the points do not move as one body")
    return MotionEstimate(motion, covariance, inliers, True, "")


def _squares(off: FloatArray, weight: NDArray[np.floating]) -> FloatArray:
    """Squared distances, shape (N,)."""
    return np.asarray(np.einsum("ni,nij,nj->n", off, weight, off))


def _first_motion(
    r: FloatArray, noise_r: FloatArray, u: FloatArray, noise_u: FloatArray, config: MotionConfig
) -> tuple[FloatArray, BoolArray] | None:
    """The best motion of many triples and the mask of its triple, shape (N,)."""
    # Orientation is not known yet: of the covariance before, the largest variance counts.
    largest = np.linalg.eigvalsh(noise_r)[:, -1]
    information = np.linalg.inv(noise_u + largest[:, None, None] * np.eye(3))
    triples = random_triples(len(r), config.trials, 0)
    gate = float(chdtri(3, 1.0 - config.gate))
    best = _best_triple(r, u, information, triples, gate)
    if best < 0:
        return None
    _, rotation, translation = pose_of_triple(r, u, triples[best])
    members = np.zeros(len(r), bool)
    members[triples[best]] = True
    return make_transform(rotation, translation), members


@njit(cache=True, nogil=True)
def _best_triple(r, u, information, triples, gate):  # type: ignore[no-untyped-def]
    """Index of the triple on whose motion most pairs agree; -1 where no triple has an area."""
    best, best_score = -1, -1.0
    for trial in range(len(triples)):
        valid, rotation, translation = pose_of_triple(r, u, triples[trial])
        if not valid:
            continue
        score = 0.0
        for i in range(len(r)):
            off = u[i] - rotation @ r[i] - translation
            score += max(0.0, gate - off @ information[i] @ off)
        if score > best_score:
            best, best_score = trial, score
    return best


def _check_pairs(before: ArrayLike, after: ArrayLike, least: int) -> tuple[FloatArray, FloatArray]:
    r, u = float_array(before, "before"), float_array(after, "after")
    if r.ndim != 2 or r.shape[1] != 3 or r.shape != u.shape:
        raise InvalidInputError("before, after", f"shapes {r.shape}, {u.shape}, expected (N, 3)")
    if len(r) < least:
        raise InvalidInputError("before", f"{len(r)} points, at least {least} needed")
    if not (np.isfinite(r).all() and np.isfinite(u).all()):
        raise InvalidInputError("before, after", "hold NaN or infinity")
    return r, u


def _check_covariances(covariances: ArrayLike, count: int, name: str) -> FloatArray:
    matrices = float_array(covariances, name)
    if matrices.shape != (count, 3, 3):
        raise InvalidInputError(name, f"shape {matrices.shape}, expected ({count}, 3, 3)")
    if not np.isfinite(matrices).all():
        raise InvalidInputError(name, "hold NaN or infinity")
    return matrices


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
