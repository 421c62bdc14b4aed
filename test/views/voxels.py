"""Maps whose every voxel is given."""

from __future__ import annotations

import itertools

import numpy as np

from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.voxels.keys import (
    BLOCK_COUNT,
    NARROW,
    NARROW_COUNT,
    pack,
    rehash,
    with_room,
)
from infomap_ros.mapping.voxels.window import UNKNOWN_QUANTA

SIDE = 8


def map_of(quanta: np.ndarray, first: tuple[int, int, int], config: VoxelMapConfig) -> VoxelMap:
    """Map with the given evidence [quanta] per voxel, `UNKNOWN_QUANTA` where never observed.

    Args:
        quanta: indexed [x, y, z], each at most 127 from 0; each side a multiple of 8.
        first: voxel index of ``quanta[0, 0, 0]``, multiples of 8.
        config: of the map.
    """
    m = VoxelMap(config)
    shape = [side // SIDE for side in quanta.shape]
    count = int(np.prod(shape))
    blocks = with_room(m._storage.blocks, count, count)
    for row, place in enumerate(itertools.product(*map(range, shape))):
        low = np.array(place) * SIDE
        part = quanta[tuple(slice(a, a + SIDE) for a in low)]
        blocks.keys[row] = pack(*(low + first) // SIDE)
        blocks.kind[row], blocks.base[row], blocks.plane[row] = NARROW, 0, row
        deltas = np.where(part == UNKNOWN_QUANTA, -128, part)
        blocks.narrow[row] = deltas.transpose(2, 1, 0).ravel()
    blocks.counts[BLOCK_COUNT] = blocks.counts[NARROW_COUNT] = count
    rehash(blocks.table, blocks.keys, count)
    m._storage.blocks = blocks
    return m
