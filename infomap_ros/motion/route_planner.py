"""Routes of base and arm from where the robot is, and where the arm has been since it stands there.

The map may change its mind about space through which the arm has come: a scan adds a speck of
noise, or the base stands a little off from where the path was planned. The path back is open all
the same, as the body itself has just been there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.arm.arm_path import QUICK_SEARCH, plan_arm_path, time_path
from infomap_ros.motion.arm.inverse_kinematics import IkConfig, solve_ik, solve_ik_batch
from infomap_ros.motion.base.drive_space import BasePath
from infomap_ros.motion.base.path_following import drive_seconds
from infomap_ros.motion.collision.checker import NearSpace
from infomap_ros.motion.route import ArmPath, ReachResult, Route
from infomap_ros.motion.whole_body import SAME_POSTURE, ReachingConfig, WholeBody

_SAME = 0.05  # [rad or m]; by which an arm may be off from its path
_MOVED = 0.1  # [m]; by which a base that stands may seem to move
_TURNED = 0.15  # [rad]
_STRAIGHT = 1e-6  # [rad or m]


@dataclass(frozen=True, eq=False)
class ArmTrail:
    """Configurations that the arm has passed, with straight lines between them.

    Attributes:
        T_map_base: where the base stands, shape (4, 4).
        positions: the oldest first, the present one last, shape (K, n) [rad or m].
    """

    T_map_base: FloatArray
    positions: FloatArray

    @classmethod
    def at(cls, T_map_base: FloatArray, q: FloatArray) -> ArmTrail:
        """Nothing is known but where the robot is."""
        return cls(np.array(T_map_base), np.array(q, dtype=np.float64)[None])

    def after(self, T_map_base: FloatArray, q: FloatArray, route: Route | None) -> ArmTrail:
        """The trail of a robot that was sent along a route, or along none, and is now here.

        A route may have been left at any point; what the arm has done besides it is not known.

        Args:
            T_map_base: where the base is, shape (4, 4).
            q: where the arm is, shape (n,).
            route: that began where this trail ends.
        """
        fresh = ArmTrail.at(T_map_base, q)
        if route is not None and route.moves_base:
            passed = _passed(route.arm_after, q)
            if passed is not None:
                return ArmTrail(fresh.T_map_base, passed)
        if self._stood_elsewhere(T_map_base):
            return fresh
        steps = [] if route is None else [route.arm_before]
        if route is not None and not route.moves_base:
            steps.append(route.arm_after)
        if np.abs(self.positions[-1] - q).max(initial=0.0) <= _SAME and not any(
            step.moves for step in steps
        ):
            return ArmTrail(fresh.T_map_base, np.concatenate([self.positions, fresh.positions]))
        before = self.positions
        for step in steps:
            passed = _passed(step, q)
            if passed is not None:
                return ArmTrail(fresh.T_map_base, np.concatenate([before, passed]))
            before = np.concatenate([before, step.positions])
        return fresh

    def back(self) -> FloatArray:
        """Corners of the path back, the present configuration first, shape (K, n)."""
        return corners_of(self.positions)[::-1]

    def _stood_elsewhere(self, T_map_base: FloatArray) -> bool:
        change = np.linalg.inv(self.T_map_base) @ T_map_base
        turn = math.acos(min(max(0.5 * (np.trace(change[:3, :3]) - 1.0), -1.0), 1.0))
        return float(np.linalg.norm(change[:3, 3])) > _MOVED or turn > _TURNED


def corners_of(positions: FloatArray) -> FloatArray:
    """Leave out the configurations, of (K, n), that lie on the line between their neighbors."""
    differs = np.abs(np.diff(positions, axis=0)).max(axis=1, initial=0.0) > _STRAIGHT
    positions = positions[np.append(True, differs)]
    kept = [0]
    for row in range(1, len(positions) - 1):
        first, middle, last = positions[kept[-1]], positions[row], positions[row + 1]
        line = last - first
        length = float(line @ line)
        share = float((middle - first) @ line) / length if length > 0.0 else 2.0
        on_line = 0.0 <= share <= 1.0 and np.abs(first + share * line - middle).max() <= _STRAIGHT
        if not on_line:
            kept.append(row)
    if len(positions) > 1:
        kept.append(len(positions) - 1)
    return positions[kept]


def _passed(path: ArmPath, q: FloatArray) -> FloatArray | None:
    """The part of a path that an arm at `q` has behind it; None if it is not on that path."""
    if not len(path.positions):
        return None
    away = np.abs(path.positions - q).max(axis=1, initial=0.0)
    nearest = int(np.argmin(away))
    if away[nearest] > _SAME:
        return None
    return np.concatenate([path.positions[: nearest + 1], q[None]])


_BRANCHES = 5  # corners of the trail from which another path is sought
_POSTURES_TRIED = 400
_NEAREST_TRIED = 6  # postures near a view to which a path is sought
_ALIKE = 0.3  # [rad or m]; where no path leads to a posture, none leads to one so near to it
_SEES_ITSELF = "the robot itself covers too much of the image"
_OUT_OF_REACH = "the arm does not reach it from where the base stands"
_BESIDE = 0.003  # [rad or m] beside where the arm has been: as good as there


@dataclass(frozen=True, eq=False)
class RoutePlanner:
    """Puts routes together for one state of map and robot. The base drives after `foldable`.

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
        """A path of the arm where the base stands: through free space, or back along its trail."""
        base = self.trail.T_map_base
        direct = self.arm(self.q, goal, base)
        return direct if direct.converged else self._back_and_on(goal, direct)

    def arm(
        self, start: FloatArray, goal: FloatArray, T_map_base: FloatArray, quick: bool = False
    ) -> ArmPath:
        """A path of the arm through free space where the base stands at a place, shape (4, 4)."""
        checker, limits = self.near.checker_at(T_map_base), self.config.trajectory
        effort = QUICK_SEARCH if quick else self.config.arm_path
        return plan_arm_path(checker, start, goal, T_map_base, effort, limits)

    def arm_to_view(
        self, view: FloatArray, ik: IkConfig, planned: FloatArray | None = None
    ) -> tuple[ReachResult | None, str]:
        """The motion of the arm alone to a view, or None and why not.

        Args:
            view: ``T_map_camera``, shape (4, 4).
            ik: tolerances; the roll about the optical axis is free.
            planned: posture, shape (n,), like which the arm is to be where that can be.
        """
        base, refused = self.trail.T_map_base, []
        checker = self.near.checker_at(base)

        def is_valid(q: FloatArray) -> bool:
            touched = checker.contact(q, base)
            if touched:
                refused.append(f"touches {touched}")
            elif not self.whole.sees_past_itself(q[None])[0]:
                refused.append(_SEES_ITSELF)
            else:
                return True
            return False

        found = solve_ik(
            self.whole.chain, np.linalg.inv(base) @ view, direction_only=True,
            q_start=self.q if planned is None else planned, config=ik, is_valid=is_valid,
        )  # fmt: skip
        if not found.converged:
            return None, refused[-1] if refused else found.reason
        arm = self.arm_from_here(found.q)
        if not arm.converged:
            return None, arm.reason
        return self.with_arm_alone(arm), ""

    def arm_near_view(
        self,
        view: FloatArray,
        position_tolerance: float,
        angle_tolerance: float,
        planned: FloatArray | None = None,
    ) -> ReachResult:
        """The motion of the arm alone as near to a view as it can come.

        Args:
            view: ``T_map_camera``, shape (4, 4).
            position_tolerance: [m].
            angle_tolerance: of the viewing direction [rad].
            planned: as for `arm_to_view`.

        Returns:
            With a reason where that is not within both tolerances; no route without any motion.
        """
        base, tolerances = self.trail.T_map_base, (position_tolerance, angle_tolerance)
        qs, errors = postures_near(self.whole, np.linalg.inv(base) @ view, *tolerances, planned)
        checker = self.near.checker_at(base)
        sees = self.whole.sees_past_itself(qs)
        free = np.flatnonzero(checker.are_free(qs, base) & sees)
        reason = "no posture near the view is free"
        if len(free):
            touched = checker.contact(qs[0], base)
            reason = f"the nearest posture touches {touched}" if touched else _OUT_OF_REACH
        for row in _apart(qs, free):
            from_here = self.arm_from_here if row == free[0] else self._quick_arm
            arm = from_here(qs[row])
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
        return ReachResult("", 0.0, arm.joint_travel, route, False, camera, arm.duration)

    def with_base(self, path: BasePath, q: FloatArray) -> ReachResult:
        """Fold the arm, drive, and unfold it to `q`, shape (n,).

        Where the path is partial and the arm cannot unfold at its end, it stays folded.
        """
        if len(path.poses) < 2 and not path.complete:
            return ReachResult(f"base path: {path.reason}")
        before, end = self._folding, path.T_map_base[-1]
        if not before.converged:
            return ReachResult(f"arm at the beginning of the base path: {before.reason}")
        after = self.arm(self.whole.driving, q, end, quick=not path.complete)
        if not after.converged and path.complete:
            return ReachResult(f"arm at the end of the base path: {after.reason}")
        if not after.converged:
            after = ArmPath.staying(self.whole.chain.joint_names, self.whole.driving)
        camera = end @ self.whole.chain.camera_pose(after.positions[-1])
        partial = not path.complete
        route = Route(before, path.poses, path.T_map_base, after, camera, partial)
        reason = "" if path.complete else f"base path: {path.reason}"
        travel = before.joint_travel + after.joint_travel
        seconds = before.duration + after.duration
        seconds += drive_seconds(path.poses, self.config.following)
        return ReachResult(reason, path.length, travel, route, partial, camera, seconds)

    def posture_like(self, view: FloatArray, T_map_base: FloatArray) -> FloatArray:
        """Of some postures, and the driving one, the one whose camera is most like a view.

        Args:
            view: ``T_map_camera``, shape (4, 4).
            T_map_base: where the base stands then, shape (4, 4).

        Returns:
            Shape (n,) [rad or m].
        """
        qs = np.concatenate([self.whole.driving[None], self.whole.postures.q[:_POSTURES_TRIED]])
        qs = qs[self.near.checker_at(T_map_base).are_free(qs, T_map_base)]
        if not len(qs):
            return self.whole.driving
        cameras = T_map_base @ self.whole.chain.camera_pose(qs)
        away = np.linalg.norm(cameras[:, :3, 3] - view[:3, 3], axis=1)
        angles = np.arccos(np.clip(cameras[:, :3, 2] @ view[:3, 2], -1.0, 1.0))
        return np.asarray(qs[int(np.argmin(away + angles))])

    def _quick_arm(self, goal: FloatArray) -> ArmPath:
        """A path of the arm from where it is, sought with less effort."""
        return self.arm(self.q, goal, self.trail.T_map_base, quick=True)

    def foldable(self) -> RoutePlanner:
        """The same with a posture to drive in to which there is a path here.

        The usual one where that can be, else another that is compact, else the one in which the
        base came to where it stands: it is the farthest back on the trail.
        """
        base, whole = self.trail.T_map_base, self.whole
        if self._folding.converged:
            return self
        checker = self.near.checker_at(base)
        for row in np.flatnonzero(checker.are_free(whole.compact, base))[:_BRANCHES]:
            if self._quick_arm(whole.compact[row]).converged:
                return replace(self, whole=whole.driving_in(whole.compact[row]))
        return replace(self, whole=whole.driving_in(self.trail.back()[-1]))

    @cached_property
    def _folding(self) -> ArmPath:
        """To the posture to drive in."""
        return self.arm_from_here(self.whole.driving)

    def _back_and_on(self, goal: FloatArray, direct: ArmPath) -> ArmPath:
        """Back along the trail, to the goal if that is on it, else on from one of its corners."""
        back = self.trail.back()
        on_it = np.flatnonzero(np.abs(back - goal).max(axis=1, initial=0.0) <= SAME_POSTURE)
        if len(on_it):
            return self._timed_back(back[: on_it[0] + 1])
        base = self.trail.T_map_base
        checker = self.near.checker_at(base)
        for row in range(1, min(len(back), _BRANCHES + 1)):
            on = plan_arm_path(checker, back[row], goal, base, QUICK_SEARCH)
            if on.converged:
                path = np.concatenate([back[:row], corners_of(on.positions)])
                return self._timed_back(path)
        return direct

    def _timed_back(self, corners: FloatArray) -> ArmPath:
        """Times for a path back, on which the arm may come off its corners by next to nothing."""
        trajectory = self.config.trajectory
        deviation = min(trajectory.corner_deviation, _BESIDE)
        limits = replace(trajectory, corner_deviation=deviation)
        return time_path(self.whole.chain, corners, limits, lambda first, second: True)


