"""simulator over DDS: what it publishes fits together, and it moves where it is told."""

from __future__ import annotations

import json
import time
from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist
from nav_msgs.msg import Odometry, Path
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from infomap_ros.errors import InvalidInputError, RobotModelError
from infomap_ros.geometry import rig_from_calibrations
from infomap_ros.messages import (
    decode_camera_info,
    decode_image,
    decode_joint_state,
    decode_odometry,
    decode_pose_with_covariance,
)
from infomap_ros.messages.motions import encode_arm_trajectory, encode_base_path
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.motion.route import ArmPath
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.nodes.driving.motion_result import MotionResult, Outcome, read_motion_result
from infomap_ros.nodes.robot_driver import RobotDriverNode
from infomap_ros.nodes.simulated.simulated_driver import simulated_driver
from infomap_ros.nodes.simulator import SimulatorNode
from infomap_ros.simulation.body.base_motion import planar
from infomap_ros.simulation.robots.robot_file import RobotFile
from infomap_ros.simulation.worlds.scenes import build_scene

TYPES = RclpyMessageTypes()
SMALL = {
    "world": "office",
    "pace": 0.0,
    "camera__width": 64,
    "camera__height": 48,
    "camera__supersampling": 1,
    "images_while_moving": False,
}


class Bench:
    """The node with a listener to everything that a robot publishes."""

    def __init__(self, graph: Any, **parameters: Any) -> None:
        self.graph = graph
        self.node = graph.add(SimulatorNode, **{**SMALL, **parameters})
        self.joints = graph.collect(JointState, "joint_states")
        self.odometry = graph.collect(Odometry, "odom")
        self.poses = graph.collect(PoseWithCovarianceStamped, "camera_pose")
        self.truth = graph.collect(PoseWithCovarianceStamped, "ground_truth/base_pose")
        self.commands = {
            "cmd_vel": graph.publisher(Twist, "cmd_vel"),
            "base_path": graph.publisher(Path, "base_path"),
            "arm_trajectory": graph.publisher(JointTrajectory, "arm_trajectory"),
        }
        graph.connect(*self.commands.values())
        graph.spin_until(lambda: self.poses and self.truth and self.joints, "the first state")
        heard = [publisher.get_subscription_count for publisher in self.commands.values()]
        graph.spin_until(lambda: all(count() for count in heard), "ears for commands")

    def base(self) -> np.ndarray:
        """Newest true x, y, yaw."""
        return planar(decode_pose_with_covariance(self.truth[-1]).transform)

    def rests_at(self, goal: np.ndarray) -> bool:
        return bool(np.abs(self.base() - goal).max() < 0.08) and not self.moving

    @property
    def moving(self) -> bool:
        return bool(self.node._simulator.is_moving)


def test_state_images_and_truth_fit_together(graph: Any) -> None:
    bench = Bench(graph)
    images = graph.collect(Image, "left/image_raw"), graph.collect(Image, "right/image_raw")
    infos = (
        graph.collect(CameraInfo, "left/camera_info"),
        graph.collect(CameraInfo, "right/camera_info"),
    )
    clocks = graph.collect(Clock, "/clock")
    descriptions = graph.collect(String, "robot_description", qos.latched())
    scenes = graph.collect(String, "ground_truth/scene", qos.latched())
    graph.spin_until(
        lambda: all(images) and all(infos) and clocks and descriptions and scenes, "everything"
    )
    left, right = (decode_image(each[0]) for each in images)
    assert left.stamp == right.stamp
    assert left.pixels.shape == (48, 64)
    assert (left.frame_id, right.frame_id) == (
        "left_camera_optical_frame",
        "right_camera_optical_frame",
    )
    rig = rig_from_calibrations(*(decode_camera_info(each[0]).calibration for each in infos))
    assert rig.baseline == pytest.approx(0.1016)
    at_image = [decode_pose_with_covariance(m) for m in bench.poses]
    assert left.stamp in [pose.stamp for pose in at_image]
    joints = decode_joint_state(bench.joints[-1])
    pose = next(p for p in reversed(at_image) if p.stamp <= joints.stamp)
    base = decode_pose_with_covariance(bench.truth[-1]).transform
    robot = RobotModel.from_urdf(descriptions[0].data)
    positions = dict(zip(joints.names, joints.positions.tolist(), strict=True))
    expected = base @ robot.forward_kinematics(positions, "left_camera_optical_frame")
    np.testing.assert_allclose(pose.transform, expected, atol=0.03)
    assert decode_odometry(bench.odometry[-1]).child_frame_id == "base_link"
    world = build_scene(scenes[0].data)
    assert np.array_equal(world.start, bench.node._simulator.world.start)


