"""Where the camera has come to since it was last located, by odometry and joints."""

from __future__ import annotations

from infomap_ros.errors import InfomapError
from infomap_ros.geometry import JointStateRecord, OdometryRecord, PoseRecord
from infomap_ros.localization.filter.motion_prior import KinematicMotion, MotionPrior, RobotPosture
from infomap_ros.motion import RobotModel
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
