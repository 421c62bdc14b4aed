"""robot_driver across DDS: controllers on paper that keep the rules of the real ones."""

from __future__ import annotations

import time
from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Path
from rclpy.action import ActionClient, CancelResponse
from rclpy.clock import ClockType
from std_msgs.msg import String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from infomap_ros.errors import ConfigError, ResourceError
from infomap_ros.geometry.resources import find_share
from infomap_ros.messages.motions import encode_arm_trajectory, encode_base_path
from infomap_ros.motion.route import ArmPath
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.nodes.driving import action_motion, arm_driver
from infomap_ros.nodes.driving.motion_result import (
    FOLLOW_JOINT_TRAJECTORY,
    MotionResult,
    Outcome,
    action_class,
    read_motion_result,
)
from infomap_ros.nodes.robot_driver import RobotDriverNode

from .controllers import PathController, TrajectoryController, VelocityController
from .rovers import PaperRover

TYPES = RclpyMessageTypes()
ARM = ("arm_pan_joint", "arm_shoulder_joint", "arm_elbow_joint")
WRIST = ("arm_wrist_joint",)
TABLE = [f"arm_controller: {', '.join(ARM)}", "wrist_controller: arm_wrist_joint"]
NEEDS_ACTIONS = pytest.mark.skipif(
    find_spec("control_msgs") is None or find_spec("nav2_msgs") is None,
    reason="control_msgs and nav2_msgs: python -m infomap_ros.nodes.common.message_packages",
)


class Bench:
    """The driver, what commands it, and what it says."""

    def __init__(self, graph: Any, **parameters: Any) -> None:
        self.graph = graph
        self.results: list[MotionResult] = []
        graph.tester.create_subscription(
            DiagnosticArray,
            "motion_results",
            lambda message: self.results.append(read_motion_result(message)),
            10,
        )
        self.paths = graph.publisher(Path, "base_path")
        self.trajectories = graph.publisher(JointTrajectory, "arm_trajectory")
        self.node = graph.add(RobotDriverNode, **parameters)
        self.stamp = 0

    def drive(self, *poses: tuple[float, float, float], frame: str = "map") -> int:
        """Command a path; returns its stamp."""
        self.stamp += 1
        path = np.array(poses, dtype=float).reshape(-1, 3)
        self.paths.publish(encode_base_path(TYPES, self.stamp, frame, path))
        return self.stamp

    def move(self, joints: tuple[str, ...], goal: list[float], time: float, label: str) -> None:
        """Command a motion of joints from 0.1, where all are, to a goal."""
        knots = np.array([[0.1] * len(joints), goal])
        path = ArmPath(joints, knots, np.array([0.0, time]))
        self.trajectories.publish(encode_arm_trajectory(TYPES, 0, path, label=label))

    def result(self, key: int | str, timeout: float = 60.0) -> MotionResult:
        """What became of the command of this stamp or label."""

        def found() -> list[MotionResult]:
            return [each for each in self.results if key in (each.stamp, each.label)]

        self.graph.spin_until(found, f"result of {key}, have {self.results}", timeout)
        return found()[0]


def spin_for(graph: Any, seconds: float) -> None:
    """Serve callbacks for a while."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        graph.executor.spin_once(timeout_sec=0.05)


class ArmBench(Bench):
    """With the two controllers of the rover's arm."""

    def __init__(self, graph: Any, **parameters: Any) -> None:
        self.arm = TrajectoryController(graph, "arm_controller", dict.fromkeys(ARM, 0.1))
        self.wrist = TrajectoryController(graph, "wrist_controller", dict.fromkeys(WRIST, 0.1))
        self.description = graph.tester.create_publisher(String, "robot_description", qos.latched())
        self.description.publish(String(data=find_share("config/rover.urdf").read_text()))
        super().__init__(graph, **{"base": "none", "controllers": TABLE, **parameters})
        graph.spin_until(self.is_ready, "controllers and joints")

    def is_ready(self) -> bool:
        driver = self.node._drivers[0]
        known = len(driver._joints.positions) == 4 and driver._joints._limits is not None
        clients = getattr(driver._carrier, "_clients", {}).values()
        linked = self.trajectories.get_subscription_count() > 0
        return known and linked and all(client.server_is_ready() for client in clients)