def _apart(qs: FloatArray, rows: NDArray[np.intp]) -> list[int]:
    """The first rows of postures, shape (M, n), that are not like an earlier one."""
    kept: list[int] = []
    for row in rows:
        if len(kept) == _NEAREST_TRIED:
            break
        if not kept or np.abs(qs[kept] - qs[row]).max(axis=1, initial=0.0).min() > _ALIKE:
            kept.append(int(row))
    return kept


_SOLVED = 64  # views about the wanted one for which inverse kinematics is solved
_SAMPLED = 400  # random postures that are nearest to it
_WITHIN = 0.8  # share of the tolerances within which these views lie: the rest is for the solver


def postures_near(
    whole: WholeBody,
    T_base_camera: FloatArray,
    position_tolerance: float,
    angle_tolerance: float,
    start: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Postures by how far the camera is from a view; nothing is said of what they touch.

    An arm reaches most views in few postures only, but views within the tolerances in many more.

    Args:
        whole: the robot.
        T_base_camera: the view, shape (4, 4).
        position_tolerance: [m].
        angle_tolerance: of the viewing direction [rad]; the roll is free.
        start: a posture, shape (n,), like which some of the solutions are to be.

    Returns:
        Postures, shape (M, n) [rad or m], the nearest first; and their errors, shape (M,): at most
        1 within both tolerances, else more.
    """
    postures, view = whole.postures, T_base_camera
    flat, azimuths = np.cos(postures.steepness), postures.azimuths
    directions = np.column_stack(
        [flat * np.cos(azimuths), flat * np.sin(azimuths), np.sin(postures.steepness)]
    )
    errors = _errors(postures.positions, directions, view, position_tolerance, angle_tolerance)
    nearest = postures.q[np.argsort(errors)[:_SAMPLED]]
    views = _views_about(view, _WITHIN * position_tolerance, _WITHIN * angle_tolerance)
    config = IkConfig(
        position_tolerance=0.1 * position_tolerance,
        rotation_tolerance=0.1 * angle_tolerance,
        restarts=0,
    )
    starts = np.resize(nearest, (_SOLVED, nearest.shape[1]))
    if start is not None:
        starts[::4] = start
    solved = solve_ik_batch(
        whole.chain, views, direction_only=True, q_start=starts, config=config
    ).q
    found = np.concatenate([solved, nearest])
    cameras = whole.chain.camera_pose(found)
    errors = _errors(
        cameras[:, :3, 3], cameras[:, :3, 2], view, position_tolerance, angle_tolerance
    )
    order = np.argsort(errors, kind="stable")
    return found[order], errors[order]


def _errors(
    positions: FloatArray, directions: FloatArray, view: FloatArray, away: float, turned: float
) -> FloatArray:
    """Errors of position and direction as shares of their tolerances, shape (M,).

    The larger one where that is at most 1. Beside the tolerances both count: a camera that is a
    little nearer shows less of what was to be seen where it looks elsewhere.
    """
    distances = np.linalg.norm(positions - view[:3, 3], axis=1) / away
    angles = np.arccos(np.clip(directions @ view[:3, 2], -1.0, 1.0)) / turned
    larger = np.maximum(distances, angles)
    return np.where(larger <= 1.0, larger, np.hypot(distances, angles))


def _views_about(view: FloatArray, away: float, turned: float) -> FloatArray:
    """Views at most so far from one, itself first, shape (`_SOLVED`, 4, 4); always the same."""
    rng, views = np.random.default_rng(0), np.tile(view, (_SOLVED, 1, 1))
    offsets = rng.normal(size=(_SOLVED, 3))
    offsets *= away * rng.random((_SOLVED, 1)) / np.linalg.norm(offsets, axis=1, keepdims=True)
    angles, sides = turned * rng.random(_SOLVED), 2.0 * np.pi * rng.random(_SOLVED)
    offsets[0], angles[0] = 0.0, 0.0
    across, upward, ahead = view[:3, 0], view[:3, 1], view[:3, 2]
    axes = np.outer(np.cos(sides), across) + np.outer(np.sin(sides), upward)
    turned_ahead = np.outer(np.cos(angles), ahead) + np.sin(angles)[:, None] * axes
    side = np.cross(upward, turned_ahead)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    views[:, :3, 0], views[:, :3, 1] = side, np.cross(turned_ahead, side)
    views[:, :3, 2] = turned_ahead
    views[:, :3, 3] += offsets
    return views
