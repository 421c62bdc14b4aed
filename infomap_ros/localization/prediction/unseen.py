"""Fiducials where nothing is known yet: a camera that looks there will find some.

What it will find is taken to be like what it knows: the known fiducials about a place, turned about
the vertical, stand for those in directions that nobody has looked at. Where the map knows that
there is nothing, or what there is, none are assumed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap

_TURNS = 6  # of the known fiducials about the vertical


def unseen_points(
    place: FloatArray, known: FloatArray, voxel_map: VoxelMap, reach: float, count: int
) -> FloatArray:
    """Points that stand for the fiducials of unknown space about a place.

    Args:
        place: shape (3,) [m, map].
        known: positions of the known fiducials, shape (N, 3) [m, map].
        voxel_map: whose unknown voxels count.
        reach: fiducials farther away tell nothing of this place [m].
        count: at most so many.

    Returns:
        Shape (P, 3) [m, map].
    """
    around = known - place
    around = around[np.linalg.norm(around, axis=1) < reach]
    if not len(around) or not count:
        return np.zeros((0, 3))
    rng = np.random.default_rng(0)  # any will do; the same map gives the same ones
    some = around[rng.choice(len(around), min(len(around), max(count // _TURNS, 1)), replace=False)]
    angles = 2.0 * np.pi * (np.arange(_TURNS)[:, None] + rng.random(len(some))) / _TURNS
    turned = Rotation.from_rotvec(np.outer(angles.ravel(), [0.0, 0.0, 1.0]))
    points = place + turned.apply(np.tile(some, (_TURNS, 1)))
    is_unknown: NDArray[np.bool_] = ~voxel_map.is_known(points)
    return np.asarray(points[is_unknown])
