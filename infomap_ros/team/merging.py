"""One map of the maps of several sessions or robots, from their files.

What robots publish is clipped and coded for the network (`infomap_ros.team.replica`). Map files
hold all of the evidence, and it adds as if one map had gone on from file to file: occupancy is the
same to the bit, a Gaussian is the sum of the information, and what a plane leaves out of a voxel
is shared by all sessions (`infomap_ros.mapping.voxels.surface`). The sums run in an order that
depends on what the maps hold, so that the result does not depend on that of the files.

An error that a map shares as a whole is its own: where the maps do not have the same one, each
surface point counts with the covariance that has it, as a contribution does.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry.pose_uncertainty import point_covariances
from infomap_ros.geometry.transforms import FloatArray, carry_covariance
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.voxels.block_kernels import (
    add_quanta,
    add_quanta_to_all,
    find_or_add_block,
    make_room,
    quanta_at,
)
from infomap_ros.mapping.voxels.changes import put_offset
from infomap_ros.mapping.voxels.keys import (
    BLOCK_COUNT,
    BLOCK_SIDE,
    BLOCK_VOXELS,
    NARROW_COUNT,
    UNIFORM,
    UNSEEN,
    WIDE_COUNT,
    unpack,
    with_room,
)
from infomap_ros.mapping.voxels.state import MEMORY_ARRAY, information_of
from infomap_ros.mapping.voxels.storage import Growth, MapStorage
from infomap_ros.mapping.voxels.surface import records_of, with_records
from infomap_ros.mapping.voxels.surface_kernels import (
    COMMON,
    EXCESS,
    INFORMATION_SIZE,
    SIDES,
    gaussian_of,
    inflation,
)
from infomap_ros.team.agreement import Agreement, compare_maps
from infomap_ros.team.registration import Registration, register_maps
from infomap_ros.team.replica import moved_map

_PER_BLOCK = SIDES * BLOCK_VOXELS  # records


class NamedMap(NamedTuple):
    """A map with the name that errors call it by, such as that of its file."""

    name: str
    map: VoxelMap


def merge_maps(
    maps: Sequence[NamedMap], has_common_frame: bool = False
) -> tuple[VoxelMap, Agreement]:
    """Join maps that are in one frame; they stay as they are.

    Args:
        maps: at least one. The configuration is that of the first.
        has_common_frame: the maps are in one frame although they name other origins, as those of
            robots that were aligned with each other.

    Returns:
        The map, and how those that were joined fit each other, over all pairs.

    Raises:
        InvalidInputError: there is none, voxels differ in size, origins differ, two maps hold the
            same session, or contradict each other; names the maps.
        CapacityError: the map could exceed ``memory_limit`` of the first.
    """
    if not maps:
        raise InvalidInputError("maps", "there is none")
    agreement = Agreement(0, 0)
    for first, second in combinations(maps, 2):
        check_pair(first, second, has_common_frame)
        found = _compared(first, second)
        compared = agreement.compared + found.compared
        agreement = Agreement(compared, agreement.contradicted + found.contradicted)
    return sum_of_maps([one.map for one in maps]), agreement


def aligned_maps(maps: Sequence[NamedMap]) -> list[tuple[NamedMap, Registration]]:
    """Maps that have no frame in common, each moved into that of the first.

    A map is found in the sum of those found before it, and shares the error of its place as a
    whole.

    Args:
        maps: at least one, in any order in which each has something in common with those before.

    Returns:
        All but the first.

    Raises:
        InvalidInputError: one is not found, or in several places, or its voxels or sessions do not
            fit; names it.
        MissingExtraError: what registers them is not installed.
    """
    for first, second in combinations(maps, 2):
        check_pair(first, second, has_common_frame=True)
    found: list[tuple[NamedMap, Registration]] = []
    whole = maps[0].map
    for name, voxel_map in maps[1:]:
        if found:
            whole = sum_of_maps([whole, found[-1][0].map])
        try:
            place = register_maps(whole, voxel_map)
        except InvalidInputError as error:
            raise InvalidInputError(name, f"and those before it {error.problem}") from error
        moved = moved_map(voxel_map, place.T_first_second)
        shared = moved.offset + carry_covariance(place.covariance, -place.T_first_second[:3, 3])
        put_offset(moved._storage, shared)
        moved.origin, moved.sessions = whole.origin, tuple(sorted(sessions_of(voxel_map)))
        found.append((NamedMap(name, moved), place))
    return found


def check_pair(
    first: NamedMap,
    second: NamedMap,
    has_common_frame: bool = False,
    may_share_sessions: bool = False,
) -> None:
    """Refuse maps that cannot be joined, or compared.

    Raises:
        InvalidInputError: voxels differ in size, or origins do, or both hold a session; names them.
    """
    names = f"{first.name} and {second.name}"
    sizes = [one.map.config.voxel_size for one in (first, second)]
    if sizes[0] != sizes[1]:
        raise InvalidInputError(names, f"have voxels of {sizes[0]:g} m and {sizes[1]:g} m")
    if not may_share_sessions and sessions_of(first.map) & sessions_of(second.map):
        raise InvalidInputError(names, "hold the same session, which would count twice")
    origins = first.map.origin, second.map.origin
    if 0 not in origins and origins[0] != origins[1] and not has_common_frame:
        raise InvalidInputError(
            names, f"are in frames with other origins, {origins[0]:08x} and {origins[1]:08x}"
        )


def _compared(first: NamedMap, second: NamedMap) -> Agreement:
    found = compare_maps(first.map, second.map)
    if found.is_contradiction:
        raise InvalidInputError(
            f"{first.name} and {second.name}",
            f"contradict each other in {found.contradicted} of {found.compared} surface voxels: "
            "they are not in one frame, or the scene has changed",
        )
    return found


def sessions_of(voxel_map: VoxelMap) -> set[int]:
    """Of a map that knows none, as older files, all that it holds is one."""
    sessions = set(voxel_map.sessions)
    if not sessions and voxel_map.known_voxels:
        sessions = {int.from_bytes(_digest(voxel_map)[:8], "little")}
    return sessions


def _digest(voxel_map: VoxelMap) -> bytes:
    """Hash of all that a map file holds of a map."""
    digest = hashlib.blake2b()
    for name, array in sorted(voxel_map.state().items()):
        digest.update(b"" if name == MEMORY_ARRAY else np.ascontiguousarray(array).tobytes())
    return digest.digest()


def sum_of_maps(maps: Sequence[VoxelMap]) -> VoxelMap:
    """Join maps that are known to be in one frame, and to have no scan in common.

    Raises:
        CapacityError: the map could exceed ``memory_limit`` of the first.
    """
    merged = VoxelMap(maps[0].config)
    is_shared = share_offset(maps)
    for part in sorted(maps, key=_digest):
        _add(merged, part, np.zeros((6, 6)) if is_shared else part.offset)
    if is_shared:
        put_offset(merged._storage, maps[0].offset)
    origins = {one.origin for one in maps} - {0}
    merged.origin = origins.pop() if len(origins) == 1 else 0
    merged.sessions = tuple(sorted(set().union(*map(sessions_of, maps))))
    return merged


def share_offset(maps: Sequence[VoxelMap]) -> bool:
    """Whether the error that each map shares as a whole is the same error, or none."""
    offsets = {one.offset.tobytes() for one in maps}
    origins = {one.origin for one in maps}
    is_one = len(origins) == 1 and origins != {0}
    return len(offsets) == 1 and (is_one or len(maps) == 1 or not maps[0].offset.any())


def _add(merged: VoxelMap, part: VoxelMap, offset: FloatArray) -> None:
    """Add a map to the sum, its points with an error of its own of covariance `offset`."""
    storage, other = merged._storage, part._storage
    records, rows = records_of(other.gaussians)
    blocks = int(other.blocks.counts[BLOCK_COUNT])
    planes = int(other.blocks.counts[NARROW_COUNT] + other.blocks.counts[WIDE_COUNT])
    pages = len(np.unique(records // BLOCK_VOXELS))
    growth = Growth(blocks, planes, pages, len(records))
    storage.check_growth(growth, merged.config.memory_limit * 1e9)
    if offset.any():
        _give_offset(other, records, rows, offset, part.config.voxel_size)
    storage.blocks = with_room(storage.blocks, blocks, blocks)
    slots = np.empty(blocks, np.int64)
    _add_blocks(storage.blocks, other.blocks, slots)
    _add_rows(storage, slots[records // _PER_BLOCK] * _PER_BLOCK + records % _PER_BLOCK, rows)


def _add_rows(storage: MapStorage, records: NDArray[np.int64], rows: NDArray[np.float32]) -> None:
    """Add records, each of them once."""
    blocks = len(storage.blocks.keys)
    storage.gaussians, places = with_records(storage.gaussians, blocks, records)
    total = storage.gaussians.rows
    total[places, EXCESS] += rows[:, EXCESS] + 2.0 * rows[:, COMMON] * total[places, COMMON]
    total[places, COMMON] += rows[:, COMMON]
    total[places, :INFORMATION_SIZE] += rows[:, :INFORMATION_SIZE]


def _give_offset(
    storage: MapStorage,
    records: NDArray[np.int64],
    rows: NDArray[np.float32],
    offset: FloatArray,
    size: float,
) -> None:
    """Put all that a map shares into the information of its points, which then share nothing."""
    indices = np.empty((len(rows), 3), np.int32)
    means, covariances = np.empty((len(rows), 3)), np.empty((len(rows), 3, 3))
    _describe(storage.blocks.keys, records, rows, size, indices, means, covariances)
    is_point = covariances[:, 0, 0] > 0.0
    covariances[is_point] += point_covariances(offset, means[is_point])
    information = information_of(indices, is_point, means, covariances, size)
    rows[:, :INFORMATION_SIZE] = information
    rows[:, [EXCESS, COMMON]] = 0.0


@njit(cache=True, nogil=True)
def _describe(
    keys: Any, records: Any, rows: Any, size: float, indices: Any, means: Any, covariances: Any
) -> None:
    """Voxels, means [m] and covariances of records; zero covariance where there is no point."""
    for i in range(len(records)):
        local = records[i] & (BLOCK_VOXELS - 1)
        place = local & 7, (local >> 3) & 7, local >> 6
        block = unpack(keys[records[i] // _PER_BLOCK])
        covariance, mean = gaussian_of(rows[i])
        scale = inflation(rows[i])
        for axis in range(3):
            indices[i, axis] = block[axis] * BLOCK_SIDE + place[axis]
            means[i, axis] = (indices[i, axis] + 0.5) * size + mean[axis]
        xx, xy, xz, yy, yz, zz = covariance
        for row, values in enumerate(((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))):
            for column in range(3):
                covariances[i, row, column] = scale * values[column]


@njit(cache=True, nogil=True)
def _add_blocks(blocks: Any, other: Any, slots: Any) -> None:
    """Add the evidence of all blocks; `slots` receives where they are in the sum."""
    for i in range(len(slots)):
        slot = np.int64(find_or_add_block(blocks, other.keys[i]))
        slots[i] = slot
        if other.kind[i] == UNIFORM:
            add_quanta_to_all(blocks, slot, other.base[i])
        elif other.kind[i] != UNSEEN:
            low, high = 0, 0
            for local in range(BLOCK_VOXELS):
                quanta = quanta_at(other, i, local)[1]
                low, high = min(low, quanta), max(high, quanta)
            make_room(blocks, slot, -low, high)
            for local in range(BLOCK_VOXELS):
                known, quanta = quanta_at(other, i, local)
                if known:
                    add_quanta(blocks, slot, local, quanta)
