"""The truth about a live exploration, from its simulators, beside its map and published poses.

Poses of a run against its ground truth, where a bag or a simulator has one.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped
from std_msgs.msg import String

from infomap_ros.exploration.view_planner_config import ViewPlannerConfig
from infomap_ros.geometry import PoseRecord, invert_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.messages import decode_pose_with_covariance
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.live.live_graph import LiveGraph
from infomap_ros.simulation.exploring.exploration_run import map_frame
from infomap_ros.simulation.exploring.simulated_robot import SimulatedRobotConfig
from infomap_ros.simulation.exploring.truth import AuditedPose, RunTruth, TrueSurface, audit_pose
from infomap_ros.simulation.worlds.builder import World


class PoseComparison:
    """Listens to camera_pose and ground_truth/camera_pose of a graph.

    Args:
        run: the graph.
        namespace: of the robot, with a slash at its end where there is one.
    """

    def __init__(self, run: LiveGraph, namespace: str = "") -> None:
        self._found: dict[int, PoseRecord] = {}
        self._true: dict[int, PoseRecord] = {}
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
        way = np.linalg.norm(np.diff(true[:, :3, 3], axis=0), axis=1).sum()
        return figures | {
            "pose_error_mm": round(1e3 * float(np.sqrt(np.mean(errors**2))), 2),
            "largest_pose_error_mm": round(1e3 * float(errors.max()), 2),
            "way_m": round(float(way), 2),
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

    def poses(self, T_world_map: FloatArray) -> list[AuditedPose]:
        """The published poses whose covariance and truth are known, in their order.

        Args:
            T_world_map: where the map's frame truly is, shape (4, 4).
        """
        T_map_world = invert_transform(T_world_map)
        return [
            audit_pose(found, T_map_world @ true.transform)
            for found, true in self._poses.pairs()
            if found.covariance is not None
        ]

    def _on_contacts(self, message: String) -> None:
        self.contacts = max(self.contacts, int(json.loads(message.data)["count"]))


def live_map_frame(world: World) -> FloatArray:
    """Where the frame of a simulated robot's map truly is, shape (4, 4): at the target."""
    return map_frame(world, SimulatedRobotConfig())


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
