"""Poses of a run against its ground truth, where a bag or a simulator has one."""

from __future__ import annotations

from typing import Any

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped

from infomap_ros.geometry import PoseRecord, invert_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.messages import decode_pose_with_covariance
from infomap_ros.nodes.live.live_graph import LiveGraph


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
