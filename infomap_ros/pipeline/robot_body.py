"""Where the robot's own body was when a scan was taken."""

from __future__ import annotations

from collections.abc import Callable

from infomap_ros.errors import RobotModelError
from infomap_ros.geometry import JointStateRecord, PlacedSolid
from infomap_ros.geometry.joint_buffer import JointBuffer, JointBufferConfig
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.pipeline.clock_jumps import JumpingBuffer


class RobotBody:
    """The robot's solids by its description and joint states.

    Args:
        robot: by its description; None where that is not known yet.
        config: of the joint positions that are kept.
        are_joints_sent: whether joint states come, so that it is worth waiting for the first.
        required: whether a description that does not tell where the body is is an error.

    Attributes:
        robot: as above.
        newest_stamp: of the last joint state [ns].
    """

    def __init__(
        self,
        robot: RobotModel | None = None,
        config: JointBufferConfig | None = None,
        are_joints_sent: Callable[[], bool] = lambda: True,
        *,
        required: bool = True,
    ) -> None:
        limits = config or JointBufferConfig()
        self._joints = JumpingBuffer(lambda: JointBuffer(limits), round(limits.max_gap * 1e9))
        self.robot = robot
        self.newest_stamp = 0
        self._unknown: dict[str, str] = {}
        self._are_joints_sent, self._is_required = are_joints_sent, required

    @property
    def unknown(self) -> str:
        """Why the place of the body in the last scan of a sensor was not known.

        Empty where it was for all sensors, or where there is no description.
        """
        return "; ".join(sorted(set(self._unknown.values())))

    def add(self, state: JointStateRecord) -> None:
        """Take a joint state."""
        self._joints.add(state)
        self.newest_stamp = state.stamp

    def check_known_at(self, stamp: int) -> None:
        """Make sure that the place of the body at a time is known.

        Args:
            stamp: [ns].

        Raises:
            PoseUnavailableError: joint positions are not known at that time.
        """
        if self.robot is not None and self.robot.joints and self._has_joints:
            self._joints.at(stamp)

    @property
    def _has_joints(self) -> bool:
        """Whether joint states have come, or will."""
        return self.newest_stamp > 0 or self._are_joints_sent()

    def solids_in(self, frame: str, stamp: int) -> list[PlacedSolid]:
        """The body's solids at a time, placed in a frame; none where their place is not known.

        `unknown` says why it is not.

        Args:
            frame: of the sensor.
            stamp: [ns].

        Raises:
            PoseUnavailableError: joint positions are not known at that time.
            RobotModelError: the body is required, and the description lacks the frame, or a joint
                has no position.
        """
        self._unknown.pop(frame, None)
        robot = self.robot
        if robot is None:
            return []
        if robot.joints and not self._has_joints:
            self._unknown[frame] = "nobody publishes joint_states"
            return []
        positions = self._joints.at(stamp) if robot.joints else {}
        try:
            return robot.visible_solids_in(frame, positions)
        except RobotModelError as error:
            if self._is_required:
                raise
            self._unknown[frame] = str(error)
            return []

    def others_have_jumped(self, stamp: int) -> None:
        """The clock of those who ask has jumped back to `stamp` [ns]."""
        self._joints.others_have_jumped(stamp)
