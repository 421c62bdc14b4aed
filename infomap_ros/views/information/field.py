"""The map as rays see it: one small code per voxel, and whole blocks where all voxels agree.

Rays of many views run through the same part of the map, so it is prepared once. A code says all
that matters to a view: how likely the voxel hides what is behind it, and, through a table by
distance, what it has to tell. Most blocks of a map are empty or unknown throughout, or were seen
through by the same scans; such a block is one entry of a dense directory, and a ray crosses it in
one step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import ConfigError, InvalidInputError
from infomap_ros.geometry import float_array
from infomap_ros.geometry.kernel import kernel
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import LOG_ODDS_QUANTUM, VoxelMap
from infomap_ros.mapping.prediction import predict_unknown
from infomap_ros.mapping.scans.workers import Workers
from infomap_ros.mapping.voxels.block_kernels import find_block
from infomap_ros.mapping.voxels.keys import (
    BLOCK_BITS,
    BLOCK_SIDE,
    BLOCK_VOXELS,
    NARROW,
    NARROW_UNKNOWN,
    UNIFORM,
    UNSEEN,
    WIDE_UNKNOWN,
    local_index,
    pack,
)
from infomap_ros.mapping.voxels.window import UNKNOWN_QUANTA

EMPTY, UNKNOWN, SOLID, UNCERTAIN = 0, 1, 2, 3
"""Codes of voxels; the first of the uncertain ones, which follow each other by evidence."""

_CODES = 256
_MOST_UNCERTAIN = 62  # so that uncertain and predicted codes fit
_LEAST_LEVELS, _LEVEL_SPAN = 4, 64.0


@dataclass(frozen=True)
class CodeBook:
    """Codes for a choice of what is certain: what the codes of voxels mean to a view.

    A code says how likely its voxel is occupied, whether it is known, and, where the precision of
    surfaces counts, how uncertain the surface in it is. Codes fit in a byte.

    After the codes of uncertain voxels come those of unknown voxels with a predicted probability,
    in the same order, and where `wanted_sigma` is positive those of surfaces that are less precise:
    by evidence (the last for a solid voxel), and for each by level of standard deviation.

    Attributes:
        certain_probability: known voxels less likely occupied are EMPTY, less likely empty SOLID.
        wanted_sigma: standard deviation of a surface along its normal that suffices [m]; 0 where
            the precision of surfaces does not count.

    Raises:
        ConfigError: the codes do not fit in a byte.
    """

    certain_probability: float
    wanted_sigma: float = 0.0

    def __post_init__(self) -> None:
        if self.wanted_sigma > 0.0 and self._levels() < _LEAST_LEVELS:
            raise ConfigError(
                "certain_probability", self.certain_probability, "at least 0.001 with wanted_sigma"
            )

    @property
    def limit(self) -> int:
        """Largest evidence, for or against, of a voxel that is not certain [quanta]."""
        certain = math.log(1.0 / self.certain_probability - 1.0) / LOG_ODDS_QUANTUM
        return min(math.ceil(certain - 1e-9) - 1, _MOST_UNCERTAIN)

    @property
    def predicted(self) -> int:
        """First code of unknown voxels with a predicted probability."""
        return UNCERTAIN + 2 * self.limit + 1

    @property
    def surface(self) -> int:
        """First code of surfaces that are not precise enough."""
        return self.predicted + 2 * self.limit + 1

    @property
    def sigma_levels(self) -> FloatArray:
        """Standard deviations that codes of surfaces tell apart, ascending, shape (S,) [m]."""
        if self.wanted_sigma == 0.0:
            return np.zeros(0)
        share = (np.arange(self._levels()) + 1.0) / self._levels()
        return np.asarray(self.wanted_sigma * _LEVEL_SPAN**share)

    def probabilities(self) -> FloatArray:
        """Probability of occupancy of each code, shape (n,)."""
        evidence = np.arange(-self.limit, self.limit + 1) * LOG_ODDS_QUANTUM
        uncertain = 1.0 / (1.0 + np.exp(-evidence))
        surfaces = np.repeat([*uncertain[self.limit + 1 :], 1.0], len(self.sigma_levels))
        return np.concatenate([[0.0, 0.5, 1.0], uncertain, uncertain, surfaces])

    def known(self) -> NDArray[np.bool_]:
        """Which codes are those of known voxels, shape (n,)."""
        codes = np.arange(len(self.probabilities()))
        return (codes != UNKNOWN) & ((codes < self.predicted) | (codes >= self.surface))

    def sigmas(self) -> FloatArray:
        """Standard deviation of each code's surface, shape (n,) [m]; 0 where it does not count."""
        levels = np.tile(self.sigma_levels, self.limit + 1)
        return np.concatenate([np.zeros(self.surface), levels])

    def _levels(self) -> int:
        return (_CODES - self.surface) // (self.limit + 1)


_TABLE_QUANTA = 64
_LARGEST = 1 << 27


