"""From the gathered rows of a scan to one observation per voxel.

The observation is the mean of the voxel's points with covariance

    v n n^T  +  max(v, s^2 / 12) (I - n n^T),    v = n^T (A + B) n + (1 - l) s^2 / 24 + w

    A = R (c + (1 - c) / k) C_points R^T,    B = J C_pose J^T

A is the range noise of k points whose errors correlate by c (eqs. 2 and 3 of Sujan and Dubowsky
2005, with the frame change in its correct form R C R^T). B is the error of the pose, J = [I,
-skew(R x)], added once per scan. n is the surface normal, s the voxel size, l the length of the
mean of the points' unit normals.

The second term is what a plane leaves out. The mean of points on a surface with the curvature q
lies off it by q s^2 / 24, and their normals turn by q s / sqrt(12) about their mean, which makes
that shorter by 1 - l = q^2 s^2 / 24. So the mean is off by s sqrt((1 - l) / 24). Of two faces that
meet at a right angle that is 0.11 s, and their points' mean lies 0.125 s from either. w is for
voxels finer than the noise (`_cut_variance`), else zero.

Of an error only its part along the normal counts. An error e along the ray moves a point along the
surface too, but there the point is gathered with those of the voxel where it ends up: the mean of
the voxel's points is off by n^T e along the normal and by nothing across it. To keep the
correlation of the two in A would make each scan a thin needle along its rays, and several scans
would be triangulated to a certainty that none of them has. Across the normal the points may be any
of the patch within the voxel, s^2 / 12; it is not taken thinner than v, so that normals that differ
from scan to scan by their noise triangulate nothing either.

Where a voxel holds an edge, no normal is known, and the covariance is A + B + s^2 / 12 I.

How much of v other scans have too is told with each observation
(`infomap_ros.mapping.voxels.surface`): as b that of the drift, n^T J C_drift J^T n, and as a what
the plane leaves out together with w and `_CHOSEN` of the variance of independent points. Of an
edge, which has no normal, the means over all directions take the places of the variances.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from infomap_ros.geometry.kernel import kernel
from infomap_ros.mapping.scans.association import pose_variance_along
from infomap_ros.mapping.voxels.keys import unpack
from infomap_ros.mapping.voxels.surface import side_of
from infomap_ros.mapping.voxels.surface_kernels import (
    added,
    inverse_symmetric,
    plane_matrix,
    rotate_symmetric,
    variance_along,
)

_AGREEMENT = 0.7
"""Length of the mean of unit normals below which a voxel holds an edge, not a smooth patch."""

_LEAST_VARIANCE = 1e-18
"""A variance along the normal of no more than this is what rounding left of one [m^2]."""

_THINNEST = 1e-5
"""A variance along the normal is taken for no less than this times that across it: information is
kept in single precision, whose rounding would drown what is known across the normal."""

_CHOSEN = 0.15
"""Share of the variance (1 - c) / k of independent points that all scans of a voxel have in common.

Noise decides which points come to lie in a voxel, so their mean keeps some of it, and the same in
each scan: k points of which the voxel takes those within it are off by a share of their sigma that
does not average out. Calibrated on 100 scans from one place with poses as good as exact, 5 and 2 cm
voxels, 96 and 480 pixels wide, seeds 50000 to 50203, which no study and no test uses: the greatest
likelihood is at 0.11 to 0.21.
"""

_LEAST_SHARE = 0.03
"""Where a scan finds the surface in a voxel with less probability than this, the voxel learns
nothing of it: such estimates take memory and hardly ever come to lie in their voxels. The rule asks
the scan alone, so that scans may come in any order."""

_FAR_SIGMAS = 1.9
"""Beyond a voxel by this many standard deviations, a surface lies in it with less than that."""


@kernel
def _pose_covariance(p: Any, x: float, y: float, z: float) -> Any:
    """``J C_pose J^T`` for a point at arm (x, y, z) [m] from the sensor, map frame.

    With T, X and D the blocks of C_pose and S = skew(arm) it is T - X S^T - S X^T + S D S^T.
    """
    # Rows of J C for the three axes: translation row, minus the rows of S times the rotation rows.
    a = (
        p[0, 0] + z * p[4, 0] - y * p[5, 0],
        p[0, 1] + z * p[4, 1] - y * p[5, 1],
        p[0, 2] + z * p[4, 2] - y * p[5, 2],
        p[0, 3] + z * p[4, 3] - y * p[5, 3],
        p[0, 4] + z * p[4, 4] - y * p[5, 4],
        p[0, 5] + z * p[4, 5] - y * p[5, 5],
    )
    b = (
        p[1, 1] - z * p[3, 1] + x * p[5, 1],
        p[1, 2] - z * p[3, 2] + x * p[5, 2],
        p[1, 3] - z * p[3, 3] + x * p[5, 3],
        p[1, 4] - z * p[3, 4] + x * p[5, 4],
        p[1, 5] - z * p[3, 5] + x * p[5, 5],
    )
    c = (
        p[2, 2] + y * p[3, 2] - x * p[4, 2],
        p[2, 3] + y * p[3, 3] - x * p[4, 3],
        p[2, 4] + y * p[3, 4] - x * p[4, 4],
    )
    return (
        a[0] + z * a[4] - y * a[5],
        a[1] - z * a[3] + x * a[5],
        a[2] + y * a[3] - x * a[4],
        b[0] - z * b[2] + x * b[4],
        b[1] + y * b[2] - x * b[3],
        c[0] + y * c[1] - x * c[2],
    )


@kernel
def _covariance_sums(sums: Any, row: int) -> Any:
    """Sum of the points' covariances of a row, in double precision."""
    return (
        np.float64(sums[row, 4]),
        np.float64(sums[row, 5]),
        np.float64(sums[row, 6]),
        np.float64(sums[row, 7]),
        np.float64(sums[row, 8]),
        np.float64(sums[row, 9]),
    )


