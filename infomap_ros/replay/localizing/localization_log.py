"""What localization in a bag has found so far."""

from __future__ import annotations

from collections import Counter

import numpy as np

from infomap_ros.localization.localized_camera import LocalizedCamera
from infomap_ros.pipeline.pipeline import Located
from infomap_ros.replay.localizing.trajectory import Trajectory, TrajectoryRecorder


class LocalizationLog:
    """Collects what became of each view.

    Attributes:
        localizations: one for each view, in order.
    """

    def __init__(self) -> None:
        self.localizations: list[LocalizedCamera] = []
        self._recorder = TrajectoryRecorder()

    def add(self, done: object) -> None:
        """Take in a view; anything else is ignored."""
        if not isinstance(done, Located):
            return
        result = done.result
        self.localizations.append(result)
        if result.T_map_camera is not None and result.covariance is not None:
            self._recorder.add(result.stamp, result.T_map_camera, result.covariance, done.kept)

    @property
    def trajectory(self) -> Trajectory:
        """The camera's poses as they were known at their stamps."""
        return self._recorder.known_then()

    @property
    def corrected_trajectory(self) -> Trajectory:
        """The camera's poses after all that was learnt later."""
        return self._recorder.known_now()

    def figures(self) -> dict[str, int | float | str]:
        """Counts of the views, length of the path and final standard deviations."""
        states = Counter(one.state for one in self.localizations)
        trajectory = self.trajectory
        steps = np.diff(trajectory.transforms[:, :3, 3], axis=0)
        last = trajectory.covariances[-1] if len(trajectory) else np.full((6, 6), np.nan)
        tracked = [one.tracked for one in self.localizations]
        return {
            "views": len(self.localizations),
            "poses": len(trajectory),
            "tracking": states["tracking"],
            "coasting": states["coasting"],
            "lost": states["lost"],
            "searching": states["searching"],
            "keyframes": sum(one.is_keyframe for one in self.localizations),
            "target_sightings": sum(one.target_seen for one in self.localizations),
            "mean_fiducials": round(float(np.mean(tracked)) if tracked else 0.0, 1),
            "path_length": round(float(np.linalg.norm(steps, axis=1).sum()), 4),
            "final_position_sigma": round(float(np.sqrt(np.trace(last[:3, :3]))), 6),
            "final_rotation_sigma": round(float(np.sqrt(np.trace(last[3:, 3:]))), 6),
        }
