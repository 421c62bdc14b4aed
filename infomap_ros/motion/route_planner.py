"""Routes of base and arm from where the robot is."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.arm.arm_path import QUICK_SEARCH, plan_arm_path
from infomap_ros.motion.arm.arm_trail import ArmTrail, corners_of
from infomap_ros.motion.arm.inverse_kinematics import IkConfig, solve_ik
from infomap_ros.motion.arm.trajectory import time_path
from infomap_ros.motion.base.base_path import BasePath
from infomap_ros.motion.collision.near_space import NearSpace
from infomap_ros.motion.postures_near import postures_near
from infomap_ros.motion.reaching_config import ReachingConfig
from infomap_ros.motion.route import ArmPath, ReachResult, Route
from infomap_ros.motion.whole_body import WholeBody

_BRANCHES = 5  # corners of the trail from which another way is sought
_POSTURES_TRIED = 400
_NEAREST_TRIED = 3  # postures near a view to which a way is sought
_THERE = 1e-6  # [rad or m]
_BESIDE = 0.003  # [rad or m] beside where the arm has been: as good as there


@dataclass(frozen=True, eq=False)
class RoutePlanner:
    """Puts routes together for one state of map and robot.

    Attributes:
        whole: the robot.
        near: the map around places.
        config: effort and speeds.
        trail: where the arm has been; ends where the robot is.
    """

    whole: WholeBody
    near: NearSpace
    config: ReachingConfig
    trail: ArmTrail

    @property
    def q(self) -> FloatArray:
        """Where the arm is, shape (n,)."""
        return self.trail.positions[-1]

    def arm_from_here(self, goal: FloatArray) -> ArmPath:
        """A way of the arm where the base stands: through free space, or back along its trail."""
        base = self.trail.T_map_base
        direct = self.arm(self.q, goal, base)
        return direct if direct.converged else self._back_and_on(goal, direct)

    def arm(self, start: FloatArray, goal: FloatArray, T_map_base: FloatArray) -> ArmPath:
        """A way of the arm through free space where the base stands at a place, shape (4, 4)."""
        checker, config = self.near.checker_at(T_map_base), self.config
        return plan_arm_path(checker, start, goal, T_map_base, config.arm_path, config.trajectory)

    def arm_to_view(self, view: FloatArray, ik: IkConfig) -> tuple[ReachResult | None, str]:
        """The motion of the arm alone to a view, or None and why not.

        Args:
            view: ``T_map_camera``, shape (4, 4).
            ik: tolerances; the roll about the optical axis is free.
        """
        base, touched = self.trail.T_map_base, []
        checker = self.near.checker_at(base)

        def is_valid(q: FloatArray) -> bool:
            report = checker.check(q, base, base=False)
            touched.append(report.what)
            return report.free

        found = solve_ik(
            self.whole.chain, np.linalg.inv(base) @ view, direction_only=True, q_start=self.q,
            config=ik, is_valid=is_valid,
        )  # fmt: skip
        if not found.converged:
            return None, f"touches {touched[-1]}" if touched else found.reason
        arm = self.arm_from_here(found.q)
        if not arm.converged:
            return None, arm.reason
        return self.with_arm_alone(arm), ""

    def arm_near_view(
        self, view: FloatArray, position_tolerance: float, angle_tolerance: float
    ) -> ReachResult:
        """The motion of the arm alone as near to a view as it can come.

        Args:
            view: ``T_map_camera``, shape (4, 4).
            position_tolerance: [m].
            angle_tolerance: of the viewing direction [rad].

        Returns:
            With a reason where that is not within both tolerances; no route without any motion.
        """
        base, tolerances = self.trail.T_map_base, (position_tolerance, angle_tolerance)
        qs, errors = postures_near(self.whole, np.linalg.inv(base) @ view, *tolerances)
        checker = self.near.checker_at(base)
        free = np.flatnonzero(checker.are_free(qs, base, base=False))
        reason = "no posture near the view is free"
        if len(free):
            reason = f"the nearest posture touches {checker.check(qs[0], base, base=False).what}"
        for row in free[:_NEAREST_TRIED]:
            arm = self.arm_from_here(qs[row])
            if arm.converged:
                return replace(
                    self.with_arm_alone(arm), reason="" if errors[row] <= 1.0 else reason
                )
            reason = arm.reason
        return ReachResult(reason)

    def with_arm_alone(self, arm: ArmPath) -> ReachResult:
        """The route of an arm whose base stays."""
        names, q = self.whole.chain.joint_names, arm.positions[-1]
        camera = self.trail.T_map_base @ self.whole.chain.camera_pose(q)
        staying = ArmPath.staying(names, self.q)
        route = Route(staying, np.zeros((0, 3)), np.zeros((0, 4, 4)), arm, camera)
        return ReachResult("", 0.0, arm.joint_travel, route, False, camera)

    def with_base(self, path: BasePath, q: FloatArray) -> ReachResult:
        """Fold the arm, drive, and unfold it to `q`, shape (n,).

        Where the way is partial and the arm cannot unfold at its end, it stays folded.
        """
        if len(path.poses) < 2 and not path.complete:
            return ReachResult(f"base path: {path.reason}")
        if self.why_not_folded:
            return ReachResult(self.why_not_folded)
        end = path.T_map_base[-1]
        after = self.arm(self.whole.driving, q, end)
        if not after.converged and path.complete:
            return ReachResult(f"arm at the end of the base path: {after.reason}")
        if not after.converged:
            after = ArmPath.staying(self.whole.chain.joint_names, self.whole.driving)
        camera = end @ self.whole.chain.camera_pose(after.positions[-1])
        before, partial = self._folding, not path.complete
        method = path.method if len(path.poses) > 1 else ""
        route = Route(before, path.poses, path.T_map_base, after, camera, partial, method)
        reason = "" if path.complete else f"base path: {path.reason}"
        travel = before.joint_travel + after.joint_travel
        return ReachResult(reason, path.length, travel, route, partial, camera)

    def posture_like(self, view: FloatArray, T_map_base: FloatArray) -> FloatArray:
        """Of some postures, and the driving one, the one whose camera is most like a view.

        Args:
            view: ``T_map_camera``, shape (4, 4).
            T_map_base: where the base stands then, shape (4, 4).

        Returns:
            Shape (n,) [rad or m].
        """
        qs = np.concatenate([self.whole.driving[None], self.whole.postures.q[:_POSTURES_TRIED]])
        qs = qs[self.near.checker_at(T_map_base).are_free(qs, T_map_base, base=False)]
        if not len(qs):
            return self.whole.driving
        cameras = T_map_base @ self.whole.chain.camera_pose(qs)
        away = np.linalg.norm(cameras[:, :3, 3] - view[:3, 3], axis=1)
        angles = np.arccos(np.clip(cameras[:, :3, 2] @ view[:3, 2], -1.0, 1.0))
        return np.asarray(qs[int(np.argmin(away + angles))])

    @property
    def why_not_folded(self) -> str:
        """Why the arm cannot be brought to the driving posture, or empty."""
        folding = self._folding
        return "" if folding.converged else f"folding the arm to drive: {folding.reason}"

    @cached_property
    def _folding(self) -> ArmPath:
        return self.arm_from_here(self.whole.driving)

    def _back_and_on(self, goal: FloatArray, direct: ArmPath) -> ArmPath:
        """Back along the trail, to the goal if that is on it, else on from one of its corners."""
        back = self.trail.back()
        on_it = np.flatnonzero(np.abs(back - goal).max(axis=1) <= _THERE)
        if len(on_it):
            return self._timed_back(back[: on_it[0] + 1])
        base = self.trail.T_map_base
        checker = self.near.checker_at(base)
        for row in range(1, min(len(back), _BRANCHES + 1)):
            on = plan_arm_path(checker, back[row], goal, base, QUICK_SEARCH)
            if on.converged:
                way = np.concatenate([back[:row], corners_of(on.positions)])
                return self._timed_back(way)
        return direct

    def _timed_back(self, way: FloatArray) -> ArmPath:
        """Times for a way back, on which the arm may come off its corners by next to nothing."""
        trajectory = self.config.trajectory
        deviation = min(trajectory.corner_deviation, _BESIDE)
        limits = replace(trajectory, corner_deviation=deviation)
        return time_path(self.whole.chain, way, limits, lambda first, second: True)