@NEEDS_ACTIONS
def test_each_controller_moves_its_own_joints_and_says_so(graph: Any) -> None:
    bench = ArmBench(graph)
    bench.move(("arm_wrist_joint", "arm_pan_joint"), [0.4, 0.6], 0.6, "both")
    result = bench.result("both")
    assert (result.topic, result.outcome) == ("arm_trajectory", Outcome.SUCCEEDED)
    assert set(result.parts) == {"arm_controller", "wrist_controller"}
    assert not bench.arm.refused
    assert not bench.wrist.refused
    assert bench.arm.goals[0].names == ARM
    assert bench.arm.goals[0].stamp == 0
    assert bench.arm.goals[0].velocities is not None
    assert bench.arm.joints["arm_pan_joint"] == pytest.approx(0.6, abs=0.01)
    assert bench.arm.joints["arm_elbow_joint"] == pytest.approx(0.1)
    assert bench.wrist.joints["arm_wrist_joint"] == pytest.approx(0.4, abs=0.01)


@NEEDS_ACTIONS
def test_a_controller_that_aborts_stops_the_others_and_is_quoted(
    graph: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(arm_driver, "_GOAL_TIME", 0.2)
    bench = ArmBench(graph)
    bench.wrist.stuck.add("arm_wrist_joint")
    bench.arm.slower = 1e3  # it is under way when the wrist aborts
    knots = np.array([[0.1, 0.1], [0.3, 0.1], [0.3, 1.0]])
    path = ArmPath(("arm_wrist_joint", "arm_pan_joint"), knots, np.array([0.0, 0.2, 0.4]))
    bench.trajectories.publish(encode_arm_trajectory(TYPES, 0, path, label="stuck"))
    result = bench.result("stuck")
    assert result.outcome is Outcome.FAILED
    assert "wrist_controller: aborted, GOAL_TOLERANCE_VIOLATED (-5)" in result.reason
    assert "joint arm_wrist_joint is 0.20 off" in result.reason
    assert (bench.arm.canceled, bench.wrist.canceled) == (1, 0)
    assert not bench.arm.moves


@NEEDS_ACTIONS
def test_a_newer_trajectory_takes_the_place_of_the_one_before(graph: Any) -> None:
    bench = ArmBench(graph)
    bench.move(("arm_wrist_joint", "arm_pan_joint"), [1.0, 1.0], 5.0, "first")
    graph.spin_until(lambda: bench.arm.moves and bench.wrist.moves, "motion")
    bench.move(("arm_pan_joint",), [0.2], 0.3, "second")
    assert bench.result("first").outcome is Outcome.CANCELED
    assert bench.result("second").outcome is Outcome.SUCCEEDED
    graph.spin_until(lambda: not bench.wrist.moves, "stop of the wrist")
    assert bench.wrist.canceled == 1  # it has no part in the second
    assert bench.arm.canceled == 0


@NEEDS_ACTIONS
def test_a_trajectory_sent_in_motion_begins_with_the_velocity_of_the_joints(graph: Any) -> None:
    bench = ArmBench(graph)
    bench.move(("arm_pan_joint",), [1.0], 5.0, "first")
    graph.spin_until(lambda: bench.arm.joints["arm_pan_joint"] > 0.4, "motion")
    onward = ArmPath(("arm_pan_joint",), np.array([[1.2]]), np.array([3.0]))
    bench.trajectories.publish(encode_arm_trajectory(TYPES, 0, onward, label="onward"))
    assert bench.result("onward").outcome is Outcome.SUCCEEDED
    goal = bench.arm.goals[1]
    assert goal.times[0] == 0.0
    pan = ARM.index("arm_pan_joint")
    # The first motion is p = 0.1 + 0.9 s^2 (3 - 2 s), from rest to rest, s being time / 5 s.
    s = np.linspace(0.0, 1.0, 10_001)
    there = np.argmin(np.abs(0.1 + 0.9 * s**2 * (3.0 - 2.0 * s) - goal.positions[0, pan]))
    speed = 0.9 * 6.0 * s[there] * (1.0 - s[there]) / 5.0
    assert speed > 0.2
    assert goal.velocities[0, pan] == pytest.approx(speed, rel=0.3)
    np.testing.assert_allclose(np.delete(goal.velocities[0], pan), 0.0, atol=1e-9)
    bench.move(("arm_pan_joint",), [0.5], 3.0, "from rest")
    assert bench.result("from rest").outcome is Outcome.SUCCEEDED
    np.testing.assert_allclose(bench.arm.goals[2].velocities[0], 0.0)


@NEEDS_ACTIONS
@pytest.mark.parametrize("means", ["empty trajectory", "service", "end of the node"])
def test_a_stop_cancels_the_goals(graph: Any, means: str) -> None:
    bench = ArmBench(graph)
    stop = graph.tester.create_client(Trigger, "robot_driver/stop")
    bench.move(("arm_wrist_joint", "arm_pan_joint"), [1.0, 1.0], 5.0, "long")
    graph.spin_until(lambda: bench.arm.moves and bench.wrist.moves, "motion")
    goals = bench.node._drivers[0]._carrier._motions._motion.goals
    graph.spin_until(lambda: all(goal._handle is not None for goal in goals), "answers")
    if means == "end of the node":
        graph.executor.remove_node(bench.node)
        graph.nodes.remove(bench.node)
        bench.node.destroy_node()
    elif means == "service":
        graph.spin_until(stop.service_is_ready, "service")
        stop.call_async(Trigger.Request())
    else:
        bench.trajectories.publish(JointTrajectory())
    graph.spin_until(lambda: not (bench.arm.moves or bench.wrist.moves), "stop")
    assert (bench.arm.canceled, bench.wrist.canceled) == (1, 1)
    assert bench.arm.joints["arm_pan_joint"] < 0.9
    if means != "end of the node":
        assert bench.result("long").outcome is Outcome.CANCELED


@NEEDS_ACTIONS
def test_a_refused_goal_stops_what_runs(graph: Any) -> None:
    bench = ArmBench(graph)
    bench.move(("arm_wrist_joint", "arm_pan_joint"), [1.0, 1.0], 5.0, "long")
    graph.spin_until(lambda: bench.arm.moves and bench.wrist.moves, "motion")
    bench.arm.inactive = True
    bench.move(("arm_pan_joint",), [0.5], 1.0, "refused")
    assert "arm_controller: refused the goal" in bench.result("refused").reason
    assert bench.result("long").outcome is Outcome.CANCELED
    graph.spin_until(lambda: not (bench.arm.moves or bench.wrist.moves), "stop")
    assert (bench.arm.canceled, bench.wrist.canceled) == (1, 1)


@NEEDS_ACTIONS
def test_a_controller_that_refuses_to_stop_is_said_at_once(graph: Any) -> None:
    bench = ArmBench(graph)
    bench.arm.server._server.register_cancel_callback(lambda _: CancelResponse.REJECT)
    bench.move(("arm_pan_joint",), [1.0], 20.0, "long")
    graph.spin_until(lambda: bench.arm.moves, "motion")
    begin = time.monotonic()
    bench.trajectories.publish(JointTrajectory())
    result = bench.result("long")
    assert "refuses to stop, the robot may still move" in result.reason
    assert time.monotonic() - begin < 2.5  # half of what is waited for an answer


@NEEDS_ACTIONS
def test_a_server_that_never_answers_stops_the_others_and_is_stopped_when_it_does(
    graph: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(action_motion, "_ANSWER", 1.0)
    bench, waiting = ArmBench(graph), []
    server = bench.arm.server._server
    answer = server._execute_goal_request

    async def keep(request: Any) -> None:
        waiting.append(request)

    server._execute_goal_request = keep
    bench.move(("arm_wrist_joint", "arm_pan_joint"), [1.0, 1.0], 60.0, "unanswered")
    result = bench.result("unanswered")
    assert result.outcome is Outcome.FAILED
    assert "has not answered the goal within 1 s, the robot may still move" in result.reason
    assert (bench.wrist.canceled, bench.wrist.moves, len(waiting)) == (1, False, 1)
    graph.executor.create_task(answer, *waiting)  # late: nobody waits for this motion any more
    graph.spin_until(lambda: bench.arm.canceled == 1, "the stop of what begins late")
    assert len(bench.arm.goals) == 1
    assert not bench.arm.moves


@NEEDS_ACTIONS
def test_a_goal_without_a_result_is_stopped(graph: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arm_driver, "_SLACK", 0.3)
    monkeypatch.setattr(arm_driver, "_GOAL_TIME", 0.2)
    bench = ArmBench(graph)
    bench.arm.slower = 1e6
    bench.move(("arm_pan_joint",), [0.3], 0.3, "endless")
    result = bench.result("endless")
    assert result.outcome is Outcome.FAILED and "no result within" in result.reason
    graph.spin_until(lambda: bench.arm.canceled == 1, "the stop")


@NEEDS_ACTIONS
def test_joints_that_the_table_lacks_are_refused(graph: Any) -> None:
    bench = ArmBench(graph, controllers=["arm_controller: arm_pan_joint"])
    bench.move(("arm_pan_joint",), [0.5], 0.3, "partial")
    result = bench.result("partial")
    assert result.outcome is Outcome.FAILED
    assert "arm_controller: refused the goal" in result.reason
    assert bench.arm.refused == ["1 joints, the controller has 3"]


@NEEDS_ACTIONS
def test_what_cannot_be_sent_is_said_and_stops_the_arm(graph: Any) -> None:
    bench = ArmBench(graph)
    bench.move(("arm_pan_joint",), [1.0], 5.0, "long")
    graph.spin_until(lambda: bench.arm.moves, "motion")
    bench.move(("gripper_joint",), [1.0], 1.0, "unknown")
    assert bench.result("unknown").reason == "no controller has the joint gripper_joint"
    assert bench.result("long").outcome is Outcome.CANCELED
    assert not bench.arm.moves
    bench.move(("arm_pan_joint",), [9.0], 9.0, "far")
    assert "'arm_pan_joint' at 9.0000 is outside" in bench.result("far").reason


@NEEDS_ACTIONS
def test_a_server_that_goes_is_noticed(graph: Any) -> None:
    bench = ArmBench(graph)
    bench.move(("arm_wrist_joint", "arm_pan_joint"), [1.0, 1.0], 5.0, "long")
    graph.spin_until(lambda: bench.arm.moves and bench.wrist.moves, "motion")
    bench.arm.server.destroy()
    result = bench.result("long")
    assert result.outcome is Outcome.FAILED
    assert "arm_controller: its action server has gone" in result.reason
    assert bench.wrist.canceled == 1
    bench.move(("arm_pan_joint",), [0.5], 1.0, "later")
    assert bench.result("later").reason == "there is no action server of arm_controller"


@NEEDS_ACTIONS
def test_topics_of_controllers_get_trajectories_that_they_accept(graph: Any) -> None:
    bench = ArmBench(graph, arm="joint_trajectory")
    bench.move(("arm_wrist_joint", "arm_pan_joint"), [0.4, 0.6], 0.6, "both")
    assert bench.result("both").outcome is Outcome.SUCCEEDED
    bench.move(("arm_pan_joint",), [1.6], 4.0, "long")
    graph.spin_until(lambda: bench.arm.joints["arm_pan_joint"] > 0.65, "motion")
    bench.trajectories.publish(JointTrajectory())
    assert bench.result("long").outcome is Outcome.CANCELED
    graph.spin_until(lambda: len(bench.arm.goals) == 3 and not bench.arm.moves, "stop")
    assert 0.1 <= bench.arm.goals[-1].times[-1] <= 0.5
    assert bench.arm.joints["arm_pan_joint"] < 1.2
    assert not bench.arm.refused
    assert not bench.wrist.refused


class Nav2Bench(Bench):
    """With Nav2's controller or navigator."""

    def __init__(self, graph: Any, base: str = "follow_path", **parameters: Any) -> None:
        self.nav2 = PathController(graph, base == "follow_path")
        super().__init__(graph, arm="none", base=base, **parameters)
        client = self.node._drivers[0]._carrier._client
        graph.spin_until(client.server_is_ready, "server")
        graph.connect(self.paths)


@NEEDS_ACTIONS
def test_a_path_is_given_in_pieces_between_turns_on_the_spot(graph: Any) -> None:
    bench = Nav2Bench(graph, controller_id="FollowPath", goal_checker_id="precise")
    bench.nav2.checkers = ("general_goal_checker", "precise")
    sent = bench.drive((0, 0, 0), (1, 0, 0), (1, 0, 1.5), (1, 1, 1.5))
    assert bench.result(sent).outcome is Outcome.SUCCEEDED
    assert [len(goal) for goal in bench.nav2.goals] == [2, 2]
    np.testing.assert_allclose(bench.nav2.goals[0][-1], (1, 0, 1.5))
    np.testing.assert_allclose(bench.nav2.base, (1, 1, 1.5))
    first = bench.nav2.requests[0]
    assert (first.controller_id, first.goal_checker_id) == ("FollowPath", "precise")
    assert first.path.header.frame_id == "map"
    assert first.path.header.stamp.sec == first.path.header.stamp.nanosec == 0


@NEEDS_ACTIONS
@pytest.mark.parametrize(
    ("given", "told"),
    [
        (
            {"controller_id": "Mine"},
            "INVALID_CONTROLLER (101): Failed to find controller name: Mine",
        ),
        ({"goal_checker_id": "mine"}, "UNKNOWN (100): Failed to find goal checker name: mine"),
    ],
)
def test_a_plugin_that_nav2_does_not_have_is_quoted(
    graph: Any, given: dict[str, str], told: str
) -> None:
    bench = Nav2Bench(graph, **given)
    result = bench.result(bench.drive((0, 0, 0), (1, 0, 0)))
    assert result.outcome is Outcome.FAILED
    assert f"aborted, {told}" in result.reason


@NEEDS_ACTIONS
def test_a_stop_cancels_nothing_that_is_commanded_after_it(graph: Any) -> None:
    bench = Nav2Bench(graph)
    spin_for(graph, 0.5)
    graph.executor.remove_node(graph.tester)  # servers take what they are asked later, all at once
    bench.drive()
    sent = bench.drive((0, 0, 0), (1, 0, 0))
    spin_for(graph, 0.5)
    graph.executor.add_node(graph.tester)
    assert bench.result(sent).outcome is Outcome.SUCCEEDED
    assert bench.nav2.canceled == 0


@NEEDS_ACTIONS
def test_an_abort_of_nav2_is_quoted_by_name(graph: Any) -> None:
    bench = Nav2Bench(graph)
    bench.nav2.blocked = True
    result = bench.result(bench.drive((0, 0, 0), (1, 0, 0)))
    assert result.outcome is Outcome.FAILED
    assert "aborted, FAILED_TO_MAKE_PROGRESS (105): Failed to make progress" in result.reason


@NEEDS_ACTIONS
def test_a_newer_path_and_an_empty_one_end_the_one_before(graph: Any) -> None:
    bench = Nav2Bench(graph)
    first = bench.drive((0, 0, 0), (20, 0, 0), (20, 0, 1.5), (20, 9, 1.5))
    graph.spin_until(lambda: bench.nav2.base[0] > 0.1, "motion")
    second = bench.drive((0, 0, 0), (0, 20, 1.57))
    assert bench.result(first).outcome is Outcome.CANCELED
    graph.spin_until(lambda: bench.nav2.base[1] > 0.1, "motion")
    bench.drive((0, 1, 1.57))  # to stay
    assert bench.result(second).outcome is Outcome.CANCELED
    assert bench.nav2.canceled == 1
    assert len(bench.nav2.goals) == 2


@NEEDS_ACTIONS
def test_a_navigator_gets_the_poses_of_the_path(graph: Any) -> None:
    bench = Nav2Bench(graph, "navigate_through_poses")
    path = [(x, 0.0, 0.0) for x in np.linspace(0.0, 2.0, 21)]
    assert bench.result(bench.drive(*path)).outcome is Outcome.SUCCEEDED
    np.testing.assert_allclose(bench.nav2.goals[0][:, 0], [0.5, 1.0, 1.5, 2.0], atol=0.051)


class VelocityBench(Bench):
    """With a base that takes velocities."""

    def __init__(self, graph: Any, kind: Any, **parameters: Any) -> None:
        self.rover = PaperRover(graph)
        self.rover.obeys = False
        self.base = VelocityController(self.rover, kind)
        super().__init__(graph, arm="none", **parameters)
        carrier = self.node._drivers[0]._carrier
        graph.connect(self.paths, carrier._velocities)
        graph.spin_until(lambda: carrier._tracker.known_state() is not None, "pose")


FAST = {"max_speed": 1.0, "max_turn_rate": 2.0, "acceleration": 4.0, "turn_acceleration": 8.0}


def test_a_base_is_driven_by_velocities_to_the_end_of_its_path(graph: Any) -> None:
    bench = VelocityBench(graph, TwistStamped, base="cmd_vel_stamped", **FAST)
    sent = bench.drive((0, 0, 0), (0.8, 0, 0), (0.8, 0, 1.57), (0.8, 0.5, 1.57))
    assert bench.result(sent).outcome is Outcome.SUCCEEDED
    assert np.linalg.norm(bench.base.pose[:2] - (0.8, 0.5)) < 0.1
    assert abs(bench.base.pose[2] - 1.57) < 0.1
    graph.spin_until(lambda: bench.base.commands[-1] == (0.0, 0.0), "stop")


def test_a_base_that_is_stuck_or_stopped_says_so(graph: Any) -> None:
    bench = VelocityBench(graph, Twist, base="cmd_vel", **FAST)
    moon = bench.drive((0, 0, 0), (1, 0, 0), frame="moon")
    assert "expected 'map' or 'odom'" in bench.result(moon).reason
    first = bench.drive((0, 0, 0), (9, 0, 0))
    graph.spin_until(lambda: bench.base.pose[0] > 0.3, "motion")
    bench.drive()
    assert bench.result(first).outcome is Outcome.CANCELED
    graph.spin_until(lambda: bench.base.commands[-1] == (0.0, 0.0), "stop")
    bench.base.stuck = True
    result = bench.result(bench.drive((0, 0, 0), (9, 0, 0)))
    assert result.outcome is Outcome.FAILED
    assert "the base is stuck at x" in result.reason


def test_a_base_whose_poses_end_under_way_is_stopped(graph: Any) -> None:
    bench = VelocityBench(graph, Twist, base="cmd_vel", **FAST)
    bench.base.patience = np.inf  # it keeps its last velocity
    sent = bench.drive((0, 0, 0), (9, 0, 0))
    graph.spin_until(lambda: bench.base.pose[0] > 0.3, "motion")
    bench.rover.is_silent = True
    result = bench.result(sent)
    assert result.outcome is Outcome.FAILED
    assert result.reason == "no pose of the base has come for 1 s"
    graph.spin_until(lambda: bench.base.commands[-1] == (0.0, 0.0), "stop")
    assert bench.base.pose[0] < 4.5


def test_stop_ends_a_drive_by_velocities_and_says_what_moved(graph: Any) -> None:
    bench = VelocityBench(graph, Twist, base="cmd_vel", **FAST)
    stop = graph.tester.create_client(Trigger, "robot_driver/stop")
    graph.spin_until(stop.service_is_ready, "service")
    first = bench.drive((0, 0, 0), (9, 0, 0))
    graph.spin_until(lambda: bench.base.pose[0] > 0.3, "motion")
    answers = []
    for _ in range(2):
        future = stop.call_async(Trigger.Request())
        graph.spin_until(future.done, "answer")
        answers.append(future.result().message)
        assert bench.result(first).outcome is Outcome.CANCELED
        graph.spin_until(lambda: bench.base.commands[-1] == (0.0, 0.0), "stop")
    assert answers[0] == "stopping" and answers[1].startswith("nothing that this node began moves")


@NEEDS_ACTIONS
def test_motions_are_timed_by_a_clock_that_nobody_sets(graph: Any) -> None:
    for bench in (ArmBench(graph), Nav2Bench(graph)):
        motions = bench.node._drivers[0]._carrier._motions
        assert motions._clock.clock_type is ClockType.STEADY_TIME


def test_an_arm_without_controllers_is_no_configuration(graph: Any) -> None:
    with pytest.raises(ConfigError, match="controllers"):
        graph.add(RobotDriverNode, base="none")


def test_a_missing_package_is_named_with_how_to_get_it() -> None:
    with pytest.raises(ResourceError, match="apt-get install ros-jazzy-no-such-msgs"):
        action_class("no_such_msgs/action/Fly")


@NEEDS_ACTIONS
@pytest.mark.parametrize("means", ["start of the node", "empty trajectory", "service"])
def test_what_a_killed_driver_began_is_stopped_too(graph: Any, means: str) -> None:
    """The goal is another client's, as that of a driver that was killed is to its successor."""
    arm = TrajectoryController(graph, "arm_controller", dict.fromkeys(ARM, 0.1))
    action = action_class(FOLLOW_JOINT_TRAJECTORY)
    stranger = ActionClient(graph.tester, action, "arm_controller/follow_joint_trajectory")
    graph.spin_until(stranger.server_is_ready, "the controller")

    def start_driver() -> RobotDriverNode:
        table = [f"arm_controller: {', '.join(ARM)}"]
        return graph.add(RobotDriverNode, base="none", controllers=table)

    driver = None if means == "start of the node" else start_driver()
    if driver is not None:
        motions = driver._drivers[0]._carrier._motions
        graph.spin_until(lambda: not motions._new, "the first cancel of all")
    knots = np.array([[0.1] * 3, [1.0] * 3])
    path = ArmPath(ARM, knots, np.array([0.0, 20.0]))
    goal = action.Goal(trajectory=encode_arm_trajectory(TYPES, 0, path))
    stranger.send_goal_async(goal)
    graph.spin_until(lambda: arm.moves, "motion")
    if driver is None:
        start_driver()
    elif means == "service":
        stop = graph.tester.create_client(Trigger, "robot_driver/stop")
        graph.spin_until(stop.service_is_ready, "the service")
        stop.call_async(Trigger.Request())
    else:
        publisher = graph.publisher(JointTrajectory, "arm_trajectory")
        graph.spin_until(publisher.get_subscription_count, "the driver")
        publisher.publish(JointTrajectory())
    graph.spin_until(lambda: not arm.moves, "stop")
    assert arm.canceled == 1
