"""Node ``next_best_view``: one more replica of the shared map, asked where to look next.

Callbacks only receive. The worker thread owns replica and planner: it applies map updates in the
order in which they come and plans when it is asked to, which takes a second or two. It publishes
its plan under its own name (``next_best_view/base_path``), never where a robot listens: a plan
must not move anything.

On team/agents it tells the team where this robot is and which view it is heading for, and hears so
of the others: it leaves to them what they are about to see, and keeps clear of them.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.clock import Clock, ClockType
from std_msgs.msg import Empty
from visualization_msgs.msg import MarkerArray

from infomap_ros.errors import ExplorationError, InfomapError
from infomap_ros.exploration.fiducial_error import FiducialLocalizationError
from infomap_ros.exploration.records.choice_text import choice_to_text
from infomap_ros.exploration.robot import Choice, FailedView, KnownPlace, RobotState
from infomap_ros.exploration.task import TaskConfig
from infomap_ros.exploration.team.team_planner import TeamPlanner
from infomap_ros.exploration.view_planner import Surrounding, ViewPlanner, ViewPlannerConfig
from infomap_ros.geometry import rig_from_calibrations
from infomap_ros.geometry.assumed_pose import AssumedPoseConfig
from infomap_ros.geometry.joint_buffer import JointBufferConfig
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.dead_reckoning import DeadReckoningConfig
from infomap_ros.localization.prediction.error_prediction import ErrorPredictionConfig
from infomap_ros.localization.target.search import TargetSearchConfig
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.files.projection import ProjectedGrid
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.compiling import prepare_kernels
from infomap_ros.nodes.common.lockstep import LockstepConfig
from infomap_ros.nodes.common.orders import offer_order
from infomap_ros.nodes.common.run import run_node
from infomap_ros.nodes.planning.exploration_status import ExplorationNews, read_status
from infomap_ros.nodes.planning.fiducial_listener import FiducialListener
from infomap_ros.nodes.planning.interests import Interests
from infomap_ros.nodes.planning.keep_out_listener import KeepOutListener
from infomap_ros.nodes.planning.plan_outputs import PlanOutputs
from infomap_ros.nodes.planning.plan_warm_up import warm_up
from infomap_ros.nodes.planning.route_status import WORKING, RouteStatusPublisher
from infomap_ros.nodes.planning.search_plans import SearchPlans
from infomap_ros.nodes.planning.traversability_map import TraversabilityMap
from infomap_ros.nodes.robot.robot_tracker import RobotTracker, RobotTrackerConfig
from infomap_ros.nodes.team.map_listener import MapListener, MapListenerConfig
from infomap_ros.nodes.team.team_agents import TeamAgents
from infomap_ros.nodes.team.team_identity import TeamIdentityConfig
from infomap_ros.nodes.team.team_radio import TeamRadioConfig
from infomap_ros.team import TeamConfig
from infomap_ros.team.agents_config import AgentsConfig
from infomap_ros.views.information.view_information import ExpectedInformation
from infomap_ros.views.ranking.strategies import make_strategy

_AT_REST = ("ended", "paused")  # states in which an exploration heads for nothing


class NextBestViewNode(MonitoredNode):
    """See the module."""

    CONFIGS = (
        (MapListenerConfig, ""),
        (TeamIdentityConfig, ""),
        (TeamConfig, "team_map."),
        (TeamRadioConfig, "team_map."),
        (RobotTrackerConfig, ""),
        (TaskConfig, "task."),
        (ViewPlannerConfig, ""),
        (ErrorPredictionConfig, "prediction."),
        (DeadReckoningConfig, "motion_noise."),
        (TargetSearchConfig, "search."),
        (AssumedPoseConfig, ""),
        (JointBufferConfig, "joints."),
        (AgentsConfig, "agents."),
        (LockstepConfig, ""),
    )

    SETTABLE = ("task.*", "strategy", "metric", "choice.rating.*", "reaching.trajectory.*")

    def __init__(self, **node_arguments: Any) -> None:
        super().__init__("next_best_view", **node_arguments)
        planning = partial(warm_up, self.config(ViewPlannerConfig))
        prepare_kernels(self, planning, seconds=150.0)
        self._tracker = RobotTracker(self)
        self._fiducials = FiducialListener(self)
        map_frame = self.config(RobotTrackerConfig).map_frame
        self._interests = Interests(map_frame)
        self._outputs = PlanOutputs(self)
        self._news = ExplorationNews()
        self._route_status, self._is_checking = RouteStatusPublisher(self), False
        self._target: FloatArray | None = None
        self._planner: TeamPlanner | None = None
        self._settings: tuple[TaskConfig, ViewPlannerConfig] | None = None
        self._error: FiducialLocalizationError | None = None
        self._agents = TeamAgents(self, self._tracker)
        self._worker = self.start_worker(1, last_job=1.0)
        self._map = MapListener(self, self._worker, on_update=self._submit_check)
        self._keep_out = KeepOutListener(self, map_frame, self._submit_check)
        self.listen(MarkerArray, "interest", self._interests.update, qos.latched(), required=False)
        self.listen(
            DiagnosticStatus, "exploration_status", self._on_status, qos.latched(), required=False
        )
        self._traversability = TraversabilityMap(self, self._worker, self._traversable)
        offer_order(self, "~/plan", self._worker, self._plan)
        offer_order(self, "~/plan_home", self._worker, lambda: self._plan_way(self._news.home))
        offer_order(self, "~/plan_back", self._worker, lambda: self._plan_way(self._news.last_look))
        offer_order(self, "~/plan_arm", self._worker, self._plan_arm)
        self._working = self.advertise(Empty, f"~/{WORKING}", qos.stream())
        self.create_timer(
            1.0, self._say_that_it_works, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )
        offer_order(self, "~/plan_search", self._worker, SearchPlans(self, self._tracker).plan)

    def _say_that_it_works(self) -> None:
        """A plan may take longer than its asker would wait for one that is gone."""
        if self._worker.waiting:
            self._working.publish(Empty())

    def judge_config(self, config: object) -> None:
        """Refuse a strategy or a metric that there is not."""
        if isinstance(config, ViewPlannerConfig):
            make_strategy(config.strategy)
            ExpectedInformation(config.metric)

    def _on_status(self, message: DiagnosticStatus) -> None:
        before, self._news = self._news, read_status(message)
        self._agents.doing = message.message
        if message.message.startswith(_AT_REST):
            self._agents.team.give_up()
        failed = self._news.failed_view
        if failed is not None and self._news.failures > before.failures:
            self._worker.submit_always(partial(self._note_failure, failed))

    def _note_failure(self, view: FailedView) -> None:
        if self._planner is not None:
            self._planner.failed(view)

    def _plan(self) -> str:
        """Choose the next view and publish it; the answer holds the choice as text.

        Raises:
            InfomapError: something that is needed has not arrived, or teammates are at all that is
                left: another call may have an answer.
        """
        planner, voxel_map, state = self._ready()
        news = self._news
        around = Surrounding(
            self._interests.current(), T_map_start=news.home_pose, past_views=news.looks
        )
        choice = planner.choose(voxel_map, state, around)
        if self._error is not None:
            self.health.note("localization error by", self._error.model)
        return self._publish(choice)

    def _traversable(self) -> ProjectedGrid:
        """Where the base can stand.

        Raises:
            InfomapError: something that is needed has not arrived.
        """
        planner, voxel_map, state = self._ready()
        return planner.planner.traversability(voxel_map, state)

    def _plan_way(self, place: KnownPlace) -> str:
        """Plan the way to where the robot has stood, which exploration_status tells.

        Raises:
            InfomapError: something that is needed has not arrived.
        """
        planner, voxel_map, state = self._ready()
        if not place.is_known:
            raise ExplorationError(f"exploration_status has not told where {place.name} is")
        return self._publish(planner.way_to(voxel_map, state, place))

    def _plan_arm(self) -> str:
        """Plan the arm's motion to the view planned last, from where the base has come to stand.

        Raises:
            InfomapError: something that is needed has not arrived, or no view was planned yet.
        """
        planner, voxel_map, state = self._ready()
        if self._target is None:
            raise ExplorationError("no view was planned yet to which the arm could move")
        choice = planner.plan_arm(voxel_map, state, self._target)
        if choice.route is not None:
            self._route_status.begin(choice.route)
        self.get_logger().info(f"arm: {choice.reason or 'planned again'}")
        return choice_to_text(choice)

    def _submit_check(self) -> None:
        """Have the worker check the route, unless that waits already."""
        if not self._is_checking:
            self._is_checking = True
            self._worker.submit_always(self._check_route)

    def _check_route(self) -> None:
        """Compare what is left of the planned route with the map as it is now."""
        self._is_checking = False
        if self._planner is None or self._target is None:
            return
        self._planner.planner.forbid(self._keep_out.current())
        try:
            state, voxel_map = self._tracker.state(), self._map.voxel_map()
            self._route_status.report(self._planner.route_problem(voxel_map, state))
        except InfomapError:  # such as a pose that is too old: checked again when it is there
            return

    def _publish(self, choice: Choice) -> str:
        self._outputs.publish(choice)
        if choice.route is not None:
            self._target = choice.target
            self._route_status.begin(choice.route)
        self.get_logger().info(choice.reason)
        self._warn_where_it_stands()
        self._traversability.publish()
        return choice_to_text(choice)

    def _warn_where_it_stands(self) -> None:
        """Warn of a base that stands where it must not."""
        where = "" if self._planner is None else self._planner.planner.stands_wrongly
        if where:
            self.get_logger().warning(f"the base stands {where}: its next drive leads out first")

    def _ready(self) -> tuple[TeamPlanner, VoxelMap, RobotState]:
        """What a plan needs.

        Raises:
            InfomapError: it is not there yet; names it.
        """
        voxel_map = self._map.voxel_map()
        robot, state = self._tracker.robot, self._tracker.state()
        settings = task, config = self.config(TaskConfig), self.config(ViewPlannerConfig)
        if self._planner is not None and settings != self._settings:
            self._planner.planner.reconfigure(task, config)
        self._settings = settings
        if self._planner is None or self._planner.planner.robot is not robot:
            rig = rig_from_calibrations(*self._tracker.calibrations)
            self._error = FiducialLocalizationError(
                rig,
                self._fiducials.fiducials,
                self.config(ErrorPredictionConfig),
                self.config(DeadReckoningConfig),
            )
            alone = ViewPlanner(robot, rig, task, config, self._error)
            self._planner = TeamPlanner(alone, self._agents.team, self._agents.announce)
        self._planner.planner.forbid(self._keep_out.current())
        return self._planner, voxel_map, state


def main() -> int:
    """Run the node."""
    return run_node(NextBestViewNode)


if __name__ == "__main__":
    raise SystemExit(main())
