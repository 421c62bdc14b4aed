"""When to look for the target, and what to believe of a sighting."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.fiducials.range_view import RangeView
from infomap_ros.localization.filter.fiducial_filter import FiducialFilter
from infomap_ros.localization.localizer_config import LocalizerConfig
from infomap_ros.localization.target.target import TargetDetector, TargetSighting

_INTERVAL = 1.0  # between two looks for the target while tracking [s]
# Sightings of the target in a row that contradict the pose, after which the target is believed and
# all else forgotten.
_CONTRADICTIONS = 3
_KEYFRAME_DISTANCE = 0.15  # after which a pose is kept [m]
_KEYFRAME_ANGLE = 0.17  # likewise [rad]
MAX_ROTATION_SIGMA = 0.15
"""The camera is lost when its rotation has a larger standard deviation about some axis [rad]."""


class TargetWatch:
    """Corrects a filter by sightings of the target.

    Attributes:
        reason: what the last look said, where it did not correct the pose.

    Args:
        detector: of the target; None where there is none.
    """

    def __init__(self, detector: TargetDetector | None) -> None:
        self.reason = ""
        self._detector = detector
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
        """Correct the pose where the target is seen anew.

        A camera that stands still sees the target with the same errors again, so that is not new.

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
        if not self.exists or (tracking and since < _INTERVAL):
            return ""
        self._looked = view.stamp
        sighting = self.sight(view)
        if sighting is None:
            return ""
        pose, covariance = sighting.camera_pose()
        if tracking and not self._is_new(pose):
            return ""
        if pose_filter.observe_pose(pose, covariance):
            self._last, self._contradictions = pose, 0
            return "corrected"
        self.reason = "target: seen where it cannot be"
        self._contradictions += 1
        return "contradicted" if self._contradictions >= _CONTRADICTIONS else ""

    def _is_new(self, pose: FloatArray) -> bool:
        return self._last is None or moved(self._last, pose)


def moved(before: FloatArray, after: FloatArray) -> bool:
    """Whether two poses, shape (4, 4), are as far apart as two keyframes."""
    distance = float(np.linalg.norm(after[:3, 3] - before[:3, 3]))
    turn = float(Rotation.from_matrix(before[:3, :3].T @ after[:3, :3]).magnitude())
    return distance > _KEYFRAME_DISTANCE or turn > _KEYFRAME_ANGLE


def is_certain(covariance: FloatArray, config: LocalizerConfig) -> bool:
    """Whether a pose with this covariance, shape (6, 6), may be believed."""
    position = float(np.linalg.eigvalsh(covariance[:3, :3])[-1])
    rotation = float(np.linalg.eigvalsh(covariance[3:, 3:])[-1])
    limits = config.max_position_sigma, MAX_ROTATION_SIGMA
    return position <= limits[0] ** 2 and rotation <= limits[1] ** 2
