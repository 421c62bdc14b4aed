"""Is what is left of a route still free in the map as it is now? Where not, and why?

What is asked is whether the map, or where the base must not go, has changed for the worse since the
route was planned. A robot may have to leave a place where it should not stand, or an arm a contact
at its start: what was not free when the route was planned, by the same checks, does not count.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import OccupancyThresholds, VoxelMap
from infomap_ros.mapping.distance_field import distance_field
from infomap_ros.mapping.terrain.terrain import Terrain
from infomap_ros.mapping.voxels.window import CONFIRMED_PROBABILITY
from infomap_ros.motion.base import stance
from infomap_ros.motion.base.drive_space import TURN_LENGTH, apart
from infomap_ros.motion.base.standing_ground import ClearStart, known_ground
from infomap_ros.motion.collision.checker import CollisionChecker
from infomap_ros.motion.keep_out import KeepOut, with_keep_out
from infomap_ros.motion.route import ArmPath, Route
from infomap_ros.motion.whole_body import ReachingConfig, WholeBody

_TURNED_UNKNOWN = (stance.OUTSIDE, stance.UNKNOWN_WHEEL, stance.UNKNOWN_BODY, stance.UNSEEN)
"""Outcomes that no obstacle has: what was seen once is not blocked for being seen less well."""
_PROGRESS = 1.0  # [m]; farther the base does not come along its path between two checks
_ARM_STEP = 0.05  # [rad or m] between configurations that are checked
_BELOW = 0.5  # [m] below the base that the map is compared


@dataclass(frozen=True)
class RouteFault:
    """Where a route is blocked.

    Attributes:
        position: of the base, or of the base whose arm moves, shape (3,) [m, map].
        reason: what is blocked, where, and by what.
    """

    position: tuple[float, float, float]
    reason: str


class RouteCheck:
    """Checks one route while it is carried out.

    Args:
        route: as planned.
        whole: the robot.
        config: of the planner.
        voxel_map: in which it was planned.
        T_map_base: where the base was then, shape (4, 4).
        joints: positions then, by name [rad or m].
        start: space that was declared clear.
        keep_out: where the base must not go, as it was then.
    """

    def __init__(
        self,
        route: Route,
        whole: WholeBody,
        config: ReachingConfig,
        voxel_map: VoxelMap,
        T_map_base: FloatArray,
        joints: Mapping[str, float],
        start: ClearStart | None = None,
        keep_out: KeepOut | None = None,
    ) -> None:
        self._keep_out = keep_out or KeepOut()
        self._whole, self._config, self._start = whole, config, start
        # The plan kept a margin; what uses it up, as noise of the ground does, breaks nothing off.
        self._vehicle = whole.vehicle.while_driving
        self._base, self._began = T_map_base, whole.chain.positions(joints)
        self._path = route.base_path if route.moves_base else np.zeros((0, 3))
        self._heights = route.base_poses[:, 2, 3] if route.moves_base else np.zeros(0)
        self._arm = _densified(route.arm_before if route.moves_base else route.arm_after)
        self._passed, self._arm_passed = 0, 0
        self._states = self._surroundings(voxel_map)
        self._fault: RouteFault | None = None
        self._stood = self._vehicle.stances(self._terrain(voxel_map), self._path).ok
        self._was_free = self._free(self._checker(voxel_map))

    def fault(
        self,
        voxel_map: VoxelMap,
        T_map_base: FloatArray,
        joints: Mapping[str, float],
        keep_out: KeepOut | None = None,
    ) -> RouteFault | None:
        """The first fault on what is left of the route; None where it is free.

        Args:
            voxel_map: as it is now. Where it is as at the last call around the route, the answer
                is the last one.
            T_map_base: where the base is, shape (4, 4).
            joints: where they are, by name [rad or m].
            keep_out: where the base must not go now.
        """
        states, rules = self._surroundings(voxel_map), keep_out or KeepOut()
        if np.array_equal(states, self._states) and rules == self._keep_out:
            return self._fault
        self._states, self._keep_out = states, rules
        self._advance(T_map_base, joints)
        self._fault = self._arm_fault(voxel_map) or self._base_fault(voxel_map)
        return self._fault

    def _advance(self, T_map_base: FloatArray, joints: Mapping[str, float]) -> None:
        """Note how much of base path and arm path lies behind the robot."""
        if len(self._path):
            left = self._path[self._passed :]
            steps = np.linalg.norm(np.diff(left[:, :2], axis=0), axis=1)
            steps += TURN_LENGTH * np.abs(np.diff(left[:, 2]))
            near = int(np.searchsorted(np.cumsum(steps), _PROGRESS)) + 1
            yaw = np.arctan2(T_map_base[1, 0], T_map_base[0, 0])
            self._passed += int(apart(left[:near], np.array([*T_map_base[:2, 3], yaw])).argmin())
        if len(self._arm):
            here = self._whole.chain.positions(joints)
            away = np.abs(self._arm[self._arm_passed :] - here).max(axis=1)
            self._arm_passed += int(away.argmin())

    def _base_fault(self, voxel_map: VoxelMap) -> RouteFault | None:
        if len(self._path) - self._passed < 2:
            return None
        terrain = self._terrain(voxel_map)
        outcomes = self._vehicle.stances(terrain, self._path).outcomes
        blocked = self._stood & (outcomes != stance.STANDS) & ~np.isin(outcomes, _TURNED_UNKNOWN)
        blocked[: self._passed] = False
        # Where it stands it can stand: what it leaves at once is no fault.
        left = blocked[self._passed :]
        leaving = int(np.argmin(left))
        end = self._path[self._passed + leaving][None]
        if apart(end, self._path[self._passed])[0] <= self._config.base.standing_reach:
            left[:leaving] = False
        if not blocked.any():
            return None
        row = int(np.argmax(blocked))
        x, y, _ = (float(value) for value in self._path[row])
        why = self._vehicle.refusal(terrain, self._path[row])
        reason = f"the base path is blocked at ({x:.2f}, {y:.2f}): {why}"
        return RouteFault((x, y, float(self._heights[row])), reason)

    def _arm_fault(self, voxel_map: VoxelMap) -> RouteFault | None:
        """What blocks the arm where the base has not left yet."""
        if len(self._arm) - self._arm_passed < 2 or self._passed:
            return None
        checker = self._checker(voxel_map)
        blocked = self._was_free & ~self._free(checker)
        blocked[: self._arm_passed] = False
        if not blocked.any():
            return None
        what = checker.contact(self._arm[int(np.argmax(blocked))], self._base)
        x, y, z = (float(value) for value in self._base[:3, 3])
        return RouteFault((x, y, z), f"the path of the arm is blocked: {what}")

    def _free(self, checker: CollisionChecker) -> NDArray[np.bool_]:
        """Where on its path the arm touches nothing, shape (A,)."""
        return checker.are_free(self._arm, self._base)

    def _terrain(self, voxel_map: VoxelMap) -> Terrain:
        """The ground as it was planned on: the same search, the same place where it stands."""
        vehicle, reach = self._whole.vehicle, self._config.base.standing_reach
        terrain = known_ground(voxel_map, vehicle, self._base, self._start, reach)
        return with_keep_out(terrain, self._keep_out)

    def _checker(self, voxel_map: VoxelMap) -> CollisionChecker:
        """The arm among what is confirmed: a single hit does not stop it, nor does doubt."""
        body, middle = self._whole.body, self._base[:3, 3]
        window = voxel_map.window(middle - self._whole.radius, middle + self._whole.radius)
        field = distance_field(
            window,
            thresholds=OccupancyThresholds(body.config.free_probability, CONFIRMED_PROBABILITY),
            unknown_is_free=True,
            doubtful_is_free=True,
            own_points=body.spheres(self._began, self._base)[:, :3],
        )
        return CollisionChecker(body, field).standing(self._began, self._base)

    def _surroundings(self, voxel_map: VoxelMap) -> NDArray[np.uint8]:
        """Free, occupied and unknown voxels in a box about the route."""
        places = np.vstack([self._base[:3, 3], np.column_stack([self._path[:, :2], self._heights])])
        reach = np.full(3, self._whole.radius)
        low, high = places.min(axis=0) - reach, places.max(axis=0) + reach
        low[2] = places[:, 2].min() - _BELOW
        thresholds = OccupancyThresholds(0.5, CONFIRMED_PROBABILITY, 0)
        return voxel_map.window(low, high).states(thresholds)


def _densified(path: ArmPath) -> FloatArray:
    """Configurations of a path at most `_ARM_STEP` apart, shape (A, n)."""
    knots = path.positions
    if len(knots) < 2:
        return np.zeros((0, len(path.joint_names)))
    steps = np.abs(np.diff(knots, axis=0)).max(axis=1)
    along = np.concatenate([[0.0], np.cumsum(np.maximum(steps, 1e-9))])
    at = np.linspace(0.0, along[-1], int(np.ceil(along[-1] / _ARM_STEP)) + 1)
    return np.column_stack([np.interp(at, along, column) for column in knots.T])
