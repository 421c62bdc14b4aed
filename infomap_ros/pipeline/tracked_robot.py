"""Where a robot is: by poses of its camera, carried on by odometry, and by its joints."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from infomap_ros.errors import InfomapError, PoseUnavailableError
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
from infomap_ros.localization.filter.motion_prior import KinematicMotion, MotionPrior, RobotPosture
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.pipeline.robot_motion import RobotMotion


class CarriedPose:
    """Carries a pose on to the newest odometry; its covariance grows on the way.

    Poses of the camera come once per pair and late; odometry comes often. And where the camera is
    lost, the robot is still where its wheels have taken it.

    Args:
        camera_frame: optical frame of the camera.
        robot: its description.
    """

    def __init__(self, camera_frame: str, robot: RobotModel) -> None:
        self._motion = RobotMotion(camera_frame, robot)
        self._noise = KinematicMotion()
        self._odometry = self._joints = -1

    def add_joints(self, record: JointStateRecord) -> None:
        """Take a joint state."""
        self._motion.add(record)
        self._joints = record.stamp

    def add_odometry(self, record: OdometryRecord) -> None:
        """Take odometry.

        Raises:
            FrameError: it is of other frames than before.
        """
        self._motion.add(record)
        self._odometry = record.stamp

    @property
    def odom_frame(self) -> str:
        """Frame of odometry, empty before any has come."""
        return self._motion.odom_frame

    @property
    def newest_stamp(self) -> int:
        """Newest time for which odometry and joints are known [ns]; -1 before."""
        return min(self._odometry, self._joints)

    def posture(self, stamp: int) -> RobotPosture:
        """Base and camera at a time.

        Args:
            stamp: [ns].

        Raises:
            PoseUnavailableError: odometry or joints are not known at that time.
            RobotModelError: a joint is never published.
        """
        return self._motion.posture(stamp)

    def carry(self, pose: PoseRecord, start: RobotPosture) -> PoseRecord:
        """The pose of the camera at the newest time for which odometry and joints are known.

        Args:
            pose: of the camera, with covariance.
            start: posture of the robot then.

        Returns:
            The later pose; the same one where odometry does not tell of the time since then.
        """
        newest = self.newest_stamp
        if newest <= pose.stamp or pose.covariance is None:
            return pose
        try:
            posture = self._motion.posture(newest)
        except InfomapError:
            return pose
        here = MotionPrior(pose.transform, pose.covariance).then(self._noise.since(start, posture))
        return PoseRecord(newest, pose.frame_id, here.T_before_after, here.covariance)


_MOST_WAITING = 50


class LastPose:
    """Remembers the newest pose with the joints and the posture of the robot at its stamp.

    Buffers of joints and odometry forget after some time; a camera that is lost for longer still
    has its last pose to be carried on from.

    Args:
        joints: is filled by the owner, who calls `settle` when it has been.
        assumed: covariance of poses that have none.

    Attributes:
        needed: joints that must be known at the stamp of a pose.
    """

    def __init__(self, joints: JointBuffer, assumed: AssumedPoseConfig) -> None:
        self._joints, self._assumed = joints, assumed
        self.needed: Collection[str] = ()
        self._waiting: list[PoseRecord] = []  # later than the known one; joints are missing
        self._known: tuple[PoseRecord, dict[str, float]] | None = None
        self._start: RobotPosture | None = None
        self._newest: int | None = None

    @property
    def newest_stamp(self) -> int | None:
        """Stamp of the newest pose [ns], whether or not joints are known then; None before."""
        return self._newest

    def add(self, pose: PoseRecord) -> None:
        """Take a pose; one that is older than the newest says that the clock was set back."""
        if self._newest is not None and pose.stamp < self._newest:
            self._waiting.clear()
            self._known = self._start = None
        self._newest = pose.stamp
        covariance = self._assumed.covariance() if pose.covariance is None else pose.covariance
        self._waiting = [*self._waiting[1 - _MOST_WAITING :], replace(pose, covariance=covariance)]

    def settle(self, carried: CarriedPose | None) -> None:
        """Find out where joints and odometry were at the newest pose, now that more are known."""
        for number in reversed(range(len(self._waiting))):
            try:
                joints = self._joints.at(self._waiting[number].stamp, self.needed)
            except PoseUnavailableError:
                continue
            self._known, self._start = (self._waiting[number], joints), None
            del self._waiting[: number + 1]
            break
        if self._known is not None and self._start is None and carried is not None:
            self._start = _posture(carried, self._known[0].stamp)

    def now(self, carried: CarriedPose | None) -> tuple[PoseRecord, dict[str, float]]:
        """Pose and joints of now, or as they were told where odometry does not tell.

        Raises:
            PoseUnavailableError: there has been no pose at which the joints are known.
        """
        if self._known is None:
            if not self._waiting:
                raise PoseUnavailableError("no camera_pose has arrived yet")
            newest = self._waiting[-1]
            return newest, self._joints.at(
                newest.stamp, self.needed
            )  # or an error that says what is missing
        pose, joints = self._known
        if carried is None or self._start is None:
            return pose, joints
        here = carried.carry(pose, self._start)
        return (pose, joints) if here is pose else (here, self._joints.at(here.stamp, self.needed))


def _posture(carried: CarriedPose, stamp: int) -> RobotPosture | None:
    try:
        return carried.posture(stamp)
    except InfomapError:
        return None


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
        change = max(float(np.linalg.norm(moved[:3, 3])), float(turn))
        return change / seconds if seconds > 0.0 else 0.0

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
