"""LE of eq. (11) from the fiducials that will be seen on the way; takes the place of pure drift."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from infomap_ros.geometry import StereoRig
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.dead_reckoning import DeadReckoningConfig
from infomap_ros.localization.filter.config import Fiducials
from infomap_ros.localization.prediction.error_prediction import (
    ErrorPrediction,
    ErrorPredictionConfig,
    Paths,
)
from infomap_ros.views.ranking.terms import OdometryDrift
from infomap_ros.views.situation import Situation

KnownFiducials = Callable[[], Fiducials | None]
"""What localization knows now; None where nothing localizes by fiducials."""


class FiducialLocalizationError:
    """Implements `infomap_ros.views.ranking.terms.LocalizationError`.

    The error of a view is how much the position sigma (root of the trace) grows on the way there
    [m]; negative where fiducials make the position better known than it is now. Where nothing
    localizes by fiducials, it is what odometry drifts.

    Args:
        rig: the rectified stereo pair.
        fiducials: asked once for each choice.
        config: of the prediction.
        motion: how far odometry and kinematics are trusted, as by the localizer.

    Attributes:
        model: what the last choice was rated by, in words; empty before the first.
    """

    def __init__(
        self,
        rig: StereoRig,
        fiducials: KnownFiducials,
        config: ErrorPredictionConfig | None = None,
        motion: DeadReckoningConfig | None = None,
    ) -> None:
        self._prediction = ErrorPrediction(rig, config, motion)
        self._drift = OdometryDrift()
        self._fiducials = fiducials
        self._situation: Situation | None = None
        self._known: Fiducials | None = None
        self._new: FloatArray = np.empty((0, 3))
        self.model = ""

    def __call__(self, situation: Situation, poses: FloatArray, lengths: FloatArray) -> FloatArray:
        """Error of the views, shape (M,) [m].

        Args:
            situation: pose, covariance and map now.
            poses: ``T_map_camera``, shape (M, 4, 4).
            lengths: of the paths there, shape (M,) [m].
        """
        known = self._known_in(situation)
        if known is None:
            return self._drift(situation, poses, lengths)
        after = self._prediction.predict(
            situation.T_map_camera,
            situation.pose_covariance,
            Paths(poses, lengths),
            (known.positions, known.covariances),
            self._new,
            situation.voxel_map,
        )
        now = float(np.trace(situation.pose_covariance[:3, :3]))
        return np.sqrt(np.trace(after[:, :3, :3], axis1=1, axis2=2)) - np.sqrt(now)

    def _known_in(self, situation: Situation) -> Fiducials | None:
        """The fiducials of a choice; those of all its ratings are the same."""
        if situation is not self._situation:
            self._situation, self._known = situation, self._fiducials()
            if self._known is None:
                self.model = "odometry drift"
            else:
                self.model = f"{len(self._known)} fiducials"
                self._new = self._prediction.new_points(
                    situation.T_map_camera, self._known.positions, situation.voxel_map
                )
        return self._known
