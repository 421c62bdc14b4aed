"""When to look for the target, and what to believe of a sighting."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.fiducials.range_view import RangeView
from infomap_ros.localization.filter.fiducial_filter import FiducialFilter
from infomap_ros.localization.localizer_config import LocalizerConfig
from infomap_ros.localization.target.target import TargetDetector, TargetSighting


class TargetWatch:
    """Corrects a filter by sightings of the target.

    Attributes:
        reason: what the last look said, where it did not correct the pose.

    Args:
        detector: of the target; None where there is none.
        config: how often it is looked for.
    """

    def __init__(self, detector: TargetDetector | None, config: LocalizerConfig) -> None:
        self.reason = ""
        self._detector, self._config = detector, config
        self.clear()

    def clear(self) -> None:
        """Forget earlier sightings."""
        self._looked = -(2**62)  # stamp of the last look while tracking [ns]
        self._last: FloatArray | None = None  # pose of the last sighting that was used
        self._contradictions = 0

    @property
    def exists(self) -> bool:
        """Whether there is a target."""
        return self._detector is not None

    def sight(self, view: RangeView) -> TargetSighting | None:
        """Look for the target."""
        if self._detector is None:
            return None
        result = self._detector.detect(view)
        if isinstance(result, TargetSighting):
            return result
        self.reason = f"target: {result.reason}"
        return None

    def correct(self, view: RangeView, pose_filter: FiducialFilter, tracking: bool) -> str:
        """Correct the pose where there is news of the target.

        A camera that stands still sees the target with the same errors again, so that is no news.

        Args:
            view: the last one.
            pose_filter: that knows the pose.
            tracking: whether the pose rests on fiducials of this view.

        Returns:
            ``corrected``; ``contradicted``, when the target was seen so often where it cannot be
            that the filter has to begin anew from it; else empty.
        """
        self.reason = ""
        since = 1e-9 * (view.stamp - self._looked)
        if not self.exists or (tracking and since < self._config.target_interval):
            return ""
        self._looked = view.stamp
        sighting = self.sight(view)
        if sighting is None:
            return ""
        pose, covariance = sighting.camera_pose()
        if tracking and not self._is_news(pose):
            return ""
        if pose_filter.observe_pose(pose, covariance):
            self._last, self._contradictions = pose, 0
            return "corrected"
        self.reason = "target: seen where it cannot be"
        self._contradictions += 1
        return "contradicted" if self._contradictions >= self._config.contradictions else ""

    def _is_news(self, pose: FloatArray) -> bool:
        return self._last is None or moved(self._last, pose, self._config)


def moved(before: FloatArray, after: FloatArray, config: LocalizerConfig) -> bool:
    """Whether two poses, shape (4, 4), are as far apart as two keyframes."""
    way = float(np.linalg.norm(after[:3, 3] - before[:3, 3]))
    turn = float(Rotation.from_matrix(before[:3, :3].T @ after[:3, :3]).magnitude())
    return way > config.keyframe_distance or turn > config.keyframe_angle


def is_certain(covariance: FloatArray, config: LocalizerConfig) -> bool:
    """Whether a pose with this covariance, shape (6, 6), may be believed."""
    position = float(np.linalg.eigvalsh(covariance[:3, :3])[-1])
    rotation = float(np.linalg.eigvalsh(covariance[3:, 3:])[-1])
    limits = config.max_position_sigma, config.max_rotation_sigma
    return position <= limits[0] ** 2 and rotation <= limits[1] ** 2
