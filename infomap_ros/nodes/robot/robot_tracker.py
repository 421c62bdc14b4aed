"""Where the robot is and what it is: pose, joints, description and camera, from their topics."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped
from sensor_msgs.msg import CameraInfo, JointState, PointCloud2

from infomap_ros.errors import FrameError, PoseUnavailableError
from infomap_ros.exploration.robot import RobotState
from infomap_ros.geometry import (
    CameraCalibration,
    PoseRecord,
    Record,
    invert_transform,
)
from infomap_ros.geometry.assumed_pose import AssumedPoseConfig
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.joint_buffer import JointBufferConfig
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.messages import decode_camera_info, decode_joint_state, decode_pose_with_covariance
from infomap_ros.messages.pose_uncertainty import decode_pose_uncertainty
from infomap_ros.motion.robot.robot_model import DescriptionConfig, RobotModel
from infomap_ros.motion.robot.urdf import hash_of_description
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.lockstep import LockstepTime
from infomap_ros.nodes.robot.description_listener import DescriptionListener, warn_of_left_out
from infomap_ros.nodes.robot.odometry_listener import OdometryListener
from infomap_ros.pipeline.tracked_robot import TrackedRobot

_MOST_UNNAMED = 10  # poses and origins that wait for each other
_PARTS = "camera_pose_uncertainty"  # names the origin of the map that a pose is in


class RobotTimeout:
    """A time limit that counts the robot's time where that goes slower than the clock.

    What a simulator on a busy machine is waited for comes, but later. Where odometry stands still
    or jumps back, the clock alone counts.

    Args:
        timeout: [s].
        stamp: of the newest odometry [ns]; negative before any has come.
        now: [s] of a clock that nobody sets.
    """

    def __init__(self, timeout: float, stamp: int, now: float) -> None:
        self._timeout, self._has_jumped = timeout, False
        self._begin, self._first = now, stamp
        self._changed, self._newest = now, stamp

    def is_over(self, stamp: int, now: float) -> bool:
        """Whether the time is over, by the newest odometry [ns] and the clock [s]."""
        self._has_jumped |= stamp < self._newest
        if self._first < 0:
            self._first = stamp
        if stamp != self._newest:
            self._changed, self._newest = now, stamp
        if now - self._begin <= self._timeout:
            return False
        is_moving_on = now - self._changed <= self._timeout
        return self._has_jumped or not is_moving_on or 1e-9 * (stamp - self._first) > self._timeout


@dataclass(frozen=True)
class RobotTrackerConfig:
    """How the robot's frames are called.

    Raises:
        ConfigError: a value is out of its range.
    """

    map_frame: str = parameter("map", "Frame of the map; camera_pose must be given in it.")
    base_frame: str = parameter(
        "base_link", "Link of robot_description that drives; its root link where empty."
    )
    odom_frame: str = parameter(
        "odom", "Frame of odometry on /tf, which gives it while nobody publishes odom."
    )
    frame_prefix: str = parameter(
        "",
        "Put before the names of the links of robot_description, as robot_state_publisher's "
        "parameter of this name.",
    )
    camera_frame: str = parameter(
        "", "Optical frame of the left camera. Empty: the frame of left/camera_info."
    )
    arm_joints: tuple[str, ...] = parameter(
        (),
        "Joints that move the camera when views are planned; all between base and camera where "
        "empty. The others between them are held.",
    )
    robot: DescriptionConfig = field(default_factory=DescriptionConfig)

    def __post_init__(self) -> None:
        check_config(self)


class RobotTracker:
    """Listens to camera_pose, joint_states, odom, robot_description and the camera infos.

    Between two poses, and where the camera is lost, odometry carries the last pose on.

    Callbacks of the node write, any thread reads.

    Args:
        node: has the configurations of tracker, joint buffer and assumed pose.
        infos: topics of the left and, for a stereo pair, the right camera info.
        required: whether the node cannot work without them.
    """

    def __init__(
        self,
        node: MonitoredNode,
        infos: tuple[str, ...] = ("left/camera_info", "right/camera_info"),
        *,
        required: bool = True,
    ) -> None:
        self._config = node.config(RobotTrackerConfig)
        self._tracked = TrackedRobot(node.config(JointBufferConfig), node.config(AssumedPoseConfig))
        self._changed = threading.Condition()
        self._infos: list[CameraCalibration | None] = [None] * len(infos)
        self._description = self._description_hash = ""
        self._camera_frame = self._last_frame = ""
        self._read: tuple[str, str] | None = None
        self._newest_pose: PoseRecord | None = None
        self._origin, self._move = 0, np.eye(4)
        self._unnamed: dict[int, PoseRecord] = {}
        self._origins: dict[int, int] = {}
        self._last: PoseRecord | None = None
        self._lockstep: LockstepTime | None = None
        self._log, self._health = node.get_logger(), node.health
        node.listen(
            PoseWithCovarianceStamped,
            "camera_pose",
            self._on_pose,
            qos.sensor_data(depth=50),
            required=required,
        )
        node.listen(PointCloud2, _PARTS, self._on_parts, qos.sensor_data(50), required=False)
        joints = qos.sensor_data(100)
        node.listen(JointState, "joint_states", self._on_joints, joints, required=required)
        self._texts = DescriptionListener(
            node,
            self._on_description,
            self._config.frame_prefix,
            required=required,
            on_edge=lambda edge: self._odometries.add(edge),
        )
        self._odometries = OdometryListener(
            node,
            self._add,
            self._texts.frames,
            self._config.odom_frame,
            self._config.base_frame,
            required=False,
        )
        for number, topic in enumerate(infos):
            listener = self._info_listener(number)
            node.listen(CameraInfo, topic, listener, qos.sensor_data(), required=required)

    @property
    def description_hash(self) -> str:
        """Of robot_description, see `hash_of_description`; empty before it has come."""
        with self._changed:
            return self._description_hash

    @property
    def robot(self) -> RobotModel:
        """The robot.

        Raises:
            PoseUnavailableError: robot_description or the camera info has not arrived.
        """
        with self._changed:
            return self._tracked.robot

    @property
    def calibrations(self) -> tuple[CameraCalibration, ...]:
        """Calibrations of the cameras, in the order of the topics.

        Raises:
            PoseUnavailableError: one has not arrived.
        """
        with self._changed:
            known = tuple(info for info in self._infos if info is not None)
            if len(known) < len(self._infos):
                raise PoseUnavailableError("no camera info has arrived yet")
            return known

    def state(self) -> RobotState:
        """The newest pose at which the joints are known too, carried on by odometry.

        Raises:
            PoseUnavailableError: pose, joints or description have not arrived.
        """
        return self.stamped_state()[1]

    def newest_stamp(self) -> int | None:
        """Stamp of the newest camera_pose or odometry [ns]; None before the first pose."""
        with self._changed:
            return self._tracked.newest_stamp

    @property
    def newest_pose(self) -> PoseRecord | None:
        """The newest camera_pose, whether or not the robot is known; None before the first."""
        with self._changed:
            return self._newest_pose

    @property
    def origin(self) -> int:
        """Names the frame of the map that camera_pose is in; 0 where it does not say."""
        with self._changed:
            return self._origin

    def take_move(self) -> FloatArray | None:
        """How the map has been moved to another frame since the last call; None where it was not.

        Returns:
            ``T_new_old``, shape (4, 4), as far as the robot stood still meanwhile.
        """
        with self._changed:
            move, self._move = self._move, np.eye(4)
        return None if np.array_equal(move, np.eye(4)) else move

    def stamped_state(self) -> tuple[int, RobotState]:
        """As `state`, with its stamp [ns].

        Raises:
            PoseUnavailableError: pose, joints or description have not arrived.
        """
        with self._changed:
            return self._tracked.stamped_state()

    def state_in_odometry(self) -> RobotState:
        """Where odometry has the robot, in its own frame: for a robot that is not located yet.

        Raises:
            PoseUnavailableError: odometry, joints or description have not arrived.
        """
        with self._changed:
            return self._tracked.state_in_odometry()

    @property
    def odom_frame(self) -> str:
        """Frame of odometry, empty before any has come."""
        with self._changed:
            return self._tracked.odom_frame

    @property
    def newest_odometry(self) -> int:
        """Stamp of the newest odometry [ns]; -1 before any has come."""
        with self._changed:
            return self._tracked.newest_odometry

    def known_state(self, in_odometry: bool = False) -> RobotState | None:
        """As `state` or `state_in_odometry`; None where that has no answer."""
        with self._changed:
            return self._tracked.known_state(in_odometry)

    def joint_positions(self) -> dict[str, float]:
        """Newest position of each joint, by name [rad or m]; empty before the first."""
        with self._changed:
            return self._tracked.joint_positions()

    def joint_velocities(self) -> dict[str, float]:
        """Velocity of each joint between its two newest positions [rad/s or m/s]."""
        with self._changed:
            return self._tracked.joint_velocities()

    def base_speed(self) -> float:
        """See `TrackedRobot.base_speed`."""
        with self._changed:
            return self._tracked.base_speed

    def wait_in_lockstep(self, time: LockstepTime) -> None:
        """From now on `wait_until` waits in the time of a simulator in lockstep."""
        self._lockstep = time

    def wait_until(
        self, condition: Callable[[], bool], timeout: float, interrupted: Callable[[], bool]
    ) -> bool:
        """Wait, not in a callback, until a condition holds.

        Args:
            condition: looked at whenever something has changed, and ten times a second.
            timeout: [s], see `RobotTimeout`.
            interrupted: breaks the waiting off.

        Returns:
            Whether the condition holds.
        """
        if self._lockstep is not None:
            return self._lockstep.wait_until(condition, timeout, interrupted)
        limit = RobotTimeout(timeout, self.newest_odometry, time.monotonic())
        while not condition():
            if interrupted() or limit.is_over(self.newest_odometry, time.monotonic()):
                return False
            with self._changed:
                self._changed.wait(0.1)
        return True

    def notify(self) -> None:
        """Wake those who wait, as when something else has come."""
        with self._changed:
            self._changed.notify_all()

    def _on_pose(self, message: PoseWithCovarianceStamped) -> None:
        pose = decode_pose_with_covariance(message)
        if pose.frame_id != self._config.map_frame:
            raise FrameError(
                f"pose in frame '{pose.frame_id}', the map is '{self._config.map_frame}'"
            )
        with self._changed:
            self._newest_pose = pose
            self._keep(self._unnamed, pose.stamp, pose)
        self._add(pose)

    def _on_parts(self, message: PointCloud2) -> None:
        stamp, _, parts = decode_pose_uncertainty(message)
        with self._changed:
            self._keep(self._origins, stamp, parts.origin)

    def _keep(self, kept: dict[int, Any], stamp: int, what: object) -> None:
        """Keep a pose or an origin until there are both of a stamp, whichever comes first."""
        kept[stamp] = what
        while len(kept) > _MOST_UNNAMED:
            del kept[next(iter(kept))]
        if stamp not in self._unnamed or stamp not in self._origins:
            return
        pose, origin = self._unnamed.pop(stamp), self._origins.pop(stamp)
        if self._origin and origin != self._origin and self._last is not None:
            self._move = pose.transform @ invert_transform(self._last.transform) @ self._move
        self._origin, self._last = origin, pose

    def _on_joints(self, message: JointState) -> None:
        joints = decode_joint_state(message)
        self._health.note_joints(joints.names)
        self._add(joints)

    def _add(self, record: Record) -> None:
        with self._changed:
            self._tracked.add(record)
            self._changed.notify_all()

    def _on_description(self, text: str) -> None:
        with self._changed:
            self._description = text
            self._description_hash = hash_of_description(self._texts.published)
            self._read_robot()

    def _info_listener(self, number: int) -> Callable[[CameraInfo], None]:
        def receive(message: CameraInfo) -> None:
            record = decode_camera_info(message)
            with self._changed:
                self._infos[number] = record.calibration
            if number == 0:
                self._take_frame(self._config.camera_frame or record.frame_id)

        return receive

    def _take_frame(self, frame: str) -> None:
        """Take the frame of a camera info.

        At once where no robot is known by another one, else when it has come twice, as a single
        odd one means nothing.
        """
        with self._changed:
            is_repeated, self._last_frame = frame == self._last_frame, frame
            if frame == self._camera_frame or not (is_repeated or self._read is None):
                return
            self._camera_frame = frame
        self._texts.want(frame)
        with self._changed:
            self._read_robot()

    def _read_robot(self) -> None:
        """Read the robot once both its description and the camera's frame are known."""
        wanted = self._description, self._camera_frame
        if not all(wanted) or self._read == wanted:
            return
        config = self._config
        robot = config.robot.read(
            self._description, self._camera_frame, config.base_frame, config.arm_joints
        )
        self._tracked.describe(robot, self._camera_frame)
        self._health.needed_joints = robot.joints_above((robot.base_frame, robot.camera_frame))
        self._read = wanted
        self._log.info(f"robot '{robot.name}', camera in '{self._camera_frame}'")
        warn_of_left_out(self._log, robot)
        self._changed.notify_all()
