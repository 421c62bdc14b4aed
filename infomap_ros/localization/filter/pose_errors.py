"""Pose errors of the filter's kind and of the package's convention, and poses that are measured.

The filter's error of a pose (R, p) is (xi, theta) with ``R_true = Exp(theta) R`` and
``p_true = Exp(theta) p + J(theta) xi``; that of docs/conventions.md is (dt, theta) with
``p_true = p + dt``. To first order ``dt = xi - skew(p) theta``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.filter.lie import exponential, left_jacobian, logarithm, skews


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
