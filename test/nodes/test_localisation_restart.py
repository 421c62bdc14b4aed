"""fiducial_localization is killed while the robot drives, and started again: one map, no ghost."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist

from infomap_ros.geometry import PoseRecord, TransformRecord
from infomap_ros.mapping import VoxelMap
from infomap_ros.nodes.live_exploration import LiveExploration
from infomap_ros.nodes.message_types import message_class
from infomap_ros.replay.messages import TF, decode_pose_with_covariance, decode_transforms
from infomap_ros.simulation.scenes import make_world
from infomap_ros.simulation.visible_surface import map_errors

NODES = ("stereo_range", "map_fusion", "fiducial_localization", "simulator")
PARAMETERS: dict[str, dict[str, Any]] = {
    "simulator": {
        "world": "mars",
        "world_seed": 2,
        "world_size": 4.5,
        "camera.width": 320,
        "camera.height": 240,
        "camera.supersampling": 1,
    },
    "map_fusion": {"autosave_period": 0.0},
    "fiducial_localization": {"save_period": 0.5},
}
TIMEOUT = 120.0  # [s]; kernels may have to be compiled


class DrivenRover:
    """A rover that is driven by hand, all that it is told and tells."""

    def __init__(self, run: LiveExploration) -> None:
        self.run = run
        self.poses: dict[int, PoseRecord] = {}
        self.truth: dict[int, PoseRecord] = {}
        self.edges: dict[int, TransformRecord] = {}
        run.subscribe(PoseWithCovarianceStamped, "camera_pose", self._keeper(self.poses))
        topic = "ground_truth/camera_pose"
        run.subscribe(PoseWithCovarianceStamped, topic, self._keeper(self.truth))
        run.subscribe(message_class(TF), "/tf", self._on_frames)
        self._velocity = run.publisher(Twist, "cmd_vel")

    def _keeper(self, kept: dict[int, PoseRecord]) -> Any:
        def keep(message: PoseWithCovarianceStamped) -> None:
            pose = decode_pose_with_covariance(message)
            kept[pose.stamp] = pose

        return keep

    def _on_frames(self, message: Any) -> None:
        for edge in decode_transforms(message):
            if (edge.frame_id, edge.child_frame_id) == ("map", "odom"):
                self.edges[edge.stamp] = edge

    def drive(self, poses: int) -> None:
        """Drive on, in a curve, until so many more poses have come."""
        wanted = len(self.poses) + poses
        command = Twist()
        command.linear.x, command.angular.z = -0.12, 0.1
        self.run.spin_until(
            lambda: len(self.poses) >= wanted,
            f"{poses} poses",
            TIMEOUT,
            lambda: self._velocity.publish(command),
        )

    def errors(self) -> np.ndarray:
        """Position errors of all poses, shape (N,) [m]: map and target are one."""
        T_world_map = make_world("mars", 2, size=4.5).T_world_target
        shared = sorted(self.poses.keys() & self.truth.keys())
        assert len(shared) > 10 and T_world_map is not None
        found = [(T_world_map @ self.poses[stamp].transform)[:3, 3] for stamp in shared]
        true = [self.truth[stamp].transform[:3, 3] for stamp in shared]
        return np.asarray(np.linalg.norm(np.array(found) - true, axis=1))


def test_a_localisation_that_is_killed_on_the_way_goes_on_in_its_map(tmp_path: Path) -> None:
    with LiveExploration(tmp_path, PARAMETERS) as run:
        rover = DrivenRover(run)
        for name in NODES:
            run.start_node(name)
        run.spin_until(lambda: run.state.count("map_fusion") >= 2, "scans in the map", TIMEOUT)
        rover.drive(6)
        last = max(rover.edges)
        run.kill_node("fiducial_localization")
        rover.drive(6)
        first = min(stamp for stamp in rover.edges if stamp > last)
        fused = run.state.count("map_fusion")
        run.spin_until(lambda: run.state.count("map_fusion") > fused, "more scans", TIMEOUT)
        run.call("map_fusion/save")
    assert rover.errors().max() < 0.04
    before, after = rover.edges[last].transform, rover.edges[first].transform
    assert np.linalg.norm(after[:3, 3] - before[:3, 3]) < 0.05
    assert np.abs(after[:3, :3] - before[:3, :3]).max() < 0.03
    world = make_world("mars", 2, size=4.5)
    assert world.T_world_target is not None
    errors = map_errors(VoxelMap.load(run.map_file), world, world.T_world_target)
    assert np.quantile(errors.distances, 0.9) < 0.06  # [m]: no surface is there twice
