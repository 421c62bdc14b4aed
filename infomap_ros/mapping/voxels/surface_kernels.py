"""Compiled storing and reading of Gaussians; layout in `infomap_ros.mapping.voxels.surface`.

Gaussians in information form, and symmetric 3x3 matrices, for kernels.

Information is a matrix (xx, xy, xz, yy, yz, zz) [1/m^2] and a vector [1/m] of a surface point
relative to its voxel's center. Merging two estimates is a sum (eq. 4 of Sujan and Dubowsky 2005,
https://doi.org/10.1177/0278364905051774, in its symmetric form ``C = (C1^-1 + C2^-1)^-1``).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from infomap_ros.geometry.kernel import kernel
from infomap_ros.mapping.voxels.keys import BLOCK_VOXELS

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


SIDES = 2
EXCESS, COMMON, MEMORY, CLOCK = 9, 10, 11, 12
"""Columns of a row after its information: E, the sum of the a_j, m, and the clock of m."""

ROW_SIZE = 13
NOTHING = np.array([0.0] * CLOCK + [-np.inf], np.float32)
"""A row without information."""

PAGE_COUNT, ROW_COUNT = 0, 1
"""Places in `SurfaceArrays.counts`."""

_TOLERANCE = 1.2
"""How far from its voxel's center a mean may lie, in half voxels."""


@kernel
def open_pages(surface: Any, records: Any) -> int:
    """Number pages for sheets that have none; returns how many pages there are then."""
    page, used = surface.page, surface.counts[PAGE_COUNT]
    for i in range(len(records)):
        sheet = records[i] >> 9
        if page[sheet] < 0:
            page[sheet] = used
            used += 1
    surface.counts[PAGE_COUNT] = used
    return int(used)


@kernel
def open_rows(surface: Any, records: Any, found: Any) -> None:
    """Row of each record, made without information if need be; pages are there."""
    page, places, rows, used = surface.page, surface.places, surface.rows, surface.counts[ROW_COUNT]
    for i in range(len(records)):
        sheet, local = np.int64(page[records[i] >> 9]), records[i] & 511
        row = np.int64(places[sheet, local])
        if row < 0:
            row = used
            used += 1
            places[sheet, local] = row
            for column in range(ROW_SIZE):
                rows[row, column] = 0.0
            rows[row, CLOCK] = -np.inf
        found[i] = row
    surface.counts[ROW_COUNT] = used


@kernel
def add_observations(
    rows: Any,
    places: Any,
    order: Any,
    information: Any,
    shares: Any,
    clock: float,
    first: int,
    last: int,
) -> None:
    """Merge observations [first, last) of one scan into their rows.

    A scan whose clock is less than one before that of a row comes late: to others it is as near as
    the latest of them, and the memory stays with those. One that is farther back has another
    beginning, and the memory goes with it.

    Args:
        rows: of the `SurfaceArrays`.
        places: row of each observation, shape (n,); each row at most once.
        order: number of each observation in what follows, shape (n,).
        information: shape (m, 9), float32.
        shares: b = s / v and a = u / v of each observation [1/m], shape (m, 2).
        clock: of the scan.
        first: first observation.
        last: one past the last.
    """
    latest, decay = np.inf, 0.0
    for i in range(first, last):
        row, source = places[i], order[i]
        for column in range(INFORMATION_SIZE):
            rows[row, column] += information[source, column]
        common = np.float64(shares[source, 1])
        rows[row, EXCESS] += 2.0 * common * np.float64(rows[row, COMMON])
        rows[row, COMMON] += common
        share = np.float64(shares[source, 0])
        if share <= 0.0:
            continue
        before, memory = np.float64(rows[row, CLOCK]), np.float64(rows[row, MEMORY])
        if before != latest:
            latest, decay = before, math.exp(-abs(clock - before))
        if 0.0 < before - clock < 1.0:
            rows[row, EXCESS] += 2.0 * share * memory
            rows[row, MEMORY] = memory + decay * share
        else:
            rows[row, EXCESS] += 2.0 * decay * share * memory
            rows[row, MEMORY] = decay * memory + share
            rows[row, CLOCK] = clock


@kernel
def read_record(surface: Any, record: int, row: Any) -> bool:
    """Copy a record, 512 * sheet + local index, into `row`, shape (13,); False without one."""
    sheet = record >> 9
    if sheet >= len(surface.page) or surface.page[sheet] < 0:
        return False
    place = np.int64(surface.places[np.int64(surface.page[sheet]), record & 511])
    if place < 0 or not surface.rows[place, 0] > 0.0:
        return False
    for column in range(ROW_SIZE):
        row[column] = surface.rows[place, column]
    return True


