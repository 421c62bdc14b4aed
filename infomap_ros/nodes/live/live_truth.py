"""The truth about a live exploration, from its simulators, beside its map and published poses."""

from __future__ import annotations

import json
from collections.abc import Sequence

from std_msgs.msg import String

from infomap_ros.exploration.view_planner_config import ViewPlannerConfig
from infomap_ros.geometry import invert_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.live.live_graph import LiveGraph
from infomap_ros.nodes.live.pose_comparison import PoseComparison
from infomap_ros.simulation.exploring.exploration_run import map_frame
from infomap_ros.simulation.exploring.pose_audit import AuditedPose, audit_pose
from infomap_ros.simulation.exploring.simulated_robot import SimulatedRobotConfig
from infomap_ros.simulation.exploring.truth import RunTruth, TrueSurface
from infomap_ros.simulation.worlds.builder import World


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
