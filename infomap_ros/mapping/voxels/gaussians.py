"""Gaussians in information form, and a hash table of rows of numbers by voxel.

A row holds the information matrix (xx, xy, xz, yy, yz, zz) [1/m^2] and the information vector
[1/m] of the surface point relative to the voxel's centre, float32. Merging two estimates is a sum
(eq. 4 of Sujan and Dubowsky 2005, https://doi.org/10.1177/0278364905051774, in its symmetric form
``C = (C1^-1 + C2^-1)^-1``), so the order of measurements does not matter.

Voxels are found through an open-addressing table whose size need not be a power of two; it stays
between 57 and 85 % full, and a voxel costs 40 bytes and its share of the table.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import CapacityError
from infomap_ros.geometry.kernel import kernel
from infomap_ros.mapping.voxels.blocks import grown
from infomap_ros.mapping.voxels.keys import BLOCK_VOXELS, table_slot

INFORMATION_SIZE = 9
GAUSSIAN_BYTES = 4 + 4 * INFORMATION_SIZE
_MAX_LOAD = 0.85
_MAX_BLOCKS = 2**32 // BLOCK_VOXELS


class GaussianArrays(NamedTuple):
    """The arrays of the Gaussians, as the kernels take them.

    Attributes:
        table: hash table, row or -1, int32.
        owner: block slot * 512 + local voxel index of each row, uint32.
        information: shape (n, 9), float32.
        counts: used rows, int64, shape (1,).
    """

    table: NDArray[np.int32]
    owner: NDArray[np.uint32]
    information: NDArray[np.float32]
    counts: NDArray[np.int64]


def empty_gaussians() -> GaussianArrays:
    """Arrays of a map without surface."""
    return GaussianArrays(
        np.full(512, -1, np.int32),
        np.empty(256, np.uint32),
        np.empty((256, INFORMATION_SIZE), np.float32),
        np.zeros(1, np.int64),
    )


def with_gaussian_room(arrays: GaussianArrays, more: int, blocks: int) -> GaussianArrays:
    """Arrays with room for `more` voxels, for a map of so many blocks.

    Raises:
        CapacityError: the map has more blocks than an owner can number.
    """
    if blocks > _MAX_BLOCKS:
        raise CapacityError(f"the map would need {blocks} blocks, the limit is {_MAX_BLOCKS}")
    count = int(arrays.counts[0])
    return arrays._replace(
        owner=grown(arrays.owner, count + more, used=count),
        information=grown(arrays.information, count + more, used=count),
    )


def with_table_room(arrays: GaussianArrays) -> GaussianArrays:
    """Arrays whose table is at most 85 % full, and not much emptier than that."""
    count = int(arrays.counts[0])
    if count + 1 <= _MAX_LOAD * len(arrays.table):
        return arrays
    size = max(512, int(1.5 * count / _MAX_LOAD))
    table = np.full(size, -1, np.int32)
    _rehash(table, arrays.owner, count)
    return arrays._replace(table=table)


def gaussian_bytes(arrays: GaussianArrays) -> int:
    """Memory in use by the Gaussians [bytes]; the hash table counts in full."""
    return int(arrays.table.nbytes + arrays.counts[0] * GAUSSIAN_BYTES)


@kernel
def _rehash(table: Any, owner: Any, count: int) -> None:
    for row in range(count):
        place = table_slot(np.int64(owner[row]), len(table))
        while table[place] >= 0:
            place += 1
            if place == len(table):
                place = 0
        table[place] = row


@kernel
def find_gaussian(gaussians: Any, owner: int) -> int:
    """Row of a voxel's Gaussian, or -1."""
    return find_row(gaussians.table, gaussians.owner, owner)


@kernel
def find_row(table: Any, owner: Any, key: int) -> Any:
    """As `find_gaussian`, from the arrays `table` and `owner`: quicker in a loop."""
    place = table_slot(key, len(table))
    while True:
        row = np.int64(table[place])
        if row < 0 or owner[row] == key:
            return row
        place += 1
        if place == len(table):
            place = 0


@kernel
def gaussian_row(table: Any, owner: Any, counts: Any, key: int, information: Any) -> Any:
    """Row of a voxel's Gaussian, made with no information if need be.

    Args:
        table: of the `GaussianArrays`, likewise owner, counts and information.
        owner: see table.
        counts: see table.
        key: the voxel, block slot * 512 + local index.
        information: see table; any numbers that a map keeps of its surface voxels.

    Returns:
        The row, or -1 with nothing changed when the voxel is new and the table is full.
    """
    place = table_slot(key, len(table))
    while True:
        row = np.int64(table[place])
        if row < 0:
            break
        if owner[row] == key:
            return row
        place += 1
        if place == len(table):
            place = 0
    row = counts[0]
    if row + 1 > _MAX_LOAD * len(table):
        return np.int64(-1)
    counts[0] = row + 1
    table[place] = row
    owner[row] = key
    for i in range(information.shape[1]):
        information[row, i] = 0
    return row


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
    """Covariance and mean relative to the voxel's centre from a row, shape (9,); two tuples.

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
