"""The map's storage as named arrays, and back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import MapFileError
from infomap_ros.mapping.voxels.blocks import (
    BLOCK_COUNT,
    NARROW,
    NARROW_COUNT,
    NARROW_FREE,
    WIDE,
    WIDE_COUNT,
    BlockArrays,
)
from infomap_ros.mapping.voxels.gaussians import INFORMATION_SIZE
from infomap_ros.mapping.voxels.keys import BLOCK_VOXELS, rehash
from infomap_ros.mapping.voxels.storage import MapStorage
from infomap_ros.mapping.voxels.surface import SurfaceArrays, records_of, surface_of
from infomap_ros.mapping.voxels.surface_kernels import (
    COMMON,
    EXCESS,
    MEMORY,
    NOTHING,
    ROW_SIZE,
    SIDES,
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
