"""Exponential, logarithm and Jacobians of rotations, as the pose filter needs them.

T. D. Barfoot, "State Estimation for Robotics", Cambridge University Press 2017, sections 7.1.3 and
7.1.5, doi:10.1017/9781316671528.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from infomap_ros.geometry.transforms import FloatArray

_SMALL = 1e-4  # [rad], below which the series serve


def exponential(vector: FloatArray) -> FloatArray:
    """Rotation matrices, shape (..., 3, 3), of rotation vectors, shape (..., 3) [rad]."""
    flat = np.reshape(vector, (-1, 3))
    return np.asarray(Rotation.from_rotvec(flat).as_matrix().reshape(*np.shape(vector), 3))


def logarithm(rotation: FloatArray) -> FloatArray:
    """Rotation vectors, shape (..., 3) [rad], of rotation matrices, shape (..., 3, 3)."""
    flat = np.reshape(rotation, (-1, 3, 3))
    return np.asarray(Rotation.from_matrix(flat).as_rotvec().reshape(np.shape(rotation)[:-1]))


def skews(vectors: FloatArray) -> FloatArray:
    """Cross-product matrices, shape (..., 3, 3), of vectors, shape (..., 3)."""
    matrices = np.zeros((*np.shape(vectors), 3))
    x, y, z = np.moveaxis(vectors, -1, 0)
    matrices[..., 0, 1], matrices[..., 0, 2] = -z, y
    matrices[..., 1, 0], matrices[..., 1, 2] = z, -x
    matrices[..., 2, 0], matrices[..., 2, 1] = -y, x
    return matrices


def left_jacobian(vector: FloatArray) -> FloatArray:
    """Left Jacobians J of rotations, shape (..., 3, 3), of rotation vectors, shape (..., 3).

    ``Exp(v + dv) = Exp(J(v) dv) Exp(v)`` to first order, and ``J(v) skew(v) = Exp(v) - 1``.
    """
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    small = angle < _SMALL
    safe = np.where(small, 1.0, angle)
    one = np.where(small, 0.5 - angle**2 / 24.0, (1.0 - np.cos(safe)) / safe**2)
    two = np.where(small, 1.0 / 6.0 - angle**2 / 120.0, (safe - np.sin(safe)) / safe**3)
    cross = skews(vector)
    return np.asarray(np.eye(3) + one * cross + two * cross @ cross)


def nearest_rotation(matrix: FloatArray) -> FloatArray:
    """The proper rotation that is nearest to a matrix, shape (3, 3)."""
    left, _, right = np.linalg.svd(matrix)
    flip = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    return np.asarray((left * flip) @ right)


def renormalized(transform: FloatArray) -> FloatArray:
    """The transform, shape (4, 4), with rounding errors of its rotation taken out."""
    result = transform.copy()
    result[:3, :3] = nearest_rotation(transform[:3, :3])
    return result
