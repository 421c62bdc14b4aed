"""What only the simulator knows of a robot's poses; for evaluation, never for the robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import PoseRecord, invert_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.pipeline.range_estimator import RangeMeasurement
from infomap_ros.pipeline.scan_synchronizer import Scan
from infomap_ros.simulation.simulator import Simulator

_KEPT = 100  # true poses, at the stamps of the newest images


@dataclass(frozen=True, eq=False)
class AuditedPose:
    """A pose that the robot believed, and how wrong it was.

    Attributes:
        pose: as the robot had it, with covariance.
        error: true minus believed, (dt, dtheta) of `geometry.transforms` in the map, shape (6,).
    """

    pose: PoseRecord
    error: FloatArray

    @property
    def nees(self) -> float:
        """Normalized estimation error squared: 6 on average where the covariance is true."""
        assert self.pose.covariance is not None
        return float(self.error @ np.linalg.solve(self.pose.covariance, self.error))


class PoseAudit:
    """Compares the poses of fused scans with the truth; implements `simulated_robot.Observer`.

    Args:
        simulator: knows the truth.
        T_world_map: where the map's frame truly is, shape (4, 4).

    Attributes:
        poses: of all scans so far.
    """

    def __init__(self, simulator: Simulator, T_world_map: FloatArray) -> None:
        self._simulator, self._T_map_world = simulator, invert_transform(T_world_map)
        self.poses: list[AuditedPose] = []
        self._true: dict[int, FloatArray] = {}

    def image_taken(self, stamp: int) -> None:
        """Remember where the camera truly is now, at `stamp` [ns]."""
        self._true[stamp] = self._T_map_world @ self._simulator.true_camera_pose()
        while len(self._true) > _KEPT:
            del self._true[next(iter(self._true))]

    def scan_fused(self, scan: Scan[RangeMeasurement]) -> None:
        """Compare the pose of a scan with the truth."""
        true = self._true.get(scan.pose.stamp)
        if true is not None and scan.pose.covariance is not None:
            self.poses.append(audit_pose(scan.pose, true))

    def figures(self) -> dict[str, float]:
        """Errors of the poses of all scans; see `pose_errors`."""
        return pose_errors(self.poses)


def audit_pose(pose: PoseRecord, T_map_camera: FloatArray) -> AuditedPose:
    """Compare a pose with the truth.

    Args:
        pose: as the robot believed it, with covariance.
        T_map_camera: as it truly was, shape (4, 4).
    """
    turn = Rotation.from_matrix(T_map_camera[:3, :3] @ pose.transform[:3, :3].T).as_rotvec()
    error = np.concatenate([T_map_camera[:3, 3] - pose.transform[:3, 3], turn])
    return AuditedPose(pose, error)


def mean_nees(poses: Sequence[AuditedPose]) -> float | None:
    """Mean NEES over its expectation of 6: 1 where covariances are true; None without poses."""
    return round(float(np.mean([pose.nees for pose in poses])) / 6.0, 3) if poses else None


def pose_errors(poses: Sequence[AuditedPose]) -> dict[str, float]:
    """Errors of poses, flat: root mean squares [m, rad], at the end and the largest [m]."""
    if not poses:
        return {}
    errors = np.stack([pose.error for pose in poses])
    distances = np.linalg.norm(errors[:, :3], axis=1)
    angles = np.linalg.norm(errors[:, 3:], axis=1)
    return {
        "pose_error_rms": round(float(np.sqrt(np.mean(distances**2))), 5),
        "pose_error_end": round(float(distances[-1]), 5),
        "pose_error_largest": round(float(distances.max()), 5),
        "pose_turn_rms": round(float(np.sqrt(np.mean(angles**2))), 5),
    }