@kernel
def observe_rows(
    rows: Any,
    sensor: Any,
    pose: Any,
    correlation: float,
    hit_quanta: int,
    first: int,
    last: int,
    information: Any,
    hits: Any,
    sides: Any,
    shares: Any,
) -> None:
    """Turn the rows [first, last) into observations.

    Args:
        rows: a `ScanRows`.
        sensor: a `Sensor`.
        pose: covariances of the pose, convention of `geometry.transforms`, shape (2, 6, 6): of all
            that is not shared by the whole map, and of its drift alone.
        correlation: of the errors of the points of one voxel, in [0, 1].
        hit_quanta: evidence of a certain hit.
        first: first row.
        last: one past the last row.
        information: receives information matrix and vector of each row relative to the voxel's
            center, shape (n, 9), float32; the first entry is 0 where a row has
            no points or its covariance is not positive definite.
        hits: receives the evidence of each row [quanta], int32.
        sides: receives the side from which the surface is seen, uint8.
        shares: receives b and a of each row [1/m], shape (n, 2), float32; see above.
    """
    sums, t, size = rows.sums, sensor.position, sensor.size
    patch = size * size / 12.0
    for row in range(first, last):
        information[row, 0] = 0.0
        hits[row] = 0
        count = np.float64(sums[row, 0])
        if count == 0.0:
            continue
        share = 1.0 / count
        offset, arm = _place(sums, row, share, unpack(rows.keys[row]), size, t)
        nx, ny, nz = np.float64(sums[row, 10]), np.float64(sums[row, 11]), np.float64(sums[row, 12])
        sides[row] = side_of(nx, ny, nz)
        length = math.sqrt(nx * nx + ny * ny + nz * nz)
        independent = (1.0 - correlation) * share
        scatter = (correlation + independent) * share
        bent = 0.5 * patch * max(0.0, 1.0 - length * share)
        if length > _AGREEMENT * count:
            normal = (nx / length, ny / length, nz / length)
            variance = _smooth_variance(sums, row, sensor.rotation, scatter, normal, patch)
            placing = max(0.0, pose_variance_along(pose[0], arm, normal))
            of_point = max(0.0, variance) * share / scatter
            cut = _cut_variance(of_point, placing, size, sensor.sigmas, sensor.limit)
            common = bent + cut + _CHOSEN * independent * of_point
            variance += placing
            unseen = bent + cut
            inside, inverse = _observe_smooth(offset, normal, variance, unseen, size, patch)
            variance += unseen
            drift = pose_variance_along(pose[1], arm, normal)
            scale = 1.0 / max(variance, _THINNEST * patch)
            shares[row, 0] = math.sqrt(max(drift, 0.0)) * scale
            shares[row, 1] = math.sqrt(common) * scale
        else:
            total = added(
                rotate_symmetric(sensor.rotation, _covariance_sums(sums, row), scatter),
                _pose_covariance(pose[0], arm[0], arm[1], arm[2]),
            )
            inside, inverse = _observe_edge(total, min(1.0, np.float64(sums[row, 13])), patch)
            drifts = _pose_covariance(pose[1], arm[0], arm[1], arm[2])
            scale = 1.0 / ((total[0] + total[3] + total[5]) / 3.0 + patch)
            drift = max(drifts[0] + drifts[3] + drifts[5], 0.0) / 3.0
            shares[row, 0] = math.sqrt(drift) * scale
            shares[row, 1] = math.sqrt(bent) * scale
        if inverse[0] == 0.0:
            continue
        hits[row] = int(hit_quanta * inside + 0.5)
        _write_information(information, row, inverse, offset)


