"""A robot on paper, and a room on paper that it sees."""

from __future__ import annotations

from typing import Any

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry, Path
from sensor_msgs.msg import CameraInfo, JointState, PointCloud2
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from infomap_ros.geometry import (
    CameraCalibration,
    CameraInfoRecord,
    JointStateRecord,
    OdometryRecord,
    PinholeCamera,
    PoseRecord,
    TextRecord,
    make_transform,
)
from infomap_ros.geometry.resources import find_share
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.messages import (
    encode_camera_info,
    encode_joint_state,
    encode_odometry,
    encode_pose,
    encode_text,
)
from infomap_ros.messages.rows import encode_rows
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.team.update import MapUpdate
from infomap_ros.team.wire import OCCUPANCY_ROW, encode_update

FRAMES = {side: f"{side}_camera_optical_frame" for side in ("left", "right")}
CAMERA = PinholeCamera(64, 48, 45.0, 45.0, 31.5, 23.5)
BASELINE = 0.1  # [m]
# The room's floor is under the wheels of a rover whose base is at the origin.
ROOM = np.array([[-2.0, -2.0, -0.08], [3.0, 2.0, 1.5]])
TYPES = RclpyMessageTypes()


class PaperRover:
    """Obeys at once: jumps to the end of each path and trajectory, and publishes its state.

    Args:
        graph: in which it is.
        tells_updates: publish an empty update with each state, as map_fusion does with each scan.

    Attributes:
        obeys: whether it drives.
        moves_arm: whether it moves its arm.
        is_located: whether it publishes its camera_pose; if not, odometry.
        is_silent: publish nothing.
        has_joints: whether it publishes its joints.
        pose_covariance: that it publishes with its camera_pose, shape (6, 6).
    """

    is_located, is_silent, has_joints = True, False, True

    def __init__(self, graph: Any, tells_updates: bool = True) -> None:
        self.graph, self.tells_updates = graph, tells_updates
        self.text = find_share("config/rover.urdf").read_text()
        self.model = RobotModel.from_urdf(self.text, FRAMES["left"], "base_link")
        self.joints = {joint.name: 0.1 for joint in self.model.joints}
        self.base, self.obeys, self.pose_covariance = np.eye(4), True, 1e-6 * np.eye(6)
        self.moves_arm = True
        self.paths: list[Path] = []
        self.trajectories: list[JointTrajectory] = []
        self.stamp = 1_000_000_000
        self.poses = graph.publisher(PoseWithCovarianceStamped, "camera_pose")
        self.odometry = graph.publisher(Odometry, "odom")
        self.states = graph.publisher(JointState, "joint_states")
        self.infos = {side: graph.publisher(CameraInfo, f"{side}/camera_info") for side in FRAMES}
        self.updates = graph.publisher(PointCloud2, "map_updates", 200)
        description = graph.tester.create_publisher(String, "robot_description", qos.latched())
        description.publish(encode_text(TYPES, TextRecord(0, "", self.text)))
        graph.tester.create_subscription(Path, "base_path", self.on_path, 10)
        graph.tester.create_subscription(JointTrajectory, "arm_trajectory", self.on_arm, 10)
        graph.tester.create_timer(0.05, self.publish)

    def T_map_camera(self) -> np.ndarray:
        return self.base @ self.model.forward_kinematics(self.joints, FRAMES["left"])

    def publish(self) -> None:
        if self.is_silent:
            return
        self.stamp += 50_000_000
        pose = PoseRecord(self.stamp, "map", self.T_map_camera(), self.pose_covariance)
        if self.is_located:
            self.poses.publish(encode_pose(TYPES, pose))
        else:
            odometry = OdometryRecord(
                self.stamp, "odom", self.base, None, "base_link", np.zeros(6), 1e-6 * np.eye(6)
            )
            self.odometry.publish(encode_odometry(TYPES, odometry))
        positions = np.array(list(self.joints.values()))
        state = JointStateRecord(self.stamp, "", tuple(self.joints), positions)
        if self.has_joints:
            self.states.publish(encode_joint_state(TYPES, state))
        for side, publisher in self.infos.items():
            info = CameraInfoRecord(self.stamp, FRAMES[side], calibration(side))
            publisher.publish(encode_camera_info(TYPES, info))
        if self.tells_updates:
            self.updates.publish(encode_rows(TYPES, self.stamp, "map", np.zeros(0, OCCUPANCY_ROW)))

    def on_path(self, message: Path) -> None:
        self.paths.append(message)
        if self.obeys and message.poses:
            place = message.poses[-1].pose.position
            self.base = make_transform(np.eye(3), (place.x, place.y, 0.0))

    def on_arm(self, message: JointTrajectory) -> None:
        self.trajectories.append(message)
        if self.moves_arm:
            self.joints |= dict(zip(message.joint_names, message.points[-1].positions, strict=True))

    def looks(self, *pans: float, tilt: float = 0.4) -> VoxelMap:
        """Map of the room after two scans in each posture of the arm [rad]."""
        voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.1, max_range=5.0))
        voxel_map.track_changes(True)
        for pan in pans:
            self.joints |= {"arm_pan_joint": pan, "arm_wrist_joint": tilt}
            for _ in range(2):
                pose = self.T_map_camera()
                voxel_map.integrate(room_scan(pose), pose, camera=CAMERA)
        return voxel_map


def calibration(side: str) -> CameraCalibration:
    """Calibration of one camera of the pair."""
    k = CAMERA.matrix
    offset = -CAMERA.fx * BASELINE if side == "right" else 0.0
    projection = np.hstack([k, [[offset], [0.0], [0.0]]])
    return CameraCalibration(CAMERA.width, CAMERA.height, intrinsics=k, projection=projection)


def room_scan(T_map_camera: np.ndarray) -> np.ndarray:
    """What the camera measures in the room, shape (48, 64, 3), float32."""
    rays = CAMERA.back_project(np.ones((CAMERA.height, CAMERA.width))).astype(np.float64)
    directions = rays @ T_map_camera[:3, :3].T
    with np.errstate(divide="ignore"):
        walls = (np.where(directions > 0.0, ROOM[1], ROOM[0]) - T_map_camera[:3, 3]) / directions
    return (rays * walls.min(axis=-1, keepdims=True)).astype(np.float32)


def update_messages(
    voxel_map: VoxelMap, robot: int = 0, version: int = 1, frame: str = "map"
) -> list[PointCloud2]:
    """A map as a robot tells it to others."""
    size = voxel_map.config.voxel_size
    update = MapUpdate.of_changes(voxel_map.take_changes(), size, robot, version)
    return [encode_rows(TYPES, 1_000_000_000, frame, rows) for rows in encode_update(update)]
