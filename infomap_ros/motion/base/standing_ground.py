"""Ground that is known because the robot stands, or has stood, on it, or began there.

A robot never sees what is under it. Without this it could not leave its first place, as unknown
ground is not driven on.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import Cylinder, PlacedSolid, check_transform, make_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.terrain.measures import largest_steps
from infomap_ros.mapping.terrain.terrain import Terrain, terrain_of
from infomap_ros.motion.base.vehicle import Vehicle
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.motion.robot.solid_extent import camera_heights, robot_bottom

_FLATTEST = 0.2  # cosine of the steepest plane that is taken for ground


def with_standing_ground(
    terrain: Terrain, vehicle: Vehicle, T_map_base: ArrayLike, reach: float = 0.2
) -> Terrain:
    """Declare the ground under a pose in which the robot stands or has stood as known.

    Cells under the body and between the wheels get the plane of the wheels, and so do those around
    that have no ground, unless something stands there that is higher than a step. Other cells with
    ground keep theirs. What is occupied in that plane and was not seen well enough to be ground, as
    a floor at a grazing angle, is ground. Unseen space up to the body's height counts as seen.

    Args:
        terrain: the ground as the map shows it.
        vehicle: the robot, its joints as they are.
        T_map_base: shape (4, 4).
        reach: how far around the body this holds [m].

    Returns:
        A changed copy. It is as large as `terrain`: what lies beyond its edge is lost.

    Raises:
        InvalidInputError: not a rigid transform, or one that is tilted too far to stand.
    """
    return _with_places(terrain, vehicle, [(T_map_base, reach)])


def known_ground(
    voxel_map: VoxelMap,
    vehicle: Vehicle,
    T_map_base: FloatArray,
    start: ClearStart | None,
    reach: float,
) -> Terrain:
    """The ground about a robot as its map shows it, with that on which it stands or began.

    Args:
        voxel_map: what is known.
        vehicle: the robot, its joints as they are when it drives.
        T_map_base: where it stands, shape (4, 4).
        start: the space that was declared clear.
        reach: how far around the body the ground is known [m].
    """
    terrain = terrain_of(voxel_map, T_map_base[:3, 3])
    began = [] if start is None else [(start.T_map_base, start.reach(vehicle))]
    return _with_places(terrain, vehicle, [*began, (T_map_base, reach)])


def _with_places(
    terrain: Terrain, vehicle: Vehicle, places: Sequence[tuple[ArrayLike, float]]
) -> Terrain:
    """As `with_standing_ground`, of poses with their reach, one after the other."""
    names = ("heights", "sigma", "roughness", "step", "floor", "overhead", "seen")
    changed = dataclasses.replace(terrain, **{n: getattr(terrain, n).copy() for n in names})
    for T_map_base, reach in places:
        _declare(changed, vehicle, check_transform(T_map_base, "T_map_base"), reach)
    # Ground that has gone made steps of what is beside it, too.
    largest_steps(changed.heights, changed.sigma, changed.resolution, changed.step)
    return changed


def _declare(terrain: Terrain, vehicle: Vehicle, T_map_base: FloatArray, reach: float) -> None:
    arrays = vehicle.arrays
    extent = np.concatenate([vehicle.undercarriage.outline, arrays.columns[:, :2]])
    low, high = extent.min(axis=0) - reach, extent.max(axis=0) + reach
    z = arrays.support[:, 2].mean()
    top = max(float(arrays.columns[:, 3].max(initial=z)), z)
    up = T_map_base[:3, 2]
    if up[2] < _FLATTEST:
        raise InvalidInputError("T_map_base", "a robot that stands is not tilted by 78 degrees")
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


_ABOVE = 0.1  # the highest camera [m]


@dataclass(frozen=True, eq=False)
class ClearStart:
    """Space about the first place of the base that is declared clear, and its ground even.

    A robot sees neither the ground under and next to it nor the space about its arm. Without such
    a declaration it could move nothing. What the map knows there counts for more.

    Attributes:
        T_map_base: first pose of the base, shape (4, 4).
        radius: about the base's origin [m].
    """

    T_map_base: FloatArray
    radius: float

    def space(self, robot: RobotModel) -> PlacedSolid:
        """The clear space: from the ground to above the highest camera, map frame."""
        height = camera_heights(robot)[1] + _ABOVE
        center = make_transform(np.eye(3), (0.0, 0.0, robot_bottom(robot) + 0.5 * height))
        return PlacedSolid(Cylinder(self.radius, height), self.T_map_base @ center, "start")

    def ground(self, terrain: Terrain, vehicle: Vehicle) -> Terrain:
        """The terrain with the plane of the wheels where the map knows no ground."""
        return with_standing_ground(terrain, vehicle, self.T_map_base, self.reach(vehicle))

    def reach(self, vehicle: Vehicle) -> float:
        """How far about the vehicle that ground is declared even [m]."""
        extent = np.abs(vehicle.undercarriage.outline).max()
        return max(self.radius - float(extent), 0.0)
