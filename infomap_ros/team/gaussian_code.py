"""Surface points in 14 bytes: the code in which robots send each other a voxel's Gaussian.

The mean is coded relative to the voxel's center in steps of 2^-15 of the voxel size. The covariance
is coded by its axes: the direction of the smallest spread (the surface's normal, on an octahedron
with 2 x 16 bits), the roll of the other two axes about it in steps of 180/256 degrees, and the
three standard deviations in voxels as powers of 2^(1/12). So every code is a positive definite
matrix, and its error stays below a tenth of the standard deviation in every direction as long as
the two larger standard deviations differ by less than a factor of 10.

What a code says is computed with correctly rounded operations and tables only, so that it is the
same to the bit on every machine.

A hash table of the codes of surface points, by voxel.

Codes are found through an open-addressing table whose size need not be a power of two; it stays
between 57 and 85 % full.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.errors import CapacityError, InvalidInputError
from infomap_ros.geometry.kernel import kernel
from infomap_ros.geometry.symmetric import smallest_axes
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.voxels.keys import BLOCK_VOXELS, grown, table_slot

MEAN_STEPS = 1 << 15
"""Steps of the mean in a voxel size."""

SIGMA_STEPS, SIGMA_ZERO = 12, 170
"""Steps of a standard deviation in an octave, and the code of one voxel size."""

_HALF_TURN, _NORMAL_LIMIT = 256, 32767
_SIGMAS = np.array([2.0 ** ((k - SIGMA_ZERO) / SIGMA_STEPS) for k in range(256)], np.float32)
_COSINES = np.array([math.cos(math.pi * k / _HALF_TURN) for k in range(256)], np.float32)
_SINES = np.array([math.sin(math.pi * k / _HALF_TURN) for k in range(256)], np.float32)
_TABLES = np.stack([_SIGMAS, _COSINES, _SINES]).astype(np.float64)

CODE_FIELDS = [
    ("mean", "<i2", (3,)),
    ("normal", "<i2", (2,)),
    ("roll", "u1"),
    ("log_sigma", "u1", (3,)),
]
"""Fields of a code in a row of a message; `normal` in 1/32767, `roll` in 180/256 degrees."""

CODE = np.dtype(CODE_FIELDS)


def encode_gaussians(offsets: FloatArray, covariances: FloatArray) -> NDArray[np.uint64]:
    """Codes of surface points.

    Args:
        offsets: means relative to the centers of their voxels, shape (K, 3) [voxels].
        covariances: shape (K, 3, 3) [voxels^2].

    Returns:
        Shape (K, 2), the 14 bytes of `CODE` and two zeros as two words.

    Raises:
        InvalidInputError: a mean is not finite or 1 voxel away or more, or a covariance is not
            positive definite.
    """
    codes = np.zeros((len(offsets), 2), np.uint64)
    if not len(offsets):
        return codes
    if not (np.isfinite(offsets).all() and np.abs(offsets).max() < 1.0 - 1.0 / MEAN_STEPS):
        raise InvalidInputError("map update", "a mean is not finite or far from its voxel")
    if not np.isfinite(covariances).all():
        raise InvalidInputError("map update", "a covariance is not finite")
    variances, normals = smallest_axes(covariances)
    if not (variances > 0.0).all():
        raise InvalidInputError("map update", "a covariance is not positive definite")
    fields = np.zeros((len(offsets), 9), np.int64)
    _encode(offsets, covariances, normals, variances, _TABLES, fields)
    return _words_of(fields)


def _words_of(fields: NDArray[np.int64]) -> NDArray[np.uint64]:
    rows = np.zeros(len(fields), CODE)
    rows["mean"], rows["normal"] = fields[:, :3], fields[:, 3:5]
    rows["roll"], rows["log_sigma"] = fields[:, 5], fields[:, 6:]
    return words_of_codes(rows)


def words_of_codes(rows: NDArray[np.void]) -> NDArray[np.uint64]:
    """Rows of dtype `CODE`, shape (K,), as words, shape (K, 2)."""
    padded = np.zeros((len(rows), 16), np.uint8)
    padded[:, : CODE.itemsize] = np.ascontiguousarray(rows).view(np.uint8).reshape(len(rows), -1)
    return padded.view("<u8").astype(np.uint64, copy=False)


def codes_of_words(words: NDArray[np.uint64]) -> NDArray[np.void]:
    """Inverse of `words_of_codes`."""
    padded = np.ascontiguousarray(words.astype("<u8", copy=False)).view(np.uint8)
    kept = np.ascontiguousarray(padded.reshape(len(words), 16)[:, : CODE.itemsize])
    return kept.reshape(-1).view(CODE)


def decode_gaussians(words: NDArray[np.uint64]) -> tuple[FloatArray, FloatArray]:
    """Offsets, shape (K, 3) [voxels], and covariances, (K, 3, 3) [voxels^2]; NaN without code."""
    offsets, covariances = np.full((len(words), 3), np.nan), np.full((len(words), 3, 3), np.nan)
    _decode_all(words, _TABLES, offsets, covariances)
    return offsets, covariances


def information_of_codes(words: NDArray[np.uint64], size: float) -> NDArray[np.float64]:
    """Information of coded surface points, as a map stores it but in double precision.

    Args:
        words: shape (K, 2).
        size: edge of a voxel [m].

    Returns:
        Matrix (xx, xy, xz, yy, yz, zz) [1/m^2] and vector [1/m] relative to the voxel's center,
        0 without code, shape (K, 9).
    """
    information = np.zeros((len(words), 9))
    _inform_all(words, size, _TABLES, information)
    return information


def code_tables() -> NDArray[np.float64]:
    """The tables that `information_of_code` needs, shape (3, 256)."""
    return _TABLES


@kernel
def _sign(value: float) -> float:
    return 1.0 if value >= 0.0 else -1.0


@kernel
def _signed(word: Any, shift: int) -> Any:
    """16 bits of a word as a signed number."""
    bits = np.int64((word >> np.uint64(shift)) & np.uint64(0xFFFF))
    return (bits ^ 0x8000) - 0x8000


@kernel
def _byte(word: Any, shift: int) -> Any:
    return np.int64((word >> np.uint64(shift)) & np.uint64(0xFF))


@kernel
def _axes(u: float, v: float, axes: Any) -> None:
    """Normal of octahedron coordinates in [-1, 1], and two axes across it, as rows (3, 3)."""
    z = 1.0 - abs(u) - abs(v)
    x, y = u, v
    if z < 0.0:
        x, y = (1.0 - abs(v)) * _sign(u), (1.0 - abs(u)) * _sign(v)
    length = math.sqrt(x * x + y * y + z * z)
    x, y, z = x / length, y / length, z / length
    axes[0, 0], axes[0, 1], axes[0, 2] = x, y, z
    if abs(x) <= abs(y) and abs(x) <= abs(z):
        a, b, c = 0.0, -z, y
    elif abs(y) <= abs(z):
        a, b, c = z, 0.0, -x
    else:
        a, b, c = -y, x, 0.0
    length = math.sqrt(a * a + b * b + c * c)
    a, b, c = a / length, b / length, c / length
    axes[1, 0], axes[1, 1], axes[1, 2] = a, b, c
    axes[2, 0], axes[2, 1], axes[2, 2] = y * c - z * b, z * a - x * c, x * b - y * a


@kernel
def _roll(axes: Any, cosine: float, sine: float) -> None:
    """Turn the second and third row about the first."""
    for i in range(3):
        first, second = axes[1, i], axes[2, i]
        axes[1, i] = cosine * first + sine * second
        axes[2, i] = cosine * second - sine * first


@kernel
def _decode(word: Any, other: Any, tables: Any, offset: Any, axes: Any, sigmas: Any) -> None:
    """Offset (3,) and sigmas (3,) [voxels], and axes as rows (3, 3)."""
    for i in range(3):
        offset[i] = _signed(word, 16 * i) / MEAN_STEPS
        sigmas[i] = tables[0, _byte(other, 24 + 8 * i)]
    u, v = _signed(word, 48) / _NORMAL_LIMIT, _signed(other, 0) / _NORMAL_LIMIT
    _axes(min(max(u, -1.0), 1.0), min(max(v, -1.0), 1.0), axes)
    roll = _byte(other, 16)
    _roll(axes, tables[1, roll], tables[2, roll])


@kernel
def information_of_code(
    word: Any, other: Any, size: float, tables: Any, work: Any, out: Any
) -> None:
    """Add the information of one code, see `information_of_codes`, to `out`, shape (9,).

    Args:
        word: first word of the code.
        other: second word, not 0.
        size: edge of a voxel [m].
        tables: `code_tables()`.
        work: scratch, shape (5, 3).
        out: see above.
    """
    offset, sigmas, axes = work[0], work[1], work[2:]
    _decode(word, other, tables, offset, axes, sigmas)
    for k in range(3):
        sigma = sigmas[k] * size
        weight = 1.0 / (sigma * sigma)
        x, y, z = axes[k, 0], axes[k, 1], axes[k, 2]
        along = weight * ((x * offset[0] + y * offset[1]) + z * offset[2]) * size
        out[0] += weight * x * x
        out[1] += weight * x * y
        out[2] += weight * x * z
        out[3] += weight * y * y
        out[4] += weight * y * z
        out[5] += weight * z * z
        out[6] += along * x
        out[7] += along * y
        out[8] += along * z


@njit(cache=True, nogil=True)
def _inform_all(words: Any, size: float, tables: Any, information: Any) -> None:
    work = np.empty((5, 3))
    for row in range(len(words)):
        if words[row, 1]:
            information_of_code(words[row, 0], words[row, 1], size, tables, work, information[row])


@njit(cache=True, nogil=True)
def _decode_all(words: Any, tables: Any, offsets: Any, covariances: Any) -> None:
    axes, sigmas = np.empty((3, 3)), np.empty(3)
    for row in range(len(words)):
        if not words[row, 1]:
            continue
        _decode(words[row, 0], words[row, 1], tables, offsets[row], axes, sigmas)
        for i in range(3):
            for j in range(3):
                total = 0.0
                for k in range(3):
                    total += sigmas[k] * sigmas[k] * axes[k, i] * axes[k, j]
                covariances[row, i, j] = total


@kernel
def _variance(covariance: Any, axis: Any, other: Any) -> float:
    total = 0.0
    for i in range(3):
        for j in range(3):
            total += axis[i] * covariance[i, j] * other[j]
    return total


@njit(cache=True, nogil=True)
def _encode(
    offsets: Any, covariances: Any, normals: Any, variances: Any, tables: Any, fields: Any
) -> None:
    """Fill the numbers of `CODE`, shape (K, 9), from the covariances and their smallest axes."""
    axes, sigmas = np.empty((3, 3)), np.empty(3)
    for row in range(len(offsets)):
        x, y, z = normals[row]
        total = abs(x) + abs(y) + abs(z)
        u, v = x / total, y / total
        if z < 0.0:
            u, v = (1.0 - abs(v)) * _sign(u), (1.0 - abs(u)) * _sign(v)
        out = fields[row]
        out[3], out[4] = round(u * _NORMAL_LIMIT), round(v * _NORMAL_LIMIT)
        _axes(out[3] / _NORMAL_LIMIT, out[4] / _NORMAL_LIMIT, axes)
        first = _variance(covariances[row], axes[1], axes[1])
        second = _variance(covariances[row], axes[2], axes[2])
        both = _variance(covariances[row], axes[1], axes[2])
        angle = 0.5 * math.atan2(2.0 * both, first - second)
        out[5] = np.int64(round(angle / math.pi * _HALF_TURN)) % _HALF_TURN
        _roll(axes, tables[1, out[5]], tables[2, out[5]])
        sigmas[0] = variances[row]
        sigmas[1] = _variance(covariances[row], axes[1], axes[1])
        sigmas[2] = _variance(covariances[row], axes[2], axes[2])
        for i in range(3):
            out[i] = round(offsets[row, i] * MEAN_STEPS)
            code = round(0.5 * math.log2(sigmas[i]) * SIGMA_STEPS) + SIGMA_ZERO
            out[6 + i] = min(max(code, 1), 255)


CODE_WORDS = 2
_MAX_LOAD = 0.85
_MAX_BLOCKS = 2**32 // BLOCK_VOXELS


class CodeTable(NamedTuple):
    """The arrays of the table, as the kernels take them.

    Attributes:
        table: hash table, row or -1, int32.
        owner: block slot * 512 + local voxel index of each row, uint32.
        codes: shape (n, 2), uint64.
        counts: used rows, int64, shape (1,).
    """

    table: NDArray[np.int32]
    owner: NDArray[np.uint32]
    codes: NDArray[np.uint64]
    counts: NDArray[np.int64]


def empty_codes() -> CodeTable:
    """A table without codes."""
    return CodeTable(
        np.full(512, -1, np.int32),
        np.empty(256, np.uint32),
        np.zeros((256, CODE_WORDS), np.uint64),
        np.zeros(1, np.int64),
    )


def with_code_room(arrays: CodeTable, more: int, blocks: int) -> CodeTable:
    """Arrays with room for `more` voxels, for a map of so many blocks.

    Raises:
        CapacityError: the map has more blocks than an owner can number.
    """
    if blocks > _MAX_BLOCKS:
        raise CapacityError(f"the map would need {blocks} blocks, the limit is {_MAX_BLOCKS}")
    count = int(arrays.counts[0])
    return arrays._replace(
        owner=grown(arrays.owner, count + more, used=count),
        codes=grown(arrays.codes, count + more, used=count),
    )


def with_table_room(arrays: CodeTable) -> CodeTable:
    """Arrays whose table is at most 85 % full, and not much emptier than that."""
    count = int(arrays.counts[0])
    if count + 1 <= _MAX_LOAD * len(arrays.table):
        return arrays
    size = max(512, int(1.5 * count / _MAX_LOAD))
    table = np.full(size, -1, np.int32)
    _rehash(table, arrays.owner, count)
    return arrays._replace(table=table)


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
def find_row(table: Any, owner: Any, key: int) -> Any:
    """Row of a voxel's code, or -1; from the arrays of a `CodeTable`."""
    place = table_slot(key, len(table))
    while True:
        row = np.int64(table[place])
        if row < 0 or owner[row] == key:
            return row
        place += 1
        if place == len(table):
            place = 0


@kernel
def code_row(table: Any, owner: Any, counts: Any, key: int, codes: Any) -> Any:
    """Row of a voxel's code, made with zeros if need be.

    Args:
        table: of the `CodeTable`, likewise owner, counts and codes.
        owner: see table.
        counts: see table.
        key: the voxel, block slot * 512 + local index.
        codes: see table.

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
    for i in range(CODE_WORDS):
        codes[row, i] = 0
    return row