@kernel
def inflation(row: Any) -> float:
    """How many times its inverse information the covariance of a record is, at least 1.

    ``1 + E / I`` with I the information along the normal: the largest eigenvalue of a matrix
    whose two others are equal, else a little more than that.
    """
    excess = np.float64(row[EXCESS])
    if not excess > 0.0:
        return 1.0
    xx, xy, xz = np.float64(row[0]), np.float64(row[1]), np.float64(row[2])
    yy, yz, zz = np.float64(row[3]), np.float64(row[4]), np.float64(row[5])
    trace = xx + yy + zz
    squares = xx * xx + yy * yy + zz * zz + 2.0 * (xy * xy + xz * xz + yz * yz)
    spread = max(3.0 * squares - trace * trace, 0.0)
    return 1.0 + 3.0 * excess / (trace + math.sqrt(2.0 * spread))


@kernel
def read_information(
    surface: Any, slot: int, local: int, half: float, row: Any, other: Any
) -> bool:
    """What a map claims to know of the surface in a voxel; False where there is nothing.

    Args:
        surface: a `SurfaceArrays`.
        slot: of the voxel's block.
        local: its index in the block.
        half: half a voxel [m].
        row: receives matrix and vector in its first nine columns, so that the inverse matrix is
            the covariance with all that scans share; shape (13,), float32.
        other: to work with, shape (13,), float32.
    """
    record = slot * SIDES * BLOCK_VOXELS + local
    is_one = read_record(surface, record, row)
    if read_record(surface, record + BLOCK_VOXELS, other):
        if is_one:
            _join(row, other, half)
        else:
            for column in range(ROW_SIZE):
                row[column] = other[column]
        is_one = True
    if is_one and row[EXCESS] > 0.0:
        scale = 1.0 / inflation(row)
        for column in range(INFORMATION_SIZE):
            row[column] *= scale
    return is_one


@kernel
def read_block(surface: Any, slot: int, half: float, locals_: Any, rows: Any, other: Any) -> int:
    """`read_information` of all voxels of a block; returns of how many there is any.

    Args:
        surface: a `SurfaceArrays`.
        slot: of the block.
        half: half a voxel [m].
        locals_: receives local indices, shape (512,).
        rows: receives what is known of each, shape (512, 13), float32.
        other: to work with, shape (13,), float32.
    """
    sheet, found = slot * SIDES, 0
    if sheet + 1 >= len(surface.page) or max(surface.page[sheet], surface.page[sheet + 1]) < 0:
        return 0
    for local in range(BLOCK_VOXELS):
        if read_information(surface, slot, local, half, rows[found], other):
            locals_[found] = local
            found += 1
    return found


@kernel
def list_records(surface: Any, records: Any, rows: Any) -> int:
    """All records with information, their numbers and rows; returns how many there are."""
    found = 0
    for sheet in range(len(surface.page)):
        if surface.page[sheet] < 0:
            continue
        for local in range(BLOCK_VOXELS):
            if found == len(records):
                return found
            if read_record(surface, sheet * BLOCK_VOXELS + local, rows[found]):
                records[found] = sheet * BLOCK_VOXELS + local
                found += 1
    return found


@kernel
def _join(row: Any, other: Any, half: float) -> None:
    """What the two sides of a voxel tell together.

    If both find the surface in the voxel it is their sum; if one does, that one: the other saw the
    far face of something thin, beyond the voxel. If none does there is no surface in the voxel.
    """
    one_lies, other_lies = _mean_lies_in(row, half), _mean_lies_in(other, half)
    for column in range(EXCESS + 1):
        if one_lies and other_lies:
            row[column] += other[column]
        elif other_lies:
            row[column] = other[column]


@kernel
def _mean_lies_in(row: Any, half: float) -> bool:
    """As `lies_in_voxel`, for those who want neither covariance nor mean."""
    covariance, mean = gaussian_of(row)
    return bool(covariance[0] > 0.0 and _is_near(mean, half))


@kernel
def _is_near(mean: Any, half: float) -> bool:
    """Whether a place relative to a voxel's center [m] lies in the voxel, with the tolerance."""
    return bool(max(abs(mean[0]), abs(mean[1]), abs(mean[2])) <= _TOLERANCE * half)


@kernel
def lies_in_voxel(information: Any, half: float, work: Any, mean: Any) -> bool:
    """Whether the mean lies in the voxel, with a tolerance of a tenth of its size.

    Args:
        information: matrix and vector, shape (9,) or more.
        half: half a voxel [m].
        work: receives the covariance, shape (6,).
        mean: receives the mean relative to the voxel's center, shape (3,).
    """
    return bool(solve_mean(information, work, mean) and _is_near(mean, half))
