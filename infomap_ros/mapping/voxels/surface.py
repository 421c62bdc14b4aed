"""One Gaussian per voxel in which a surface may lie, and what its scans share.

What is seen from one side of a thin wall must not be merged with what is seen from the other. A
block therefore has two sheets, number ``2 * slot + side``, and a voxel up to two records, number
``512 * sheet + local index``; `side_of` a normal tells which. How they become one estimate is told
in `surface_kernels`.

A record is a row of thirteen float32. Nine are the information of all scans, as if their errors
were independent (`infomap_ros.mapping.voxels.surface_kernels`). Four say how far they are not. The
error of a pose drifts: of two scans with clocks c and d it correlates by ``exp(-|c - d|)``
(`infomap_ros.geometry.pose_uncertainty`). What a plane leaves out of a voxel
(`infomap_ros.mapping.scans.observation`) belongs to the voxel: all scans have it, whatever their
clocks. The mean of a voxel weighs observation k by the information I_k = 1 / v_k along its normal.
Where s_k^2 of the variance v_k is drift and u_k^2 what the plane leaves out, the variance of that
mean is

    (1 + E / I) / I,    I = sum of I_k,
    E = sum over j != k of b_j b_k exp(-|c_j - c_k|) + a_j a_k,    b = s / v,    a = u / v.

A scan adds ``2 b m`` to E, m being the sum of the earlier b_j, each by now correlated by
``exp(-|c_j - c|)``: one number that is carried on from clock to clock; and ``2 a`` times the sum of
the earlier a_j. So the row holds E, the sum of the a_j, m, and the clock at which m was so. The
covariance that a map claims is that of the nine numbers times ``1 + E / I``.

A sheet with records has a page that names the row of each of its voxels.

How much evidence the scans from one place may bring.

A hundred images from one place are not a hundred witnesses: where the matcher errs, it errs in all
of them. So the scans of one visit, while the camera stays where it is, move the evidence of a voxel
by at most `LIMIT` hits, or as many misses. What changes in view meanwhile is still seen: the limit
is one of the sum, so a voxel that was seen through for long takes hits again.

The sum of each voxel is a number of three bits, and 64 voxels are counted at once: bit b of plane p
of a word is bit p of the sum of voxel b, plus `LIMIT`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from infomap_ros.geometry.kernel import kernel
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.voxels import surface_kernels as kernels
from infomap_ros.mapping.voxels.keys import BLOCK_VOXELS, grown
from infomap_ros.mapping.voxels.surface_kernels import PAGE_COUNT, ROW_COUNT, ROW_SIZE, SIDES

PAGE_BYTES, ROW_BYTES = 4 * BLOCK_VOXELS, 4 * ROW_SIZE
MAX_BLOCKS = 2**32 // BLOCK_VOXELS
"""So many blocks a map file can number the voxels of."""

MAX_ROWS = 2**31 - 1
_ACROSS = (0.262, 0.472, 0.841)


@kernel
def side_of(x: float, y: float, z: float) -> int:
    """Side, 0 or 1, from which a surface with normal (x, y, z), of any length, is seen.

    Opposite normals have different sides. The plane between them is far from those of the axes,
    so that noise seldom splits what is seen of one wall or floor.
    """
    return 1 if _ACROSS[0] * x + _ACROSS[1] * y + _ACROSS[2] * z < 0.0 else 0


class SurfaceArrays(NamedTuple):
    """The arrays of the Gaussians, as the kernels take them.

    Attributes:
        page: of each sheet, or -1, int32.
        places: of each page the rows of its voxels, or -1, int32, shape (n, 512).
        rows: the records, float32, shape (m, 13); see `surface_kernels`.
        counts: pages and rows in use, int64.
    """

    page: NDArray[np.int32]
    places: NDArray[np.int32]
    rows: NDArray[np.float32]
    counts: NDArray[np.int64]


def empty_surface() -> SurfaceArrays:
    """Arrays of a map without surface."""
    return SurfaceArrays(
        page=np.full(512, -1, np.int32),
        places=np.empty((64, BLOCK_VOXELS), np.int32),
        rows=np.empty((1024, ROW_SIZE), np.float32),
        counts=np.zeros(2, np.int64),
    )


def surface_bytes(surface: SurfaceArrays, blocks: int) -> int:
    """Memory in use by the Gaussians of a map of so many blocks [bytes]."""
    pages, rows = int(surface.counts[PAGE_COUNT]), int(surface.counts[ROW_COUNT])
    return 4 * SIDES * blocks + pages * PAGE_BYTES + rows * ROW_BYTES


def with_records(
    surface: SurfaceArrays, blocks: int, records: NDArray[np.int64]
) -> tuple[SurfaceArrays, NDArray[np.int64]]:
    """Make the records that are not there, without information.

    Args:
        surface: the arrays; new records are entered.
        blocks: number of block slots of the map, at most `MAX_BLOCKS`.
        records: 512 * sheet + local index, shape (n,).

    Returns:
        The arrays, larger ones where there was no room, and the row of each record.
    """
    before = int(surface.counts[PAGE_COUNT])
    surface = surface._replace(page=grown(surface.page, SIDES * blocks, -1))
    pages = before + count_new(surface, records >> 9, records & 511)[0]
    surface = surface._replace(  # all memory is had before anything is entered
        places=grown(surface.places, pages, used=before),
        rows=grown(
            surface.rows,
            int(surface.counts[ROW_COUNT]) + len(records),
            used=int(surface.counts[ROW_COUNT]),
        ),
    )
    surface.places[before:pages] = -1
    found = np.empty(len(records), np.int64)
    kernels.open_pages(surface, records)
    kernels.open_rows(surface, records, found)
    return surface, found


def put_records(
    surface: SurfaceArrays,
    blocks: int,
    records: NDArray[np.int64],
    rows: NDArray[np.float32],
) -> SurfaceArrays:
    """Replace records.

    Args:
        surface: the arrays; what they hold is changed.
        blocks: number of block slots of the map, at most `MAX_BLOCKS`.
        records: 512 * sheet + local index, shape (n,); each at most once.
        rows: shape (n, 13), or (n, 9) for information of which nothing is shared with scans.

    Returns:
        The arrays, larger ones where there was no room.
    """
    surface, places = with_records(surface, blocks, records)
    surface.rows[places] = kernels.NOTHING
    surface.rows[places, : rows.shape[1]] = rows
    return surface


def records_of(surface: SurfaceArrays) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """All records with information in the order of their numbers: numbers (n,), rows (n, 13)."""
    count = int(surface.counts[ROW_COUNT])
    records, rows = np.empty(count, np.int64), np.empty((count, ROW_SIZE), np.float32)
    found = int(kernels.list_records(surface, records, rows))
    return records[:found], rows[:found]


def surface_of(blocks: int, records: NDArray[np.int64], rows: NDArray[np.float32]) -> SurfaceArrays:
    """The inverse of `records_of`, for a map of so many blocks."""
    return put_records(empty_surface(), blocks, records, rows)


def count_new(
    surface: SurfaceArrays, sheets: NDArray[np.int64], locals_: NDArray[np.int64]
) -> tuple[int, int]:
    """How many pages and rows voxels would make.

    Args:
        surface: the arrays.
        sheets: number of the sheet of each, shape (n,); negative ones are new, each its own.
        locals_: indices of the voxels in their blocks, shape (n,).
    """
    known = (sheets >= 0) & (sheets < len(surface.page))
    pages = np.where(known, surface.page[np.where(known, sheets, 0)], -1)
    stored = (pages >= 0) & (surface.places[np.maximum(pages, 0), locals_] >= 0)
    return len(np.unique(sheets[pages < 0])), int(np.count_nonzero(~stored))


LIMIT = 3
"""Scans from one place that count.

