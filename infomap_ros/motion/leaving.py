"""Ways of a base that stands where it must not: first out, by the shortest way, then on."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.terrain.terrain import Terrain
from infomap_ros.motion.base.base_path import BasePath, BasePlannerConfig
from infomap_ros.motion.base.base_planner import BasePlanner
from infomap_ros.motion.base.drive_graph import HEADINGS
from infomap_ros.motion.base.vehicle import Vehicle

_EXITS = 40  # nearest cells outside, of which the one with the cheapest way is taken


class LeavingPlanner(BasePlanner):
    """Plans for a robot that stands in a keep-out region or outside a fence.

    Ways begin with the shortest one to where it may stand; from there on they keep to the rules.
    Other regions and fences hold from the start.

    Args:
        terrain: the ground, with all that is closed.
        opened: the same without what the robot stands in.
        vehicle: the robot.
        config: of the planner.
        standing: poses T_map_base in which the robot stands or has stood, shape (P, 4, 4).
        previous: as for `BasePlanner`.
    """

    def __init__(
        self,
        terrain: Terrain,
        opened: Terrain,
        vehicle: Vehicle,
        config: BasePlannerConfig,
        standing: FloatArray,
        previous: BasePlanner | None = None,
    ) -> None:
        super().__init__(terrain, vehicle, config, standing, previous)
        self._opened = BasePlanner(opened, vehicle, config, standing)
        self._out: tuple[FloatArray, BasePath] | None = None

    def plan(self, start: ArrayLike, goals: ArrayLike, samples: int | None = None) -> BasePath:
        """The way out and on to one of the goals, or as near to one as is safe; see `BasePlanner`.

        Where there is no way on, the way out alone, with the reason.
        """
        out = self._way_out(np.asarray(start, dtype=np.float64))
        if not out.complete:
            return out
        on = super().plan(out.poses[-1], goals, samples)
        return _joined(out, on) if len(on.poses) else _alone(out, on)

    def reachable_area(self, start: ArrayLike | None = None) -> NDArray[np.bool_]:
        """Cells in which the base may stand and to which it can drive; see `BasePlanner`."""
        if start is None:
            return super().reachable_area()
        out = self._way_out(np.asarray(start, dtype=np.float64))
        if not out.complete:
            return np.zeros(self.terrain.heights.shape, np.bool_)
        return super().reachable_area(out.poses[-1])

    def _way_out(self, start: FloatArray) -> BasePath:
        """The shortest way to where the robot may stand, remembered for the last start."""
        if self._out is None or not np.array_equal(self._out[0], start):
            self._out = start.copy(), self._find_way_out(start)
        return self._out[1]

    def _find_way_out(self, start: FloatArray) -> BasePath:
        area = self._opened.reachable_area(start)
        cells = np.argwhere(area)
        middles = self._opened.terrain.centers_of(cells)
        order = np.argsort(np.hypot(*(middles - start[:2]).T), kind="stable")
        places = np.empty((len(order), len(HEADINGS), 3))
        places[:, :, :2], places[:, :, 2] = middles[order][:, None], HEADINGS
        good = self.vehicle.stances(self.terrain, places.reshape(-1, 3)).ok
        exits = places[good.reshape(places.shape[:2]).any(axis=1)][:_EXITS]
        goals = exits.reshape(-1, 3)
        goals = goals[self.vehicle.stances(self.terrain, goals).ok]
        where = self.vehicle.closed_at(self.terrain, *start)
        if not len(goals):
            reason = f"the robot stands {where}, and no way leads out"
            return self._space.nowhere(reason)
        path = self._opened.plan(start, goals, samples=0)
        if path.complete:
            return path
        return self._space.nowhere(f"the robot stands {where}: {path.reason}")


def _joined(first: BasePath, second: BasePath) -> BasePath:
    """One path after the other."""
    poses = np.concatenate([first.poses, second.poses[1:]])
    poses[:, 2] = np.unwrap(poses[:, 2])
    return dataclasses.replace(
        second,
        poses=poses,
        T_map_base=np.concatenate([first.T_map_base, second.T_map_base[1:]]),
        length=first.length + second.length,
    )


def _alone(out: BasePath, on: BasePath) -> BasePath:
    """The way out, which leads to no goal."""
    return dataclasses.replace(out, complete=False, reason=on.reason, goal=on.goal)
