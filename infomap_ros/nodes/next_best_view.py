"""Node ``next_best_view``: one more replica of the shared map, asked where to look next.

Or a map of another mapper, which is an OctoMap tree: each one takes the place of that before.

Callbacks only receive. The worker thread owns replica and planner: it applies map updates in the
order in which they come and plans when it is asked to, which takes a second or two. It publishes
its plan under its own name (``next_best_view/base_path``), never where a robot listens: a plan
must not move anything.

On team/agents it reports where this robot is and which view it is heading for, and receives so
of the others: it leaves to them what they are about to see, and keeps clear of them.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Empty
from visualization_msgs.msg import Marker, MarkerArray

from infomap_ros.errors import (
    ConfigError,
    ExplorationError,
    FrameError,
    InfomapError,
    InvalidInputError,
    MalformedMessageError,
)
from infomap_ros.exploration.fiducial_error import FiducialLocalizationError
from infomap_ros.exploration.records.choice_text import choice_to_text
from infomap_ros.exploration.robot import Choice, FailedView, KnownPlace, RobotState
from infomap_ros.exploration.target_search import TargetSearchPlanner
from infomap_ros.exploration.task import TaskConfig
from infomap_ros.exploration.team.team_planner import TeamPlanner
from infomap_ros.exploration.view_planner import Surrounding, ViewPlanner, ViewPlannerConfig
from infomap_ros.geometry import (
    Box,
    CameraCalibration,
    PlacedSolid,
    Sphere,
    StereoRig,
    rig_from_calibrations,
)
from infomap_ros.geometry.assumed_pose import AssumedPoseConfig
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.joint_buffer import JointBufferConfig
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.dead_reckoning import DeadReckoningConfig
from infomap_ros.localization.filter.config import Fiducials
from infomap_ros.localization.prediction.error_prediction import ErrorPredictionConfig
from infomap_ros.localization.target.search import TargetSearchConfig
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.files.export import ProjectedGrid
from infomap_ros.mapping.files.octomap_file import DEPTH, OctomapLeaves, leaves_of_tree
from infomap_ros.messages.encode import OCTOMAP
from infomap_ros.messages.fiducials import decode_fiducials
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.lockstep import LockstepConfig
from infomap_ros.nodes.common.message_types import message_class
from infomap_ros.nodes.common.orders import offer_order
from infomap_ros.nodes.common.run import prepare_kernels, run_node
from infomap_ros.nodes.planning.exploration_status import ExplorationStatus, read_status
from infomap_ros.nodes.planning.keep_out_listener import MARKER, KeepOutListener, MarkerSet, pose_of
from infomap_ros.nodes.planning.plan_outputs import PlanOutputs, TraversabilityMap
from infomap_ros.nodes.planning.plan_warm_up import warm_up
from infomap_ros.nodes.planning.remote_planner import WORKING, RouteStatusPublisher
from infomap_ros.nodes.robot.robot_tracker import RobotTracker, RobotTrackerConfig
from infomap_ros.nodes.team.map_listener import MapListener, MapListenerConfig
from infomap_ros.nodes.team.team_agents import TeamAgents
from infomap_ros.nodes.team.team_radio import TeamRadioConfig
from infomap_ros.nodes.team.team_topics import TeamIdentityConfig
from infomap_ros.stereo import DepthCameraConfig
from infomap_ros.team.agents import AgentsConfig
from infomap_ros.team.config import TeamConfig
from infomap_ros.team.update import are_one_frame
from infomap_ros.views.information.view_information import ExpectedInformation
from infomap_ros.views.information.view_query import DISPARITY_SIGMA
from infomap_ros.views.ranking.strategies import make_strategy
from infomap_ros.views.situation import Interest


class Interests(MarkerSet[Interest]):
    """The places that are of interest now; markers add, replace and delete them.

    A marker is a CUBE or a SPHERE (of its smallest diameter); its weight, the factor by which the
    information inside counts, is the number in its text.

    Args:
        map_frame: frame in which the markers must be.
    """

    def __init__(self, map_frame: str) -> None:
        super().__init__(map_frame, _place, "interest")


def _place(marker: Any) -> Interest:
    sides = (marker.scale.x, marker.scale.y, marker.scale.z)
    try:
        solid = _solid(marker.type, sides)
        placed = PlacedSolid(solid, pose_of(marker), f"{marker.ns}/{marker.id}")
        return Interest(placed, float(marker.text))
    except (InvalidInputError, ValueError) as error:
        raise MalformedMessageError(MARKER, f"{marker.ns}/{marker.id}: {error}") from error


def _solid(kind: int, sides: tuple[float, float, float]) -> Box | Sphere:
    if kind == Marker.CUBE:
        return Box(sides)
    if kind == Marker.SPHERE:
        return Sphere(0.5 * min(sides))
    raise ValueError(f"type {kind}, expected CUBE or SPHERE")


@dataclass(frozen=True)
class PlannedCameraConfig:
    """The camera whose views are planned.

    Raises:
        ConfigError: a value is out of its range.
    """

    source: str = parameter(
        "stereo",
        "A pair of cameras (left/camera_info and right/camera_info), or a depth camera "
        "(depth/camera_info).",
        choices=("stereo", "depth"),
    )
    depth_noise: float = parameter(
        DepthCameraConfig.sigma_quadratic,
        "With source depth: growth of its noise with the square of the depth, as "
        "depth_camera.sigma_quadratic of stereo_range.",
        unit="1/m",
        low=1e-6,
        high=1.0,
    )

    def __post_init__(self) -> None:
        check_config(self)

    @property
    def infos(self) -> tuple[str, ...]:
        """Topics of the camera infos."""
        pair = ("left/camera_info", "right/camera_info")
        return pair if self.source == "stereo" else ("depth/camera_info",)

    def rig(self, calibrations: tuple[CameraCalibration, ...]) -> StereoRig:
        """The pair, or one as noisy as the depth camera is.

        Args:
            calibrations: those of `infos`.

        Raises:
            CalibrationError: they cannot be.
        """
        if self.source == "stereo":
            return rig_from_calibrations(*calibrations)
        camera = calibrations[0].rectified_camera()
        return StereoRig(camera, camera, DISPARITY_SIGMA / (camera.fx * self.depth_noise))


class SearchPlans:
    """Plans look after look; used by the worker thread. A new robot begins the search anew.

    Args:
        node: has the configurations of planner and search.
        tracker: knows the robot, its cameras, and where odometry has it.
    """

    def __init__(self, node: MonitoredNode, tracker: RobotTracker) -> None:
        self._node, self._tracker = node, tracker
        self._planner: TargetSearchPlanner | None = None

    def plan(self) -> str:
        """The next look as text, pose and paths in the frame of odometry; nothing is published.

        What the camera sees from where it is counts as looked at in vain.

        Raises:
            InfomapError: something that is needed has not arrived.
        """
        robot, state = self._tracker.robot, self._tracker.state_in_odometry()
        if self._planner is None or self._planner.robot is not robot:
            seen_by = self._node.config(PlannedCameraConfig)
            camera = seen_by.rig(self._tracker.calibrations).left
            configs = self._node.config(ViewPlannerConfig), self._node.config(TargetSearchConfig)
            self._planner = TargetSearchPlanner(robot, camera, *configs)
        choice = self._planner.choose(state)
        self._node.get_logger().info(choice.reason)
        return choice_to_text(choice)


_TOPIC = "fiducials"


class FiducialListener:
    """Keeps the newest fiducials. A callback of the node writes, any thread reads.

    Args:
        node: that listens; has a `RobotTrackerConfig`.
    """

    def __init__(self, node: MonitoredNode) -> None:
        self._frame = node.config(RobotTrackerConfig).map_frame
        self._newest: Fiducials | None = None
        node.listen(PointCloud2, _TOPIC, self._receive, qos.latched(), required=False)

    def fiducials(self) -> Fiducials | None:
        """What was published last; None before the first message."""
        return self._newest

    def _receive(self, message: PointCloud2) -> None:
        """Replace what is known.

        Raises:
            InfomapError: the message cannot be used; what was known stays.
        """
        _, frame, fiducials = decode_fiducials(message)
        if frame != self._frame:
            raise FrameError(f"fiducials in frame '{frame}', the map is '{self._frame}'")
        self._newest = fiducials


@dataclass(frozen=True)
class MapSourceConfig:
    """Whose map views are planned on.

    Raises:
        ConfigError: a value is out of its range.
    """

    map_source: str = parameter(
        "updates",
        "The map of map_fusion and the team, on map_updates and team/map_updates, or that of "
        "octomap_server or another mapper, an octomap_msgs/Octomap on octomap_full.",
        choices=("updates", "octomap"),
    )
    octomap_free: float = parameter(
        0.12,
        "With map_source octomap: leaves up to this occupancy probability are free. The default "
        "is sensor_model.min of octomap_server, at which it clamps.",
        low=0.05,
        high=0.4,
    )

    def __post_init__(self) -> None:
        check_config(self)


class OctomapListener:
    """The newest octree, as a map. A callback of the node reads it, the worker makes the map.

    Args:
        node: that listens; has the configurations of tracker, listener and source of the map.
        on_update: called with each octree.

    Raises:
        ConfigError: octomap_msgs is not installed.
    """

    def __init__(self, node: MonitoredNode, on_update: Callable[[], None]) -> None:
        if find_spec("octomap_msgs") is None:
            raise ConfigError("map_source", "octomap", "octomap_msgs, which is not installed")
        self._node, self._on_update = node, on_update
        self._frame = node.config(RobotTrackerConfig).map_frame
        self._newest: OctomapLeaves | None = None
        self._known: OctomapLeaves | None = None
        self._map: VoxelMap | None = None
        prepare_kernels(node, _make_a_map, seconds=5.0)
        node.listen(message_class(OCTOMAP), _OCTOMAP, self._receive, qos.latched())

    def voxel_map(self) -> VoxelMap:
        """The map of the newest octree that can be one.

        Raises:
            ExplorationError: there is none, or it is empty.
        """
        if self._newest is not self._known:
            self._known = self._newest
            self._node.guard(_OCTOMAP, self._make_map)
        if self._map is None or not self._map.known_voxels:
            raise ExplorationError(f"no {_OCTOMAP} with something in it has arrived yet")
        return self._map

    def _make_map(self) -> None:
        if self._known is not None:
            free = self._node.config(MapSourceConfig).octomap_free
            limit = self._node.config(MapListenerConfig).memory_limit
            self._map = self._known.voxel_map(free, limit)

    def _receive(self, message: Any) -> None:
        """Read an octree; the map is made of it when somebody asks for one.

        Raises:
            InfomapError: it cannot be used; the one before stays.
        """
        frame = message.header.frame_id
        if frame != self._frame:
            raise FrameError(f"octree in frame '{frame}', the map is '{self._frame}'")
        if message.id != "OcTree":
            raise MalformedMessageError(OCTOMAP, f"of a '{message.id}', expected an OcTree")
        data = bytes(message.data)
        self._newest = leaves_of_tree(data, message.resolution, binary=message.binary)
        self._node.health.produced()
        self._on_update()


_OCTOMAP = "octomap_full"


def _make_a_map() -> None:
    """Of one voxel in the corner of a tree, and the nodes above it."""
    nodes = struct.pack("<fB", 1.0, 1) * DEPTH + struct.pack("<fB", 1.0, 0)
    leaves_of_tree(nodes, 1.0, binary=False).voxel_map(0.12, 1.0)


_AT_REST = ("ended", "paused")  # states in which an exploration heads for nothing


class NextBestViewNode(MonitoredNode):
    """See the module."""

    CONFIGS = (
        (PlannedCameraConfig, ""),
        (MapSourceConfig, ""),
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
        self._camera = self.config(PlannedCameraConfig)
        self._tracker = RobotTracker(self, self._camera.infos)
        self._fiducials = FiducialListener(self)
        map_frame = self.config(RobotTrackerConfig).map_frame
        self._interests = Interests(map_frame)
        self._outputs = PlanOutputs(self)
        self._last = ExplorationStatus()
        self._route_status, self._is_checking = RouteStatusPublisher(self), False
        self._target: FloatArray | None = None
        self._planner: TeamPlanner | None = None
        self._origin = 0
        self._settings: tuple[TaskConfig, ViewPlannerConfig] | None = None
        self._error: FiducialLocalizationError | None = None
        self._agents = TeamAgents(self, self._tracker)
        self._worker = self.start_worker(1, last_job=1.0)
        self._map = (
            OctomapListener(self, self._submit_check)
            if self.config(MapSourceConfig).map_source == "octomap"
            else MapListener(self, self._worker, on_update=self._submit_check)
        )
        self._keep_out = KeepOutListener(self, map_frame, self._submit_check)
        self.listen(MarkerArray, "interest", self._interests.update, qos.latched(), required=False)
        self.listen(
            DiagnosticStatus, "exploration_status", self._on_status, qos.latched(), required=False
        )
        self._traversability = TraversabilityMap(self, self._worker, self._traversable)
        offer_order(self, "~/plan", self._worker, self._plan)
        offer_order(self, "~/plan_home", self._worker, lambda: self._plan_to(self._last.home))
        offer_order(self, "~/plan_back", self._worker, lambda: self._plan_to(self._last.last_look))
        offer_order(self, "~/plan_arm", self._worker, self._plan_arm)
        self._working = self.advertise(Empty, f"~/{WORKING}", qos.stream())
        self.repeat(1.0, self._say_that_it_works)
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
        before, self._last = self._last, read_status(message)
        self._agents.doing = message.message
        if message.message.startswith(_AT_REST):
            self._agents.team.give_up()
        failed = self._last.failed_view
        if failed is not None and self._last.failures > before.failures:
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
        status = self._last
        around = Surrounding(
            self._interests.current(), T_map_start=status.home_pose, past_views=status.looks
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
        return planner.planner.motion.traversability(voxel_map, state)

    def _plan_to(self, place: KnownPlace) -> str:
        """Plan the route to where the robot has stood, which exploration_status says.

        Raises:
            InfomapError: something that is needed has not arrived.
        """
        planner, voxel_map, state = self._ready()
        if not place.is_known:
            raise ExplorationError(f"exploration_status has not said where {place.name} is")
        return self._publish(planner.route_to(voxel_map, state, place))

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
        if self._tracker.origin != self._origin:
            self._route_status.report("the map has been moved to another frame")
            return
        self._planner.planner.motion.keep_out = self._keep_out.current()
        try:
            state, voxel_map = self._tracker.state(), self._map.voxel_map()
            problem = self._planner.planner.motion.route_problem(voxel_map, state)
            self._route_status.report(problem)
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
        where = "" if self._planner is None else self._planner.planner.motion.stands_wrongly
        if where:
            self.get_logger().warning(f"the base stands {where}: its next drive leads out first")

    def _ready(self) -> tuple[TeamPlanner, VoxelMap, RobotState]:
        """What a plan needs.

        Raises:
            InfomapError: it is not there yet; names it.
        """
        voxel_map = self._map.voxel_map()
        robot, state = self._tracker.robot, self._tracker.state()
        origin = self._tracker.origin
        if not are_one_frame(voxel_map.origin, origin):
            raise ExplorationError("the map has not been moved yet to the frame of camera_pose")
        if origin != self._origin:  # what the planner remembers is of another frame
            self._origin, self._planner, self._target = origin, None, None
        settings = task, config = self.config(TaskConfig), self.config(ViewPlannerConfig)
        if self._planner is not None and settings != self._settings:
            self._planner.planner.reconfigure(task, config)
        self._settings = settings
        if self._planner is None or self._planner.planner.robot is not robot:
            rig = self._camera.rig(self._tracker.calibrations)
            self._error = FiducialLocalizationError(
                rig,
                self._fiducials.fiducials,
                self.config(ErrorPredictionConfig),
                self.config(DeadReckoningConfig),
            )
            alone = ViewPlanner(robot, rig, task, config, self._error)
            self._planner = TeamPlanner(alone, self._agents.team, self._agents.announce)
        self._planner.planner.motion.keep_out = self._keep_out.current()
        return self._planner, voxel_map, state


def main() -> int:
    """Run the node."""
    return run_node(NextBestViewNode)


if __name__ == "__main__":
    raise SystemExit(main())
