"""Where description, joints or odometry do not tell, /tf and /tf_static do."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped
from sensor_msgs.msg import CameraInfo, JointState, PointCloud2
from std_msgs.msg import String

from infomap_ros.geometry import (
    CameraCalibration,
    CameraInfoRecord,
    JointStateRecord,
    TextRecord,
    TransformRecord,
    make_transform,
)
from infomap_ros.messages import (
    TF,
    decode_pose_with_covariance,
    encode_camera_info,
    encode_joint_state,
    encode_point_cloud,
    encode_pose,
    encode_text,
    encode_transforms,
)
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.message_types import message_class
from infomap_ros.nodes.dead_reckoning import DeadReckoningNode
from infomap_ros.nodes.map_fusion import MapFusionNode
from infomap_ros.nodes.next_best_view import NextBestViewNode

from .test_map_fusion import START, TYPES, cloud, pose

pytest.importorskip("tf2_msgs")
SECOND = 1_000_000_000
OPTICAL = "camera_infra1_optical_frame"
LOOKING_AHEAD = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
MOUNT = make_transform(LOOKING_AHEAD, [0.2, 0.0, 0.5])
# A robot whose description ends where its camera's driver begins.
ROBOT = """
<robot name="plain">
  <link name="base_link">
    <collision><origin xyz="2.2 0 0.5"/><geometry><sphere radius="0.5"/></geometry></collision>
  </link>
  <link name="mast"/>
  <joint name="lift" type="prismatic">
    <parent link="base_link"/><child link="mast"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="1" effort="1" velocity="1"/>
  </joint>
</robot>
"""


class Frames:
    """Publishes transforms as a robot's driver does."""

    def __init__(self, graph: Any) -> None:
        kind = message_class(TF)
        self.static = graph.tester.create_publisher(kind, "/tf_static", qos.latched())
        self.moving = graph.tester.create_publisher(kind, "/tf", qos.stream())

    def fix(self, parent: str, child: str, transform: Any) -> None:
        edge = TransformRecord(0, parent, child, transform, True)
        self.static.publish(encode_transforms(TYPES, [edge]))

    def move(self, stamp: int, parent: str, child: str, transform: Any) -> None:
        edge = TransformRecord(stamp, parent, child, transform)
        self.moving.publish(encode_transforms(TYPES, [edge]))


def describe(graph: Any, text: str = ROBOT) -> None:
    publisher = graph.tester.create_publisher(String, "robot_description", qos.latched())
    publisher.publish(encode_text(TYPES, TextRecord(0, "", text)))


def show_camera(graph: Any, topic: str = "left/camera_info", stamp: int = SECOND) -> Any:
    infos = graph.publisher(CameraInfo, topic)
    graph.connect(infos)
    record = CameraInfoRecord(stamp, OPTICAL, CameraCalibration(width=64, height=48))
    infos.publish(encode_camera_info(TYPES, record))
    return infos


def test_camera_and_odometry_of_a_robot_without_description_come_from_tf(graph: Any) -> None:
    frames = Frames(graph)
    frames.fix("base_link", OPTICAL, MOUNT)
    node = graph.add(DeadReckoningNode)
    poses = graph.collect(PoseWithCovarianceStamped, "camera_pose")
    graph.spin_until(lambda: frames.moving.get_subscription_count(), "a listener of /tf")
    stamp = SECOND
    infos = show_camera(graph)

    def drive() -> bool:
        nonlocal stamp
        stamp += SECOND // 10
        place = make_transform(np.eye(3), [stamp / SECOND, 0.0, 0.0])
        frames.move(stamp, "odom", "base_link", place)
        info = CameraInfoRecord(stamp, OPTICAL, CameraCalibration(width=64, height=48))
        infos.publish(encode_camera_info(TYPES, info))
        return len(poses) > 2

    graph.spin_until(drive, "poses")

    for message in poses:
        found = decode_pose_with_covariance(message)
        expected = MOUNT.copy()
        expected[0, 3] += found.stamp / SECOND
        np.testing.assert_allclose(found.transform, expected, atol=1e-9)
        assert found.covariance is not None
    assert "odometry" not in node.health.missing()


def test_the_body_is_cut_where_the_camera_is_fixed_to_the_robot_by_tf(graph: Any) -> None:
    node = graph.add(MapFusionNode, voxel_size=0.1)
    clouds = graph.publisher(PointCloud2, "points2")
    poses = graph.publisher(PoseWithCovarianceStamped, "camera_pose")
    graph.connect(clouds, poses)
    describe(graph, ROBOT.replace('type="prismatic"', 'type="fixed"'))
    body = node._inputs._body
    graph.spin_until(lambda: body.robot is not None, "the description")

    def fuse(number: int) -> None:
        stamp = START + number * SECOND
        poses.publish(encode_pose(TYPES, pose(stamp)))
        clouds.publish(encode_point_cloud(TYPES, cloud(stamp, frame=OPTICAL)))
        graph.spin_until(lambda: node.health.results() > number, "a scan")

    fuse(0)
    assert OPTICAL in node.health.values()["body"]
    assert node._keeper._builder.points_cut == 0

    Frames(graph).fix("base_link", OPTICAL, MOUNT)
    graph.spin_until(lambda: OPTICAL in body.robot.frames, "the frame")

    fuse(1)
    assert node.health.values()["body"] == "removed"
    assert node._keeper._builder.points_cut > 100


def test_a_robot_whose_joints_nobody_tells_is_mapped_with_a_warning(graph: Any) -> None:
    node = graph.add(MapFusionNode, voxel_size=0.1)
    node._inputs._listener._on_description(ROBOT.replace("mast", OPTICAL))
    node._inputs._listener._since -= 10.0
    clouds = graph.publisher(PointCloud2, "points2")
    poses = graph.publisher(PoseWithCovarianceStamped, "camera_pose")
    graph.connect(clouds, poses)

    poses.publish(encode_pose(TYPES, pose()))
    clouds.publish(encode_point_cloud(TYPES, cloud(frame=OPTICAL)))

    graph.spin_until(lambda: node.health.results() == 1, "the scan")
    assert "joint_states" in node.health.values()["body"]


def test_a_planner_takes_the_cameras_frame_from_tf(graph: Any) -> None:
    node = graph.add(NextBestViewNode)
    describe(graph)
    Frames(graph).fix("mast", OPTICAL, MOUNT)
    show_camera(graph)
    show_camera(graph, "right/camera_info")
    joints = graph.publisher(JointState, "joint_states")
    graph.connect(joints)
    state = JointStateRecord(SECOND, "", ("lift",), np.array([0.3]))
    joints.publish(encode_joint_state(TYPES, state))

    graph.spin_until(lambda: node._tracker._tracked.is_described, "the robot")

    found = node._tracker.robot.forward_kinematics({"lift": 0.3}, OPTICAL)
    np.testing.assert_allclose(found[:3, 3], [0.2, 0.0, 0.8], atol=1e-9)
    np.testing.assert_allclose(found[:3, :3], LOOKING_AHEAD, atol=1e-9)