def test_a_depth_camera_takes_the_place_of_the_pair(graph: Any) -> None:
    Bench(graph, range_source="depth")
    depths = graph.collect(Image, "depth/image_rect")
    infos = graph.collect(CameraInfo, "depth/camera_info")
    pairs = graph.collect(Image, "left/image_raw")
    graph.spin_until(lambda: len(depths) > 1 and infos, "depth images")
    image = decode_image(depths[0])
    assert (image.encoding, image.frame_id) == ("32FC1", "left_camera_optical_frame")
    assert np.nanmedian(image.pixels) == pytest.approx(1.5, abs=1.2)
    assert not pairs
    assert decode_camera_info(infos[0]).calibration.rectified_camera().width == 64


def test_a_path_in_the_map_is_driven(graph: Any) -> None:
    bench = Bench(graph)
    start = bench.base()
    goal = np.add(start, (0.3, 0.1, 0.6))
    poses = np.array([start, np.add(start, (0.25, 0.0, 0.0)), goal])
    bench.commands["base_path"].publish(encode_base_path(TYPES, 0, "map", poses))
    graph.spin_until(lambda: bench.rests_at(goal), "the goal")
    believed = planar(decode_odometry(bench.odometry[-1]).transform)
    np.testing.assert_allclose(believed, (0.3, 0.1, 0.6), atol=0.2)


def test_an_empty_path_stops(graph: Any) -> None:
    bench = Bench(graph, pace=1.0)
    start = bench.base()
    far = np.array([start, np.add(start, (1.5, 0.0, 0.0))])
    bench.commands["base_path"].publish(encode_base_path(TYPES, 0, "odom", far - start))
    graph.spin_until(lambda: bench.base()[0] > start[0] + 0.05, "the drive to begin")
    bench.commands["base_path"].publish(encode_base_path(TYPES, 0, "map", np.zeros((0, 3))))
    graph.spin_until(lambda: not bench.moving, "standing still")
    assert bench.base()[0] < start[0] + 1.0


def test_velocity_and_trajectory_move_base_and_arm(graph: Any) -> None:
    bench = Bench(graph)
    names = ("arm_pan_joint", "arm_wrist_joint")
    path = ArmPath(names, np.array([(0.0, 0.0), (0.5, -0.3)]), np.array([0.0, 1.0]))
    bench.commands["arm_trajectory"].publish(encode_arm_trajectory(TYPES, 0, path))
    turn = Twist()
    turn.angular.z = 0.5
    start = bench.base()[2]

    told = [0.0]

    def turned() -> bool:
        if time.monotonic() > told[0] + 0.05:  # more of them would leave the simulation no time
            told[0] = time.monotonic()
            bench.commands["cmd_vel"].publish(turn)
        joints = decode_joint_state(bench.joints[-1])
        positions = dict(zip(joints.names, joints.positions, strict=True))
        arm = abs(positions[names[0]] - 0.5) + abs(positions[names[1]] + 0.3)
        return bool(np.sin(bench.base()[2] - start) > 0.2 and arm < 0.03)

    graph.spin_until(turned, "turned base and moved arm")


def test_bad_commands_are_counted_and_move_nothing(graph: Any) -> None:
    bench = Bench(graph, publish_tf=False)
    graph.spin_until(lambda: not bench.moving, "standing still")
    seen = len(bench.truth)
    graph.spin_until(lambda: len(bench.truth) > seen + 2, "news from where it stands")
    before = bench.base()
    there = np.array([np.add(before, (1.0, 0.0, 0.0))])
    bench.commands["base_path"].publish(encode_base_path(TYPES, 0, "mars", there))
    unknown = ArmPath(("elbow",), np.zeros((1, 1)), np.zeros(1))
    bench.commands["arm_trajectory"].publish(encode_arm_trajectory(TYPES, 0, unknown))
    bench.commands["arm_trajectory"].publish(JointTrajectory())
    twist = Twist()
    twist.linear.x = float("nan")
    bench.commands["cmd_vel"].publish(twist)
    reasons = ("wrong frame", "invalid data", "malformed message")
    graph.spin_until(
        lambda: all(any(r in key for key in bench.node.health.values()) for r in reasons), "drops"
    )
    late = ArmPath(("arm_elbow_joint",), np.ones((1, 1)), np.zeros(1))
    bench.commands["arm_trajectory"].publish(encode_arm_trajectory(TYPES, 1, late))
    graph.spin_until(
        lambda: "s ago" in bench.node.health.values()["last drop: invalid data"],
        "the refusal of a trajectory whose stamp is past",
    )
    np.testing.assert_allclose(bench.base(), before, atol=1e-6)


