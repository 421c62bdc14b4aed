"""What the filter knows of the fiducials in one image, and how the image corrects it.

The fiducials are described relative to the camera: d = xi_f - xi_p, stacked over the M fiducials of
the image, and the camera's rotation error theta. A fiducial is at y = R^T (f - p + J_r(theta) d)
in the camera frame and is measured as z = h(y) = (u, v, 1/y_z). The correction is that of the
iterated extended Kalman filter, eq. (16)-(18) of doi:10.1177/0278364905051774 with the Jacobian
evaluated anew until it stays (B. M. Bell, F. W. Cathey, IEEE TAC 38(2), 1993,
doi:10.1109/9.250476).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from infomap_ros.geometry import PinholeCamera
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.fiducials.observations import FiducialObservations
from infomap_ros.localization.filter.lie import left_jacobian

BoolArray = NDArray[np.bool_]

_ITERATIONS = 8
_CONVERGED = 1e-2  # change of every expected measurement, in standard deviations of it


@dataclass(frozen=True, eq=False)
class Measured:
    """Measurements of M fiducials, ready for the filter.

    Attributes:
        camera: that took the image.
        values: (u, v, rho), shape (M, 3) [px, px, 1/m]; 0 where rho is missing.
        variances: of the values, shape (M, 3); 1 where rho is missing.
        present: False where rho is missing, shape (M, 3).
    """

    camera: PinholeCamera
    values: FloatArray
    variances: FloatArray
    present: BoolArray

    @classmethod
    def of(cls, camera: PinholeCamera, observations: FiducialObservations) -> Measured:
        """The measurements of observations."""
        rho, sigmas = observations.inverse_depths, observations.inverse_depth_sigmas
        across = np.square(observations.pixel_sigmas)
        present = np.column_stack([np.ones((len(rho), 2), bool), observations.has_range])
        values = np.column_stack([observations.pixels, rho])
        variances = np.column_stack([across, across, np.square(sigmas)])
        return cls(
            camera, np.where(present, values, 0.0), np.where(present, variances, 1.0), present
        )

    def __len__(self) -> int:
        return len(self.values)

    def select(self, index: NDArray[np.int64]) -> Measured:
        """The same of some of the fiducials: indices, shape (K,)."""
        return Measured(self.camera, self.values[index], self.variances[index], self.present[index])

    def expected(self, points: FloatArray) -> FloatArray:
        """Values h(y) that points in the camera frame, shape (M, 3), should have."""
        inverse = 1.0 / points[:, 2]
        values = np.column_stack(
            [
                self.camera.fx * points[:, 0] * inverse + self.camera.cx,
                self.camera.fy * points[:, 1] * inverse + self.camera.cy,
                inverse,
            ]
        )
        return np.where(self.present, values, 0.0)

    def jacobians(self, points: FloatArray) -> FloatArray:
        """Derivatives of h at points, shape (M, 3, 3)."""
        inverse = 1.0 / points[:, 2]
        result = np.zeros((len(points), 3, 3))
        result[:, 0, 0] = self.camera.fx * inverse
        result[:, 1, 1] = self.camera.fy * inverse
        result[:, 0, 2] = -self.camera.fx * points[:, 0] * inverse**2
        result[:, 1, 2] = -self.camera.fy * points[:, 1] * inverse**2
        result[:, 2, 2] = np.where(self.present[:, 2], -(inverse**2), 0.0)
        return result


@dataclass(frozen=True, eq=False)
class Sight:
    """What is known before the image.

    Attributes:
        measured: the measurements.
        rotation: of the camera at which all is linearized, ``R_map_camera``, shape (3, 3).
        points: R^T (f - p) there, shape (M, 3) [m].
        mean: expected d, shape (3M,) [m].
        theta: expected rotation error, shape (3,) [rad].
        covariance: of d, shape (3M, 3M).
        theta_d: covariance of theta with d, shape (3, 3M).
    """

    measured: Measured
    rotation: FloatArray
    points: FloatArray
    mean: FloatArray
    theta: FloatArray
    covariance: FloatArray
    theta_d: FloatArray

    def select(self, chosen: BoolArray | NDArray[np.int64]) -> Sight:
        """The same for some of the fiducials: mask or indices, shape (M,)."""
        index = np.arange(len(self.points))[chosen]
        rows = (3 * index[:, None] + np.arange(3)).ravel()
        return Sight(
            self.measured.select(index),
            self.rotation,
            self.points[index],
            self.mean[rows],
            self.theta,
            self.covariance[np.ix_(rows, rows)],
            self.theta_d[:, rows],
        )


@dataclass(frozen=True, eq=False)
class Correction:
    """The image's correction of what was known.

    Attributes:
        jacobian: of the values by d, one block per fiducial, shape (M, 3, 3).
        innovation: of the values against the prior, shape (3M,).
        factor: its lower triangle is the Cholesky factor of the innovation's covariance S, shape
            (3M, 3M).
        weighted: S^-1 innovation, shape (3M,).
        d: corrected d, shape (3M,) [m].
        theta: corrected theta, shape (3,) [rad].
    """

    jacobian: FloatArray
    innovation: FloatArray
    factor: FloatArray
    weighted: FloatArray
    d: FloatArray
    theta: FloatArray

    @property
    def nis(self) -> float:
        """Normalized innovation squared."""
        return float(self.innovation @ self.weighted)

    def whitened(self, rows: FloatArray) -> FloatArray:
        """L^-1 A rows, for rows of a covariance with d, shape (3M, n)."""
        turned = (self.jacobian @ rows.reshape(len(self.jacobian), 3, -1)).reshape(len(rows), -1)
        return np.asarray(
            solve_triangular(self.factor, turned, lower=True, overwrite_b=True, check_finite=False)
        )

    def left_out_innovations(self) -> FloatArray:
        """Difference of each fiducial from what the others and the prior say, shape (M, 3).

        Turned and scaled to unit covariance: with w = S^-1 innovation, whose covariance is S^-1,
        the difference is ``((S^-1)_jj)^-1 w_j``. Missing values are 0.
        """
        count = len(self.jacobian)
        inverse = cho_solve((self.factor, True), np.eye(3 * count), check_finite=False)
        blocks = inverse.reshape(count, 3, count, 3)[np.arange(count), :, np.arange(count)]
        w = self.weighted.reshape(count, 3, 1)
        return np.asarray(np.linalg.solve(np.linalg.cholesky(blocks), w)[:, :, 0])


def correct(sight: Sight, weights: FloatArray) -> Correction | None:
    """Correct with all measurements of a sight.

    Args:
        sight: what is known.
        weights: of the fiducials, shape (M,): variances are divided by them.

    Returns:
        The correction; None where a fiducial comes to lie behind the camera.
    """
    noise = (sight.measured.variances / weights[:, None]).ravel()
    d, theta = np.zeros_like(sight.mean), np.zeros(3)
    last: FloatArray | None = None
    for _ in range(_ITERATIONS):
        turn = sight.rotation.T @ left_jacobian(-theta)
        points = sight.points + d.reshape(-1, 3) @ turn.T
        if not (points[:, 2] > 0.0).all():
            return None
        expected = sight.measured.expected(points)
        jacobian = sight.measured.jacobians(points) @ turn
        step = _solve(sight, jacobian, expected, noise, d)
        if (
            last is not None
            and np.abs((expected.ravel() - last) / np.sqrt(noise)).max() < _CONVERGED
        ):
            return step
        last, d, theta = expected.ravel(), step.d, step.theta
    return step


def _solve(
    sight: Sight, jacobian: FloatArray, expected: FloatArray, noise: FloatArray, d: FloatArray
) -> Correction:
    """One step of the iteration: the linear correction about d."""
    count = len(jacobian)
    about = (jacobian @ (d - sight.mean).reshape(-1, 3, 1)).ravel()
    innovation = (sight.measured.values - expected).ravel() + about
    over = (jacobian @ sight.covariance.reshape(count, 3, -1)).reshape(3 * count, -1)
    S = (over.reshape(3 * count, count, 1, 3) @ jacobian.transpose(0, 2, 1)).reshape(3 * count, -1)
    S[np.diag_indices(3 * count)] += noise
    factor = cho_factor(S, lower=True, overwrite_a=True, check_finite=False)
    weighted = cho_solve(factor, innovation, check_finite=False)
    pulled = (jacobian.transpose(0, 2, 1) @ weighted.reshape(-1, 3, 1)).ravel()
    return Correction(
        jacobian,
        innovation,
        factor[0],
        weighted,
        sight.mean + sight.covariance @ pulled,
        sight.theta + sight.theta_d @ pulled,
    )


def innovations_from(sight: Sight, members: BoolArray, correction: Correction) -> FloatArray:
    """Differences of all fiducials of a sight from what the members say, shape (M, 3).

    Members are compared with what the other members say. Each difference has unit covariance if
    the fiducial stands still; infinite behind the camera.

    Args:
        sight: of all fiducials.
        members: those that the correction rests on, shape (M,).
        correction: with the members alone.
    """
    innovations = np.full((len(members), 3), np.inf)
    innovations[members] = correction.left_out_innovations()
    others = np.flatnonzero(~members)
    if not len(others):
        return innovations
    rows_in = (3 * np.flatnonzero(members)[:, None] + np.arange(3)).ravel()
    rows_out = (3 * others[:, None] + np.arange(3)).ravel()
    cross = sight.covariance[np.ix_(rows_in, rows_out)]
    white = correction.whitened(cross)
    pull = solve_triangular(
        correction.factor, correction.innovation, lower=True, check_finite=False
    )
    d = (sight.mean[rows_out] + white.T @ pull).reshape(-1, 3)
    turn = sight.rotation.T @ left_jacobian(-correction.theta)
    points = sight.points[others] + d @ turn.T
    blocks = rows_out.reshape(-1, 3)
    known = sight.covariance[blocks[:, :, None], blocks[:, None, :]]
    columns = white.T.reshape(len(others), 3, -1)
    known = known - columns @ columns.transpose(0, 2, 1)
    innovations[others] = normalized_differences(sight.measured.select(others), points, turn, known)
    return innovations


def normalized_differences(
    measured: Measured, points: FloatArray, turn: FloatArray, covariances: FloatArray
) -> FloatArray:
    """Differences of measurements from points whose d has known covariances, shape (M, 3).

    Turned and scaled to unit covariance; infinite behind the camera.
    """
    in_front = points[:, 2] > 0.0
    safe = np.where(in_front[:, None], points, [0.0, 0.0, 1.0])
    jacobian = measured.jacobians(safe) @ turn
    S = jacobian @ covariances @ jacobian.transpose(0, 2, 1)
    S[:, range(3), range(3)] += measured.variances
    residual = (measured.values - measured.expected(safe))[:, :, None]
    white = np.linalg.solve(np.linalg.cholesky(S), residual)[:, :, 0]
    return np.where(in_front[:, None], white, np.inf)
