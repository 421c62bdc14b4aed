"""Where a robot is: by poses of its camera, carried on by odometry, and by its joints."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from infomap_ros.errors import PoseUnavailableError
from infomap_ros.exploration.robot import RobotState
from infomap_ros.geometry import (
    JointStateRecord,
    OdometryRecord,
    PoseRecord,
    Record,
    invert_transform,
)
from infomap_ros.geometry.assumed_pose import AssumedPoseConfig
from infomap_ros.geometry.joint_buffer import JointBuffer, JointBufferConfig
from infomap_ros.motion import RobotModel
from infomap_ros.pipeline.carried_pose import CarriedPose
from infomap_ros.pipeline.last_pose import LastPose


class TrackedRobot:
    """Tracks a robot. Between two poses, and where the camera is lost, odometry carries on.

    Odometry counts from the moment on at which the robot's description is known.

    Args:
        joints: how long joint positions are kept.
        assumed: covariance of poses that have none.

    Attributes:
        newest_odometry: stamp of the newest odometry [ns]; -1 before any has come.
    """

    def __init__(
        self,
        joints: JointBufferConfig | None = None,
        assumed: AssumedPoseConfig | None = None,
    ) -> None:
        self._assumed = assumed or AssumedPoseConfig()
        self._joints = JointBuffer(joints or JointBufferConfig())
        self._pose = LastPose(self._joints, self._assumed)
        self._robot: RobotModel | None = None
        self._carried: CarriedPose | None = None
        self.newest_odometry = -1
        self._last_two: list[OdometryRecord] = []
        self._stamped: tuple[int, RobotState] | None = None  # what is asked for again and again

    def describe(self, robot: RobotModel, camera_frame: str) -> None:
        """Learn what the robot is, and which optical frame the poses are of."""
        self._robot, self._carried = robot, CarriedPose(camera_frame, robot)
        self._pose.needed = robot.joints_above((robot.base_frame, robot.camera_frame))
        self._stamped = None

    def add(self, record: Record) -> None:
        """Take a pose of the camera in the map, odometry or joints; other records are ignored.

        Raises:
            FrameError: odometry is of other frames than before.
        """
        if isinstance(record, OdometryRecord):
            if self._carried is None:
                return
            self._carried.add_odometry(record)
            self.newest_odometry = record.stamp
            self._last_two = [*self._last_two[-1:], record]
        elif isinstance(record, PoseRecord):
            self._pose.add(record)
        elif isinstance(record, JointStateRecord):
            self._joints.add(record)
            if self._carried is not None:
                self._carried.add_joints(record)
        else:
            return
        self._pose.settle(self._carried)
        self._stamped = None

    @property
    def robot(self) -> RobotModel:
        """The robot.

        Raises:
            PoseUnavailableError: it is not known yet.
        """
        if self._robot is None:
            raise PoseUnavailableError("no robot_description or camera info has arrived yet")
        return self._robot

    @property
    def is_described(self) -> bool:
        """Whether it is known what the robot is."""
        return self._robot is not None

    @property
    def newest_stamp(self) -> int | None:
        """Stamp of the newest pose or odometry [ns]; None before the first pose."""
        newest = self._pose.newest_stamp
        return None if newest is None else max(newest, self.newest_odometry)

    @property
    def odom_frame(self) -> str:
        """Frame of odometry, empty before any has come."""
        return "" if self._carried is None else self._carried.odom_frame

    @property
    def base_speed(self) -> float:
        """How fast the base moves, the larger of [m/s] and [rad/s], by the newest odometry.

        Between its last two poses: not all drivers tell a twist. 0 before two have come, and where
        the clock has been set back.
        """
        if len(self._last_two) < 2:
            return 0.0
        first, last = self._last_two
        seconds = 1e-9 * (last.stamp - first.stamp)
        moved = invert_transform(first.transform) @ last.transform
        turn = Rotation.from_matrix(moved[:3, :3]).magnitude()
        way = max(float(np.linalg.norm(moved[:3, 3])), float(turn))
        return way / seconds if seconds > 0.0 else 0.0

    def joint_positions(self) -> dict[str, float]:
        """Newest position of each joint, by name [rad or m]; empty before the first."""
        return self._joints.newest()

    def joint_velocities(self) -> dict[str, float]:
        """Velocity of each joint between its two newest positions [rad/s or m/s]."""
        return self._joints.velocities()

    def state(self) -> RobotState:
        """The newest pose at which the joints are known too, carried on by odometry.

        Raises:
            PoseUnavailableError: pose, joints or description have not arrived.
        """
        return self.stamped_state()[1]

    def stamped_state(self) -> tuple[int, RobotState]:
        """As `state`, with its stamp [ns]."""
        if self._stamped is None:
            robot = self.robot
            pose, joints = self._pose.now(self._carried)
            assert pose.covariance is not None
            T_base_camera = robot.forward_kinematics(joints, robot.camera_frame)
            T_map_base = pose.transform @ invert_transform(T_base_camera)
            state = RobotState(T_map_base, pose.transform, pose.covariance, joints)
            self._stamped = pose.stamp, state
        return self._stamped

    def state_in_odometry(self) -> RobotState:
        """Where odometry has the robot, in its own frame: for a robot that is not located yet.

        Raises:
            PoseUnavailableError: odometry, joints or description have not arrived.
        """
        robot = self.robot
        if self._carried is None:
            raise PoseUnavailableError("no odometry has arrived yet")
        posture = self._carried.posture(self._carried.newest_stamp)
        camera, joints = posture.T_odom_camera, self._joints.newest()
        T_base_camera = robot.forward_kinematics(joints, robot.camera_frame)
        base = camera @ invert_transform(T_base_camera)
        return RobotState(base, camera, self._assumed.covariance(), joints)

    def known_state(self, in_odometry: bool = False) -> RobotState | None:
        """As `state` or `state_in_odometry`; None where that has no answer."""
        try:
            return self.state_in_odometry() if in_odometry else self.state()
        except PoseUnavailableError:
            return None