@dataclass(frozen=True, eq=False)
class VisibleField:
    """Part of a map, prepared for rays.

    Attributes:
        directory: per block of 8 x 8 x 8 voxels the row in `codes`, or -1 - code where all voxels
            of the block have the same; int32, indexed [x, y, z]. Beyond it everything is unknown.
        first: block coordinates of ``directory[0, 0, 0]``, shape (3,).
        codes: per voxel, uint8, shape (rows, 512), in the order of `mapping.keys.local_index`.
        voxel_size: [m].
    """

    directory: NDArray[np.int32]
    first: NDArray[np.int64]
    codes: NDArray[np.uint8]
    voxel_size: float

    def relative(self, points: ArrayLike) -> FloatArray:
        """Points, shape (..., 3) [m, map], as the rays count them: [voxels] from `first`."""
        return np.asarray(np.asarray(points) / self.voxel_size - self.first * BLOCK_SIDE)


@cache
def workers_of(threads: int) -> Workers:
    """Threads that share the work; kept, because starting them costs more than many a view."""
    return Workers(threads)


def visible_field(
    m: VoxelMap, low: ArrayLike, high: ArrayLike, book: CodeBook, threads: int = 1
) -> VisibleField:
    """Prepare the part of a map that lies in a box.

    Args:
        m: the map.
        low: corner of the box, shape (3,), map frame [m].
        high: opposite corner.
        book: of codes.
        threads: that share the blocks.

    Raises:
        InvalidInputError: the box is none, or too large for a dense directory of blocks.
    """
    corners = np.stack([float_array(low, "low"), float_array(high, "high")])
    if corners.shape != (2, 3) or not np.isfinite(corners).all() or (corners[1] < corners[0]).any():
        raise InvalidInputError("field", f"{corners.tolist()} is not a box")
    size, bounds = m.config.voxel_size, m.bounds()
    if bounds is None:
        bounds = (np.zeros(3, np.int64), np.zeros(3, np.int64))
    first = np.maximum(np.floor(corners[0] / size).astype(np.int64), bounds[0]) // BLOCK_SIDE
    last = np.minimum(np.floor(corners[1] / size).astype(np.int64), bounds[1]) // BLOCK_SIDE
    shape = np.maximum(last - first + 1, 1)
    if float(np.prod(shape.astype(float))) > _LARGEST:
        raise InvalidInputError("field", f"of {shape.tolist()} blocks is too large")
    directory = np.full(tuple(shape), -1 - UNKNOWN, np.int32)
    blocks, table = m._storage.blocks, _evidence_codes(book)
    rows = _enter_blocks(blocks, first, table, directory)
    codes = np.empty((rows, BLOCK_VOXELS), np.uint8)

    def fill(_: int, start: int, end: int) -> None:
        corner = first + np.array([start, 0, 0])
        _fill_codes(blocks, corner, table, directory[start:end], codes)

    workers_of(threads).run(fill, len(directory))
    return VisibleField(directory, first, codes, size)


def with_rows(field: VisibleField, blocks: NDArray[np.int64]) -> VisibleField:
    """The field with a row of its own for each of some blocks, (K, 3), that had one code."""
    directory, at = field.directory.copy(), tuple(blocks.T)
    alike = np.unique(np.ravel_multi_index(at, directory.shape)[directory[at] < 0])
    own = (-1 - directory.flat[alike]).astype(np.uint8)
    codes = np.concatenate([field.codes, np.repeat(own[:, None], BLOCK_VOXELS, axis=1)])
    directory.flat[alike] = len(field.codes) + np.arange(len(alike))
    return replace(field, directory=directory, codes=codes)


def with_nothing_unknown_but(field: VisibleField, voxels: NDArray[np.int64]) -> VisibleField:
    """The field in which all that is unknown is empty, but for voxels, (K, 3), of the map."""
    directory = np.where(field.directory == -1 - UNKNOWN, -1 - EMPTY, field.directory)
    codes = np.where(field.codes == UNKNOWN, np.uint8(EMPTY), field.codes)
    places = voxels - field.first * BLOCK_SIDE
    blocks = places >> BLOCK_BITS
    inside = ((blocks >= 0) & (blocks < directory.shape)).all(axis=1)
    places, blocks = places[inside], blocks[inside]
    field = with_rows(replace(field, directory=directory, codes=codes), blocks)
    locals_ = np.ravel_multi_index(tuple((places % BLOCK_SIDE).T[::-1]), (BLOCK_SIDE,) * 3)
    field.codes[field.directory[tuple(blocks.T)], locals_] = UNKNOWN
    return field


def _evidence_codes(book: CodeBook) -> NDArray[np.uint8]:
    """Code of known voxels by evidence, from -_TABLE_QUANTA to _TABLE_QUANTA."""
    quanta = np.arange(-_TABLE_QUANTA, _TABLE_QUANTA + 1)
    codes = UNCERTAIN + book.limit + quanta
    codes[quanta < -book.limit], codes[quanta > book.limit] = EMPTY, SOLID
    return codes.astype(np.uint8)


