"""Where a robot looks next for a target that is not in sight, and how its camera gets there.

Nothing is mapped yet and the map's frame is not known, so all is in the frame of odometry, and the
robot moves in its own clear start alone: the arm turns the camera, and where that does not suffice,
the base turns or drives a little. The looks are those of `localization.target.search`.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation

from infomap_ros.exploration.robot import Choice, MapProgress, RobotState
from infomap_ros.exploration.view_planner_config import ViewPlannerConfig
from infomap_ros.geometry import PinholeCamera
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.target.search import TargetSearch, TargetSearchConfig
from infomap_ros.mapping import VoxelMap
from infomap_ros.motion.base.standing_ground import ClearStart
from infomap_ros.motion.reaching import WholeBodyReach
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.motion.robot.solid_extent import random_postures
from infomap_ros.motion.route import Route

_NO_MAP = MapProgress(0.0, math.nan, math.nan, 0, 0, 0.0)
_POSTURES = 3000
_TRIES = 3  # postures for one look
# Share of the directions looked at in vain after which the target is given up.
_ENOUGH = 0.97
_MOST_FAILURES = 40  # looks that cannot be had, in one choice
_SAME = 1.0 + 2.0 * np.cos(0.03)  # trace of a turn by 0.03 rad
_BASE_TURN = 2.0  # [rad] of a joint's travel that turning the base at all counts for


class TargetSearchPlanner:
    """Chooses look after look until all directions were seen that can be seen.

    Args:
        robot: with its camera frame.
        camera: whose field of view counts.
        planner: how the robot reaches its views, and how far about its start it is clear.
        config: where the target may be.
    """

    def __init__(
        self,
        robot: RobotModel,
        camera: PinholeCamera,
        planner: ViewPlannerConfig | None = None,
        config: TargetSearchConfig | None = None,
    ) -> None:
        self.robot, self._config = robot, planner or ViewPlannerConfig()
        self._search = TargetSearch(camera, config)
        self._map, self._looks = VoxelMap(), 0
        self._tried: list[FloatArray] = []
        self._start: ClearStart | None = None
        self._reach: WholeBodyReach | None = None
        self._sent: Route | None = None
        rng = np.random.default_rng(self._config.seed)
        self._postures = self._upright(random_postures(robot, _POSTURES, rng))
        self._cameras = robot.arm.camera_pose(self._postures)  # in the base frame

    def choose(self, state: RobotState) -> Choice:
        """The next look.

        Args:
            state: where the robot is in the frame of odometry; what it sees from there does not
                show the target.

        Returns:
            Pose and route in the frame of odometry; without a route where nothing is left to look
            at, and the reason says how much was seen in vain.
        """
        self._search.look(state.T_map_camera)
        self._looks += 1
        tries = _Tries(self, state, self._reach_from(state))
        proposed = []
        if self._search.seen_share < _ENOUGH:
            proposed = self._search.proposals(state.T_map_camera, 1, tries.can_look)
        seen = f"{self._looks} looks, {100.0 * self._search.seen_share:.0f} % of the directions"
        self._sent = tries.route
        if not proposed or tries.route is None:
            why = f"; the rest cannot be looked at: {tries.reason}" if tries.reason else ""
            return Choice(_NO_MAP, None, None, f"the target was not found: {seen}{why}")
        self._tried.append(proposed[0].rotation)
        share, pose = proposed[0].new_share, tries.route.T_map_camera
        reason = f"looking for the target: {seen} so far, {100.0 * share:.0f} % to come"
        return Choice(_NO_MAP, pose, tries.route, reason)

    def poses_for(self, rotation: FloatArray, state: RobotState) -> FloatArray:
        """Camera poses that look along a rotation's optical axis, the cheapest first.

        Args:
            rotation: of the camera, shape (3, 3), in the frame of odometry.
            state: where the robot is.

        Returns:
            Shape (N, 4, 4). The first ones are for the arm alone, where it turns so far.
        """
        axis = state.T_map_base[:3, :3].T @ rotation[:, 2]
        axes = self._cameras[:, :3, 2]
        off = np.abs(np.arcsin(np.clip(axes[:, 2], -1, 1)) - np.arcsin(np.clip(axis[2], -1, 1)))
        turns = _wrapped(np.arctan2(axis[1], axis[0]) - np.arctan2(axes[:, 1], axes[:, 0]))
        away = np.abs(self._postures - self.robot.arm.positions(state.joints))
        small = np.abs(turns) < 0.1
        joints = away.max(axis=1, initial=0.0)
        cost = 10.0 * np.abs(off) + joints + np.where(small, 0.0, _BASE_TURN + np.abs(turns))
        best = np.argsort(cost)[:_TRIES]
        turned = Rotation.from_rotvec(np.outer(np.where(small, 0.0, turns)[best], [0.0, 0.0, 1.0]))
        moves = np.tile(np.eye(4), (len(best), 1, 1))
        moves[:, :3, :3] = turned.as_matrix()
        return np.asarray(state.T_map_base @ moves @ self._cameras[best])

    def was_tried(self, rotation: FloatArray) -> bool:
        """Whether the robot was already asked to look so, shape (3, 3)."""
        return any(float(np.trace(before.T @ rotation)) > _SAME for before in self._tried)

    def _reach_from(self, state: RobotState) -> WholeBodyReach:
        config = self._config
        if self._start is None:
            self._start = ClearStart(state.T_map_base, config.start_clearance)
        self._reach = WholeBodyReach(
            self.robot,
            self._map,
            state.T_map_base,
            state.joints,
            config.reaching,
            self._start,
            previous=self._reach,
            sent=self._sent,
        )
        return self._reach

    def _upright(self, postures: FloatArray) -> FloatArray:
        """Those that do not hold the camera upside down, where there are any."""
        upright = self.robot.arm.camera_pose(postures)[:, 2, 1] < 0.0
        return postures[upright] if upright.any() else postures


class _Tries:
    """Tries to reach looks; keeps the last route or why there was none."""

    def __init__(
        self, planner: TargetSearchPlanner, state: RobotState, reach: WholeBodyReach
    ) -> None:
        self._planner, self._state, self._reach = planner, state, reach
        self._failures = 0
        self.route: Route | None = None
        self.reason = ""

    def can_look(self, rotation: FloatArray) -> bool:
        """Whether the camera can be turned so, shape (3, 3), from somewhere near."""
        if self._failures >= _MOST_FAILURES or self._planner.was_tried(rotation):
            return False
        for pose in self._planner.poses_for(rotation, self._state):
            result = self._reach.reach(pose)
            if result.route is not None and not result.partial:
                self.route = result.route
                return True
            self.reason = result.reason
        self._failures += 1
        return False


def _wrapped(angles: FloatArray) -> FloatArray:
    return np.asarray((angles + np.pi) % (2.0 * np.pi) - np.pi)
