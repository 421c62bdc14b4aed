"""Node ``explorer``: runs the loop of Fig. 3 and moves the robot.

The loop runs in a thread of its own, which may block; callbacks only receive. What next_best_view
plans, the loop has the robot carry out on base_path and arm_trajectory, and it waits until pose and
joints say that it is done. The account of the mission is kept in a file, so that a restarted
explorer can go on with it.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.duration import Duration
from std_srvs.srv import Trigger

from infomap_ros.errors import CalibrationError, ExplorationError, InfomapError
from infomap_ros.exploration.commanded_robot import CommandedRobot, CommandedRobotConfig
from infomap_ros.exploration.loop import Exploration
from infomap_ros.exploration.mission import Mission
from infomap_ros.exploration.records.run_log import RunLogFile
from infomap_ros.exploration.robot import FailedView, Interrupted
from infomap_ros.exploration.rules import STOPPED, Control, Ending, EndReason, Request
from infomap_ros.exploration.target_hunt import find_target
from infomap_ros.exploration.task import TaskConfig
from infomap_ros.exploration.team.keep_clear import PAUSE, Awareness, KeepClearConfig, KeepsClear
from infomap_ros.geometry.assumed_pose import AssumedPoseConfig
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.joint_buffer import JointBufferConfig
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.lockstep import LockstepConfig, LockstepTime
from infomap_ros.nodes.common.run import run_node
from infomap_ros.nodes.locating.localization_status import (
    LOCALIZATION_STATUS,
    SEEN,
    LocalizationState,
    read_status,
)
from infomap_ros.nodes.planning.exploration_status import status_message
from infomap_ros.nodes.planning.remote_planner import RemotePlanner, RemotePlannerConfig
from infomap_ros.nodes.planning.robot_topics import RobotTopics
from infomap_ros.nodes.robot.robot_tracker import RobotTracker, RobotTrackerConfig
from infomap_ros.nodes.team.team_topics import TeamIdentityConfig, listen_to_agents
from infomap_ros.team.agent_board import AgentBoard
from infomap_ros.team.agents import Agent


class TeammatesNear:
    """What the others report of themselves.

    Args:
        node: that listens; has the configurations of team and tracker.
        tracker: knows in which frame this robot is.
    """

    def __init__(self, node: MonitoredNode, tracker: RobotTracker) -> None:
        self._tracker = tracker
        who = node.config(TeamIdentityConfig)
        self._board = AgentBoard(who.robot_id, None, team=who.team, key=who.read_key())
        self._own = node.resolve_topic_name("robot_description")
        self._lock = threading.Lock()
        listen_to_agents(node, node.config(RobotTrackerConfig).map_frame, self._receive)

    def present(self) -> tuple[Agent, ...]:
        """The others that have reported lately; may be asked by any thread."""
        with self._lock:
            self._board.origin = self._tracker.origin
            present = self._board.present(time.monotonic())
        # An explorer that was given no id receives its own robot's next_best_view, too.
        return tuple(agent for agent in present if agent.description != self._own)

    def _receive(self, text: str) -> None:
        with self._lock:
            self._board.receive(text, time.monotonic())


_PAIRS = 2  # that are looked at in one place; the first may be from the way
_PAIRS_OF_TEAMMATE = 12  # where a teammate is in view; several sightings have to agree


class TargetSight:
    """Implements `infomap_ros.exploration.target_hunt.SearchSight`.

    Args:
        node: listens to localization_status.
        tracker: woken by new messages, and knows where odometry has the robot.
    """

    def __init__(self, node: MonitoredNode, tracker: RobotTracker) -> None:
        self._tracker = tracker
        self._progress_timeout = node.config(CommandedRobotConfig).progress_timeout
        self._last = LocalizationState(0, "", "")
        self._looks = 0
        profile = qos.latched()
        node.listen(DiagnosticStatus, LOCALIZATION_STATUS, self._on_status, profile, required=False)

    @property
    def found(self) -> bool:
        """Whether localization says anything else than that it searches."""
        return self._last.state not in ("", "searching") and not self.wants_team

    @property
    def wants_team(self) -> bool:
        """Whether a teammate with tags is still to be found, instead of a target."""
        return bool(self._last.team)

    @property
    def is_wanted(self) -> bool:
        """Whether a target or a team was never seen, and there is odometry to look for it by."""
        is_searching = self._last.state == "searching" or self.wants_team
        return is_searching and self._tracker.known_state(in_odometry=True) is not None

    def look(self, interrupted: Interrupted) -> str:
        """Wait until pairs from here have been looked at; empty, or why not."""
        before = self._looks

        def done() -> bool:
            wanted = _PAIRS_OF_TEAMMATE if self._last.team == SEEN else _PAIRS
            return self._looks - before >= wanted or self.found

        if self._tracker.wait_until(done, self._progress_timeout, interrupted) or interrupted():
            return ""
        return f"no pair was looked at within {self._progress_timeout:g} s"

    def _on_status(self, message: DiagnosticStatus) -> None:
        status = read_status(message)
        self._looks += status.stamp != self._last.stamp
        self._last = status
        self._tracker.notify()


_STATUS_PERIOD = 0.5  # [s]
_ACKNOWLEDGED = Duration(seconds=1)  # for which a status is waited for at most


@dataclass(frozen=True)
class ExplorerConfig:
    """How the explorer is started and what it leaves.

    Raises:
        ConfigError: a value is out of its range.
    """

    autostart: bool = parameter(False, "Begin at once, without ~/start.")
    plan_only: bool = parameter(
        False, "Choose views and paths again and again, and move nothing: others move the robot."
    )
    mission_file: str = parameter(
        "mission.json", "File with the account of the mission, relative to the working directory."
    )
    log_file: str = parameter(
        "exploration.jsonl", "Log of the run, one JSON object per line, for the report."
    )
    resume: bool = parameter(False, "Go on with the mission of mission_file, where there is one.")

    def __post_init__(self) -> None:
        check_config(self)


class ExplorerNode(MonitoredNode):
    """See the module."""

    CONFIGS = (
        (ExplorerConfig, ""),
        (TaskConfig, "task."),
        (CommandedRobotConfig, ""),
        (RemotePlannerConfig, ""),
        (RobotTrackerConfig, ""),
        (AssumedPoseConfig, ""),
        (JointBufferConfig, "joints."),
        (KeepClearConfig, "keep_clear."),
        (TeamIdentityConfig, ""),
        (LockstepConfig, ""),
    )

    SETTABLE = ("task.*",)

    def __init__(self, **node_arguments: Any) -> None:
        super().__init__("explorer", **node_arguments)
        self._config = self.config(ExplorerConfig)
        self._exploration: Exploration | None = None
        self._has_started = False
        self._thread: threading.Thread | None = None
        self._tracker = RobotTracker(self, infos=("left/camera_info",))
        self._time: LockstepTime | None = None
        if self.lockstep is not None:
            self._time = LockstepTime(self, self.lockstep, lambda: self._running)
            self._tracker.wait_in_lockstep(self._time)
        link = RobotTopics(self, self._tracker, self._stopped)
        self._robot = CommandedRobot(link, self.config(CommandedRobotConfig))
        self._teammates = TeammatesNear(self, self._tracker)
        self._sight = TargetSight(self, self._tracker)
        self._failed_views: list[FailedView] = []
        self._planner = RemotePlanner(self, self._failed_views.append, self._stopped)
        self._mission_file = Path(self._config.mission_file).absolute()
        profile = qos.alive(qos.latched())
        self._status = self.advertise(DiagnosticStatus, "exploration_status", profile)
        orders: dict[str, Callable[[], str]] = {
            "start": self._start,
            "pause": partial(self._ask, Request.PAUSE, "pausing"),
            "resume": partial(self._ask, Request.RUN, "going on"),
            "home": partial(self._ask, Request.HOME, "going home"),
            "stop": partial(self._ask, Request.STOP, "stopping"),
        }
        for name, order in orders.items():
            self.create_service(Trigger, f"~/{name}", partial(self._serve, order))
        self.repeat(_STATUS_PERIOD, self._publish_status)
        self.begins, self.ends = self._begin, self._end
        if self.is_active:
            self._begin()

    def _begin(self) -> None:
        if self._config.autostart:
            self.get_logger().info(self._start())

    def take_config(self, config: object) -> None:
        """Have the exploration that runs go on by another task."""
        if isinstance(config, TaskConfig) and self._exploration is not None:
            self._exploration.change_task(config)

    @property
    def _running(self) -> bool:
        return self._thread is not None and self._thread.is_alive()

    def _serve(
        self, order: Callable[[], str], _: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        """Carry out an order of the user, none of which takes long."""
        try:
            response.message, response.success = order(), True
        except InfomapError as error:
            response.message, response.success = str(error), False
        self.get_logger().info(response.message)
        return response

    def _start(self) -> str:
        """Begin a mission, or go on with the one of the mission file.

        Raises:
            ExplorationError: one runs already, or this node is inactive.
            MissionFileError: the mission file cannot be read.
        """
        if self._running:
            raise ExplorationError("the exploration is running already")
        if not self.is_active:
            raise ExplorationError("this node is inactive: ros2 lifecycle set /explorer activate")
        self._has_started = False
        goes_on = self._config.resume and self._mission_file.exists()
        mission = Mission.load(self._mission_file) if goes_on else Mission()
        path = Path(self._config.log_file).absolute()
        stamps = (lambda: 1e-9 * self.get_clock().now().nanoseconds) if self._time is None else None
        log = RunLogFile(path, append=goes_on, robot_clock=stamps or self._seconds)
        self._log = log
        self._exploration = Exploration(
            KeepsClear(self._robot, self._awareness(), self.config(KeepClearConfig)),
            self._planner,
            self.config(TaskConfig),
            log,
            Control(),
            mission,
            self._config.plan_only,
            self._on_step,
            self._seconds,
        )
        if self._time is not None:
            self._time.is_over = False
        self._thread = threading.Thread(target=self._explore, name="exploration", daemon=True)
        self._thread.start()
        return f"going on after {mission.views} views" if goes_on else "starting"

    def _seconds(self) -> float:
        """Of the time in which the robot moves, whatever else the machine has to do [s]."""
        if self._time is not None:
            return self._time.seconds
        return 1e-9 * self.motion_clock.now().nanoseconds

    def _awareness(self) -> Awareness:
        """Teammates are in the map: who still looks for its target does not know where they are."""
        tracker, robot = self._tracker, self._robot
        return Awareness(
            robot.place,
            tracker.joint_positions,
            lambda joints: tracker.robot.solids_in(tracker.robot.base_frame, joints),
            lambda: () if robot.in_odometry else self._teammates.present(),
            lambda: tracker.wait_until(lambda: False, PAUSE, self._stopped),
            self._say,
        )

    def _say(self, state: str, reason: str) -> None:
        if self._exploration is not None:
            self._exploration.say(state, reason)

    def _explore(self) -> None:
        """The thread of the loop."""
        exploration = self._exploration
        assert exploration is not None
        try:
            ending = self._find_target(exploration)
        except InfomapError as error:
            ending = STOPPED if self._stopped() else Ending(EndReason.FAILED, str(error))
        if ending is None:
            self._write_start()
            self.get_logger().info("exploration begins")
            ending = exploration.run()
        else:
            exploration.end(ending)
        self.get_logger().info(f"exploration ended: {ending.reason.value}: {ending.detail}")

    def _find_target(self, exploration: Exploration) -> Ending | None:
        """Wait until all is there; where localization has to see its target first, look for it."""
        while not self._stopped():
            exploration.control.answered(Request.HOME, Request.PAUSE)  # home is not known yet
            exploration.control.wait_while_paused()
            if not self._tracker.wait_until(self._can_begin, math.inf, self._stopped):
                break
            if not self._sight.is_wanted:
                return None
            self._write_start()  # the motions of the search are in the log, too
            self._robot.in_odometry, is_for_team = True, self._sight.wants_team
            what = "teammates" if is_for_team else "the target"
            ending = find_target(exploration, self._sight, self._planner, what)
            self._robot.in_odometry = False
            if ending is not None and is_for_team:  # its map is its own until one comes into view
                self.get_logger().info(f"no teammate was found: {ending.detail}")
                if self._tracker.wait_until(self._is_complete, math.inf, self._stopped):
                    return None
            if ending is not None:
                return ending
        return STOPPED

    def _can_begin(self) -> bool:
        """Whether everything is there, or the search for the target can begin."""
        return self._is_complete() or (self._sight.is_wanted and self._planner.is_there)

    def _write_start(self) -> None:
        """Begin the log of the run, now that the robot is known; once."""
        if self._has_started:
            return
        self._has_started = True
        names = ("width", "height", "fx", "fy", "cx", "cy")
        try:
            camera = self._tracker.calibrations[0].rectified_camera()
            known = {"camera": {name: getattr(camera, name) for name in names}}
        except CalibrationError:
            known = {}  # next_best_view will say so
        task = asdict(self.config(TaskConfig))
        self._log.write("start", task=task, robot=self._tracker.robot.name, **known)

    def _is_complete(self) -> bool:
        """Whether everything is there that a mission needs; says what is not."""
        assert self._exploration is not None
        missing = ""
        if self._tracker.known_state() is None:
            missing = "camera_pose, joint_states, robot_description and left/camera_info"
        elif not self._robot.sees:
            missing = "map_updates"
        elif not self._planner.is_there:
            missing = "next_best_view"
        if missing:
            self._exploration.last_reason = f"waiting for {missing}"
            self.get_logger().info(f"waiting for {missing}", throttle_duration_sec=5.0)
        return not missing

    def _stopped(self) -> bool:
        exploration = self._exploration
        return exploration is not None and exploration.control.request is Request.STOP

    def _ask(self, request: Request, answer: str) -> str:
        """Pass a request on.

        Raises:
            ExplorationError: nothing runs that could carry it out.
        """
        if not self._running or self._exploration is None:
            raise ExplorationError("no exploration is running")
        self._exploration.control.ask(request)
        self._tracker.notify()
        return answer

    def _on_step(self, exploration: Exploration) -> None:
        """Save the account of the mission and publish it; called in the exploration's thread.

        Who plans has to know of it before it is asked.
        """
        if (move := self._tracker.take_move()) is not None:
            exploration.mission.move(move)
        try:
            exploration.mission.save(self._mission_file)
        except OSError as error:
            self.get_logger().error(
                f"cannot write {self._mission_file}: {error.strerror}", throttle_duration_sec=10.0
            )
        self._status.publish(status_message(exploration, self._failed_views))
        if not self._stopped():
            self._status.wait_for_all_acked(_ACKNOWLEDGED)

    def _publish_status(self) -> None:
        """Say what is being done; next_best_view learns from it what failed and where home is."""
        if self._exploration is None:
            return
        if not self._running and not self._exploration.state.startswith("ended"):
            raise RuntimeError("the thread of the exploration has ended by an error, see above")
        self._status.publish(status_message(self._exploration, self._failed_views))

    def _end(self) -> None:
        """End the exploration and stop the robot."""
        if self._exploration is not None and self._thread is not None:
            self._exploration.control.ask(Request.STOP)
            if self._time is not None:
                self._time.stop()
            self._thread.join(5.0)

    def destroy_node(self) -> None:
        """Stop the robot, then the node."""
        self._end()
        super().destroy_node()


def main() -> int:
    """Run the node."""
    return run_node(ExplorerNode)


if __name__ == "__main__":
    raise SystemExit(main())
