"""Ways of the base over rough ground."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import float_array
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.terrain.terrain import Terrain
from infomap_ros.motion.base.base_path import BasePath, BasePlannerConfig
from infomap_ros.motion.base.drive_kernels import legs_of
from infomap_ros.motion.base.drive_links import links_for
from infomap_ros.motion.base.drive_reach import DriveReach
from infomap_ros.motion.base.drive_space import DriveSpace
from infomap_ros.motion.base.driven_path import DrivenPath
from infomap_ros.motion.base.standing_ground import with_standing_ground
from infomap_ros.motion.base.vehicle import Vehicle


class BasePlanner:
    """Plans for one terrain, one vehicle in one posture, and one place where it stands.

    What was found out about the ground is kept, so that many plans cost less than one each.

    Args:
        terrain: the ground as the map shows it.
        vehicle: the robot.
        config: None for the defaults.
        standing: poses T_map_base in which the robot stands or has stood, shape (4, 4) or
            (P, 4, 4): the ground there is known.
        previous: a planner for an earlier state of the ground: what it found out is kept where
            the ground has not changed and the vehicle is the same.
    """

    def __init__(
        self,
        terrain: Terrain,
        vehicle: Vehicle,
        config: BasePlannerConfig | None = None,
        standing: ArrayLike | None = None,
        previous: BasePlanner | None = None,
    ) -> None:
        self.config = config or BasePlannerConfig()
        self.vehicle = vehicle
        self._reach: DriveReach | None = None
        known: DriveSpace | None = None if previous is None else previous._space
        if standing is not None:
            reach = self.config.standing_reach
            terrain = with_standing_ground(terrain, vehicle, standing, reach)
        self._space: DriveSpace = DriveSpace(terrain, vehicle, self.config, known)

    @property
    def terrain(self) -> Terrain:
        """The ground, with that on which the robot stands."""
        return self._space.terrain

    def plan(self, start: ArrayLike, goals: ArrayLike, samples: int | None = None) -> BasePath:
        """Find a way to one of the goals, or as near to one as is safe.

        The lattice says which goal is nearest and how it is reached; OMPL plans the path there
        anew and shortens it (`driven_path`). The lattice's path is kept where OMPL finds none
        that costs less.

        Args:
            start: x, y [m] and yaw [rad] of the base in the map, shape (3,).
            goals: likewise, shape (3,) or (G, 3); yaw NaN for any heading.
            samples: random places that OMPL may try; None for the configuration's, 0 for the
                lattice's path as it is.

        Raises:
            InvalidInputError: shapes do not fit, or values are not finite.
        """
        here, targets = _places(start, "start", False)[0], _places(goals, "goals", True)
        places, owners, reasons = self._space.standable_goals(targets)
        found = self._reached_from(here).way_to_any(places)
        if found is None:
            return self._approach(targets, reasons, samples)
        way, method = self._driven(found[0], samples)
        goal = _owner(way[-1], places, owners)
        if np.isnan(targets[goal, 2]):
            way = self._free_arrival(way)
        return self._space.finished(way, goal, method)

    def reachable_area(self, start: ArrayLike | None = None) -> NDArray[np.bool_]:
        """Cells of the terrain in whose middle the base can stand and to which it can drive.

        Args:
            start: x, y, yaw of the base, shape (3,); None for the start of the last call.

        Returns:
            Shape (nx, ny), indexed [x, y] as `terrain`.

        Raises:
            InvalidInputError: there was no start yet, or it is not finite.
        """
        if start is not None:
            here = _places(start, "start", False)[0]
            self._reached_from(here)
        if self._reach is None:
            raise InvalidInputError("start", "is not known yet: give it or plan first")
        return self._reach.cells()

    @property
    def _ompl(self) -> DrivenPath:
        return DrivenPath(self._space, links_for(self.config, float(self._space.grid[2])))

    def _reached_from(self, start: FloatArray) -> DriveReach:
        """All ground that can be reached from a start, remembered for the last one."""
        if self._reach is None or not self._reach.starts_at(start):
            self._reach = DriveReach(self._space, start)
        return self._reach

    def _driven(self, way: FloatArray, samples: int | None) -> tuple[FloatArray, str]:
        """OMPL's path or else the lattice's, and which it is."""
        most = self.config.samples if samples is None else samples
        path = self._ompl.better_than(way, most) if most > 0 else None
        return (way, "lattice") if path is None else (path, "ompl")

    def _free_arrival(self, way: FloatArray) -> FloatArray:
        """A way to a goal of any heading without its last turn, where that may be left out."""
        if len(way) < 2 or self.config.turning_radius > 0.0:
            return way
        a, b = way[-2:]
        first, length, _ = legs_of(*a, *b, self.config.reverse)
        arrival = way.copy()
        arrival[-1, 2] = a[2] + first if length > 0.0 else a[2]
        return way if self._space.fault_on(arrival[-2:]) is not None else arrival

    def _approach(self, targets: FloatArray, reasons: list[str], samples: int | None) -> BasePath:
        """The farthest safe approach, or no way at all, and why."""
        assert self._reach is not None
        nearest = self._reach.nearest_to(targets)
        if nearest is None:
            reason = self._why_stuck(self._reach)
            return self._space.nowhere(f"the robot cannot leave its place: {reason}")
        way, goal, left = nearest
        reason = reasons[goal] or "no way to the goal over ground that is known and safe"
        reason += f"; the farthest safe approach ends {left:.2f} m from it"
        way, method = self._driven(way, samples)
        return self._space.finished(way, goal, method, reason)

    def _why_stuck(self, reach: DriveReach) -> str:
        x, y, yaw = (float(value) for value in reach.start)
        reason = self.vehicle.stance(self.terrain, x, y, yaw).reason
        return reason or "no pose next to it is safe"


def _places(values: ArrayLike, name: str, any_heading: bool) -> FloatArray:
    rows = float_array(values, name)
    if rows.ndim == 1:
        rows = rows[None]
    if rows.ndim != 2 or rows.shape[1] != 3 or not len(rows):
        raise InvalidInputError(name, f"shape {rows.shape}, expected (3,) or (N, 3)")
    if not np.isfinite(rows[:, : 2 if any_heading else 3]).all() or np.isinf(rows).any():
        raise InvalidInputError(name, "hold NaN or infinity")
    return rows


def _owner(place: FloatArray, places: FloatArray, owners: NDArray[np.int64]) -> int:
    """Goal to which the place belongs at which a way ends."""
    away = np.hypot(*(places[:, :2] - place[:2]).T)
    away += np.abs((places[:, 2] - place[2] + math.pi) % (2.0 * math.pi) - math.pi)
    return int(owners[away.argmin()])
