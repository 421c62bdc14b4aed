"""A pose on which many fiducials agree, found without a prior: RANSAC.

M. A. Fischler, R. C. Bolles, CACM 24(6), 1981, doi:10.1145/358669.358692, scored by truncated
squares as in P. H. S. Torr, A. Zisserman, CVIU 78(1), 2000, doi:10.1006/cviu.1999.0832.

Rigid motions from three pairs of points, the smallest sample that gives one.
"""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.geometry.transforms import FloatArray, make_transform
from infomap_ros.localization.filter.sight import Measured, normalized_differences


def random_triples(count: int, trials: int, seed: int) -> NDArray[np.int64]:
    """Triples of different numbers below count, shape (trials, 3)."""
    rng = np.random.default_rng(seed)
    first = rng.integers(0, count, trials)
    second = (first + rng.integers(1, count, trials)) % count
    third = (first + rng.integers(1, count, trials)) % count
    kept = third != second
    return np.column_stack([first, second, third])[kept]


@njit(cache=True, nogil=True)
def pose_of_triple(points, seen, triple):  # type: ignore[no-untyped-def]
    """Pose that takes the triangle of three points to that of the seen ones."""
    before_valid, before = _triangle_axes(points, triple)
    after_valid, after = _triangle_axes(seen, triple)
    rotation = after @ before.T
    middle = (points[triple[0]] + points[triple[1]] + points[triple[2]]) / 3.0
    middle_seen = (seen[triple[0]] + seen[triple[1]] + seen[triple[2]]) / 3.0
    return before_valid and after_valid, rotation, middle_seen - rotation @ middle


@njit(cache=True, nogil=True)
def _triangle_axes(points, triple):  # type: ignore[no-untyped-def]
    """Whether a triangle has an area, and its axes as columns, shape (3, 3)."""
    axes = np.eye(3)
    one = points[triple[1]] - points[triple[0]]
    two = points[triple[2]] - points[triple[0]]
    normal = np.cross(one, two)
    length, area = np.sqrt((one * one).sum()), np.sqrt((normal * normal).sum())
    if not area > 1e-2 * length * np.sqrt((two * two).sum()):
        return False, axes
    axes[:, 0] = one / length
    axes[:, 2] = normal / area
    axes[:, 1] = np.cross(axes[:, 2], axes[:, 0])
    return True, axes


BoolArray = NDArray[np.bool_]

_LEAST = 3
_PIXEL_ERROR = 3.0  # [px] within which a fiducial agrees with a pose found from pixels alone


def find_pose(
    points: FloatArray,
    covariances: FloatArray,
    measured: Measured,
    gate: float,
    trials: int,
    seed: int = 0,
) -> tuple[FloatArray, NDArray[np.int64]] | None:
    """The pose on which most fiducials agree.

    Args:
        points: of the fiducials in any frame a, shape (M, 3) [m].
        covariances: of the points relative to each other, in the axes of the new camera, shape
            (M, 3, 3) [m^2].
        measured: in the new image.
        gate: squared distance, three degrees of freedom, up to which a fiducial agrees.
        trials: triples of fiducials that are tried.
        seed: of their choice.

    Returns:
        ``T_camera_a``, shape (4, 4), and the indices of the fiducials that it was made from; None
        where there are too few.
    """
    ranged = np.flatnonzero(measured.present[:, 2] & (measured.values[:, 2] > 0.0))
    if len(ranged) < _LEAST + 1:
        return _pose_from_pixels(points, measured)
    seen = _back_projected(measured)
    information = _information(seen, covariances, measured)
    triples = random_triples(len(ranged), trials, seed)
    camera = measured.camera
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    tried = ranged[triples]
    best = _best_triple(points, seen, measured.values, information, tried, intrinsics, gate)
    if best < 0:
        return None
    _, rotation, translation = pose_of_triple(points, seen, tried[best])
    return make_transform(rotation, translation), tried[best]


def agreeing(
    T_camera_a: FloatArray,
    points: FloatArray,
    covariances: FloatArray,
    measured: Measured,
    gate: float,
) -> BoolArray:
    """Which fiducials agree with a pose, shape (M,); arguments as of `find_pose`."""
    rotation = T_camera_a[:3, :3]
    inside = points @ rotation.T + T_camera_a[:3, 3]
    differences = normalized_differences(measured, inside, np.eye(3), covariances)
    return np.asarray((differences**2).sum(axis=1) <= gate)


def _back_projected(measured: Measured) -> FloatArray:
    """Points in the camera frame, shape (M, 3); at 1 m without range."""
    camera = measured.camera
    rho = np.where(measured.values[:, 2] > 0.0, measured.values[:, 2], 1.0)
    x = (measured.values[:, 0] - camera.cx) / camera.fx
    y = (measured.values[:, 1] - camera.cy) / camera.fy
    return np.column_stack([x, y, np.ones_like(x)]) / rho[:, None]


def _information(seen: FloatArray, covariances: FloatArray, measured: Measured) -> FloatArray:
    """Inverse covariances of the differences between expected and measured, shape (M, 3, 3)."""
    jacobian = measured.jacobians(seen)
    S = jacobian @ covariances @ jacobian.transpose(0, 2, 1)
    S[:, range(3), range(3)] += measured.variances
    information = np.linalg.inv(S)
    information[:, 2, 2] *= measured.present[:, 2]
    return np.asarray(information)


def _pose_from_pixels(
    points: FloatArray, measured: Measured
) -> tuple[FloatArray, NDArray[np.int64]] | None:
    """The pose from pixels of known points alone (P3P in RANSAC)."""
    if len(points) < 2 * _LEAST:
        return None
    cv2.setRNGSeed(0)
    try:
        found, vector, translation, inliers = cv2.solvePnPRansac(
            points.astype(np.float64),
            measured.values[:, :2].astype(np.float64),
            measured.camera.matrix,
            None,
            reprojectionError=_PIXEL_ERROR,
            flags=cv2.SOLVEPNP_SQPNP,
        )
    except cv2.error:  # all in one pixel
        return None
    if not found:
        return None
    pose = make_transform(cv2.Rodrigues(vector)[0], translation.ravel())
    return pose, np.asarray(inliers, np.int64).ravel()


@njit(cache=True, nogil=True)
def _best_triple(  # type: ignore[no-untyped-def]
    points, seen, values, information, triples, intrinsics, gate
):
    """Index of the triple with the best pose; -1 where no triple has an area."""
    best, best_score = -1, -1.0
    for trial in range(len(triples)):
        valid, rotation, translation = pose_of_triple(points, seen, triples[trial])
        if not valid:
            continue
        score = _score(points, values, information, intrinsics, gate, rotation, translation)
        if score > best_score:
            best, best_score = trial, score
    return best


@njit(cache=True, nogil=True)
def _score(  # type: ignore[no-untyped-def]
    points, values, information, intrinsics, gate, rotation, translation
):
    """Sum over the fiducials of how far their squared distance stays below the gate."""
    score = 0.0
    for i in range(len(points)):
        y = rotation @ points[i] + translation
        if y[2] <= 0.0:
            continue
        off = np.empty(3)
        off[0] = values[i, 0] - intrinsics[0] * y[0] / y[2] - intrinsics[2]
        off[1] = values[i, 1] - intrinsics[1] * y[1] / y[2] - intrinsics[3]
        off[2] = values[i, 2] - 1.0 / y[2]
        distance = 0.0
        for row in range(3):
            for column in range(3):
                distance += off[row] * information[i, row, column] * off[column]
        if distance < gate:
            score += gate - distance
    return score