@kernel
def _place(sums: Any, row: int, share: float, voxel: Any, size: float, origin: Any) -> Any:
    """Mean of a row's points, relative to the voxel's center and to the sensor [m], map frame."""
    offset = (sums[row, 1] * share, sums[row, 2] * share, sums[row, 3] * share)
    arm = (
        (voxel[0] + 0.5) * size + offset[0] - origin[0],
        (voxel[1] + 0.5) * size + offset[1] - origin[1],
        (voxel[2] + 0.5) * size + offset[2] - origin[2],
    )
    return offset, arm


@kernel
def _write_information(information: Any, row: int, inverse: Any, mean: Any) -> None:
    """Write the information matrix `inverse` and the vector for a mean, both tuples."""
    x, y, z = mean
    for i in range(6):
        information[row, i] = inverse[i]
    information[row, 6] = inverse[0] * x + inverse[1] * y + inverse[2] * z
    information[row, 7] = inverse[1] * x + inverse[3] * y + inverse[4] * z
    information[row, 8] = inverse[2] * x + inverse[4] * y + inverse[5] * z


@kernel
def _smooth_variance(sums: Any, row: int, r: Any, scale: float, normal: Any, patch: float) -> float:
    """``scale * n^T R S R^T n`` of the points' covariances S of a row.

    -inf where ``scale * S`` is not positive even with `patch` added to each variance [m^2].
    """
    total, spare = _covariance_sums(sums, row), patch / scale
    if not _is_positive(
        total[0] + spare, total[1], total[2], total[3] + spare, total[4], total[5] + spare
    ):
        return -np.inf
    nx, ny, nz = normal
    x = r[0] * nx + r[3] * ny + r[6] * nz
    y = r[1] * nx + r[4] * ny + r[7] * nz
    z = r[2] * nx + r[5] * ny + r[8] * nz
    return scale * max(0.0, variance_along(total, x, y, z))


@kernel
def _is_positive(xx: float, xy: float, xz: float, yy: float, yz: float, zz: float) -> bool:
    """Whether a symmetric matrix is positive definite."""
    minor, c0, c1, c2 = xx * yy - xy * xy, yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    return xx > 0.0 and minor > 0.0 and xx * c0 + xy * c1 + xz * c2 > 0.0


@kernel
def _cut_variance(point: float, placing: float, size: float, sigmas: float, limit: float) -> float:
    """What is unknown where the noise of points reaches farther than a point is associated [m^2].

    A voxel then takes the points within w = `limit` voxels of it, and their mean says little of
    where the surface is: of a normal distribution that is cut off at t = w / sigma on either side
    the variance is less by the share 2 t phi(t) / (2 Phi(t) - 1). That is what the mean has not
    seen. It is the same in all scans. 0 where points inform all that they reach.
    """
    sigma = math.sqrt(point + placing)
    if sigmas * sigma <= limit * size:
        return 0.0
    t = limit * size / sigma
    if t < 1e-3:
        return point
    density = math.exp(-0.5 * t * t) * 0.3989422804014327
    return point * min(1.0, 2.0 * t * density / math.erf(t * 0.7071067811865476))


@kernel
def _observe_smooth(
    offset: Any, normal: Any, variance: float, unseen: float, size: float, patch: float
) -> Any:
    """Probability that the surface lies in a voxel, and the information; zeros where it is none.

    `variance` is that of the points, which decide where the surface lies; the information is less
    by what they leave `unseen`.
    """
    nothing = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    if not variance > _LEAST_VARIANCE:
        return 0.0, nothing
    nx, ny, nz = normal
    distance = abs(offset[0] * nx + offset[1] * ny + offset[2] * nz)
    half = 0.5 * size * (abs(nx) + abs(ny) + abs(nz))
    if distance - half > 0.0 and (distance - half) ** 2 > _FAR_SIGMAS**2 * variance:
        return 0.0, nothing
    scale = 1.0 / math.sqrt(2.0 * variance)
    inside = 0.5 * (math.erf((half - distance) * scale) + math.erf((half + distance) * scale))
    if inside < _LEAST_SHARE:
        return 0.0, nothing
    variance = max(variance + unseen, _THINNEST * patch)
    return inside, plane_matrix(1.0 / variance, 1.0 / max(variance, patch), nx, ny, nz)


@kernel
def _observe_edge(total: Any, inside: float, patch: float) -> Any:
    """As `_observe_smooth`, for a voxel without a normal and the covariance of its points."""
    return inside, inverse_symmetric(added(total, (patch, 0.0, 0.0, patch, 0.0, patch)))
