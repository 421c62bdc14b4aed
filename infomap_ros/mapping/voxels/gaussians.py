"""Gaussians in information form, and symmetric 3x3 matrices, for kernels.

Information is a matrix (xx, xy, xz, yy, yz, zz) [1/m^2] and a vector [1/m] of a surface point
relative to its voxel's center. Merging two estimates is a sum (eq. 4 of Sujan and Dubowsky 2005,
https://doi.org/10.1177/0278364905051774, in its symmetric form ``C = (C1^-1 + C2^-1)^-1``).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from infomap_ros.geometry.kernel import kernel

INFORMATION_SIZE = 9


@kernel
def invert_symmetric(a: Any, out: Any) -> bool:
    """Invert a symmetric positive definite 3x3 matrix given as (xx, xy, xz, yy, yz, zz).

    Returns:
        False, with `out` zero, when the matrix is not positive definite.
    """
    inverse = inverse_symmetric((a[0], a[1], a[2], a[3], a[4], a[5]))
    for n in range(6):
        out[n] = inverse[n]
    return bool(inverse[0] > 0.0)


@kernel
def inverse_symmetric(a: Any) -> Any:
    """As `invert_symmetric`, as a tuple; zeros when the matrix is not positive definite."""
    xx, xy, xz, yy, yz, zz = a
    minor = xx * yy - xy * xy
    c0, c1, c2 = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    determinant = xx * c0 + xy * c1 + xz * c2
    if not (xx > 0.0 and minor > 0.0 and determinant > 0.0):
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    scale = 1.0 / determinant
    return (
        c0 * scale,
        c1 * scale,
        c2 * scale,
        (xx * zz - xz * xz) * scale,
        (xy * xz - xx * yz) * scale,
        minor * scale,
    )


@kernel
def gaussian_of(information: Any) -> Any:
    """Covariance and mean relative to the voxel's center from a row, shape (9,); two tuples.

    Zeros when the information is not positive definite.
    """
    xx, xy, xz = np.float64(information[0]), np.float64(information[1]), np.float64(information[2])
    yy, yz, zz = np.float64(information[3]), np.float64(information[4]), np.float64(information[5])
    c = inverse_symmetric((xx, xy, xz, yy, yz, zz))
    x, y, z = np.float64(information[6]), np.float64(information[7]), np.float64(information[8])
    return c, (
        c[0] * x + c[1] * y + c[2] * z,
        c[1] * x + c[3] * y + c[4] * z,
        c[2] * x + c[4] * y + c[5] * z,
    )


@kernel
def solve_mean(information: Any, covariance: Any, mean: Any) -> bool:
    """As `gaussian_of`, into arrays of shape (6,) and (3,).

    Returns:
        False when the information is not positive definite.
    """
    found, place = gaussian_of(information)
    for n in range(6):
        covariance[n] = found[n]
    for n in range(3):
        mean[n] = place[n]
    return bool(found[0] > 0.0)


@kernel
def rotate_symmetric(r: Any, c: Any, scale: float) -> Any:
    """``scale * R S R^T`` as (xx, xy, xz, yy, yz, zz); R row by row, S in the same order."""
    ax, ay, az = (
        r[0] * c[0] + r[1] * c[1] + r[2] * c[2],
        r[0] * c[1] + r[1] * c[3] + r[2] * c[4],
        r[0] * c[2] + r[1] * c[4] + r[2] * c[5],
    )
    bx, by, bz = (
        r[3] * c[0] + r[4] * c[1] + r[5] * c[2],
        r[3] * c[1] + r[4] * c[3] + r[5] * c[4],
        r[3] * c[2] + r[4] * c[4] + r[5] * c[5],
    )
    cx, cy, cz = (
        r[6] * c[0] + r[7] * c[1] + r[8] * c[2],
        r[6] * c[1] + r[7] * c[3] + r[8] * c[4],
        r[6] * c[2] + r[7] * c[4] + r[8] * c[5],
    )
    return (
        scale * (ax * r[0] + ay * r[1] + az * r[2]),
        scale * (ax * r[3] + ay * r[4] + az * r[5]),
        scale * (ax * r[6] + ay * r[7] + az * r[8]),
        scale * (bx * r[3] + by * r[4] + bz * r[5]),
        scale * (bx * r[6] + by * r[7] + bz * r[8]),
        scale * (cx * r[6] + cy * r[7] + cz * r[8]),
    )


@kernel
def variance_along(c: Any, nx: float, ny: float, nz: float) -> float:
    """``n^T C n`` of C = (xx, xy, xz, yy, yz, zz)."""
    variance = c[0] * nx * nx + c[3] * ny * ny + c[5] * nz * nz
    return variance + 2.0 * (c[1] * nx * ny + c[2] * nx * nz + c[4] * ny * nz)


@kernel
def plane_matrix(along: float, across: float, nx: float, ny: float, nz: float) -> Any:
    """``along n n^T + across (I - n n^T)`` as (xx, xy, xz, yy, yz, zz)."""
    d = along - across
    return (
        across + d * nx * nx,
        d * nx * ny,
        d * nx * nz,
        across + d * ny * ny,
        d * ny * nz,
        across + d * nz * nz,
    )


@kernel
def added(a: Any, b: Any) -> Any:
    """Sum of two symmetric matrices given by their upper triangles."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3], a[4] + b[4], a[5] + b[5])
