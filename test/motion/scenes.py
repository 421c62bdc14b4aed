"""Scenes of blocked voxels around the rover, for tests."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.distance_field import DistanceField, field_of_blocked
from infomap_ros.mapping.voxels.state import VoxelStates, put_states

SIZE = 0.05
FIRST = np.array((-40, -40, -10))
SHAPE = (80, 80, 50)

Condition = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""Of x, y, z of voxel centers [m, map]."""


def blocked_where(condition: Condition) -> np.ndarray:
    """Voxels whose centers meet a condition."""
    x, y, z = ((np.indices(SHAPE).T + FIRST + 0.5) * SIZE).T
    return np.asarray(condition(x, y, z))


def field_where(condition: Condition) -> DistanceField:
    """Distance field of these voxels; all outside is free."""
    return field_of_blocked(blocked_where(condition), FIRST, SIZE, outside_is_free=True)


def map_where(
    occupied: Condition, known: Condition, half: float = 3.0, height: float = 2.0
) -> VoxelMap:
    """A map of certain voxels, occupied or else free, in a box around the origin.

    Args:
        occupied: which are.
        known: which were observed; the others are unknown.
        half: half the box's edge along x and y [m].
        height: of the box above z = -0.5 m [m].
    """
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=SIZE))
    shape = (*[round(2.0 * half / SIZE)] * 2, round(height / SIZE))
    corner = np.array((-shape[0] // 2, -shape[1] // 2, -10))
    indices = np.indices(shape).reshape(3, -1).T + corner
    x, y, z = ((indices + 0.5) * SIZE).T
    chosen = np.broadcast_to(known(x, y, z), x.shape)
    quanta = np.where(occupied(x, y, z), 20, -20)[chosen].astype(np.int32)
    states = VoxelStates(
        indices[chosen].astype(np.int32),
        np.ones(len(quanta), bool),
        quanta,
        np.zeros((len(quanta), 9), np.float32),
    )
    put_states(voxel_map._storage, states)
    return voxel_map
