"""The robot's own body in a bag, so that it stays out of the map."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from infomap_ros.errors import RobotModelError
from infomap_ros.geometry import JointStateRecord, Record, TextRecord
from infomap_ros.geometry.joint_buffer import JointBuffer
from infomap_ros.mapping.scans.body import BodyFilterConfig, body_mask
from infomap_ros.motion import RobotModel
from infomap_ros.motion.robot.description_config import DescriptionConfig
from infomap_ros.replay.measuring.range_meters import Measurement


class RobotBody:
    """Drops the points of measurements that may lie on the robot.

    Attributes:
        dropped_points: how many were dropped.
        note: why nothing is dropped, empty where something can be.
    """

    def __init__(self, robot: RobotModel | None, config: BodyFilterConfig | None = None) -> None:
        self.dropped_points = 0
        self.note = "" if robot is not None else "no robot description"
        self._robot, self._config = robot, config or BodyFilterConfig()
        self._joints = JointBuffer()

    @classmethod
    def from_description(
        cls,
        description: str | Path,
        config: BodyFilterConfig | None = None,
        reading: DescriptionConfig | None = None,
    ) -> RobotBody:
        """A body by its URDF, a file or the text itself.

        Args:
            description: path or text.
            config: how points on it are found.
            reading: what the description does not say.

        Raises:
            RobotModelError: the URDF cannot be used.
        """
        return cls((reading or DescriptionConfig()).read(description), config)

    @property
    def needs_joints(self) -> bool:
        """Whether joint positions decide where the body is."""
        return self._robot is not None and bool(self._robot.joints)

    def add(self, record: Record) -> None:
        """Take a joint state; other records are ignored."""
        if isinstance(record, JointStateRecord):
            self._joints.add(record)

    def check_known_at(self, stamp: int, frame: str) -> None:
        """Make sure that the place of the body at a time is known.

        Where the robot does not have the frame, its body is left alone from now on; `note` tells.

        Raises:
            PoseUnavailableError: joint positions are not known at that time.
        """
        if self._robot is None:
            return
        if frame not in self._robot.frames:
            self.note = f"robot '{self._robot.name}' has no frame '{frame}'"
            self._robot = None
        elif self._robot.joints:
            self._joints.at(stamp)

    def remove(self, measurement: Measurement) -> np.ndarray:
        """Points of a measurement, shape (H, W, 3) [m], NaN where they may lie on the body.

        Raises:
            PoseUnavailableError: joint positions are not known at its stamp.
        """
        points = measurement.cloud.organised_points
        if self._robot is None:
            return points
        joints = self._joints.at(measurement.stamp) if self._robot.joints else {}
        try:
            solids = self._robot.solids_in(measurement.frame_id, joints)
        except RobotModelError as error:  # a joint that is never published
            self.note, self._robot = str(error), None
            return points
        mask = body_mask(points, measurement.cloud.covariance_triangles, solids, self._config)
        if mask.any():
            points = points.copy()
            points[mask] = np.nan
            self.dropped_points += int(mask.sum())
        return points


def description_among(records: Iterable[Record]) -> str:
    """The first robot description among text records, empty where there is none."""
    texts = (record.text for record in records if isinstance(record, TextRecord))
    return next((text for text in texts if "<robot" in text), "")
