"""The truth about a live exploration, from its simulators, beside its map and published poses.

Poses of a run against its ground truth, where a bag or a simulator has one.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String

from infomap_ros.errors import ProcessError
from infomap_ros.exploration.robot import planar_pose
from infomap_ros.exploration.view_planner_config import ViewPlannerConfig
from infomap_ros.geometry import PoseRecord, invert_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.messages import decode_pose_with_covariance
from infomap_ros.messages.pose_uncertainty import decode_pose_uncertainty
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.live.live_graph import LiveGraph
from infomap_ros.simulation.body.base_motion import level_pose
from infomap_ros.simulation.exploring.exploration_run import map_frame
from infomap_ros.simulation.exploring.simulated_robot import SimulatedRobotConfig
from infomap_ros.simulation.exploring.truth import (
    AuditedPose,
    RunTruth,
    TrueSurface,
    audit_pose,
    mean_nees,
    pose_errors,
)
from infomap_ros.simulation.worlds.builder import World


class PoseComparison:
    """Listens to camera_pose and ground_truth/camera_pose of a graph.

    Args:
        run: the graph.
        namespace: of the robot, with a slash at its end where there is one.

    Attributes:
        begin: where its base truly was at first, in the world; None before that was received.
    """

    def __init__(self, run: LiveGraph, namespace: str = "") -> None:
        self._found: dict[int, PoseRecord] = {}
        self._true: dict[int, PoseRecord] = {}
        self._origins: dict[int, int] = {}
        self.begin: PoseRecord | None = None
        parts = f"{namespace}camera_pose_uncertainty"
        run.subscribe(PointCloud2, parts, self._on_parts)
        base = f"{namespace}ground_truth/base_pose"
        run.subscribe(PoseWithCovarianceStamped, base, self._on_base)
        for topic, kept in (
            ("camera_pose", self._found),
            ("ground_truth/camera_pose", self._true),
        ):
            run.subscribe(PoseWithCovarianceStamped, namespace + topic, self._keeper(kept))

    @property
    def observed_seconds(self) -> float:
        """Time from the first true pose that was received to the last [s]."""
        return 1e-9 * (max(self._true, default=0) - min(self._true, default=0))

    def pairs(self) -> list[tuple[PoseRecord, PoseRecord]]:
        """Poses and what they truly were, of all stamps that have both, in their order."""
        shared = sorted(self._found.keys() & self._true.keys())
        return [(self._found[stamp], self._true[stamp]) for stamp in shared]

    def origins(self) -> list[tuple[int, int]]:
        """Origins of the maps in which the poses were, with the first stamp of each [ns]."""
        found: dict[int, int] = {}
        for stamp, origin in sorted(self._origins.items()):
            found.setdefault(origin, stamp)
        return [(stamp, origin) for origin, stamp in found.items()]

    def origin_at(self, stamp: int) -> int:
        """Names the map in which a pose was; 0 where that was not received."""
        return self._origins.get(stamp, 0)

    def _on_parts(self, message: PointCloud2) -> None:
        stamp, _, parts = decode_pose_uncertainty(message)
        self._origins[stamp] = parts.origin

    def _on_base(self, message: PoseWithCovarianceStamped) -> None:
        self.begin = self.begin or decode_pose_with_covariance(message)

    def _keeper(self, kept: dict[int, PoseRecord]) -> Any:
        def keep(message: PoseWithCovarianceStamped) -> None:
            pose = decode_pose_with_covariance(message)
            kept[pose.stamp] = pose

        return keep

    def figures(self) -> dict[str, object]:
        """Number of poses and, where their truth is known, their errors.

        Motion since the first pose is compared, as the two may be in maps of their own.
        """
        pairs = self.pairs()
        figures: dict[str, object] = {"poses": len(self._found)}
        if len(pairs) < 2:
            return figures
        found, true = (_since_first(list(poses)) for poses in zip(*pairs, strict=True))
        errors = np.linalg.norm(found[:, :3, 3] - true[:, :3, 3], axis=1)
        length = np.linalg.norm(np.diff(true[:, :3, 3], axis=0), axis=1).sum()
        return figures | {
            "pose_error_mm": round(1e3 * float(np.sqrt(np.mean(errors**2))), 2),
            "largest_pose_error_mm": round(1e3 * float(errors.max()), 2),
            "path_length_m": round(float(length), 2),
        }


def _since_first(poses: list[PoseRecord]) -> FloatArray:
    """Motions from the first pose to each, shape (N, 4, 4)."""
    T_first_map = invert_transform(poses[0].transform)
    return np.array([T_first_map @ pose.transform for pose in poses])


class LiveTruth:
    """Listens to what a simulated robot publishes of its camera, and to the truth beside it.

    Args:
        run: the graph.
        namespace: of the robot, with a slash at its end where there is one.

    Attributes:
        contacts: forbidden contacts of the robot so far.
    """

    def __init__(self, run: LiveGraph, namespace: str = "") -> None:
        self._poses = PoseComparison(run, namespace)
        self.contacts = 0
        topic = f"{namespace}ground_truth/contacts"
        run.subscribe(String, topic, self._on_contacts, qos.latched())

    @property
    def simulated_seconds(self) -> float:
        """Simulated time that was observed, from the begin of the world but for a moment [s]."""
        return self._poses.observed_seconds

    def poses(self, T_world_map: FloatArray, origin: int | None = None) -> list[AuditedPose]:
        """The published poses whose covariance and truth are known, in their order.

        Args:
            T_world_map: where the map's frame truly is, shape (4, 4).
            origin: names that frame, where the map was moved: only the poses in it; None for all.
        """
        T_map_world = invert_transform(T_world_map)
        return [
            audit_pose(found, T_map_world @ true.transform)
            for found, true in self._poses.pairs()
            if found.covariance is not None and origin in (None, self._poses.origin_at(found.stamp))
        ]

    @property
    def begin(self) -> FloatArray:
        """Where odometry begins, shape (4, 4) [world]: level, where the base truly was at first.

        Raises:
            ProcessError: that was not received.
        """
        if self._poses.begin is None:
            raise ProcessError("no ground_truth/base_pose was received")
        pose = self._poses.begin.transform
        return level_pose(pose[:3, 3], planar_pose(pose)[2])

    @property
    def origins(self) -> list[tuple[int, int]]:
        """See `PoseComparison.origins`."""
        return self._poses.origins()

    def _on_contacts(self, message: String) -> None:
        self.contacts = max(self.contacts, int(json.loads(message.data)["count"]))


def live_map_frame(world: World) -> FloatArray:
    """Where the frame of a simulated robot's map truly is, shape (4, 4): at the target."""
    return map_frame(world, SimulatedRobotConfig())


