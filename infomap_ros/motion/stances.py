"""Places where the base can stand for the arm to bring the camera to a view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.arm.arm_path import QUICK_SEARCH, plan_arm_path
from infomap_ros.motion.arm.inverse_kinematics import IkConfig, solve_ik_batch
from infomap_ros.motion.base.base_planner import BasePlanner
from infomap_ros.motion.base.drive_space import apart
from infomap_ros.motion.collision.checker import CollisionChecker, NearSpace
from infomap_ros.motion.whole_body import ReachingConfig, WholeBody

_LEAN = 0.1  # [rad]
_UNEVEN = 0.1  # [m]; by which the base's origin may be off from level ground below its middle
_ASKED = 50


@dataclass(frozen=True, eq=False)
class Stances:
    """Places for the base.

    Attributes:
        places: x, y [m] and yaw [rad] in the map, shape (P, 3).
        q: posture of the arm that brings the camera to the view there, shape (P, n) [rad or m].
        T_map_base: how the robot stands there, shape (P, 4, 4).
    """

    places: FloatArray
    q: FloatArray
    T_map_base: FloatArray

    def rows(self, chosen: np.ndarray | list[int]) -> Stances:
        """Some of them."""
        return Stances(self.places[chosen], self.q[chosen], self.T_map_base[chosen])


@dataclass(frozen=True, eq=False)
class StanceFinder:
    """Looks for stances in one state of map and robot.

    Attributes:
        whole: the robot.
        planner: of its base.
        near: the map around places.
        config: effort and tolerances.
        here: x, y, yaw of the base now, shape (3,).
    """

    whole: WholeBody
    planner: BasePlanner
    near: NearSpace
    config: ReachingConfig
    here: FloatArray

    def preferred_places(self, view: FloatArray) -> FloatArray:
        """Places from which a level base would reach a view, whatever the ground, shape (P, 3)."""
        places, _, _ = self.whole.postures.places_for(view, self._steepness_tolerance)
        count = min(len(places), self.config.goals)
        return places[np.random.default_rng(0).choice(len(places), count, replace=False)]

    def find(self, view: FloatArray) -> tuple[Stances | None, str]:
        """Stances for one view, T_map_camera (4, 4), the nearest first; or why there are none.

        Cheap conditions are asked first.
        """
        found, reason = self._standing(view)
        if found is None:
            return None, reason
        checker = self.near.checker_around(found.T_map_base)
        found, reason = self._reaching(view, found, checker)
        if found is None:
            return None, reason
        nearest = found.rows(np.argsort(apart(found.places, self.here))[: self.config.goals])
        good, reason = self._unfolding(nearest)
        return (nearest.rows(good), "") if good else (None, reason)

    def _standing(self, view: FloatArray) -> tuple[Stances | None, str]:
        """Places on ground that can be reached, at the right height, where the robot stands."""
        places, heights, rows = self.whole.postures.places_for(view, self._steepness_tolerance)
        terrain, area = self.planner.terrain, self.planner.reachable_area(self.here)
        cells = terrain.cells_of(places)
        inside = np.asarray(((cells >= 0) & (cells < area.shape)).all(axis=1))
        inside[inside] = area[tuple(cells[inside].T)]
        if not inside.any():
            return None, "no ground that the base can reach is near enough to the view"
        grounds = terrain.heights[tuple(cells[inside].T)] + self.whole.origin_height
        chosen = np.flatnonzero(inside)[np.abs(grounds - heights[inside]) <= _UNEVEN]
        if not len(chosen):
            return None, "the view is too high or too low above the ground around it"
        if len(chosen) > self.config.stances:
            chosen = np.random.default_rng(0).choice(chosen, self.config.stances, replace=False)
        stances = self.planner.vehicle.stances(terrain, places[chosen])
        if not stances.ok.any():
            why = self.planner.vehicle.refusal(terrain, places[chosen[0]])
            return None, f"no safe stance among {len(chosen)}, for example: {why}"
        ok = stances.ok
        postures = self.whole.postures.q[rows[chosen[ok]]]
        return Stances(places[chosen[ok]], postures, stances.T_map_base[ok]), ""

    def _reaching(
        self, view: FloatArray, found: Stances, checker: CollisionChecker
    ) -> tuple[Stances | None, str]:
        """Those where the arm reaches the view and touches nothing."""
        config = IkConfig(
            position_tolerance=self.config.position_tolerance,
            rotation_tolerance=self.config.direction_tolerance,
            restarts=0,
        )
        solved = solve_ik_batch(
            self.whole.chain, np.linalg.inv(found.T_map_base) @ view, direction_only=True,
            q_start=found.q, config=config,
        )  # fmt: skip
        count = len(solved.converged)
        if not solved.converged.any():
            return None, f"no inverse kinematics at {count} stances"
        reached = Stances(found.places, solved.q, found.T_map_base).rows(solved.converged)
        reached = reached.rows(self.whole.sees_past_itself(reached.q))
        if not len(reached.q):
            return None, f"the robot itself covers too much of the image at all of {count} stances"
        free = checker.are_free(reached.q, reached.T_map_base)
        if not free.any():
            return (
                None,
                f"the arm is free at none of {len(free)} stances: {_mostly(checker, reached)}",
            )
        return reached.rows(free), ""

    def _unfolding(self, found: Stances) -> tuple[list[int], str]:
        """Rows of those where the arm gets from the driving posture to the view in balance."""
        good: list[int] = []
        reason = ""
        vehicle, terrain = self.planner.vehicle, self.planner.terrain
        for row, (place, q, pose) in enumerate(
            zip(found.places, found.q, found.T_map_base, strict=True)
        ):
            refusal = vehicle.refusal(terrain, place, q)
            if refusal:
                reason = f"with the arm at the view: {refusal}"
                continue
            checker = self.near.checker_at(pose)
            path = plan_arm_path(checker, self.whole.driving, q, pose, QUICK_SEARCH)
            if path.converged:
                good.append(row)
            else:
                reason = f"unfolding the arm: {path.reason}"
        return good, reason

    @property
    def _steepness_tolerance(self) -> float:
        """The base may lean when it stands there [rad]."""
        return self.config.direction_tolerance + _LEAN


def _mostly(checker: CollisionChecker, found: Stances) -> str:
    """What the arm touches at most of the first places, with one of them."""
    reports = [
        checker.contact(q, pose)
        for q, pose in zip(found.q[:_ASKED], found.T_map_base[:_ASKED], strict=True)
    ]
    kinds = [what.split(" at ")[0] for what in reports]
    commonest = max(kinds, key=kinds.count)
    return f"mostly {reports[kinds.index(commonest)]}"