The errors of neighboring pixels of a stereo pair correlate by 0.41, the default of
`StereoConfig.error_correlation`, and so do those of one pixel in images from the same place; n
observations whose errors correlate by c are worth n / (1 + (n - 1) c) independent ones, at most
1 / 0.41 = 2.4.
"""

STEP, TURN = 0.05, 0.05
"""A camera that moves or turns farther has left its place [m, rad]: by a voxel of the usual size,
and by as much at a distance of 1 m. Poses of a camera that rests scatter less."""

_ONE, _ALL = np.uint64(1), np.uint64(0xFFFFFFFFFFFFFFFF)
_PLANES, _WORDS = 3, 8


def _has_left(place: FloatArray, pose: FloatArray) -> bool:
    step = float(np.linalg.norm(pose[:3, 3] - place[:3, 3]))
    turn = float(Rotation.from_matrix(place[:3, :3].T @ pose[:3, :3]).magnitude())
    return step > STEP or turn > TURN


class WitnessArrays(NamedTuple):
    """The sums of the present visit, as the kernels take them.

    Attributes:
        rows: per block slot the row of its sums or -1, int32.
        sums: three planes of bits of each block, uint64, shape (n, 3, 8).
        slots: block slot of each row, int64.
        used: number of rows in use, shape (1,), int64.
    """

    rows: NDArray[np.int32]
    sums: NDArray[np.uint64]
    slots: NDArray[np.int64]
    used: NDArray[np.int64]


class Witnesses:
    """The sums of evidence of the present visit."""

    def __init__(self) -> None:
        self._place: FloatArray | None = None
        self._arrays = WitnessArrays(
            rows=np.full(0, -1, np.int32),
            sums=np.empty((0, _PLANES, _WORDS), np.uint64),
            slots=np.empty(0, np.int64),
            used=np.zeros(1, np.int64),
        )

    def at(self, T_map_sensor: FloatArray, slots: int, more: int) -> WitnessArrays:
        """The sums for the next scan.

        Args:
            T_map_sensor: its pose, shape (4, 4); where the sensor has left its place, sums begin
                anew.
            slots: number of block slots of the map.
            more: blocks that the scan touches at the most.
        """
        arrays = self._arrays
        if self._place is None or _has_left(self._place, T_map_sensor):
            self._place = np.array(T_map_sensor)
            _forget(arrays.rows, arrays.slots, arrays.used)
        used = int(arrays.used[0])
        self._arrays = WitnessArrays(
            rows=grown(arrays.rows, slots, -1),
            sums=grown(arrays.sums, used + more, used=used),
            slots=grown(arrays.slots, used + more, used=used),
            used=arrays.used,
        )
        return self._arrays


@kernel
def _forget(rows: Any, slots: Any, used: Any) -> None:
    """Empty all sums."""
    for row in range(used[0]):
        rows[slots[row]] = -1
    used[0] = 0


@kernel
def _row_of(witnesses: Any, slot: int) -> int:
    """Row of a block's sums, made if need be; every sum begins with `LIMIT`, binary 011."""
    if witnesses.rows[slot] < 0:
        row = witnesses.used[0]
        witnesses.rows[slot], witnesses.slots[row] = row, slot
        witnesses.used[0] = row + 1
        for word in range(_WORDS):
            witnesses.sums[row, 0, word] = witnesses.sums[row, 1, word] = _ALL
            witnesses.sums[row, 2, word] = 0
    return witnesses.rows[slot]


