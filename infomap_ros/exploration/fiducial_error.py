"""LE of eq. (11) from the fiducials that will be seen on the way; takes the place of pure drift."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from infomap_ros.geometry import StereoRig
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.prediction.error_prediction import (
    ErrorPrediction,
    ErrorPredictionConfig,
)
from infomap_ros.localization.prediction.ways import Ways
from infomap_ros.views.situation import Situation

KnownFiducials = Callable[[], tuple[FloatArray, FloatArray]]
"""What localisation knows now: positions (N, 3) [m, map] and covariances (N, 3, 3) [m^2]."""


class FiducialLocalisationError:
    """Implements `infomap_ros.views.ranking.localisation_error.LocalisationError`.

    The error of a view is how much the position sigma (root of the trace) grows on the way there
    [m]; negative where fiducials make the position better known than it is now.

    Args:
        rig: the rectified stereo pair.
        disparity_sigma: of the tracked fiducials [px].
        fiducials: asked once for each choice.
        config: of the prediction.
    """

    def __init__(
        self,
        rig: StereoRig,
        disparity_sigma: float,
        fiducials: KnownFiducials,
        config: ErrorPredictionConfig | None = None,
    ) -> None:
        sigma = disparity_sigma / (rig.left.fx * rig.baseline)
        self._prediction = ErrorPrediction(rig.left, sigma, config)
        self._fiducials = fiducials
        self._situation: Situation | None = None
        self._known: tuple[FloatArray, FloatArray] = np.empty((0, 3)), np.empty((0, 3, 3))
        self._new: FloatArray = np.empty((0, 3))

    def __call__(self, situation: Situation, poses: FloatArray, lengths: FloatArray) -> FloatArray:
        """Error of the views, shape (M,) [m].

        Args:
            situation: pose, covariance and map now.
            poses: ``T_map_camera``, shape (M, 4, 4).
            lengths: of the ways there, shape (M,) [m].
        """
        now = float(np.trace(situation.pose_covariance[:3, :3]))
        after = self.covariances(situation, poses, lengths)
        return np.sqrt(np.trace(after[:, :3, :3], axis1=1, axis2=2)) - np.sqrt(now)

    def covariances(
        self, situation: Situation, poses: FloatArray, lengths: FloatArray
    ) -> FloatArray:
        """Predicted pose covariances at the views, shape (M, 6, 6); arguments as the call's."""
        if situation is not self._situation:
            self._situation, self._known = situation, self._fiducials()
            camera, known = situation.T_map_camera, self._known[0]
            self._new = self._prediction.new_points(camera, known, situation.voxel_map)
        return self._prediction.predict(
            situation.T_map_camera,
            situation.pose_covariance,
            Ways(poses, lengths),
            self._known,
            self._new,
            situation.voxel_map,
        )
