"""fiducial_localization is killed on the robot's way, and started again: one map, no ghost.

The robot drives on for a little while without localization, as one does until somebody notices, and
waits then. How long the node takes to come back depends on the machine; how far the robot drives
unseen does not.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist
from scipy.special import chdtri

from infomap_ros.geometry import PoseRecord, TransformRecord
from infomap_ros.mapping import VoxelMap
from infomap_ros.messages import TF, decode_pose_with_covariance, decode_transforms
from infomap_ros.nodes.common.message_types import message_class
from infomap_ros.nodes.live.live_exploration import LiveExploration
from infomap_ros.simulation.exploring.visible_surface import map_errors
from infomap_ros.simulation.worlds.scenes import make_world

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
        self._command(-0.12, 0.1, lambda: len(self.poses) >= wanted, f"{poses} poses")

    def drive_unseen(self, pairs: int) -> None:
        """Drive on until so many more pairs of images were taken, and stand."""
        wanted = len(self.truth) + pairs
        self._command(-0.12, 0.1, lambda: len(self.truth) >= wanted, f"{pairs} pairs")
        self._velocity.publish(Twist())

    def stand(self, poses: int) -> None:
        """Stand until so many more poses have come."""
        wanted = len(self.poses) + poses
        self._command(0.0, 0.0, lambda: len(self.poses) >= wanted, f"{poses} poses")

    def _command(self, ahead: float, turn: float, until: Callable[[], bool], what: str) -> None:
        command = Twist()
        command.linear.x, command.angular.z = ahead, turn
        self.run.spin_until(until, what, TIMEOUT, lambda: self._velocity.publish(command))

    def errors(self) -> tuple[np.ndarray, np.ndarray]:
        """Position errors of all poses [m] and their squares in sigmas, shape (N,) each."""
        T_world_map = make_world("mars", 2, size=4.5).T_world_target
        shared = sorted(self.poses.keys() & self.truth.keys())
        assert len(shared) > 10 and T_world_map is not None
        found = np.array([(T_world_map @ self.poses[stamp].transform)[:3, 3] for stamp in shared])
        errors = found - [self.truth[stamp].transform[:3, 3] for stamp in shared]
        # errors are in the world, covariances in the map, which is the target's frame
        in_map = errors @ T_world_map[:3, :3]
        covariances = [self.poses[stamp].covariance[:3, :3] for stamp in shared]
        squares = [e @ np.linalg.solve(c, e) for e, c in zip(in_map, covariances, strict=True)]
        return np.linalg.norm(errors, axis=1), np.array(squares)


def test_a_localization_that_is_killed_on_the_way_goes_on_in_its_map(tmp_path: Path) -> None:
    with LiveExploration(tmp_path, PARAMETERS) as run:
        rover = DrivenRover(run)
        for name in NODES:
            run.start_node(name)
        run.spin_until(lambda: run.state.count("map_fusion") >= 2, "scans in the map", TIMEOUT)
        rover.drive(6)
        last = max(rover.edges)
        run.kill_node("fiducial_localization")
        rover.drive_unseen(2)
        rover.stand(2)
        rover.drive(4)
        first = min(stamp for stamp in rover.edges if stamp > last)
        fused = run.state.count("map_fusion")
        run.spin_until(lambda: run.state.count("map_fusion") > fused, "more scans", TIMEOUT)
        run.call("map_fusion/save")
    errors, squares = rover.errors()
    print(errors, squares)
    assert errors.max() < 0.04
    assert squares.max() < chdtri(3, 1e-4)
    before, after = rover.edges[last].transform, rover.edges[first].transform
    assert np.linalg.norm(after[:3, 3] - before[:3, 3]) < 0.05
    assert np.abs(after[:3, :3] - before[:3, :3]).max() < 0.03
    world = make_world("mars", 2, size=4.5)
    assert world.T_world_target is not None
    errors = map_errors(VoxelMap.load(run.map_file), world, world.T_world_target)
    assert np.quantile(errors.distances, 0.9) < 0.06  # [m]: no surface is there twice