@kernel
def admit_hit(witnesses: Any, slot: int, local: int) -> bool:
    """Count a hit in a voxel; False where it is at the upper limit, binary 110."""
    sums, word = witnesses.sums[_row_of(witnesses, slot)], local >> 6
    bit = _ONE << np.uint64(local & 63)
    low, middle, high = sums[0, word], sums[1, word], sums[2, word]
    if high & middle & ~low & bit:
        return False
    carry = low & bit
    sums[0, word] = low ^ bit
    sums[1, word] = middle ^ carry
    sums[2, word] = high ^ (carry & middle)
    return True


@kernel
def admit_misses(witnesses: Any, slot: int, bits: Any) -> None:
    """Count misses of the voxels with a bit, and clear those at the lower limit, binary 000.

    Args:
        witnesses: a `WitnessArrays`.
        slot: of the block.
        bits: uint64, shape (8,).
    """
    sums = witnesses.sums[_row_of(witnesses, slot)]
    for word in range(_WORDS):
        low, middle, high = sums[0, word], sums[1, word], sums[2, word]
        admitted = bits[word] & (low | middle | high)
        bits[word] = admitted
        borrow = admitted & ~low
        sums[0, word] = low ^ admitted
        sums[1, word] = middle ^ borrow
        sums[2, word] = high ^ (borrow & ~middle)
