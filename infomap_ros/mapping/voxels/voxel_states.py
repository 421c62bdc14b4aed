"""Whole states of voxels: write them into a map.

A state is a voxel's evidence and the information of its surface point. Where a map is the sum of
several contributions, its voxels are not observed but set: to what the contributions add up to.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry.kernel import kernel
from infomap_ros.mapping.voxels.block_kernels import (
    find_or_add_block,
    make_room,
    mark_dirty,
    quanta_of,
    widen,
)
from infomap_ros.mapping.voxels.blocks import NARROW, NARROW_UNKNOWN, WIDE_UNKNOWN, with_room
from infomap_ros.mapping.voxels.gaussians import INFORMATION_SIZE, invert_symmetric
from infomap_ros.mapping.voxels.keys import BLOCK_BITS, BLOCK_VOXELS, local_index, pack
from infomap_ros.mapping.voxels.storage import Growth, MapStorage
from infomap_ros.mapping.voxels.surface import put_records
from infomap_ros.mapping.voxels.surface_kernels import EXCESS, ROW_SIZE, SIDES, read_record


class VoxelStates(NamedTuple):
    """States of voxels, a row each.

    Attributes:
        indices: voxel indices within the coordinate limit, shape (K, 3), int32.
        known: whether the voxel was ever observed, shape (K,), bool.
        quanta: evidence in units of LOG_ODDS_QUANTUM, 0 where unknown, shape (K,), int32.
        information: information matrix (xx, xy, xz, yy, yz, zz) [1/m^2] and vector [1/m] of the
            surface point relative to the voxel's center, 0 where there is none, shape (K, 9),
            float32.
    """

    indices: NDArray[np.int32]
    known: NDArray[np.bool_]
    quanta: NDArray[np.int32]
    information: NDArray[np.float32]

    def rows(self, chosen: NDArray[np.bool_]) -> VoxelStates:
        """The states that a mask, shape (K,), chooses."""
        indices, known, quanta, information = self
        return VoxelStates(indices[chosen], known[chosen], quanta[chosen], information[chosen])


def unknown_states(indices: NDArray[np.int32]) -> VoxelStates:
    """States of voxels, shape (K, 3), of which nothing is known."""
    count = len(indices)
    return VoxelStates(
        indices,
        np.zeros(count, np.bool_),
        np.zeros(count, np.int32),
        np.zeros((count, INFORMATION_SIZE), np.float32),
    )


def information_of(
    indices: NDArray[np.int32],
    has_gaussian: NDArray[np.bool_],
    means: NDArray[np.float64],
    covariances: NDArray[np.float64],
    size: float,
) -> NDArray[np.float32]:
    """Information of surface points as a map stores it, shape (K, 9).

    Args:
        indices: of the voxels, shape (K, 3).
        has_gaussian: where there is a surface point, shape (K,).
        means: of the points, shape (K, 3) [m].
        covariances: shape (K, 3, 3) [m^2].
        size: edge of a voxel [m].

    Raises:
        InvalidInputError: a Gaussian is not finite, or its covariance cannot be inverted.
    """
    information = np.zeros((len(indices), INFORMATION_SIZE), np.float32)
    bad = _invert_all(indices, has_gaussian, means, covariances, size, information)
    if bad >= 0:
        raise InvalidInputError(
            "covariance", f"of voxel {tuple(indices[bad].tolist())} cannot be inverted"
        )
    return information


def put_states(storage: MapStorage, states: VoxelStates) -> NDArray[np.bool_]:
    """Replace the states of voxels by others; each voxel at most once.

    Evidence saturates as in every map (`infomap_ros.mapping.voxels.blocks`). With what scans see
    later, surface points that are put share no errors.

    Returns:
        Which of them are other than before, shape (K,).

    Raises:
        CapacityError: there are more than can be numbered; the map is as it was.
    """
    count = len(states.quanta)
    changed = np.zeros(count, np.bool_)
    rooms = int(count_block_changes(states.indices))
    storage.check_growth(Growth(rooms, rooms, min(rooms * SIDES, count), count))
    storage.blocks = with_room(storage.blocks, rooms, rooms)
    blocks, records = len(storage.blocks.keys), np.full((count, SIDES), -1, np.int64)
    stored = np.empty(ROW_SIZE, np.float32)
    _put_states(storage.blocks, storage.gaussians, *states, changed, records, stored)
    for side in range(SIDES):
        put = records[:, side] >= 0
        information = states.information[put] if side == 0 else _nothing(np.count_nonzero(put))
        storage.gaussians = put_records(storage.gaussians, blocks, records[put, side], information)
    return changed


def _nothing(count: Any) -> NDArray[np.float32]:
    return np.zeros((int(count), INFORMATION_SIZE), np.float32)


@kernel
def count_block_changes(indices: Any) -> int:
    """How often the block changes along voxels, shape (K, 3): at least the number of blocks."""
    changes, last = 0, np.int64(-1)
    for row in range(len(indices)):
        x, y, z = indices[row, 0], indices[row, 1], indices[row, 2]
        key = pack(x >> BLOCK_BITS, y >> BLOCK_BITS, z >> BLOCK_BITS)
        changes += key != last
        last = key
    return changes


@njit(cache=True, nogil=True)
def _invert_all(
    indices: Any, has_gaussian: Any, means: Any, covariances: Any, size: float, information: Any
) -> int:
    """Fill the information; returns the first row for which there is none, or -1."""
    upper, inverse, offset = np.empty(6), np.empty(6), np.empty(3)
    for row in range(len(indices)):
        if not has_gaussian[row]:
            continue
        c = covariances[row]
        upper[0], upper[1], upper[2] = c[0, 0], c[0, 1], c[0, 2]
        upper[3], upper[4], upper[5] = c[1, 1], c[1, 2], c[2, 2]
        if not invert_symmetric(upper, inverse):
            return row
        for i in range(3):
            offset[i] = means[row, i] - (indices[row, i] + 0.5) * size
        out = information[row]
        for i in range(6):
            out[i] = inverse[i]
        out[6] = inverse[0] * offset[0] + inverse[1] * offset[1] + inverse[2] * offset[2]
        out[7] = inverse[1] * offset[0] + inverse[3] * offset[1] + inverse[4] * offset[2]
        out[8] = inverse[2] * offset[0] + inverse[4] * offset[1] + inverse[5] * offset[2]
        if not (out[0] > 0.0 and np.isfinite(np.sum(out))):
            return row
    return -1


@kernel
def _put_states(
    blocks: Any,
    gaussians: Any,
    indices: Any,
    known: Any,
    quanta: Any,
    information: Any,
    changed: Any,
    records: Any,
    stored: Any,
) -> None:
    """Put the evidence; list in `records` those whose information is other than before.

    `stored` is memory, shape (13,), float32.
    """
    kinds, bases, planes = blocks.kind, blocks.base, blocks.plane
    narrow, wide, tracked = blocks.narrow, blocks.wide, len(blocks.dirty) > 0
    last_key, slot = np.int64(-1), np.int64(-1)
    for row in range(len(quanta)):
        x, y, z = indices[row, 0], indices[row, 1], indices[row, 2]
        key = pack(x >> BLOCK_BITS, y >> BLOCK_BITS, z >> BLOCK_BITS)
        if key != last_key:
            slot, last_key = np.int64(find_or_add_block(blocks, key)), key
        local = local_index(x, y, z)
        was = quanta_of(kinds[slot], bases[slot], planes[slot], narrow, wide, local)
        if known[row] != was[0] or quanta[row] != was[1]:
            changed[row] = True
            _put_quanta(blocks, slot, local, known[row], quanta[row])
        for side in range(SIDES):  # the second is left empty
            record = (slot * SIDES + side) * BLOCK_VOXELS + local
            stored[:] = 0.0
            read_record(gaussians, record, stored)
            same = stored[EXCESS] == 0.0
            for i in range(INFORMATION_SIZE):
                same &= stored[i] == (information[row, i] if side == 0 else np.float32(0.0))
            if not same:
                changed[row], records[row, side] = True, record
        if tracked and changed[row]:
            mark_dirty(blocks, slot, local)


@kernel
def _put_quanta(blocks: Any, slot: int, local: int, known: bool, quanta: int) -> None:
    """Set the evidence of one voxel."""
    if blocks.kind[slot] < NARROW:
        make_room(blocks, slot, 0, 0)
    delta = np.int64(quanta) - blocks.base[slot]
    if blocks.kind[slot] == NARROW and known and abs(delta) > 127:
        widen(blocks, slot)
    if blocks.kind[slot] == NARROW:
        blocks.narrow[blocks.plane[slot], local] = delta if known else NARROW_UNKNOWN
    else:
        bounded = min(max(delta, -32767), 32767)
        blocks.wide[blocks.plane[slot], local] = bounded if known else WIDE_UNKNOWN
