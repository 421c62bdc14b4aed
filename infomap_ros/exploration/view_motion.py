"""How the robot gets to views: routes to them, and the check of the one that is carried out."""

from __future__ import annotations

from collections.abc import Sequence

from infomap_ros.exploration.robot import KnownPlace, RobotState
from infomap_ros.exploration.task import TaskConfig
from infomap_ros.exploration.view_planner_config import ViewPlannerConfig
from infomap_ros.geometry import PlacedSolid
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.motion import RobotModel
from infomap_ros.motion.base.pose_margin import base_sigma
from infomap_ros.motion.collision.clear_start import ClearStart
from infomap_ros.motion.collision.obstacles import Obstacle
from infomap_ros.motion.reaching import WholeBodyReach
from infomap_ros.motion.route import ReachResult, Route
from infomap_ros.motion.route_check import RouteCheck
from infomap_ros.motion.whole_body import WholeBody


class ViewMotion:
    """Plans routes from wherever the robot is, each knowing of the one before.

    Args:
        robot: with its camera frame.
        config: of the motion, and of the space that is clear about the start.
        task: how near the camera must come to a view.
    """

    def __init__(self, robot: RobotModel, config: ViewPlannerConfig, task: TaskConfig) -> None:
        self._robot, self._config, self._task = robot, config, task
        self._start: ClearStart | None = None
        self._last_reach: WholeBodyReach | None = None
        self._sent: Route | None = None
        self._check: RouteCheck | None = None

    @property
    def clear_space(self) -> tuple[PlacedSolid, ...]:
        """What was declared clear about the start [map]."""
        return () if self._start is None else (self._start.space(self._robot),)

    def begin(self, T_map_start: FloatArray) -> None:
        """Note where the mission began, shape (4, 4), where that is not known yet."""
        if self._start is None and self._config.start_clearance > 0.0:
            self._start = ClearStart(T_map_start, self._config.start_clearance)

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
            self._config.reaching,
            self._start,
            previous=self._last_reach,
            sent=self._sent,
            obstacles=obstacles,
            sigma=self._sigma(state) if widen else 0.0,
        )
        self._last_reach, self._sent = reach, None
        return reach

    def send(
        self,
        voxel_map: VoxelMap,
        state: RobotState,
        route: Route | None,
        known_free: Sequence[PlacedSolid] = (),
    ) -> None:
        """Note the route along which the robot is sent from here.

        Args:
            voxel_map: in which it was planned.
            state: where the robot is.
            route: None for none.
            known_free: space that was taken for free although it was never seen [map].
        """
        self._sent, self._check = route, None
        if route is not None:
            reaching = self._config.reaching
            whole = WholeBody.of(self._robot, reaching, state.joints)
            self._check = RouteCheck(
                route, whole, reaching, voxel_map, state.T_map_base, state.joints, self._start,
                known_free,
            )  # fmt: skip

    def withdraw(self) -> None:
        """Note that the robot is not sent along the last route."""
        self._sent = self._check = None

    def way_to(
        self,
        voxel_map: VoxelMap,
        state: RobotState,
        place: KnownPlace,
        obstacles: Sequence[Obstacle] = (),
    ) -> ReachResult:
        """The way to where the robot has stood, or why there is none."""
        result = self.reach(voxel_map, state, obstacles).way_to(place.base, place.joints)
        self.send(voxel_map, state, result.route)
        return result

    def plan_arm(
        self,
        voxel_map: VoxelMap,
        state: RobotState,
        T_map_camera: FloatArray,
        obstacles: Sequence[Obstacle] = (),
    ) -> ReachResult:
        """A motion of the arm alone to a view, from where the base has come to stand.

        Within the task's tolerances or as near as can be. The space that the body filled when the
        route was planned is free, as it was for that plan: nothing sees it. Where a doubtful pose
        asks for too much room, with as much as a sure one.

        Args:
            voxel_map: what is known.
            state: where the robot is.
            T_map_camera: the view, shape (4, 4).
            obstacles: what must not be touched and the map does not show.
        """
        task, before = self._task, self._last_reach
        been = () if before is None else before.near.own_space
        for widen in (True, False):
            reach = self.reach(voxel_map, state, obstacles, widen)
            reach.near.add_free(been)
            result = reach.with_arm_alone(
                T_map_camera, task.view_position_tolerance, task.view_angle_tolerance
            )
            if not result.reason:
                break
        self.send(voxel_map, state, result.route, been)
        return result

    def route_problem(self, voxel_map: VoxelMap, state: RobotState) -> str:
        """Why what is left of the route along which the robot was sent is blocked, or empty."""
        if self._check is None:
            return ""
        fault = self._check.fault(voxel_map, state.T_map_base, state.joints)
        return "" if fault is None else fault.reason

    def _sigma(self, state: RobotState) -> float:
        """How well it is known where the base is [m]."""
        whole = WholeBody.of(self._robot, self._config.reaching, state.joints)
        return base_sigma(
            state.T_map_camera, state.pose_covariance, state.T_map_base, whole.base_radius
        )
