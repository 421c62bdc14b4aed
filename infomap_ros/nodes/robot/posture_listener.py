"""What odometry, joints, the robot's description and tf say of the camera's motion."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

from sensor_msgs.msg import JointState

from infomap_ros.errors import PoseUnavailableError, RobotModelError
from infomap_ros.geometry import JointStateRecord, OdometryRecord, PlacedSolid, TransformRecord
from infomap_ros.geometry.pose_buffer import PoseBufferConfig
from infomap_ros.localization.filter.motion_prior import RobotPosture
from infomap_ros.messages import decode_joint_state
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.robot.description_listener import DescriptionListener, warn_of_left_out
from infomap_ros.nodes.robot.odometry_listener import OdometryListener
from infomap_ros.nodes.robot.robot_tracker import RobotTrackerConfig
from infomap_ros.pipeline.clock_jumps import CLOCK_JUMP, ClockGate
from infomap_ros.pipeline.robot_motion import RobotMotion

_MOST_EARLY = 1000  # records that come before robot and camera are known


class PostureListener:
    """Listens to odom, joint_states, robot_description, and where these do not suffice to tf.

    When the clock of odometry jumps back, what was known before is forgotten. A lone odometry
    whose stamp no other agrees with is dropped (`ClockGate`).

    Args:
        node: that listens; has the configurations of frames and poses.
        on_change: called when more is known than before.
        required: whether the node cannot work without odometry.
        on_odometry: called with each record.
        on_edge: called with each transform of tf that is received.
    """

    def __init__(
        self,
        node: MonitoredNode,
        on_change: Callable[[], None],
        *,
        required: bool,
        on_odometry: Callable[[OdometryRecord], None] = lambda _: None,
        on_edge: Callable[[TransformRecord], None] = lambda _: None,
    ) -> None:
        self._node, self._frames = node, node.config(RobotTrackerConfig)
        self._buffer = node.config(PoseBufferConfig)
        self._on_change, self._log = on_change, node.get_logger()
        self._pass_odometry, self._pass_edge = on_odometry, on_edge
        self._robot: RobotModel | None = None
        self._motion: RobotMotion | None = None
        self._camera_frame = self._frames.camera_frame
        self._early: deque[OdometryRecord | JointStateRecord] = deque(maxlen=_MOST_EARLY)
        self._joints: JointStateRecord | None = None
        self._newest = -1
        self._gate: ClockGate[OdometryRecord] = ClockGate(node.drop, time.monotonic)
        self._useless = ""
        self.odom_frame = ""
        self._texts = DescriptionListener(
            node,
            self._on_description,
            self._frames.frame_prefix,
            required=False,
            on_edge=self._on_edge,
        )
        stream = qos.sensor_data(100)
        node.listen(JointState, "joint_states", self._on_joints, stream, required=False)
        self._odometry = OdometryListener(
            node,
            self._on_odometry,
            self._texts.frames,
            self._frames.odom_frame,
            self._frames.base_frame,
            required=required,
        )
        self._texts.want(self._camera_frame)

    @property
    def is_offered(self) -> bool:
        """Whether somebody publishes odometry, and where the camera is on the robot."""
        if self._useless or not self._odometry.is_offered:
            return False
        description = self._node.resolve_topic_name("robot_description")
        return self._motion is not None or self._node.count_publishers(description) > 0

    @property
    def is_known(self) -> bool:
        """Whether it is known where on the robot the camera is."""
        return self._motion is not None

    @property
    def newest_stamp(self) -> int | None:
        """Of odometry [ns], None before there is any."""
        return self._newest if self._newest >= 0 else None

    def look_from(self, camera_frame: str) -> None:
        """Set in which frame images are."""
        if not self._camera_frame:
            self._camera_frame = camera_frame
            self._texts.want(camera_frame)
            self._begin()

    def body(self, stamp: int) -> list[PlacedSolid]:
        """The robot's solids in the camera's frame at a time [ns]; none where it is not known."""
        if self._motion is None or self._useless:
            return []
        try:
            return self._motion.body(stamp)
        except PoseUnavailableError:
            return []

    def posture(self, stamp: int) -> RobotPosture:
        """Where base and camera were at a time [ns].

        Raises:
            PoseUnavailableError: it is not known.
        """
        if self._motion is None:
            text = self._useless or "no robot_description nor tf of the camera has arrived"
            raise PoseUnavailableError(text, "no odometry", may_arrive=not self._useless)
        try:
            return self._motion.posture(stamp)
        except PoseUnavailableError as error:
            if stamp < self._newest - CLOCK_JUMP:  # images have jumped back, odometry will
                raise PoseUnavailableError(str(error), error.reason, may_arrive=True) from error
            raise
        except RobotModelError as error:
            self._give_up(str(error))
            raise PoseUnavailableError(str(error), "robot description") from error

    def _on_description(self, text: str) -> None:
        self._robot = self._frames.robot.read(text, base_frame=self._frames.base_frame)
        self._log.info(f"robot '{self._robot.name}'")
        warn_of_left_out(self._log, self._robot)
        self._begin()

    def _on_joints(self, message: JointState) -> None:
        self._joints = decode_joint_state(message)
        self._node.health.note_joints(self._joints.names)
        self._add(self._joints)

    def _on_edge(self, edge: TransformRecord) -> None:
        """Transforms give odometry, and the camera where the description does not."""
        self._pass_edge(edge)
        self._odometry.add(edge)
        if not edge.is_static and (self._motion is None or self._is_on_robot):
            return
        if self._motion is not None:
            self._motion.add(edge)
        elif self._camera_frame in self._texts.frames.static:
            self._begin()

    @property
    def _is_on_robot(self) -> bool:
        """Whether the description tells where the camera is."""
        return self._robot is not None and self._camera_frame in self._robot.frames

    def _on_odometry(self, odometry: OdometryRecord) -> None:
        for record, has_jumped in self._gate.add(odometry.stamp, odometry):
            if has_jumped:
                self._begin()
                if self._joints is not None:  # which may have jumped before
                    self._add(self._joints)
            self._newest, self.odom_frame = record.stamp, record.frame_id
            self._pass_odometry(record)
            self._add(record)

    def _add(self, record: OdometryRecord | JointStateRecord) -> None:
        """Use a record, or keep it until robot and camera are known."""
        if self._motion is None:
            self._early.append(record)
        else:
            self._motion.add(record)
            self._on_change()

    def _begin(self) -> None:
        """Begin to collect, once it is known where on the robot the camera is, or anew."""
        self._newest = -1
        if not self._camera_frame:
            return
        fixed = self._texts.frames.static
        if not self._is_on_robot:
            self._texts.frames.listen_to_moving()
        if self._is_on_robot or self._camera_frame in fixed:
            self._useless = ""
            edges = () if self._is_on_robot else fixed.values()
            self._motion = RobotMotion(self._camera_frame, self._robot, edges, self._buffer)
            while self._early:
                self._motion.add(self._early.popleft())
        elif self._robot is not None:
            self._give_up(f"robot '{self._robot.name}' has no frame '{self._camera_frame}'")

    def _give_up(self, reason: str) -> None:
        """Say once why odometry is of no use."""
        if not self._useless:
            self._log.warning(f"odometry does not tell where the camera is: {reason}")
        self._useless = reason
