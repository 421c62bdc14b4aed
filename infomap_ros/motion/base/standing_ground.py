"""Ground that is known because the robot stands, or has stood, on it.

A robot never sees what is under it. Without this it could not leave its first place, as unknown
ground is not driven on.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import check_transform, float_array
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.terrain.measures import largest_steps
from infomap_ros.mapping.terrain.terrain import Terrain
from infomap_ros.motion.base.vehicle import Vehicle

_FLATTEST = 0.2  # cosine of the steepest plane that is taken for ground


def with_standing_ground(
    terrain: Terrain, vehicle: Vehicle, T_map_bases: ArrayLike, reach: float = 0.2
) -> Terrain:
    """Declare the ground under poses in which the robot stands or has stood as known.

    Cells under the body and between the wheels get the plane of the wheels, and so do those around
    that have no ground, unless something stands there that is higher than a step. Other cells with
    ground keep theirs. What is occupied in that plane and was not seen well enough to be ground, as
    a floor at a grazing angle, is ground. Unseen space up to the body's height counts as seen.

    Args:
        terrain: the ground as the map shows it.
        vehicle: the robot, its joints as they are.
        T_map_bases: shape (4, 4) or (P, 4, 4).
        reach: how far around the body this holds [m].

    Returns:
        A changed copy. It is as large as `terrain`: what lies beyond its edge is lost.

    Raises:
        InvalidInputError: not rigid transforms.
    """
    poses = float_array(T_map_bases, "T_map_bases")
    if poses.ndim not in (2, 3) or poses.shape[-2:] != (4, 4):
        raise InvalidInputError("T_map_bases", f"shape {poses.shape}, expected (P, 4, 4)")
    names = ("heights", "sigma", "roughness", "step", "floor", "overhead", "seen")
    changed = dataclasses.replace(terrain, **{n: getattr(terrain, n).copy() for n in names})
    for pose in poses.reshape(-1, 4, 4):
        _declare(changed, vehicle, check_transform(pose, "T_map_bases"), reach)
    # Ground that has gone made steps of what is beside it, too.
    largest_steps(changed.heights, changed.sigma, changed.step)
    return changed


def _declare(terrain: Terrain, vehicle: Vehicle, T_map_base: FloatArray, reach: float) -> None:
    arrays = vehicle.arrays
    extent = np.concatenate([vehicle.undercarriage.outline, arrays.columns[:, :2]])
    low, high = extent.min(axis=0) - reach, extent.max(axis=0) + reach
    z = arrays.support[:, 2].mean()
    top = max(float(arrays.columns[:, 3].max(initial=z)), z)
    up = T_map_base[:3, 2]
    if up[2] < _FLATTEST:
        raise InvalidInputError("T_map_bases", "a robot that stands is not tilted by 78 degrees")
    cells = np.argwhere(np.ones(terrain.heights.shape, np.bool_))
    middle = terrain.centers_of(cells)
    # Heights of the wheels' plane at the cells' middles, then those places in the base frame.
    on_plane = T_map_base[:3, 3] + z * up
    heights = on_plane[2] - (middle - on_plane[:2]) @ up[:2] / up[2]
    places = np.column_stack([middle, heights]) - T_map_base[:3, 3]
    local = places @ T_map_base[:3, :3]
    near = ((local[:, :2] >= low) & (local[:, :2] <= high)).all(axis=1)
    i, j = cells[near].T
    plane, places = heights[near], local[near, :2]
    ceiling = plane + (top - z) / up[2] + reach
    _stand_on(terrain, vehicle, (i, j), places, plane, extent)
    unknown = np.isnan(terrain.heights[i, j])
    u, v = i[unknown], j[unknown]
    terrain.heights[u, v] = terrain.floor[u, v] = plane[unknown]
    terrain.sigma[u, v], terrain.roughness[u, v] = terrain.resolution, 0.0
    seen = np.minimum(np.maximum(terrain.seen[i, j], ceiling), terrain.overhead[i, j])
    terrain.seen[i, j] = seen


def _stand_on(
    terrain: Terrain,
    vehicle: Vehicle,
    cells: tuple[NDArray[np.int64], NDArray[np.int64]],
    places: FloatArray,
    plane: FloatArray,
    extent: FloatArray,
) -> None:
    """Take away what cannot be where a body stands: ground far off its wheels' plane, obstacles.

    Args:
        terrain: changed; heights become unknown where they cannot be.
        vehicle: the robot.
        cells: indices of cells around the body.
        places: their middles in the base frame, shape (N, 2) [m].
        plane: heights of the wheels' plane there, shape (N,) [m, map].
        extent: points that the body covers, in the base frame, shape (M, 2) [m].
    """
    arrays, size = vehicle.arrays, terrain.resolution
    between_wheels = _covers(vehicle.undercarriage.outline, places, size)
    clearance = float(arrays.columns[:, 2].min(initial=np.inf) - arrays.support[:, 2].mean())
    most = max(float(arrays.limits[2]), clearance if np.isfinite(clearance) else 0.0)
    lowest = terrain.overhead[cells]
    wrong = between_wheels & (np.abs(terrain.heights[cells] - plane) > most)
    terrain.heights[cells[0][wrong], cells[1][wrong]] = np.nan
    in_plane = (lowest <= plane + size) & (lowest >= plane - 2.0 * size)
    gone = between_wheels | (in_plane & _covers(extent, places, size))
    gone &= np.isnan(terrain.heights[cells])
    terrain.overhead[cells[0][gone], cells[1][gone]] = np.inf


def _covers(extent: FloatArray, places: FloatArray, margin: float) -> NDArray[np.bool_]:
    """Which places, shape (N, 2), lie in the box about points, shape (M, 2), and a margin [m]."""
    low, high = extent.min(axis=0) - margin, extent.max(axis=0) + margin
    return np.asarray(((places >= low) & (places <= high)).all(axis=1))