def compare_joint_map(
    world: World, voxel_map: VoxelMap, observed: Sequence[LiveTruth]
) -> tuple[RunTruth, dict[str, object]]:
    """As `compare_with_truth`, for robots without a target that met.

    The joint frame is that of the first robot's map, which begins where its base was; poses count
    from when they are in it. Each robot's poses before that are compared in its own frame.

    Returns:
        The comparison, and flat figures: when each robot came into the joint frame by its images
        [s], and the errors of its poses in it.

    Raises:
        ProcessError: a robot did not come into it, or nothing was received.
    """
    begin = [robot.origins for robot in observed]
    if not all(begin):
        raise ProcessError("no camera_pose_uncertainty was received")
    joint = begin[0][0][1]
    T_world_map = observed[0].begin
    poses, figures = list[AuditedPose](), dict[str, object]()
    for number, robot in enumerate(observed, start=1):
        first, own = robot.origins[0]
        met = [stamp for stamp, origin in robot.origins if origin == joint]
        if not met:
            raise ProcessError(f"robot {number} did not come into the frame of robot 1")
        joined = robot.poses(T_world_map, joint)
        poses += joined
        name = f"rover{number}"
        figures[f"{name} in the joint frame after [s]"] = round(1e-9 * (met[0] - first), 1)
        figures[f"{name} poses in the joint frame"] = len(joined)
        errors = pose_errors(joined)
        figures |= {f"{name} {key}": value for key, value in errors.items()}
        figures[f"{name} pose_nees"] = mean_nees(joined)
        if own != joint:
            figures[f"{name} pose_nees before"] = mean_nees(robot.poses(robot.begin, own))
    surface = TrueSurface(world, T_world_map, ViewPlannerConfig().max_range)
    contacts = sum(robot.contacts for robot in observed)
    return surface.compare(voxel_map, poses, contacts), figures


def compare_with_truth(
    world: World, voxel_map: VoxelMap, observed: Sequence[LiveTruth]
) -> RunTruth:
    """How a map and the poses of the robots that made it compare with the truth.

    Args:
        world: the true world.
        voxel_map: the map.
        observed: one for each robot.

    Raises:
        InvalidInputError: the world has no target.
        SimulationError: the robot cannot stand at the world's start.
    """
    T_world_map = live_map_frame(world)
    surface = TrueSurface(world, T_world_map, ViewPlannerConfig().max_range)
    poses = [pose for robot in observed for pose in robot.poses(T_world_map)]
    return surface.compare(voxel_map, poses, sum(robot.contacts for robot in observed))
