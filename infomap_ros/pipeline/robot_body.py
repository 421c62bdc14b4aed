"""Where the robot's own body was when a scan was taken."""

from __future__ import annotations

from infomap_ros.geometry import JointStateRecord, PlacedSolid
from infomap_ros.geometry.joint_buffer import JointBuffer, JointBufferConfig
from infomap_ros.motion import RobotModel
from infomap_ros.pipeline.clock_jumps import JumpingBuffer


class RobotBody:
    """The robot's solids by its description and joint states.

    Args:
        robot: by its description; None where that is not known yet.
        config: of the joint positions that are kept.

    Attributes:
        robot: as above.
        newest_stamp: of the last joint state [ns].
    """

    def __init__(
        self, robot: RobotModel | None = None, config: JointBufferConfig | None = None
    ) -> None:
        limits = config or JointBufferConfig()
        self._joints = JumpingBuffer(lambda: JointBuffer(limits), round(limits.max_gap * 1e9))
        self.robot = robot
        self.newest_stamp = 0

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
        if self.robot is not None and self.robot.joints:
            self._joints.at(stamp)

    def solids_in(self, frame: str, stamp: int) -> list[PlacedSolid]:
        """The body's solids at a time, placed in a frame; none before there is a description.

        Args:
            frame: optical frame of the camera.
            stamp: [ns].

        Raises:
            RobotModelError: the description lacks the frame, or a joint has no position.
            PoseUnavailableError: joint positions are not known at that time.
        """
        if self.robot is None:
            return []
        positions = self._joints.at(stamp) if self.robot.joints else {}
        return self.robot.solids_in(frame, positions)

    def others_have_jumped(self, stamp: int) -> None:
        """The clock of those who ask has jumped back to `stamp` [ns]."""
        self._joints.others_have_jumped(stamp)
