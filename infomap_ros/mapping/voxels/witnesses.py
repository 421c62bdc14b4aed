"""How much evidence the scans from one place may bring.

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
from infomap_ros.mapping.voxels.blocks import grown

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
