"""What only the simulator knows of how well an exploration went; for evaluation, never for a robot.

Whatever compares a run with its truth (the demos, ``infomap explore``, the benchmarks) takes its
figures from here; ``docs/results/exploration_worlds.md`` says what they mean.

What only the simulator knows of a robot's poses; for evaluation, never for the robot.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import PoseRecord, invert_transform, transform_points
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.pipeline.range_estimator import RangeMeasurement
from infomap_ros.pipeline.scan_synchronizer import Scan
from infomap_ros.simulation.exploring.visible_surface import (
    VisibleSurfaceConfig,
    map_errors,
    surface_coverage,
    visible_surface,
)
from infomap_ros.simulation.simulator import Simulator
from infomap_ros.simulation.worlds.builder import World

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


# A share of 95 % of the 15,000 points or more that are visible among these has a standard error of
# 0.2 %, and counting takes 4 to 10 s of a core in place of 6 to 40 s.
_SURFACE = VisibleSurfaceConfig(max_points=30_000)


@dataclass(frozen=True)
class RunTruth:
    """How an exploration compares with the truth.

    Attributes:
        true_coverage: share of the visible true surface with a surface voxel within one voxel.
        within_1_sigma: share of the surface voxels whose distance to the true surface, along its
            normal, is at most one standard deviation that the map claims there; None where the
            map has no surface.
        within_2_sigma: likewise, two.
        within_3_sigma: likewise, three.
        map_error_median: of these distances [m].
        pose_nees: mean normalized estimation error squared of the poses over its expectation of 6;
            None without poses.
        contacts: forbidden ones, as the simulator counts them.
    """

    true_coverage: float
    within_1_sigma: float | None
    within_2_sigma: float | None
    within_3_sigma: float | None
    map_error_median: float | None
    pose_nees: float | None
    contacts: int

    def figures(self) -> dict[str, float | int | None]:
        """All of them by name."""
        return dataclasses.asdict(self)

    def summary(self) -> str:
        """The figures as one line for people."""
        within = (self.within_1_sigma, self.within_2_sigma, self.within_3_sigma)
        shares = " / ".join("-" if share is None else f"{share:.0%}" for share in within)
        parts = [f"{self.true_coverage:.1%} of the visible surface mapped"]
        if self.map_error_median is not None:
            parts.append(f"error {1e3 * self.map_error_median:.1f} mm in the median")
        parts.append(f"{shares} within 1 / 2 / 3 sigma")
        if self.pose_nees is not None:
            parts.append(f"pose NEES/6 {self.pose_nees:.2f}")
        parts.append(f"{self.contacts} contacts")
        return "compared with the truth: " + ", ".join(parts)

    def __str__(self) -> str:
        """The figures in a line, as a person reads them."""
        shares = (self.within_1_sigma, self.within_2_sigma, self.within_3_sigma)
        within = " / ".join("-" if share is None else f"{100.0 * share:.1f}" for share in shares)
        nees = "-" if self.pose_nees is None else f"{self.pose_nees:.2f}"
        return (
            f"true coverage {100.0 * self.true_coverage:.1f} %, "
            f"within 1 / 2 / 3 sigma {within} %, "
            f"pose NEES / 6 {nees}, contacts {self.contacts}"
        )


class TrueSurface:
    """The true surface of a world in the frame of a map, to compare maps with.

    Args:
        world: the true world.
        T_world_map: where the map's frame truly is, shape (4, 4).
        max_range: range of the camera [m].

    Raises:
        SimulationError: the world has no bounded region, or its start is not free.
    """

    def __init__(self, world: World, T_world_map: FloatArray, max_range: float) -> None:
        self._world, self._T_world_map = world, T_world_map
        visible = visible_surface(world, max_range, _SURFACE).points
        self._visible = transform_points(invert_transform(T_world_map), visible)

    def coverage(self, voxel_map: VoxelMap) -> float:
        """Share of the visible surface that is mapped."""
        return surface_coverage(voxel_map, self._visible)

    def compare(self, voxel_map: VoxelMap, poses: Sequence[AuditedPose], contacts: int) -> RunTruth:
        """How a map and the poses of its robots compare with the truth.

        Args:
            voxel_map: the map.
            poses: that the robots believed.
            contacts: forbidden ones that the simulator has counted.
        """
        errors = map_errors(voxel_map, self._world, self._T_world_map)
        within: dict[int, float | None] = {1: None, 2: None, 3: None}
        median = None
        if len(errors.distances):
            within = {sigmas: round(errors.share_within(sigmas), 4) for sigmas in within}
            median = round(float(np.median(errors.distances)), 5)
        return RunTruth(
            true_coverage=round(self.coverage(voxel_map), 4),
            within_1_sigma=within[1],
            within_2_sigma=within[2],
            within_3_sigma=within[3],
            map_error_median=median,
            pose_nees=mean_nees(poses),
            contacts=contacts,
        )
