"""What odometry, joint states and the robot's description say of the camera's motion."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from infomap_ros.errors import FrameError, PoseUnavailableError, RobotModelError
from infomap_ros.geometry import JointStateRecord, OdometryRecord, PlacedSolid
from infomap_ros.geometry.pose_buffer import PoseBufferConfig
from infomap_ros.localization.filter.motion_prior import RobotPosture
from infomap_ros.messages import decode_joint_state, decode_odometry, decode_text
from infomap_ros.motion import RobotModel
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.robot.robot_tracker import RobotTrackerConfig
from infomap_ros.pipeline.clock_jumps import CLOCK_JUMP
from infomap_ros.pipeline.robot_motion import RobotMotion

_MOST_EARLY = 1000  # records that come before robot and camera are known


class PostureListener:
    """Listens to odom, joint_states and robot_description.

    When the clock of odometry jumps back, what was known before is forgotten.

    Args:
        node: that listens; has the configurations of frames and poses.
        on_news: called when more is known than before.
        required: whether the node cannot work without them.
    """

    def __init__(self, node: MonitoredNode, on_news: Callable[[], None], *, required: bool) -> None:
        self._node, self._frames = node, node.config(RobotTrackerConfig)
        self._buffer = node.config(PoseBufferConfig)
        self._on_news, self._log = on_news, node.get_logger()
        self._robot: RobotModel | None = None
        self._motion: RobotMotion | None = None
        self._camera_frame = self._frames.camera_frame
        self._early: deque[OdometryRecord | JointStateRecord] = deque(maxlen=_MOST_EARLY)
        self._newest = -1
        self._useless = ""
        self.odom_frame = ""
        node.listen(
            String, "robot_description", self._on_description, qos.latched(), required=required
        )
        node.listen(
            JointState, "joint_states", self._on_joints, qos.sensor_data(100), required=required
        )
        node.listen(Odometry, "odom", self._on_odometry, qos.sensor_data(100), required=required)

    @property
    def is_offered(self) -> bool:
        """Whether somebody publishes odometry and the description of a robot with this camera."""
        topics = [self._node.resolve_topic_name(name) for name in ("odom", "robot_description")]
        return not self._useless and all(self._node.count_publishers(name) for name in topics)

    def look_from(self, camera_frame: str) -> None:
        """Tell in which frame images are."""
        if not self._camera_frame:
            self._camera_frame = camera_frame
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
            text = self._useless or "no robot_description has arrived"
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

    def _on_description(self, message: String) -> None:
        text = decode_text(message).text
        self._robot = self._frames.robot.read(text, base_frame=self._frames.base_frame)
        self._log.info(f"robot '{self._robot.name}'")
        self._begin()

    def _on_joints(self, message: JointState) -> None:
        self._add(decode_joint_state(message))

    def _on_odometry(self, message: Odometry) -> None:
        odometry: OdometryRecord = decode_odometry(message)
        wanted = self._frames.base_frame
        if wanted and odometry.child_frame_id != wanted:
            raise FrameError(f"odometry of '{odometry.child_frame_id}', base_frame is '{wanted}'")
        if odometry.stamp < self._newest - CLOCK_JUMP:
            self._begin()
        self._newest, self.odom_frame = odometry.stamp, odometry.frame_id
        self._add(odometry)

    def _add(self, record: OdometryRecord | JointStateRecord) -> None:
        """Use a record, or keep it until robot and camera are known."""
        if self._motion is None:
            self._early.append(record)
        else:
            self._motion.add(record)
            self._on_news()

    def _begin(self) -> None:
        """Begin to collect, once robot and camera are known, or anew."""
        self._newest = -1
        if self._robot is None or not self._camera_frame:
            return
        if self._camera_frame not in self._robot.frames:
            self._give_up(f"robot '{self._robot.name}' has no frame '{self._camera_frame}'")
        else:
            self._motion = RobotMotion(self._camera_frame, self._robot, config=self._buffer)
            while self._early:
                self._motion.add(self._early.popleft())

    def _give_up(self, reason: str) -> None:
        """Say once why odometry is of no use."""
        if not self._useless:
            self._log.warning(f"odometry does not tell where the camera is: {reason}")
        self._useless = reason
