"""Does the robot touch itself or the map?

The body is covered by spheres (`sphere_cover`), which are compared with the voxels of the map
(`mapping.distance_field`) and with each other. Both are on the safe side: what is called free is
free of voxels that are not known to be free, and no two links touch that should not.

Links that stand still on the base are compared with the map only when asked for: where the base can
stand is the question of the planner of the base.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import check_transform, float_array
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import OccupancyThresholds, VoxelMap, VoxelWindow
from infomap_ros.mapping.distance_field import DistanceField, distance_field, field_of_blocked
from infomap_ros.motion.base.way_kernels import first_on_way
from infomap_ros.motion.collision import kernels
from infomap_ros.motion.collision.body import CollisionBody
from infomap_ros.motion.collision.collision_config import CollisionConfig
from infomap_ros.motion.collision.kernels import CLEAR, BodyArrays, MotionSpace
from infomap_ros.motion.robot.robot_model import RobotModel

_SLACK = 1e-6  # [m]

__all__ = ["CollisionBody", "CollisionChecker", "CollisionConfig", "CollisionReport"]


@dataclass(frozen=True)
class CollisionReport:
    """Whether a configuration is free of collisions.

    Attributes:
        free: touches nothing.
        what: what touches what, in words; empty if free.
    """

    free: bool
    what: str = ""


class CollisionChecker:
    """Compares a robot with a map and with itself. Immutable; kernels release the GIL.

    Args:
        robot: the robot, or its body where that has been made before (it takes a while).
        surroundings: the map, a window of it, or its distance field. All outside a window counts
            as unknown.
        config: how; that of the body where a body is given.
        wider: by how much more than the margin the arm is to keep off what the map shows, at
            least 0 [m].

    Attributes:
        body: the robot's.
        field: the map's.
    """

    def __init__(
        self,
        robot: RobotModel | CollisionBody,
        surroundings: VoxelMap | VoxelWindow | DistanceField,
        config: CollisionConfig | None = None,
        wider: float = 0.0,
    ) -> None:
        if isinstance(robot, RobotModel):
            robot = CollisionBody.from_robot(robot, config)
        if not (np.isfinite(wider) and wider >= 0.0):
            raise InvalidInputError("wider", f"is {wider}, expected at least 0 m")
        self.body, self._wider = robot, wider
        self.field = _field(surroundings, robot.config)
        self._shrunk: FloatArray = np.zeros(len(robot.arrays.spheres))

    def check(self, q: ArrayLike, T_map_base: ArrayLike, base: bool = True) -> CollisionReport:
        """Check one configuration and say what it touches.

        Args:
            q: positions of the arm, shape (n,).
            T_map_base: shape (4, 4).
            base: compare the links that stand still on the base with the map too.

        Raises:
            InvalidInputError: malformed positions or pose.
        """
        position = self.body.chain.check(q)
        space = self.space(T_map_base, base)
        pair, sphere, *place = kernels.first_contact(space, position)
        if pair != CLEAR:
            first, second = (self.body.links[i] for i in self.body.arrays.pairs[pair])
            return CollisionReport(False, f"{first} with {second}")
        if sphere != CLEAR:
            where = ", ".join(f"{x:.2f}" for x in place)
            return CollisionReport(False, f"{self._link_of(sphere)} with the map at ({where})")
        return CollisionReport(True)

    def are_free(
        self, qs: ArrayLike, T_map_bases: ArrayLike, base: bool = True
    ) -> NDArray[np.bool_]:
        """Check many configurations.

        Args:
            qs: positions of the arm, shape (N, n).
            T_map_bases: one for all, shape (4, 4), or one for each, shape (N, 4, 4).
            base: compare the links that stand still on the base with the map too.

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
            self.space(np.eye(4), base),
            np.ascontiguousarray(rows),
            np.ascontiguousarray(poses),
            free,
        )
        return free

    def space(self, T_map_base: ArrayLike, base: bool = False) -> MotionSpace:
        """What the kernels take.

        Args:
            T_map_base: shape (4, 4).
            base: compare the links that stand still on the base with the map too.
        """
        body, pose = self.body, check_transform(T_map_base, "T_map_base")
        return MotionSpace(
            tree=body.tree.arrays,
            body=self._arrays,
            field=self.field.arrays,
            links=self._all_links if base else body.moving_links,
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

    def first_on_way(
        self, q_start: ArrayLike, q_goal: ArrayLike, T_map_base: ArrayLike
    ) -> CollisionReport:
        """Check the straight way between two configurations, wholly.

        Raises:
            InvalidInputError: malformed positions or pose.
        """
        first, second = (self.body.chain.check(q) for q in (q_start, q_goal))
        share = first_on_way(self.space(T_map_base), first, second, self.body.scratch())
        if share < 0.0:
            return CollisionReport(True)
        return self.check(first + share * (second - first), T_map_base, base=False)

    @cached_property
    def _radii(self) -> FloatArray:
        return self.body.arrays.spheres[:, 3] + self._wider + self._shrunk

    @cached_property
    def _arrays(self) -> BodyArrays:
        """Those of the body, with the balls about its links as wide as their spheres."""
        arrays = self.body.arrays
        return arrays._replace(balls=arrays.balls + np.array([0.0, 0.0, 0.0, self._wider]))

    @cached_property
    def _all_links(self) -> NDArray[np.int64]:
        return np.concatenate([self.body.moving_links, self.body.base_links])

    def _link_of(self, sphere: int) -> str:
        starts = self.body.arrays.starts
        return self.body.links[int(np.searchsorted(starts, sphere, side="right")) - 1]


def _field(
    surroundings: VoxelMap | VoxelWindow | DistanceField, config: CollisionConfig
) -> DistanceField:
    if isinstance(surroundings, DistanceField):
        return surroundings
    thresholds = OccupancyThresholds(config.free_probability)
    unknown_is_free = config.unknown_is_free
    if isinstance(surroundings, VoxelWindow):
        return distance_field(surroundings, thresholds=thresholds, unknown_is_free=unknown_is_free)
    bounds, size = surroundings.bounds(), surroundings.config.voxel_size
    if bounds is None:
        blocked = np.full((1, 1, 1), not unknown_is_free)
        return field_of_blocked(blocked, (0, 0, 0), size, unknown_is_free)
    low, high = (np.asarray(bound) for bound in bounds)
    window = surroundings.window((low + 0.25) * size, (high + 0.75) * size)
    return distance_field(window, thresholds=thresholds, unknown_is_free=unknown_is_free)
