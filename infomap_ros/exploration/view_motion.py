"""How the robot gets to views: routes to them, and the check of the one that is carried out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from infomap_ros.exploration.robot import KnownPlace, RobotState
from infomap_ros.exploration.task import TaskConfig
from infomap_ros.exploration.view_planner_config import ViewPlannerConfig
from infomap_ros.geometry import PinholeCamera, PlacedSolid
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.files.export import ProjectedGrid
from infomap_ros.motion.base.standing_ground import ClearStart, known_ground
from infomap_ros.motion.keep_out import KeepOut, Obstacle, with_keep_out
from infomap_ros.motion.reaching import WholeBodyReach, traversability
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.motion.route import ReachResult, Route
from infomap_ros.motion.route_check import RouteCheck
from infomap_ros.motion.whole_body import WholeBody, base_sigma
from infomap_ros.views.situation import MotionTimes

_POSTURES = 500  # of which the time of a usual motion of the arm is the mean
_LOOK = 3.0  # [s] of a look and of choosing the view after it
_CORRECTION = 1.0
"""Longest drive that corrects where the base has stopped [m]: one that goes back, turns and comes
again brings a base there that is 0.12 m and 0.2 rad off, which counts as arrived."""


class ViewMotion:
    """Plans routes from wherever the robot is, each knowing of the one before.

    Args:
        robot: with its camera frame.
        config: of the motion, and of the space that is clear about the start.
        task: how near the camera must come to a view.
        camera: in whose image the robot itself must not cover much; None where that is no matter.

    Attributes:
        config: as given; may be replaced.
        task: likewise.
        keep_out: regions and fences besides those of the task, where the base must not go; may be
            replaced, and then the route that is carried out is judged by them.
    """

    def __init__(
        self,
        robot: RobotModel,
        config: ViewPlannerConfig,
        task: TaskConfig,
        camera: PinholeCamera | None = None,
    ) -> None:
        self._robot, self.config, self.task, self._camera = robot, config, task, camera
        self.keep_out = KeepOut()
        self._start: ClearStart | None = None
        self._last_reach: WholeBodyReach | None = None
        self._sent: Route | None = None
        self._check: RouteCheck | None = None
        self._planned: FloatArray | None = None  # posture at the view planned last
        self._may_drive = True  # once more to the view planned last

    @property
    def _forbidden(self) -> KeepOut:
        """Where the base must not go."""
        return self.task.rules.with_others(self.keep_out)

    @property
    def stands_wrongly(self) -> str:
        """Where the base stood at the last choice although it must not, or empty.

        For the end of a sentence: "in or next to keep-out region 'x'". The next drive leads out.
        """
        return "" if self._last_reach is None else self._last_reach.stands_wrongly

    @property
    def clear_space(self) -> tuple[PlacedSolid, ...]:
        """What was declared clear about the start [map]."""
        return () if self._start is None else (self._start.space(self._robot),)

    def begin(self, T_map_start: FloatArray) -> None:
        """Note where the mission began, shape (4, 4), where that is not known yet."""
        if self._start is None and self.config.start_clearance > 0.0:
            self._start = ClearStart(T_map_start, self.config.start_clearance)

    def reach(
        self,
        voxel_map: VoxelMap,
        state: RobotState,
        obstacles: Sequence[Obstacle] = (),
        widen: bool = True,
    ) -> WholeBodyReach:
        """Answers which views can be reached from here.

        Args:
            voxel_map: what is known.
            state: where the robot is.
            obstacles: what must not be touched and the map does not show.
            widen: keep as much more room as the pose is doubtful.
        """
        reach = WholeBodyReach(
            self._robot,
            voxel_map,
            state.T_map_base,
            state.joints,
            self.config.reaching,
            self._start,
            previous=self._last_reach,
            sent=self._sent,
            obstacles=obstacles,
            sigma=self._sigma(state) if widen else 0.0,
            keep_out=self._forbidden,
            camera=self._camera,
        )
        self._last_reach, self._sent = reach, None
        return reach

    def traversability(self, voxel_map: VoxelMap, state: RobotState) -> ProjectedGrid:
        """Where the base can stand, the arm in its posture for driving."""
        vehicle = self.whole(state).vehicle
        reach = self.config.reaching.base.standing_reach
        terrain = known_ground(voxel_map, vehicle, state.T_map_base, self._start, reach)
        return traversability(with_keep_out(terrain, self._forbidden), vehicle)

    def send(self, voxel_map: VoxelMap, state: RobotState, route: Route | None) -> None:
        """Note the route along which the robot is sent from here.

        Args:
            voxel_map: in which it was planned.
            state: where the robot is.
            route: None for none.
        """
        self._sent, self._check = route, None
        self._planned = None if route is None else route.arm_after.positions[-1]
        self._may_drive = True
        self._watch(voxel_map, state, route)

    def _watch(self, voxel_map: VoxelMap, state: RobotState, route: Route | None) -> None:
        """Begin to check a route that begins here."""
        if route is not None:
            reaching = self.config.reaching
            whole = self.whole(state)
            if route.moves_base:
                whole = whole.driving_in(route.arm_before.positions[-1])
            self._check = RouteCheck(
                route, whole, reaching, voxel_map, state.T_map_base, state.joints, self._start,
                self._forbidden,
            )  # fmt: skip

    def withdraw(self) -> None:
        """Note that the robot is not sent along the last route."""
        self._sent = self._check = None

    def route_to(
        self,
        voxel_map: VoxelMap,
        state: RobotState,
        place: KnownPlace,
        obstacles: Sequence[Obstacle] = (),
    ) -> ReachResult:
        """The route to where the robot has stood, or why there is none."""
        result = self.reach(voxel_map, state, obstacles).route_to(place.base, place.joints)
        self.send(voxel_map, state, result.route)
        return result

    def plan_arm(
        self,
        voxel_map: VoxelMap,
        state: RobotState,
        T_map_camera: FloatArray,
        obstacles: Sequence[Obstacle] = (),
    ) -> ReachResult:
        """The rest of the route to a view, from where the base has come to stand.

        A motion of the arm alone within the task's tolerances. Where that cannot be, once for each
        view, a short drive to where it can; else as near with the arm as can be. Where a doubtful
        pose asks for too much room, with as much as a sure one.

        Args:
            voxel_map: what is known.
            state: where the robot is.
            T_map_camera: the view, shape (4, 4).
            obstacles: what must not be touched and the map does not show.
        """
        task = self.task
        for widen in (True, False):
            reach = self.reach(voxel_map, state, obstacles, widen)
            result = reach.with_arm_alone(
                T_map_camera,
                task.view_position_tolerance,
                task.view_angle_tolerance,
                self._planned,
            )
            if not result.reason or not reach.near.wider:
                break
        if result.reason and self._may_drive:
            driven = reach.reach(T_map_camera)
            if not driven.reason and driven.travel <= _CORRECTION:
                result, self._may_drive = driven, False
        self._sent, self._check = result.route, None
        self._watch(voxel_map, state, result.route)
        return result

    def route_problem(self, voxel_map: VoxelMap, state: RobotState) -> str:
        """Why what is left of the route along which the robot was sent is blocked, or empty."""
        if self._check is None:
            return ""
        fault = self._check.fault(voxel_map, state.T_map_base, state.joints, self._forbidden)
        return "" if fault is None else fault.reason

    def times(self, state: RobotState) -> MotionTimes:
        """How long motions of the robot take, by the speeds that it is driven with."""
        reaching = self.config.reaching
        whole, limits = self.whole(state), reaching.following
        rates = reaching.trajectory.velocities(whole.chain)
        postures = whole.postures.q[:_POSTURES]
        folding = (np.abs(postures - whole.driving) / rates).max(axis=1, initial=0.0)
        ramp = float(rates.max(initial=0.0)) / reaching.trajectory.acceleration
        arm = float(folding.mean()) + ramp if len(folding) else 0.0
        turning = float(np.median(rates)) if len(rates) else limits.max_turn_rate
        return MotionTimes(
            limits.max_speed,
            limits.max_turn_rate,
            arm,
            turning,
            0.5 * whole.arm_reach,
            _LOOK,
        )

    def whole(self, state: RobotState) -> WholeBody:
        """The robot as it is, whatever the map."""
        return WholeBody.of(self._robot, self.config.reaching, state.joints, self._camera)

    def _sigma(self, state: RobotState) -> float:
        """How well it is known where the base is [m]."""
        whole = self.whole(state)
        return base_sigma(
            state.T_map_camera, state.pose_covariance, state.T_map_base, whole.base_radius
        )
