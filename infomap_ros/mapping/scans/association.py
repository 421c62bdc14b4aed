"""Where a point lies in the map, and how far from there the surface may be.

A point informs every voxel that it may belong to: those which the segment from ``-k sigma`` to
``+k sigma`` along the surface normal crosses, sigma being the standard deviation along the normal
of point and pose together. Were each point given to the one voxel in which noise put it, the noise
would select itself: voxels beside the surface would collect only the outliers, agreeing with each
other, and report them as certain.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from infomap_ros.geometry.kernel import inlined_kernel
from infomap_ros.mapping.voxels.keys import COORDINATE_LIMIT

NEAREST = 1e-6
"""What is nearer to the sensor is no measurement [m]."""


class Sensor(NamedTuple):
    """Where the sensor is and how well that is known, for the kernels.

    Attributes:
        rotation: R of T_map_sensor, row by row.
        position: t of T_map_sensor [m].
        inverse_size: 1 / voxel size [1/m].
        size: voxel size [m].
        max_range: [m].
        sigmas: association distance in standard deviations.
        limit: limit of the association distance [voxels].
    """

    rotation: tuple[float, ...]
    position: tuple[float, ...]
    inverse_size: float
    size: float
    max_range: float
    sigmas: float
    limit: float


@inlined_kernel
def rotated(r: Any, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Rotate a vector by a rotation given row by row."""
    return (
        r[0] * x + r[1] * y + r[2] * z,
        r[3] * x + r[4] * y + r[5] * z,
        r[6] * x + r[7] * y + r[8] * z,
    )


@inlined_kernel
def voxel_position(sensor: Any, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Map position of a point of the sensor frame [m], in voxels."""
    t, inverse = sensor.position, sensor.inverse_size
    mx, my, mz = rotated(sensor.rotation, x, y, z)
    return (mx + t[0]) * inverse, (my + t[1]) * inverse, (mz + t[2]) * inverse


@inlined_kernel
def within_limit(x: float, y: float, z: float) -> bool:
    """Whether a position, in voxels, and its surroundings can be packed into keys."""
    return max(abs(x), max(abs(y), abs(z))) < COORDINATE_LIMIT - 128.0


@inlined_kernel
def variance_along(covariances: Any, row: int, columns: Any, x: float, y: float, z: float) -> float:
    """Variance of a point along a direction; covariance in any layout named by `columns`."""
    xx, xy, xz = (
        covariances[row, columns[0]],
        covariances[row, columns[1]],
        covariances[row, columns[2]],
    )
    yy, yz, zz = (
        covariances[row, columns[3]],
        covariances[row, columns[4]],
        covariances[row, columns[5]],
    )
    return xx * x * x + yy * y * y + zz * z * z + 2.0 * (xy * x * y + xz * x * z + yz * y * z)


@inlined_kernel
def pose_variance_along(pose_covariance: Any, arm: Any, direction: Any) -> float:
    """Variance that the pose's error gives a point along a direction, both in the map frame.

    Args:
        pose_covariance: shape (6, 6).
        arm: point relative to the sensor's position [m].
        direction: unit vector.
    """
    v = (
        direction[0],
        direction[1],
        direction[2],
        arm[1] * direction[2] - arm[2] * direction[1],
        arm[2] * direction[0] - arm[0] * direction[2],
        arm[0] * direction[1] - arm[1] * direction[0],
    )
    total = 0.0
    for i in range(6):
        across = 0.5 * pose_covariance[i, i] * v[i]
        for j in range(i + 1, 6):
            across += pose_covariance[i, j] * v[j]
        total += v[i] * across
    return 2.0 * total


@inlined_kernel
def set_reach(
    sensor: Any,
    pose_covariance: Any,
    x: float,
    y: float,
    z: float,
    covariances: Any,
    row: int,
    columns: Any,
    direction: Any,
    reach: Any,
    axis: Any,
) -> None:
    """Association segment of a point.

    Args:
        sensor: a `Sensor`.
        pose_covariance: shape (6, 6), convention of `geometry.transforms`.
        x: of the point, sensor frame [m], likewise y and z.
        y: see x.
        z: see x.
        covariances: of the points, sensor frame.
        row: of the point in `covariances`.
        columns: layout of `covariances`.
        direction: unit vector of the segment, sensor frame, shape (3,).
        reach: receives half the segment in the map frame, shape (3,) [voxels].
        axis: receives the direction in the map frame, shape (3,).
    """
    r = sensor.rotation
    axis[0], axis[1], axis[2] = rotated(r, direction[0], direction[1], direction[2])
    arm = rotated(r, x, y, z)
    variance = variance_along(covariances, row, columns, direction[0], direction[1], direction[2])
    variance += pose_variance_along(pose_covariance, arm, axis)
    length = sensor.sigmas * np.sqrt(max(variance, 0.0)) * sensor.inverse_size
    length = min(length, sensor.limit)
    for i in range(3):
        reach[i] = axis[i] * length
