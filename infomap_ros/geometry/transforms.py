"""Rigid transforms as plain 4x4 arrays.

Convention: ``T_a_b`` takes coordinates in frame b to coordinates in frame a,
``p_a = T_a_b @ p_b``, so that ``T_a_c = T_a_b @ T_b_c``. Quaternions are ``(x, y, z, w)`` as in
ROS messages.

Covariance of a pose follows ``geometry_msgs/PoseWithCovariance``: order (x, y, z, rotation about
x, y, z), both expressed in the parent frame. The perturbation model is
``t_true = t + dt`` and ``R_true = Exp(dtheta) @ R``, hence a point ``p_a = R p_b + t`` moves by
``dt - skew(R p_b) dtheta``.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray
from scipy.spatial.transform import Rotation, Slerp

from infomap_ros.errors import InvalidInputError

FloatArray = NDArray[np.float64]

_ROTATION_TOLERANCE = 1e-4
_ROW_TOLERANCE = 1e-9
_LAST_ROW = np.array([0.0, 0.0, 0.0, 1.0])
_IDENTITY = np.eye(3)
_QUATERNION_TOLERANCE = 1e-2


def float_array(values: ArrayLike, name: str, dtype: DTypeLike = np.float64) -> NDArray[Any]:
    """Return `values` as a new array of numbers.

    Args:
        values: array-like of numbers, any shape.
        name: how an error names it.
        dtype: type of the result.

    Raises:
        InvalidInputError: they are not numbers, or not in rows of one length.
    """
    try:
        return np.array(values, dtype=dtype)
    except (TypeError, ValueError) as error:
        raise InvalidInputError(name, f"is not an array of numbers ({error})") from error


def check_transform(transform: ArrayLike, name: str = "transform") -> FloatArray:
    """Return `transform` as a float64 array after checking that it is rigid.

    Args:
        transform: array-like, shape (4, 4).
        name: how an error names it.

    Returns:
        Copy, shape (4, 4), float64.

    Raises:
        InvalidInputError: wrong shape, not finite, or the rotation part is not a proper rotation
            within 1e-4.
    """
    matrix = float_array(transform, name)
    if matrix.shape != (4, 4):
        raise InvalidInputError(name, f"shape {matrix.shape}, expected (4, 4)")
    if not np.isfinite(matrix).all():
        raise InvalidInputError(name, "holds NaN or infinity")
    if np.abs(matrix[3] - _LAST_ROW).max() > _ROW_TOLERANCE:
        raise InvalidInputError(name, f"last row is {matrix[3].tolist()}, expected [0, 0, 0, 1]")
    rotation = matrix[:3, :3]
    if np.abs(rotation @ rotation.T - _IDENTITY).max() > _ROTATION_TOLERANCE:
        raise InvalidInputError(name, "its rotation part is not orthonormal")
    if np.linalg.det(rotation) < 0.0:
        raise InvalidInputError(name, "its rotation part is a reflection")
    return matrix


def check_transforms(transforms: ArrayLike, name: str = "transforms") -> FloatArray:
    """Return many transforms as a float64 array after checking each as `check_transform` does.

    Args:
        transforms: array-like, shape (M, 4, 4).
        name: how an error names it.

    Returns:
        Copy, shape (M, 4, 4), float64.

    Raises:
        InvalidInputError: wrong shape, or one is not a rigid transform; names the first.
    """
    matrices = float_array(transforms, name)
    if matrices.ndim != 3 or matrices.shape[1:] != (4, 4):
        raise InvalidInputError(name, f"shape {matrices.shape}, expected (M, 4, 4)")
    rotations = matrices[:, :3, :3]
    with np.errstate(all="ignore"):
        off = np.abs(rotations @ rotations.transpose(0, 2, 1) - _IDENTITY).max(axis=(1, 2))
        row = np.abs(matrices[:, 3] - _LAST_ROW).max(axis=1)
        rigid = (off <= _ROTATION_TOLERANCE) & (row <= _ROW_TOLERANCE)
        rigid &= np.linalg.det(rotations) >= 0.0
    suspicious = ~(rigid & np.isfinite(matrices).all(axis=(1, 2)))
    for index in np.flatnonzero(suspicious):
        check_transform(matrices[index], f"{name}[{index}]")
    return matrices


def check_covariance(covariance: ArrayLike, size: int, name: str = "covariance") -> FloatArray:
    """Return `covariance` as a symmetric float64 array after checking that it is one.

    Args:
        covariance: array-like, shape (size, size).
        size: number of dimensions.
        name: how an error names it.

    Returns:
        Symmetrised copy, shape (size, size), float64.

    Raises:
        InvalidInputError: wrong shape, not finite, not symmetric, or with a negative eigenvalue.
    """
    matrix = float_array(covariance, name)
    if matrix.shape != (size, size):
        raise InvalidInputError(name, f"shape {matrix.shape}, expected ({size}, {size})")
    if not np.isfinite(matrix).all():
        raise InvalidInputError(name, "holds NaN or infinity")
    scale = float(np.abs(matrix).max())
    if np.abs(matrix - matrix.T).max() > 1e-6 * scale:
        raise InvalidInputError(name, "is not symmetric")
    symmetric = 0.5 * (matrix + matrix.T)
    smallest = float(np.linalg.eigvalsh(symmetric)[0])
    if smallest < -1e-9 * scale:
        raise InvalidInputError(name, f"has the negative eigenvalue {smallest:.3g}")
    return symmetric


def make_transform(rotation: ArrayLike, translation: ArrayLike) -> FloatArray:
    """Compose a transform, shape (4, 4), from a rotation (3, 3) and a translation (3,) [m]."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    matrix[:3, 3] = translation
    return matrix


