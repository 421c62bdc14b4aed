"""Maps made voxel by voxel, for tests that need to know every one."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from infomap_ros.mapping import FREE, OCCUPIED, VoxelMap, VoxelMapConfig
from infomap_ros.mapping.voxels.block_kernels import add_quanta, find_or_add_block, make_room
from infomap_ros.mapping.voxels.keys import BLOCK_BITS, local_index, pack, unpack, with_room

EVIDENCE = 12  # quanta for occupied, against for free


def map_of(states: np.ndarray, first: tuple[int, int, int], size: float) -> VoxelMap:
    """A map whose voxels have these states, UNKNOWN, FREE or OCCUPIED; without Gaussians.

    Args:
        states: shape (nx, ny, nz).
        first: voxel index of ``states[0, 0, 0]``.
        size: of a voxel [m].
    """
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=size))
    storage = voxel_map._storage
    count = int(np.prod([n // 8 + 2 for n in states.shape]))
    storage.blocks = with_room(storage.blocks, count, count)
    quanta = np.zeros(states.shape, np.int64)
    quanta[states == FREE], quanta[states == OCCUPIED] = -EVIDENCE, EVIDENCE
    _fill(storage.blocks, np.array(first, dtype=np.int64), quanta)
    return voxel_map


def voxels_of(voxel_map: VoxelMap) -> dict[tuple[int, int, int], tuple[float, bytes]]:
    """Evidence, information and excess of every known voxel, to compare maps to the bit.

    Information of a voxel that is not known counts for nothing.
    """
    state = voxel_map.state()
    slots, locals_ = np.divmod(state["gaussian_owner"].astype(np.int64), 512)
    information = {}
    for key, local, row, excess in zip(
        state["block_keys"][slots].tolist(),
        locals_.tolist(),
        state["gaussian_information"],
        state["gaussian_excess"],
        strict=True,
    ):
        x, y, z = unpack(key)
        index = (8 * x + (local & 7), 8 * y + ((local >> 3) & 7), 8 * z + (local >> 6))
        information[index] = information.get(index, b"") + row.tobytes() + excess.tobytes()
    indices, evidence = voxel_map.voxels()
    places = [tuple(index) for index in indices.tolist()]
    return {
        place: (value, information.get(place, b""))
        for place, value in zip(places, evidence.tolist(), strict=True)
    }


@njit(cache=True)
def _fill(blocks: Any, first: Any, quanta: Any) -> None:
    for i in range(quanta.shape[0]):
        for j in range(quanta.shape[1]):
            for k in range(quanta.shape[2]):
                if quanta[i, j, k] != 0:
                    x, y, z = first[0] + i, first[1] + j, first[2] + k
                    key = pack(x >> BLOCK_BITS, y >> BLOCK_BITS, z >> BLOCK_BITS)
                    slot = find_or_add_block(blocks, key)
                    make_room(blocks, slot, 20, 20)
                    add_quanta(blocks, slot, local_index(x, y, z), quanta[i, j, k])
