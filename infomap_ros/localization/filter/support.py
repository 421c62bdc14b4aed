"""Which fiducials of an image could be found out if they were mistaken for others.

A fiducial that was mistaken for another one is found out by those that contradict it. Where the
image shows one or two fiducials of a place that is known only roughly relative to everything else
in view, nothing contradicts them wherever they are seen, and they would pull the whole place along.

The redundancy of a measurement tells how much of a gross error of it its own residual shows
(W. Baarda, "A testing procedure for use in geodetic networks", Netherlands Geodetic Commission
2(5), 1968; W. Foerstner, "Reliability analysis of parameter estimation in linear models with
applications to mensuration problems in computer vision", CVGIP 40, 1987,
doi:10.1016/0734-189X(87)90144-5). Of m equal witnesses of something unknown it is 1 - 1/m. What
counts here is by how much it is smaller than it would be if only the camera's pose were unknown.
"""

from __future__ import annotations

import numpy as np

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.filter.lie import skews
from infomap_ros.localization.filter.sight import BoolArray, Sight

_GROSS = 1.0  # [px], sigma of pixels for which redundancy is told
_POSE = 1e-9  # that keeps few fiducials from leaving the pose undetermined, of its information


def controlled(sight: Sight, jacobian: FloatArray, least: float) -> BoolArray:
    """Which fiducials of an image would be found out, shape (M,).

    The one of which most is hidden is left out until little enough of all others is. All pixels
    count as equally exact, to a pixel: mistakes are no smaller, and a witness of a mistake need
    not be exact.

    Args:
        sight: what is known of M fiducials before the image.
        jacobian: derivatives of their values by d, shape (M, 3, 3).
        least: share of an error that must show beside the map's uncertainty, below 1.

    Raises:
        numpy.linalg.LinAlgError: the covariance is singular.
    """
    count = len(jacobian)
    over = (jacobian @ sight.covariance.reshape(count, 3, -1)).reshape(3 * count, -1)
    S = (over.reshape(3 * count, count, 1, 3) @ jacobian.transpose(0, 2, 1)).reshape(3 * count, -1)
    noise = sight.measured.variances.copy()
    noise[:, :2] = np.maximum(noise[:, :2], _GROSS**2)
    S[np.diag_indices(3 * count)] += noise.ravel()
    inverse: FloatArray = np.asarray(np.linalg.inv(S))
    by_pose = _pose_derivatives(sight, jacobian)
    left = np.ones(count, bool)
    while left.any():
        shown = _blocks(inverse, noise)
        by_map = np.subtract(_shown_of_a_known_map(by_pose, noise, left), shown)
        hidden = np.linalg.eigvalsh(by_map)[:, -1] - (1.0 - least)
        worst = int(np.where(left, hidden, -1.0).argmax())
        if hidden[worst] <= 0.0:
            break
        left[worst] = False
        inverse = _without(inverse, worst)
    return left


def _blocks(inverse: FloatArray, noise: FloatArray) -> FloatArray:
    """Redundancy of each fiducial's pixel, shape (M, 2, 2), from the inverse of S."""
    each, sigmas = np.arange(len(noise)), np.sqrt(noise[:, :2])
    blocks = inverse.reshape(len(noise), 3, len(noise), 3)[each, :2, each, :2]
    return np.asarray(sigmas[:, :, None] * blocks * sigmas[:, None, :])


def _pose_derivatives(sight: Sight, jacobian: FloatArray) -> FloatArray:
    """Derivatives of the values by a motion of the camera, shape (M, 3, 6)."""
    lever = -skews(sight.points @ sight.rotation.T)
    return np.concatenate([jacobian, jacobian @ lever], axis=2)


def _shown_of_a_known_map(by_pose: FloatArray, noise: FloatArray, left: BoolArray) -> FloatArray:
    """Redundancy of each pixel if nothing but the camera's pose is unknown, shape (M, 2, 2)."""
    white = by_pose / np.sqrt(noise)[:, :, None]
    flat = white[left].reshape(-1, 6)
    information = flat.T @ flat
    information += _POSE * np.diag(np.diag(information))
    pixels = white[:, :2]
    return np.asarray(np.eye(2) - pixels @ np.linalg.solve(information, pixels.transpose(0, 2, 1)))


def _without(inverse: FloatArray, index: int) -> FloatArray:
    """The inverse of the covariance of the others; rows and columns of this one are zero."""
    own = slice(3 * index, 3 * index + 3)
    rows = inverse[own]
    rest = inverse - rows.T @ np.linalg.solve(rows[:, own], rows)
    rest[own], rest[:, own] = 0.0, 0.0
    return np.asarray(rest)
