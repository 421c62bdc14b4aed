"""Poses of the camera from its own trajectory, for mapping a bag that tells none."""

from __future__ import annotations

from infomap_ros.errors import PoseUnavailableError
from infomap_ros.geometry import PoseRecord, Record
from infomap_ros.replay.localizing.trajectory import Trajectory

MAP_FRAME = "map"


class TrajectoryPoses:
    """Poses at the stamps of views, in place of `CameraPoses`.

    Attributes:
        camera_frame: the camera's optical frame.
        map_frame: ``map``.
    """

    def __init__(self, camera_frame: str) -> None:
        self.camera_frame, self.map_frame = camera_frame, MAP_FRAME
        self._poses: dict[int, PoseRecord] = {}

    def take(self, trajectory: Trajectory) -> None:
        """Use the poses of a trajectory."""
        self._poses = {
            int(stamp): PoseRecord(int(stamp), MAP_FRAME, pose, covariance, self.camera_frame)
            for stamp, pose, covariance in zip(
                trajectory.stamps, trajectory.transforms, trajectory.covariances, strict=True
            )
        }

    def add(self, record: Record) -> None:
        """Poses in the bag do not count."""

    def at(self, stamp: int) -> PoseRecord:
        """Pose of the camera at the stamp of a view [ns].

        Raises:
            PoseUnavailableError: the camera was lost then.
        """
        if stamp not in self._poses:
            raise PoseUnavailableError(f"no pose at {stamp} ns", "the camera was lost")
        return self._poses[stamp]
