"""The pose of known points from their pixels and, where measured, their inverse depths.

Maximum likelihood by Gauss-Newton with Huber's weights (doi:10.1214/aoms/1177703732) from every
pose that the pixels allow: a plane seen from afar allows two (Collins and Bartoli 2014,
doi:10.1007/s11263-014-0725-5), which only perspective or measured range tells apart. Inverse depth
rho = 1/z is compared up to a common scale s, rho = (1 + s) / z, as an error in the baseline or in
the size of the print acts; s has a prior.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from infomap_ros.geometry import PinholeCamera, invert_transform, make_transform, transform_points
from infomap_ros.geometry.transforms import FloatArray, perturb_transform

_ITERATIONS = 30
_HUBER = 2.0  # sigmas; corners are checked as whole tags, ranges have outliers


class KnownPoints(NamedTuple):
    """Points of the target that the view measured.

    Attributes:
        points: in the target's frame, shape (N, 3) [m].
        pixels: shape (N, 2) [px].
        whitening: inverse square roots of the pixels' covariances, shape (N, 2, 2) [1/px].
    """

    points: FloatArray
    pixels: FloatArray
    whitening: FloatArray


class KnownRanges(NamedTuple):
    """Points of the target whose inverse depth was measured.

    Attributes:
        points: in the target's frame, shape (M, 3) [m].
        inverse_depths: shape (M,) [1/m].
        sigmas: shape (M,) [1/m].
        scale_sigma: prior of the common scale error.
    """

    points: FloatArray
    inverse_depths: FloatArray
    sigmas: FloatArray
    scale_sigma: float


class PoseFit(NamedTuple):
    """A pose that explains the measurements.

    Attributes:
        T_camera_target: shape (4, 4).
        covariance: in the camera frame, shape (6, 6), as the noise predicts.
        pixel_cost: sum of the squared, whitened residuals of the pixels, robustified.
        cost: with the ranges and the prior of their scale.
        scale: common scale error of the ranges.
        scale_variance: of it, if the ranges decided it alone, without the prior.
    """

    T_camera_target: FloatArray
    covariance: FloatArray
    pixel_cost: float
    cost: float
    scale: float
    scale_variance: float


def whitening_of(covariances: FloatArray) -> FloatArray:
    """Matrices W with ``W.T @ W`` the inverse of each covariance, shapes (N, 2, 2)."""
    return np.linalg.inv(np.linalg.cholesky(covariances))


def no_ranges() -> KnownRanges:
    """What to fit with where nothing was measured."""
    return KnownRanges(np.zeros((0, 3)), np.zeros(0), np.ones(0), 1.0)


def initial_poses(points: FloatArray, pixels: FloatArray, camera: PinholeCamera) -> FloatArray:
    """Poses that pixels allow before refinement.

    Args:
        points: in the target's frame, at least four, shape (N, 3) [m].
        pixels: shape (N, 2) [px].
        camera: without distortion.

    Returns:
        ``T_camera_target``, shape (K, 4, 4), K from 0 to 2; none where the points tell none, as
        on one line or in one pixel.
    """
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    flat = spread[2] < 1e-6 * spread[0]
    method = cv2.SOLVEPNP_IPPE if flat else cv2.SOLVEPNP_SQPNP
    plane = _plane_axes(points)
    local = transform_points(invert_transform(plane), points)
    try:
        _, turns, shifts, _ = cv2.solvePnPGeneric(local, pixels, camera.matrix, None, flags=method)
    except cv2.error:  # so it says that points or pixels are degenerate
        return np.zeros((0, 4, 4))
    poses = [
        make_transform(cv2.Rodrigues(turn)[0], np.ravel(shift)) @ invert_transform(plane)
        for turn, shift in zip(turns, shifts, strict=True)
        if np.isfinite(turn).all() and np.isfinite(shift).all()
    ]
    return np.reshape(poses, (-1, 4, 4))


def _plane_axes(points: FloatArray) -> FloatArray:
    """A frame with its origin in the middle of the points and its z across their plane."""
    middle = points.mean(axis=0)
    _, _, axes = np.linalg.svd(points - middle)
    axes[2] *= np.linalg.det(axes)
    return make_transform(axes.T, middle)


def fit_pose(
    camera: PinholeCamera, known: KnownPoints, ranges: KnownRanges, start: FloatArray
) -> PoseFit | None:
    """Refine a pose.

    Args:
        camera: without distortion.
        known: at least three points.
        ranges: possibly none.
        start: first ``T_camera_target``, shape (4, 4).

    Returns:
        The fit, or None where it does not converge or puts a point behind the camera.
    """
    state = (start, 0.0)
    damping, cost = 1e-6, _cost(camera, known, ranges, state)
    if not np.isfinite(cost):
        return None
    for _ in range(_ITERATIONS):
        residual, jacobian = _linearize(camera, known, ranges, state)
        information = jacobian.T @ jacobian
        scaled = information + damping * np.diag(np.diag(information) + 1e-12)
        step = -np.linalg.solve(scaled, jacobian.T @ residual)
        moved = (perturb_transform(state[0], step[:6]), state[1] + step[6])
        moved_cost = _cost(camera, known, ranges, moved)
        if moved_cost <= cost:
            done = cost - moved_cost < 1e-9 * (1.0 + cost)
            state, cost, damping = moved, moved_cost, max(damping * 0.1, 1e-9)
            if done:
                break
        else:
            damping *= 10.0
            if damping > 1e8:
                break
    return _fit(camera, known, ranges, state)


def pixel_residuals(
    camera: PinholeCamera, known: KnownPoints, T_camera_target: FloatArray
) -> FloatArray:
    """Whitened residuals, predicted minus measured, shape (N, 2); NaN behind the camera."""
    predicted = camera.project(transform_points(T_camera_target, known.points))
    return np.einsum("nij,nj->ni", known.whitening, predicted - known.pixels)


def _range_residuals(ranges: KnownRanges, pose: FloatArray, scale: float) -> FloatArray:
    z = transform_points(pose, ranges.points)[:, 2]
    rho = np.where(z > 0.0, (1.0 + scale) / np.where(z > 0.0, z, 1.0), np.nan)
    return np.asarray((rho - ranges.inverse_depths) / ranges.sigmas)


def _huber_weights(sizes: FloatArray) -> FloatArray:
    return np.asarray(np.minimum(1.0, _HUBER / np.maximum(sizes, 1e-12)))


def _huber_cost(sizes: FloatArray) -> float:
    far = sizes > _HUBER
    return float(np.sum(np.where(far, 2.0 * _HUBER * sizes - _HUBER**2, sizes**2)))


def _cost(
    camera: PinholeCamera, known: KnownPoints, ranges: KnownRanges, state: tuple[FloatArray, float]
) -> float:
    pose, scale = state
    corners = np.linalg.norm(pixel_residuals(camera, known, pose), axis=1)
    depths = np.abs(_range_residuals(ranges, pose, scale))
    total = _huber_cost(corners) + _huber_cost(depths) + (scale / ranges.scale_sigma) ** 2
    return total if np.isfinite(total) else np.inf


def _linearize(
    camera: PinholeCamera, known: KnownPoints, ranges: KnownRanges, state: tuple[FloatArray, float]
) -> tuple[FloatArray, FloatArray]:
    """Weighted residuals, shape (R,), and their derivative by pose and scale, shape (R, 7)."""
    pose, scale = state
    corners = pixel_residuals(camera, known, pose)
    root = np.sqrt(_huber_weights(np.linalg.norm(corners, axis=1)))
    by_pixel = root[:, None, None] * (known.whitening @ pixel_jacobian(camera, known.points, pose))
    depths = _range_residuals(ranges, pose, scale)
    range_root = np.sqrt(_huber_weights(np.abs(depths)))
    by_range = _range_jacobian(ranges, pose, scale) * range_root[:, None]
    jacobian = np.zeros((2 * len(corners) + len(depths) + 1, 7))
    jacobian[: 2 * len(corners), :6] = by_pixel.reshape(-1, 6)
    jacobian[2 * len(corners) : -1] = by_range
    jacobian[-1, 6] = 1.0 / ranges.scale_sigma
    weighted = [(root[:, None] * corners).ravel(), range_root * depths]
    return np.concatenate([*weighted, [scale / ranges.scale_sigma]]), jacobian


def pixel_jacobian(camera: PinholeCamera, points: FloatArray, pose: FloatArray) -> FloatArray:
    """Derivative of the pixels of points by the pose error of the convention, shape (N, 2, 6)."""
    x, y, z = transform_points(pose, points).T
    by_point = np.zeros((len(points), 2, 3))
    by_point[:, 0, 0], by_point[:, 0, 2] = camera.fx / z, -camera.fx * x / z**2
    by_point[:, 1, 1], by_point[:, 1, 2] = camera.fy / z, -camera.fy * y / z**2
    return by_point @ point_jacobian(points, pose)


def point_jacobian(points: FloatArray, pose: FloatArray) -> FloatArray:
    """Derivative of points in the camera frame by the pose error, shape (N, 3, 6)."""
    turned = points @ pose[:3, :3].T
    jacobian = np.zeros((len(points), 3, 6))
    jacobian[:, :, :3] = np.eye(3)
    x, y, z = turned.T
    jacobian[:, 0, 4], jacobian[:, 0, 5] = z, -y
    jacobian[:, 1, 3], jacobian[:, 1, 5] = -z, x
    jacobian[:, 2, 3], jacobian[:, 2, 4] = y, -x
    return jacobian


def _range_jacobian(ranges: KnownRanges, pose: FloatArray, scale: float) -> FloatArray:
    z = transform_points(pose, ranges.points)[:, 2]
    jacobian = np.zeros((len(z), 7))
    by_depth = point_jacobian(ranges.points, pose)[:, 2]
    jacobian[:, :6] = (-(1.0 + scale) / z**2)[:, None] * by_depth
    jacobian[:, 6] = 1.0 / z
    return jacobian / ranges.sigmas[:, None]


def _fit(
    camera: PinholeCamera, known: KnownPoints, ranges: KnownRanges, state: tuple[FloatArray, float]
) -> PoseFit | None:
    _, jacobian = _linearize(camera, known, ranges, state)
    information = jacobian.T @ jacobian
    if np.linalg.cond(information) > 1e14:
        return None
    covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
    corners = np.linalg.norm(pixel_residuals(camera, known, state[0]), axis=1)
    return PoseFit(
        state[0],
        covariance[:6, :6],
        _huber_cost(corners),
        _cost(camera, known, ranges, state),
        state[1],
        _scale_variance(information, ranges.scale_sigma),
    )


def _scale_variance(information: FloatArray, prior_sigma: float) -> float:
    """Variance of the scale from the measurements alone; infinite where they do not fix it."""
    measured = information[6, 6] - prior_sigma**-2
    measured -= information[6, :6] @ np.linalg.solve(information[:6, :6], information[:6, 6])
    return float(1.0 / measured) if measured > 1e-12 else np.inf
