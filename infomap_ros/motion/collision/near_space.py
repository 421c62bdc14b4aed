"""The map around some place of the robot, as its collision checks see it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from infomap_ros.geometry import (
    Box,
    ConvexPolytope,
    Cylinder,
    PlacedSolid,
    Solid,
    Sphere,
)
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import OccupancyThresholds, VoxelMap
from infomap_ros.mapping.distance_field import distance_field
from infomap_ros.motion.collision.body import CollisionBody
from infomap_ros.motion.collision.checker import CollisionChecker

_REMEMBERED = 4


class NearSpace:
    """Makes collision checkers for parts of a map.

    At the start nothing is known, least of all around the arm, and unknown space counts as
    occupied. Three things let a robot move all the same, none of which takes anything for free
    that was seen to be occupied: the space that its body fills, and a little around it, is free;
    so is what the user declares to be free; and a way may leave what the body touches at its start
    (`CollisionChecker.departure`). Voxels within the body are free even if something was seen
    there, as that can only have been the robot itself. And where the base is to stand, the planner
    of the base answers for the space that the foot of the arm fills, which hardly moves; where it
    stands, the foot may be as near to what the map shows as it is (`CollisionChecker.standing`).

    Args:
        voxel_map: what is known.
        body: the robot's.
        T_map_base: where it is now, shape (4, 4).
        joints: where all its joints are now, by name [rad or m].
        radius: no point of the body is farther from the base's origin [m].
        clear_body: space within this of the present body is free, and more where the checks take a
            link for larger than it is [m].
        known_free: further space that is free although it was never seen [map].
        foot: solids of the foot of the arm, base frame.
        in_the_way: solids that must not be touched and that the map does not show [map].
        wider: what the arm keeps off the map beyond its margin [m].
    """

    def __init__(
        self,
        voxel_map: VoxelMap,
        body: CollisionBody,
        T_map_base: FloatArray,
        joints: Mapping[str, float],
        radius: float,
        clear_body: float,
        known_free: Sequence[PlacedSolid] = (),
        foot: Sequence[PlacedSolid] = (),
        in_the_way: Sequence[PlacedSolid] = (),
        wider: float = 0.0,
    ) -> None:
        self._thresholds = OccupancyThresholds(body.config.free_probability)
        self._map, self._body, self._radius, self.wider = voxel_map, body, radius + wider, wider
        robot = body.robot
        positions = {j.name: float(np.clip(0.0, j.lower, j.upper)) for j in robot.joints}
        positions.update({name: float(joints[name]) for name in positions if name in joints})
        half_diagonal = 0.5 * math.sqrt(3.0) * voxel_map.config.voxel_size
        least = body.config.margin + wider
        clear = {link: max(clear_body, out + least) for link, out in body.protrusions.items()}
        own = [
            PlacedSolid(
                # No voxel that is not free reaches into what the checks take for the body.
                _grown(part.solid, clear[part.name] + half_diagonal),
                T_map_base @ part.transform,
                part.name,
            )
            for part in robot.solids_in(robot.base_frame, positions)
        ]
        reach = body.config.tolerance + body.config.margin + wider + half_diagonal
        self._foot = [
            PlacedSolid(_grown(part.solid, reach), part.transform, part.name) for part in foot
        ]
        self._known_free = (*known_free, *own)
        self._in_the_way = [
            PlacedSolid(_grown(part.solid, half_diagonal), part.transform, part.name)
            for part in in_the_way
        ]
        self._base, self._q = T_map_base, body.chain.positions(positions)
        self._own_points = body.spheres(self._q, T_map_base)[:, :3]
        self._remembered: dict[bytes, CollisionChecker] = {}

    def checker_at(self, T_map_base: FloatArray) -> CollisionChecker:
        """For a robot that stands at one place, shape (4, 4)."""
        key = T_map_base.tobytes()
        if key not in self._remembered:
            if len(self._remembered) >= _REMEMBERED:
                self._remembered.pop(next(iter(self._remembered)))
            checker = self.checker_around(T_map_base[None])
            if key == self._base.tobytes():
                checker = checker.standing(self._q, T_map_base)
            self._remembered[key] = checker
        return self._remembered[key]

    def checker_around(self, T_map_bases: FloatArray) -> CollisionChecker:
        """For a robot that stands at any of several places, shape (N, 4, 4)."""
        middles = T_map_bases[:, :3, 3]
        feet = [
            PlacedSolid(part.solid, pose @ part.transform, part.name)
            for pose in T_map_bases
            for part in self._foot
        ]
        low, high = middles.min(axis=0) - self._radius, middles.max(axis=0) + self._radius
        field = distance_field(
            self._map.window(low, high),
            thresholds=self._thresholds,
            unknown_is_free=self._body.config.unknown_is_free,
            known_free=[
                solid for solid in (*self._known_free, *feet) if _touches_box(solid, low, high)
            ],
            own_points=self._own_points,
            in_the_way=[solid for solid in self._in_the_way if _touches_box(solid, low, high)],
        )
        return CollisionChecker(self._body, field, wider=self.wider)


def _touches_box(placed: PlacedSolid, low: FloatArray, high: FloatArray) -> bool:
    nearest = np.clip(placed.transform[:3, 3], low, high)
    away = float(np.linalg.norm(nearest - placed.transform[:3, 3]))
    return away <= placed.solid.bounding_radius


def _grown(solid: Solid, by: float) -> Solid:
    """A solid of the same kind that holds all points within `by` of it."""
    if isinstance(solid, Sphere):
        return Sphere(solid.radius + by)
    if isinstance(solid, Box):
        x, y, z = (edge + 2.0 * by for edge in solid.size)
        return Box((x, y, z))
    if isinstance(solid, Cylinder):
        return Cylinder(solid.radius + by, solid.length + 2.0 * by)
    assert isinstance(solid, ConvexPolytope)
    return ConvexPolytope(solid.normals, solid.offsets + by, solid.radius + by)
