"""Does the robot touch itself or the map?

The body is covered by spheres (`body`), which are compared with the voxels of the map
(`mapping.distance_field`) and with each other. Both are on the safe side: what is called free is
free of voxels that are not known to be free, and no two links touch that should not.

Links that stand still on the base are not compared with the map: where the base can stand is the
question of the planner of the base.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import (
    Box,
    ConvexPolytope,
    Cylinder,
    PlacedSolid,
    Solid,
    Sphere,
    check_transform,
    float_array,
)
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import OccupancyThresholds, VoxelMap
from infomap_ros.mapping.distance_field import DistanceField, distance_field
from infomap_ros.motion.collision import kernels
from infomap_ros.motion.collision.body import CollisionBody
from infomap_ros.motion.collision.kernels import CLEAR, BodyArrays, MotionSpace, first_on_segment

_SLACK = 1e-6  # [m]


class CollisionChecker:
    """Compares a robot with a map and with itself. Immutable; kernels release the GIL.

    Args:
        body: the robot's.
        field: the map's.
        wider: by how much more than the margin the arm is to keep off what the map shows, at
            least 0 [m].
    """

    def __init__(self, body: CollisionBody, field: DistanceField, wider: float = 0.0) -> None:
        if not (np.isfinite(wider) and wider >= 0.0):
            raise InvalidInputError("wider", f"is {wider}, expected at least 0 m")
        self.body, self.field, self._wider = body, field, wider
        self._shrunk: FloatArray = np.zeros(len(body.arrays.spheres))

    def contact(self, q: ArrayLike, T_map_base: ArrayLike) -> str:
        """What a configuration touches, in words; empty where it is free.

        Args:
            q: positions of the arm, shape (n,).
            T_map_base: shape (4, 4).

        Raises:
            InvalidInputError: malformed positions or pose.
        """
        position = self.body.chain.check(q)
        space = self.space(T_map_base)
        pair, sphere, *place = kernels.first_contact(space, position)
        if pair != CLEAR:
            first, second = (self.body.links[i] for i in self.body.arrays.pairs[pair])
            return f"{first} with {second}"
        if sphere != CLEAR:
            where = ", ".join(f"{x:.2f}" for x in place)
            return f"{self._link_of(sphere)} with the map at ({where})"
        return ""

    def are_free(self, qs: ArrayLike, T_map_bases: ArrayLike) -> NDArray[np.bool_]:
        """Check many configurations.

        Args:
            qs: positions of the arm, shape (N, n).
            T_map_bases: one for all, shape (4, 4), or one for each, shape (N, 4, 4).

        Returns:
            Which touch nothing, shape (N,).

        Raises:
            InvalidInputError: shapes do not fit or are not finite.
        """
        rows = float_array(qs, "qs")
        if rows.ndim != 2 or rows.shape[1] != len(self.body.chain) or not np.isfinite(rows).all():
            expected = f"(N, {len(self.body.chain)}), finite"
            raise InvalidInputError("qs", f"shape {rows.shape}, expected {expected}")
        poses = float_array(T_map_bases, "T_map_bases")
        if poses.shape not in ((4, 4), (len(rows), 4, 4)) or not np.isfinite(poses).all():
            raise InvalidInputError("T_map_bases", f"shape {poses.shape}, expected (N, 4, 4)")
        poses = np.broadcast_to(poses, (len(rows), 4, 4))[:, :3]
        free = np.empty(len(rows), np.bool_)
        kernels.all_free(
            self.space(np.eye(4)),
            np.ascontiguousarray(rows),
            np.ascontiguousarray(poses),
            free,
        )
        return free

    def space(self, T_map_base: ArrayLike) -> MotionSpace:
        """What the kernels take where the base stands at a place, shape (4, 4)."""
        body, pose = self.body, check_transform(T_map_base, "T_map_base")
        return MotionSpace(
            tree=body.tree.arrays,
            body=self._arrays,
            field=self.field.arrays,
            links=body.moving_links,
            radii=self._radii,
            gaps=self.body.gaps,
            kept=self.body.kept,
            pair_reach=self.body.pair_reach,
            margin=float(body.config.margin),
            T_map_base=np.ascontiguousarray(pose[:3]),
        )

    def departure(self, q: ArrayLike, T_map_base: ArrayLike) -> MotionSpace:
        """The space for a motion that begins in a configuration, which it may leave in any case.

        A robot that stands beside a wall may, by the map, stand in it. A link that touches the map,
        or another link, may come no nearer to anything, or to that link, than it is now; all others
        keep their margin. Without a contact this is `space`.

        Args:
            q: where the arm is, shape (n,).
            T_map_base: where the base is, shape (4, 4).
        """
        space, position = self.space(T_map_base), self.body.chain.check(q)
        gaps = np.empty_like(space.gaps)
        depths = np.repeat(self._depths(space, position), np.diff(self.body.arrays.starts))
        kernels.pair_gaps(space, position, space.gaps + _SLACK, gaps)
        return space._replace(radii=space.radii + depths, gaps=gaps - _SLACK)

    def standing(self, q: ArrayLike, T_map_base: ArrayLike) -> CollisionChecker:
        """The same where the robot stands: each link may be as near to things as it is now.

        A base that came to stand closer to a wall than planned could not fold its arm else. What a
        link keeps to things may be less than the margin, but no link may reach into what the map
        shows, except those that the first joint turns in place: they are where they are in every
        posture. What the map shows there was seen wrongly, or does not touch them, and they may
        come nearer to it by half a voxel, as the map tells no better.

        Args:
            q: where the arm is, shape (n,).
            T_map_base: where the base is, shape (4, 4).
        """
        body = self.body
        depths = self._depths(self.space(T_map_base), body.chain.check(q))
        kept = np.array([body.protrusions[link] for link in body.links]) + body.config.margin
        touching = np.where(depths < 0.0, depths - 0.5 * self.field.voxel_size, 0.0)
        depths = np.where(body.foot, touching, np.maximum(depths, -kept - self._wider))
        other = CollisionChecker(self.body, self.field, wider=self._wider)
        other._shrunk = np.repeat(depths, np.diff(self.body.arrays.starts))
        return other

    def _depths(self, space: MotionSpace, q: FloatArray) -> FloatArray:
        """How far each link is within its margin of the map, shape (links,) [m]; 0 or less."""
        kept, found = 1.001 * space.margin, np.empty_like(space.radii)
        kernels.sphere_clearances(space, q, space.radii + kept, found)
        starts = self.body.arrays.starts[:-1]
        return np.minimum(np.minimum.reduceat(found - kept - space.radii, starts), 0.0)

    def contact_between(self, q_start: ArrayLike, q_goal: ArrayLike, T_map_base: ArrayLike) -> str:
        """What is touched on the segment between two configurations, in words, or empty.

        All of it is looked at.

        Raises:
            InvalidInputError: malformed positions or pose.
        """
        first, second = (self.body.chain.check(q) for q in (q_start, q_goal))
        share = first_on_segment(self.space(T_map_base), first, second, self.body.scratch())
        if share < 0.0:
            return ""
        return self.contact(first + share * (second - first), T_map_base)

    @cached_property
    def _radii(self) -> FloatArray:
        return self.body.arrays.spheres[:, 3] + self._wider + self._shrunk

    @cached_property
    def _arrays(self) -> BodyArrays:
        """Those of the body, with the balls about its links as wide as their spheres."""
        arrays = self.body.arrays
        return arrays._replace(balls=arrays.balls + np.array([0.0, 0.0, 0.0, self._wider]))

    def _link_of(self, sphere: int) -> str:
        starts = self.body.arrays.starts
        return self.body.links[int(np.searchsorted(starts, sphere, side="right")) - 1]


_REMEMBERED = 4


class NearSpace:
    """Makes collision checkers for parts of a map.

    At the start nothing is known, least of all around the arm, and unknown space counts as
    occupied. Three things let a robot move all the same, none of which takes anything for free
    that was seen to be occupied: the space that its body fills, and a little around it, is free;
    so is what the user declares to be free; and a path may leave what the body touches at its start
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
        obstacles: solids that must not be touched and that the map does not show [map].
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
        obstacles: Sequence[PlacedSolid] = (),
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
        self._obstacles = [
            PlacedSolid(_grown(part.solid, half_diagonal), part.transform, part.name)
            for part in obstacles
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
            unknown_is_free=False,
            known_free=[
                solid for solid in (*self._known_free, *feet) if _touches_box(solid, low, high)
            ],
            own_points=self._own_points,
            obstacles=[solid for solid in self._obstacles if _touches_box(solid, low, high)],
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
