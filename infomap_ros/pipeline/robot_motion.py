"""How a robot's odometry and joints say that its camera has moved."""

from __future__ import annotations

from collections.abc import Iterable

from infomap_ros.errors import FrameError, PoseUnavailableError, RobotModelError
from infomap_ros.geometry import (
    OdometryRecord,
    PlacedSolid,
    PoseBufferConfig,
    Record,
    TransformRecord,
    invert_transform,
)
from infomap_ros.geometry.joint_buffer import JointBuffer
from infomap_ros.geometry.pose_buffer import TransformTree
from infomap_ros.geometry.records import JointStateRecord
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.filter.motion_prior import RobotPosture
from infomap_ros.motion.robot.robot_model import RobotModel


class RobotMotion:
    """Odometry of the base, and the camera on it by forward kinematics or by tf.

    Where the robot's description has both the frame whose pose odometry tells and the camera's,
    joints lead from one to the other; else the edges of tf do.

    Args:
        camera_frame: optical frame of the camera.
        robot: by its description, if there is one.
        static: edges of tf_static.
    """

    def __init__(
        self,
        camera_frame: str,
        robot: RobotModel | None = None,
        static: Iterable[TransformRecord] = (),
        config: PoseBufferConfig | None = None,
    ) -> None:
        self._camera_frame, self._robot = camera_frame, robot
        self._joints = JointBuffer()
        self._tree = TransformTree(config)
        self._odom = self._base = ""
        for edge in static:
            self._tree.add_transform(edge)

    def add(self, record: Record) -> None:
        """Take odometry, a joint state or a transform; other records are ignored.

        Raises:
            FrameError: the frames contradict those before.
        """
        if isinstance(record, OdometryRecord):
            self._odom, self._base = record.frame_id, record.child_frame_id
            self._tree.add_pose(record, record.child_frame_id)
        elif isinstance(record, JointStateRecord):
            self._joints.add(record)
        elif isinstance(record, TransformRecord) and record.child_frame_id != self._base:
            self._tree.add_transform(record)

    @property
    def is_offered(self) -> bool:
        """True: who makes it has odometry."""
        return True

    @property
    def odom_frame(self) -> str:
        """Frame of odometry, empty before any has come."""
        return self._odom

    def posture(self, stamp: int) -> RobotPosture:
        """Where base and camera were.

        Args:
            stamp: [ns].

        Raises:
            PoseUnavailableError: odometry or joints are not known at that time.
            RobotModelError: a joint is never published.
        """
        if not self._odom:
            raise PoseUnavailableError("no odometry has arrived", "no odometry", may_arrive=True)
        T_odom_base = self._tree.at(self._odom, self._base, stamp).transform
        return RobotPosture(T_odom_base, self._T_base_camera(stamp))

    def body(self, stamp: int) -> list[PlacedSolid]:
        """The robot's solids in the camera frame; none where its description does not tell.

        Args:
            stamp: [ns].

        Raises:
            PoseUnavailableError: joints are not known at that time.
        """
        robot = self._robot
        if robot is None or self._camera_frame not in robot.frames:
            return []
        joints = self._joints.at(stamp) if robot.joints else {}
        try:
            return robot.visible_solids_in(self._camera_frame, joints)
        except RobotModelError:  # a joint that is never published
            return []

    def _T_base_camera(self, stamp: int) -> FloatArray:
        robot = self._robot
        if robot is None or not {self._base, self._camera_frame} <= set(robot.frames):
            return self._by_tf(stamp)
        needed = robot.joints_above((self._base, self._camera_frame))
        joints = self._joints.at(stamp, needed) if needed else {}
        T_root_base = robot.forward_kinematics(joints, self._base)
        return invert_transform(T_root_base) @ robot.forward_kinematics(joints, self._camera_frame)

    def _by_tf(self, stamp: int) -> FloatArray:
        try:
            return self._tree.at(self._base, self._camera_frame, stamp).transform
        except FrameError as error:
            reason = f"frame {self._camera_frame} has no place on {self._base}"
            raise PoseUnavailableError(str(error), reason) from error