@pytest.mark.skipif(
    find_spec("control_msgs") is None or find_spec("nav2_msgs") is None,
    reason="control_msgs and nav2_msgs: python -m infomap_ros.nodes.common.message_packages",
)
def test_it_moves_by_actions_through_robot_driver(graph: Any) -> None:
    joints = ", ".join(f"arm_{name}_joint" for name in ("pan", "shoulder", "elbow", "wrist"))
    driver = graph.add(RobotDriverNode, controllers=[f"arm_controller: {joints}"])
    bench = Bench(graph, commands="actions")
    results: list[MotionResult] = []
    graph.tester.create_subscription(
        DiagnosticArray, "motion_results", lambda m: results.append(read_motion_result(m)), 10
    )
    graph.connect(driver._results)
    parts = [part._carrier for part in driver._drivers]
    clients = [parts[0]._clients["arm_controller"], parts[1]._client]
    graph.spin_until(lambda: all(client.server_is_ready() for client in clients), "servers")
    graph.spin_until(lambda: driver._drivers[0]._joints._limits, "description")
    x, y, yaw = planar(decode_odometry(bench.odometry[-1]).transform)
    poses = [(x, y, yaw), (x + 0.2 * np.cos(yaw), y + 0.2 * np.sin(yaw), yaw)]
    before = bench.base()
    bench.commands["base_path"].publish(encode_base_path(TYPES, 7, "odom", np.array(poses)))
    graph.spin_until(lambda: results, "the result of the path")
    assert (results[0].stamp, results[0].outcome) == (7, Outcome.SUCCEEDED), results
    assert np.linalg.norm((bench.base() - before)[:2]) == pytest.approx(0.2, abs=0.05)
    path = ArmPath(("arm_pan_joint",), np.full((1, 1), 0.5), np.array([1.0]))
    message = encode_arm_trajectory(TYPES, 0, path, label="turn")
    bench.commands["arm_trajectory"].publish(message)
    graph.spin_until(lambda: len(results) == 2, "the result of the trajectory")
    assert (results[1].label, results[1].outcome) == ("turn", Outcome.SUCCEEDED), results
    states = decode_joint_state(bench.joints[-1])
    pan = states.positions[states.names.index("arm_pan_joint")]
    assert pan == pytest.approx(0.5, abs=0.03)


@pytest.mark.skipif(
    find_spec("control_msgs") is None or find_spec("nav2_msgs") is None,
    reason="control_msgs and nav2_msgs: python -m infomap_ros.nodes.common.message_packages",
)
def test_the_controller_of_a_robot_from_its_file_has_the_arm_without_the_hand(graph: Any) -> None:
    robot = {
        name: list(value) if isinstance(value, tuple) else value
        for name, value in RobotFile.read("panda_on_base").parameters.items()
    }
    driver = graph.add(RobotDriverNode, **{**robot, **simulated_driver("panda_on_base")})
    bench = Bench(graph, commands="actions", **robot)
    results: list[MotionResult] = []
    graph.tester.create_subscription(
        DiagnosticArray, "motion_results", lambda m: results.append(read_motion_result(m)), 10
    )
    graph.connect(driver._results)
    graph.spin_until(lambda: driver._drivers[0]._joints._limits, "description")
    client = driver._drivers[0]._carrier._clients["arm_controller"]
    graph.spin_until(client.server_is_ready, "the server")
    states = decode_joint_state(bench.joints[-1])
    start = states.positions[states.names.index("panda_joint1")]
    path = ArmPath(("panda_joint1",), np.full((1, 1), start + 0.3), np.array([2.0]))

    bench.commands["arm_trajectory"].publish(encode_arm_trajectory(TYPES, 0, path, label="turn"))
    graph.spin_until(lambda: results, "the result of the trajectory", 60.0)

    assert any("finger" in name for name in states.names)
    assert results[0].outcome == Outcome.SUCCEEDED, results


def test_a_contact_is_told(graph: Any) -> None:
    bench = Bench(graph)
    contacts = graph.collect(String, "ground_truth/contacts", qos.latched())
    graph.spin_until(lambda: contacts, "the first count")
    assert json.loads(contacts[0].data) == {"count": 0}
    path = ArmPath(
        ("arm_shoulder_joint", "arm_elbow_joint"), np.array([(1.9, 2.65)]), np.array([3.0])
    )
    bench.commands["arm_trajectory"].publish(encode_arm_trajectory(TYPES, 0, path))
    graph.spin_until(lambda: json.loads(contacts[-1].data)["count"] > 0, "a contact")
    assert "arm" in str(json.loads(contacts[-1].data)["last"])


def test_an_impossible_parameter_is_refused(graph: Any) -> None:
    with pytest.raises(InvalidInputError, match="mars, office, cave"):
        graph.add(SimulatorNode, world="venus")
    with pytest.raises(RobotModelError, match="no_wheel"):
        graph.add(SimulatorNode, **SMALL, robot__left_wheels=["no_wheel"])