@kernel
def _code(table: Any, quanta: int) -> Any:
    return table[min(max(quanta, -_TABLE_QUANTA), _TABLE_QUANTA) + _TABLE_QUANTA]


@kernel
def _enter_blocks(blocks: Any, first: Any, table: Any, directory: Any) -> int:
    """Enter what is known of each block: its one code, or its row; returns the number of rows."""
    nx, ny, nz = directory.shape
    kinds, bases, rows = blocks.kind, blocks.base, 0
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                slot = find_block(blocks, pack(first[0] + i, first[1] + j, first[2] + k))
                if slot < 0 or kinds[slot] == UNSEEN:
                    continue
                if kinds[slot] == UNIFORM:
                    directory[i, j, k] = -1 - np.int32(_code(table, np.int64(bases[slot])))
                else:
                    directory[i, j, k] = rows
                    rows += 1
    return rows


@kernel
def _fill_codes(blocks: Any, first: Any, table: Any, directory: Any, codes: Any) -> None:
    """Fill the rows; blocks all of whose voxels turn out alike lose theirs again."""
    nx, ny, nz = directory.shape
    kinds, bases, planes = blocks.kind, blocks.base, blocks.plane
    narrow, wide = blocks.narrow, blocks.wide
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                row = directory[i, j, k]
                if row < 0:
                    continue
                slot = find_block(blocks, pack(first[0] + i, first[1] + j, first[2] + k))
                base, plane = np.int64(bases[slot]), planes[slot]
                if kinds[slot] == NARROW:
                    alike = _fill_row(narrow[plane], NARROW_UNKNOWN, base, table, codes[row])
                else:
                    alike = _fill_row(wide[plane], WIDE_UNKNOWN, base, table, codes[row])
                if alike:
                    directory[i, j, k] = -1 - np.int32(codes[row, 0])


@kernel
def _fill_row(deltas: Any, unknown: int, base: int, table: Any, row: Any) -> bool:
    """Codes of one block; returns whether all are the same."""
    low, high = np.uint8(255), np.uint8(0)
    for local in range(BLOCK_VOXELS):
        delta = np.int64(deltas[local])
        code = np.uint8(UNKNOWN) if delta == unknown else _code(table, base + delta)
        row[local] = code
        low, high = min(low, code), max(high, code)
    return low == high


@kernel
def code_at(directory: Any, codes: Any, x: int, y: int, z: int) -> Any:
    """Code of a voxel, by its index relative to the directory."""
    nx, ny, nz = directory.shape
    i, j, k = x >> BLOCK_BITS, y >> BLOCK_BITS, z >> BLOCK_BITS
    if not (0 <= i < nx and 0 <= j < ny and 0 <= k < nz):
        return np.int64(UNKNOWN)
    entry = np.int64(directory[i, j, k])
    if entry < 0:
        return -1 - entry
    return np.int64(codes[entry, local_index(x, y, z)])


_LEAST_PROBABILITY = 1e-7


def with_predictions(
    field: VisibleField,
    m: VoxelMap,
    book: CodeBook,
) -> VisibleField:
    """The field with unknown voxels near known ones as `predict_unknown` predicts them.

    No more certain than the least certain EMPTY or SOLID voxel: nobody has looked there.

    Args:
        field: of the map.
        m: the map.
        book: that the field was made with.
    """
    size = field.voxel_size
    low = (field.first * BLOCK_SIDE + 0.5) * size
    high = low + (np.array(field.directory.shape) * BLOCK_SIDE - 1) * size
    window = m.window(low, high)
    p = np.clip(predict_unknown(window), _LEAST_PROBABILITY, 1.0 - _LEAST_PROBABILITY)
    limit = book.limit
    levels = np.rint(np.log(p / (1.0 - p)) / LOG_ODDS_QUANTUM).clip(-limit, limit).astype(np.int16)
    levels[window.quanta != UNKNOWN_QUANTA] = 0
    blank = field.directory == -1 - UNKNOWN
    used = np.logical_or.reduceat(levels != 0, np.arange(0, levels.shape[0], BLOCK_SIDE), axis=0)
    for axis in (1, 2):
        used = np.logical_or.reduceat(used, np.arange(0, levels.shape[axis], BLOCK_SIDE), axis=axis)
    field = with_rows(field, np.argwhere(blank & used))
    _enter(field.directory, window.quanta, levels, book.predicted + limit, field.codes)
    return field


@njit(cache=True, nogil=True)
def _enter(
    directory: NDArray[Any], quanta: Any, levels: Any, even: int, codes: NDArray[Any]
) -> None:
    """Write the codes of the unknown voxels; `even` is the code of level 0."""
    nx, ny, nz = levels.shape
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                if quanta[i, j, k] == UNKNOWN_QUANTA and levels[i, j, k] != 0:
                    row = directory[i // BLOCK_SIDE, j // BLOCK_SIDE, k // BLOCK_SIDE]
                    codes[row, local_index(i, j, k)] = even + levels[i, j, k]
