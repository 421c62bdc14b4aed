"""dead_reckoning across DDS: one pose per camera info, with its stamp, frame and numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import CameraInfo, JointState
from std_msgs.msg import String

from infomap_ros.geometry import (
    CameraCalibration,
    CameraInfoRecord,
    JointStateRecord,
    OdometryRecord,
    PoseRecord,
    TextRecord,
    make_transform,
)
from infomap_ros.geometry.resources import find_share
from infomap_ros.messages import (
    TF,
    decode_odometry,
    decode_pose_with_covariance,
    decode_transforms,
    encode_camera_info,
    encode_joint_state,
    encode_odometry,
    encode_pose,
    encode_text,
)
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.message_types import RclpyMessageTypes, message_class
from infomap_ros.nodes.dead_reckoning import DeadReckoningNode

CAMERA = "left_camera_optical_frame"
TYPES = RclpyMessageTypes()
SECOND = 1_000_000_000


class Stage:
    def __init__(self, graph: Any) -> None:
        self.graph = graph
        self.text = find_share("config/rover.urdf").read_text()
        self.robot = RobotModel.from_urdf(self.text, CAMERA, "base_link")
        self.poses = graph.collect(PoseWithCovarianceStamped, "camera_pose")
        self.node = graph.add(DeadReckoningNode)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.description = graph.tester.create_publisher(String, "robot_description", latched)
        self.description.publish(encode_text(TYPES, TextRecord(0, "", self.text)))
        self.infos = graph.publisher(CameraInfo, "left/camera_info")
        self.joints = graph.publisher(JointState, "joint_states")
        self.odometry = graph.publisher(Odometry, "odom")
        graph.connect(self.infos, self.joints, self.odometry, self.description)
        graph.spin_until(lambda: self.node._motion._robot is not None, "the description")

    def tell(self, stamp: int, x: float, pan: float) -> None:
        names = tuple(joint.name for joint in self.robot.joints)
        positions = np.array([pan if name == "arm_pan_joint" else 0.2 for name in names])
        self.joints.publish(
            encode_joint_state(TYPES, JointStateRecord(stamp, "", names, positions))
        )
        base = make_transform(np.eye(3), (x, 0.0, 0.1))
        record = OdometryRecord(stamp, "odom", base, None, "base_link", np.zeros(6))
        self.odometry.publish(encode_odometry(TYPES, record))

    def look(self, stamp: int) -> None:
        info = CameraInfoRecord(stamp, CAMERA, CameraCalibration(width=64, height=48))
        self.infos.publish(encode_camera_info(TYPES, info))


def test_pose_between_two_odometries(graph: Any) -> None:
    stage = Stage(graph)
    stage.tell(10 * SECOND, x=1.0, pan=0.0)
    stage.look(10 * SECOND + SECOND // 10)
    stage.tell(10 * SECOND + SECOND // 5, x=2.0, pan=0.4)
    graph.spin_until(lambda: stage.poses, "a pose")
    record = decode_pose_with_covariance(stage.poses[0])
    joints = {joint.name: 0.2 for joint in stage.robot.joints}
    expected = stage.robot.forward_kinematics(joints, CAMERA)
    expected[0, 3] += 1.5
    expected[2, 3] += 0.1
    np.testing.assert_allclose(record.transform, expected, atol=1e-9)
    assert (record.stamp, record.frame_id) == (10 * SECOND + SECOND // 10, "map")
    assert record.covariance is not None
    assert (np.diag(record.covariance) > 0.0).all()


def test_the_frame_of_odometry_is_placed_in_the_map_again_and_again(graph: Any) -> None:
    pytest.importorskip("tf2_msgs")
    frames = graph.collect(message_class(TF), "/tf", qos.stream(100))
    stage = Stage(graph)
    stage.tell(10 * SECOND, x=1.0, pan=0.0)
    stage.look(10 * SECOND)

    graph.spin_until(lambda: len(frames) > 5, "frames")

    edges = [edge for message in frames for edge in decode_transforms(message)]
    assert {(edge.frame_id, edge.child_frame_id) for edge in edges} == {("map", "odom")}
    assert edges[0].stamp == 10 * SECOND + SECOND // 2
    assert len({edge.stamp for edge in edges}) == len(edges)
    np.testing.assert_allclose(edges[-1].transform, np.eye(4), atol=1e-12)


def test_what_is_known_of_the_way_is_forgotten_when_time_goes_back(graph: Any) -> None:
    stage = Stage(graph)
    for second in range(40, 50):
        stage.tell(second * SECOND, x=float(second), pan=0.0)
    stage.look(49 * SECOND)
    graph.spin_until(lambda: stage.poses, "the pose after a motion")
    for moment in (SECOND, SECOND + SECOND // 10):  # a lone stamp would be no jump
        stage.tell(moment, x=0.0, pan=0.0)
    stage.look(SECOND + SECOND // 10)
    graph.spin_until(lambda: len(stage.poses) == 2, "the pose after the jump")
    far, near = (decode_pose_with_covariance(message).covariance for message in stage.poses)
    assert np.trace(near) < 0.01 * np.trace(far)


def test_odometry_of_another_link_is_refused(graph: Any) -> None:
    stage = Stage(graph)
    record = OdometryRecord(SECOND, "odom", np.eye(4), None, "base_footprint", np.zeros(6))
    stage.odometry.publish(encode_odometry(TYPES, record))
    graph.spin_until(lambda: stage.node.health.drops().get("wrong frame"), "the drop")


def test_info_without_odometry_is_dropped_and_counted(graph: Any) -> None:
    stage = Stage(graph)
    stage.tell(10 * SECOND, x=1.0, pan=0.0)
    stage.look(9 * SECOND)
    stage.tell(20 * SECOND, x=1.0, pan=0.0)
    key = "dropped: no odometry or joints at the stamp"
    graph.spin_until(lambda: stage.node.health.values().get(key) == "1", "the drop")
    assert stage.poses == []


@pytest.mark.parametrize("text", ["", "<robot"])
def test_bad_description_is_counted(graph: Any, text: str) -> None:
    stage = Stage(graph)
    stage.description.publish(encode_text(TYPES, TextRecord(0, "", text)))
    key = "dropped: robot description"
    graph.spin_until(lambda: stage.node.health.values().get(key) == "1", "the drop")


def test_the_base_is_published_and_is_where_a_user_puts_it(graph: Any) -> None:
    stage = Stage(graph)
    bases = graph.collect(Odometry, "base_odometry")
    told = graph.publisher(PoseWithCovarianceStamped, "initialpose")
    graph.connect(told)
    stage.tell(10 * SECOND, x=1.0, pan=0.3)
    stage.look(10 * SECOND)
    graph.spin_until(lambda: bases, "base_odometry")
    found = decode_odometry(bases[0])
    np.testing.assert_allclose(found.transform[:3, 3], (1.0, 0.0, 0.1), atol=1e-9)
    assert (found.frame_id, found.child_frame_id) == ("map", "base_link")
    assert found.covariance is not None

    plane = np.diag([0.25, 0.25, 0.0, 0.0, 0.0, 0.07])  # as RViz tells it
    quarter = make_transform([[0, -1, 0], [1, 0, 0], [0, 0, 1]], (5.0, 6.0, 0.0))
    told.publish(encode_pose(TYPES, PoseRecord(0, "map", quarter, plane)))
    graph.spin_until(lambda: stage.node._bases.newest_stamp is None, "the new place")
    stage.tell(11 * SECOND, x=2.0, pan=0.3)
    stage.look(11 * SECOND)
    graph.spin_until(lambda: len(bases) > 1, "the base at its new place")
    moved = decode_odometry(bases[1]).transform
    np.testing.assert_allclose(moved[:3, 3], (5.0, 7.0, 0.1), atol=1e-9)

    told.publish(encode_pose(TYPES, PoseRecord(0, "odom", quarter, plane)))
    graph.spin_until(lambda: stage.node.health.drops().get("wrong frame"), "the drop")
