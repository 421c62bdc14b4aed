"""The newest pose of the camera that was told, and what odometry has made of it since."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

from infomap_ros.errors import InfomapError, PoseUnavailableError
from infomap_ros.geometry import PoseRecord
from infomap_ros.geometry.assumed_pose import AssumedPoseConfig
from infomap_ros.geometry.joint_buffer import JointBuffer
from infomap_ros.localization.filter.motion_prior import RobotPosture
from infomap_ros.pipeline.carried_pose import CarriedPose

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