def invert_transform(transform: FloatArray) -> FloatArray:
    """Invert a rigid transform, shape (4, 4): ``T_b_a`` from ``T_a_b``."""
    rotation = transform[:3, :3].T
    return make_transform(rotation, -rotation @ transform[:3, 3])


def transform_points(transform: FloatArray, points: ArrayLike) -> FloatArray:
    """Take points, shape (..., 3) [m], through a transform, shape (4, 4)."""
    coordinates = np.asarray(points, dtype=np.float64)
    return coordinates @ transform[:3, :3].T + transform[:3, 3]


def transform_from_quaternion(quaternion: ArrayLike, translation: ArrayLike) -> FloatArray:
    """Build a transform from a quaternion (x, y, z, w) and a translation (3,) [m].

    A quaternion within 1 % of unit length is normalized, as messages carry rounded numbers.

    Raises:
        InvalidInputError: the quaternion or the translation is not finite or has a wrong shape,
            or the quaternion's norm differs from one by more than 1 %.
    """
    numbers, offset = float_array(quaternion, "quaternion"), float_array(translation, "translation")
    if numbers.shape != (4,):
        raise InvalidInputError("quaternion", f"shape {numbers.shape}, expected (4,)")
    if offset.shape != (3,) or not np.isfinite(offset).all():
        raise InvalidInputError("translation", f"is {offset.tolist()}, expected 3 finite numbers")
    x, y, z, w = numbers.tolist()
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    if not abs(norm - 1.0) <= _QUATERNION_TOLERANCE:
        raise InvalidInputError("quaternion", f"has norm {norm:.6g}, expected 1")
    # As SciPy does it, to the bit, which takes ten times as long for the one of a message.
    x, y, z, w = x / norm, y / norm, z / norm, w / norm
    xx, yy, zz, ww = x * x, y * y, z * z, w * w
    rotation = (
        (xx - yy - zz + ww, 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)),
        (2.0 * (x * y + z * w), -xx + yy - zz + ww, 2.0 * (y * z - x * w)),
        (2.0 * (x * z - y * w), 2.0 * (y * z + x * w), -xx - yy + zz + ww),
    )
    return make_transform(rotation, offset)


def quaternion_from_transform(transform: FloatArray) -> FloatArray:
    """Rotation of a transform, shape (4, 4), as quaternion (x, y, z, w), shape (4,), w >= 0."""
    return np.asarray(Rotation.from_matrix(transform[:3, :3]).as_quat(canonical=True))


def skew(vector: ArrayLike) -> FloatArray:
    """Cross-product matrix, shape (3, 3): ``skew(a) @ b == np.cross(a, b)``."""
    x, y, z = np.asarray(vector, dtype=np.float64)
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def carry_covariance(covariance: FloatArray, lever: FloatArray) -> FloatArray:
    """Covariance of a pose at the end of a lever that turns with another pose.

    Args:
        covariance: of the pose at its beginning, shape (6, 6).
        lever: from there, shape (3,) [m], in the frame of the covariance.
    """
    over = np.eye(6)
    over[:3, 3:] = -skew(lever)
    return np.asarray(over @ covariance @ over.T)


def compose_poses(
    T_a_b: FloatArray,
    covariance_ab: FloatArray,
    T_b_c: FloatArray,
    covariance_bc: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Compose two poses whose errors are independent.

    Args:
        T_a_b: shape (4, 4).
        covariance_ab: in frame a, shape (6, 6).
        T_b_c: shape (4, 4).
        covariance_bc: in frame b, shape (6, 6).

    Returns:
        ``T_a_c`` and its covariance in frame a, to first order.
    """
    turn = np.kron(np.eye(2), T_a_b[:3, :3])
    carried = carry_covariance(covariance_ab, T_a_b[:3, :3] @ T_b_c[:3, 3])
    return T_a_b @ T_b_c, carried + turn @ covariance_bc @ turn.T


def perturb_transform(transform: FloatArray, perturbation: ArrayLike) -> FloatArray:
    """Apply a pose error of the convention above.

    Args:
        transform: ``T_a_b``, shape (4, 4).
        perturbation: (dx, dy, dz) [m] and rotation vector [rad], both in frame a, shape (6,).

    Returns:
        Perturbed ``T_a_b``, shape (4, 4).
    """
    delta = np.asarray(perturbation, dtype=np.float64)
    rotation = Rotation.from_rotvec(delta[3:]).as_matrix() @ transform[:3, :3]
    return make_transform(rotation, transform[:3, 3] + delta[:3])


def interpolate_transforms(first: FloatArray, second: FloatArray, fraction: float) -> FloatArray:
    """Interpolate between two transforms, shape (4, 4).

    Translation linearly, rotation along the shortest arc (slerp).

    Args:
        first: transform at fraction 0.
        second: transform at fraction 1.
        fraction: within [0, 1].
    """
    rotations = Rotation.from_matrix(np.stack([first[:3, :3], second[:3, :3]]))
    rotation = Slerp([0.0, 1.0], rotations)(fraction).as_matrix()
    translation = (1.0 - fraction) * first[:3, 3] + fraction * second[:3, 3]
    return make_transform(rotation, translation)
