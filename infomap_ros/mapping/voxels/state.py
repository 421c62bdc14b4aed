"""The map's storage as named arrays, and back.

Whole states of voxels: write them into a map.

A state is a voxel's evidence and the information of its surface point. Where a map is the sum of
several contributions, its voxels are not observed but set: to what the contributions add up to.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.errors import InvalidInputError, MapFileError
from infomap_ros.geometry.kernel import kernel
from infomap_ros.mapping.voxels.block_kernels import (
    find_or_add_block,
    make_room,
    mark_dirty,
    quanta_of,
    widen,
)
from infomap_ros.mapping.voxels.keys import (
    BLOCK_BITS,
    BLOCK_COUNT,
    BLOCK_VOXELS,
    NARROW,
    NARROW_COUNT,
    NARROW_FREE,
    NARROW_UNKNOWN,
    WIDE,
    WIDE_COUNT,
    WIDE_UNKNOWN,
    BlockArrays,
    local_index,
    pack,
    rehash,
    with_room,
)
from infomap_ros.mapping.voxels.storage import Growth, MapStorage
from infomap_ros.mapping.voxels.surface import SurfaceArrays, put_records, records_of, surface_of
from infomap_ros.mapping.voxels.surface_kernels import (
    COMMON,
    EXCESS,
    INFORMATION_SIZE,
    MEMORY,
    NOTHING,
    ROW_SIZE,
    SIDES,
    invert_symmetric,
    read_record,
)

_LAYOUT: dict[str, tuple[str, tuple[int, ...]]] = {
    "block_keys": ("int64", ()),
    "block_base": ("int32", ()),
    "block_kind": ("uint8", ()),
    "block_plane": ("int32", ()),
    "narrow": ("int8", (BLOCK_VOXELS,)),
    "wide": ("int16", (BLOCK_VOXELS,)),
    "free_rows": ("int32", ()),
    "gaussian_owner": ("uint32", ()),
    "gaussian_side": ("uint8", ()),
    "gaussian_information": ("float32", (INFORMATION_SIZE,)),
    "gaussian_excess": ("float32", ()),
    "gaussian_common": ("float32", ()),
    "offset": ("float64", (6,)),
}

MEMORY_ARRAY = "gaussian_memory"
"""What scans to come need to know of the drift of those before; two sessions share none."""


def storage_state(storage: MapStorage) -> dict[str, NDArray[Any]]:
    """Copies of the used parts of all arrays."""
    blocks, (records, rows) = storage.blocks, records_of(storage.gaussians)
    sheets, locals_ = np.divmod(records, BLOCK_VOXELS)
    count, narrow, wide = (int(blocks.counts[i]) for i in (BLOCK_COUNT, NARROW_COUNT, WIDE_COUNT))
    return {
        "block_keys": blocks.keys[:count].copy(),
        "block_base": blocks.base[:count].copy(),
        "block_kind": blocks.kind[:count].copy(),
        "block_plane": blocks.plane[:count].copy(),
        "narrow": blocks.narrow[:narrow].copy(),
        "wide": blocks.wide[:wide].copy(),
        "free_rows": blocks.free_rows[: int(blocks.counts[NARROW_FREE])].copy(),
        "gaussian_owner": (sheets // SIDES * BLOCK_VOXELS + locals_).astype(np.uint32),
        "gaussian_side": (sheets % SIDES).astype(np.uint8),
        "gaussian_information": rows[:, :INFORMATION_SIZE].copy(),
        "gaussian_excess": rows[:, EXCESS].copy(),
        "gaussian_common": rows[:, COMMON].copy(),
        MEMORY_ARRAY: rows[:, MEMORY:].copy(),
        "offset": storage.offset.copy(),
    }


def storage_from_state(state: Mapping[str, NDArray[Any]]) -> MapStorage:
    """Rebuild storage from `storage_state`; without `MEMORY_ARRAY` scans to come begin anew.

    Raises:
        MapFileError: an array is missing, has a wrong type or shape, or refers to what is not
            there.
    """
    arrays = {name: _checked(state, name) for name in _LAYOUT}
    _check_references(arrays)
    count = len(arrays["block_keys"])
    table = np.full(max(1024, 2 * count), -1, np.int32)
    rehash(table, arrays["block_keys"], count)
    counts = np.array(
        [count, len(arrays["narrow"]), len(arrays["wide"]), len(arrays["free_rows"])], np.int64
    )
    free_rows = np.zeros(max(1, len(arrays["narrow"])), np.int32)
    free_rows[: len(arrays["free_rows"])] = arrays["free_rows"]
    blocks = BlockArrays(
        table=table,
        keys=arrays["block_keys"],
        base=arrays["block_base"],
        kind=arrays["block_kind"],
        plane=arrays["block_plane"],
        narrow=arrays["narrow"],
        wide=arrays["wide"],
        free_rows=free_rows,
        dirty=np.zeros((0, 8), np.uint64),
        counts=counts,
    )
    surface = _gaussians(arrays, state.get(MEMORY_ARRAY))
    return MapStorage(blocks, surface, offset=arrays["offset"])


def _gaussians(arrays: Mapping[str, NDArray[Any]], memory: NDArray[Any] | None) -> SurfaceArrays:
    rows = np.tile(NOTHING, (len(arrays["gaussian_owner"]), 1))
    rows[:, :INFORMATION_SIZE] = arrays["gaussian_information"]
    rows[:, EXCESS] = arrays["gaussian_excess"]
    rows[:, COMMON] = arrays["gaussian_common"]
    if memory is not None:
        if np.shape(memory) != (len(rows), ROW_SIZE - MEMORY) or np.isnan(memory).any():
            raise MapFileError(f"map state: '{MEMORY_ARRAY}' is not valid")
        rows[:, MEMORY:] = memory
    slots, locals_ = np.divmod(arrays["gaussian_owner"].astype(np.int64), BLOCK_VOXELS)
    records = (SIDES * slots + arrays["gaussian_side"]) * BLOCK_VOXELS + locals_
    return surface_of(len(arrays["block_keys"]), records, rows)


def _checked(state: Mapping[str, NDArray[Any]], name: str) -> NDArray[Any]:
    dtype, row = _LAYOUT[name]
    if name not in state:
        raise MapFileError(f"map state lacks the array '{name}'")
    array = np.array(state[name])
    if array.dtype != np.dtype(dtype) or array.shape[1:] != row or array.ndim != 1 + len(row):
        raise MapFileError(
            f"map state: '{name}' has type {array.dtype} and shape {array.shape}, "
            f"expected {dtype} and rows of shape {row}"
        )
    return array


def _check_references(arrays: Mapping[str, NDArray[Any]]) -> None:
    count = len(arrays["block_keys"])
    for name in ("block_base", "block_kind", "block_plane"):
        if len(arrays[name]) != count:
            raise MapFileError(f"map state: '{name}' has {len(arrays[name])} rows, not {count}")
    kind, plane = arrays["block_kind"], arrays["block_plane"]
    for code, pool in ((NARROW, "narrow"), (WIDE, "wide")):
        used = plane[kind == code]
        if len(used) and not (used.min() >= 0 and used.max() < len(arrays[pool])):
            raise MapFileError(f"map state: 'block_plane' refers to a missing row of '{pool}'")
    if (kind > WIDE).any() or len(np.unique(arrays["block_keys"])) != count:
        raise MapFileError("map state: 'block_kind' or 'block_keys' is not valid")
    owners, sides = arrays["gaussian_owner"], arrays["gaussian_side"]
    if len(owners) != len(arrays["gaussian_information"]) or (
        len(owners) and int(owners.max()) >= count * BLOCK_VOXELS
    ):
        raise MapFileError("map state: a Gaussian belongs to no block")
    if len(sides) != len(owners) or (sides >= SIDES).any():
        raise MapFileError("map state: 'gaussian_side' is not valid")
    offset = arrays["offset"]
    if not np.isfinite(arrays["gaussian_information"]).all():
        raise MapFileError("map state: a Gaussian is not finite")
    for name in ("gaussian_excess", "gaussian_common"):
        column = arrays[name]
        if len(column) != len(owners) or not (np.isfinite(column).all() and (column >= 0.0).all()):
            raise MapFileError(f"map state: '{name}' is not valid")
    if offset.shape != (6, 6) or not np.isfinite(offset).all():
        raise MapFileError("map state: 'offset' is not valid")


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

    Evidence saturates as in every map (`infomap_ros.mapping.voxels.keys`). With what scans see
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
