"""Scenes of blocked voxels around the rover, for tests."""

from __future__ import annotations

import numpy as np

from infomap_ros.mapping.distance_field import DistanceField, field_of_blocked

SIZE = 0.05
FIRST = np.array((-40, -40, -10))
SHAPE = (80, 80, 50)


def blocked_where(condition: object) -> np.ndarray:
    """Voxels whose centres meet ``condition(x, y, z)`` [m, map]."""
    x, y, z = ((np.indices(SHAPE).T + FIRST + 0.5) * SIZE).T
    return np.asarray(condition(x, y, z))  # type: ignore[operator]


def field_where(condition: object) -> DistanceField:
    """Distance field of these voxels; all outside is free."""
    return field_of_blocked(blocked_where(condition), FIRST, SIZE, outside_is_free=True)
