"""The localizer with what it needs of the robot. Used by one thread."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from infomap_ros.geometry import PinholeCamera
from infomap_ros.localization.filter_records import Fiducials, KeptPoses
from infomap_ros.localization.localizer import Localisation, Localizer
from infomap_ros.localization.localizer_config import LocalizerConfig
from infomap_ros.localization.motion_prior import KinematicMotion, RobotPosture
from infomap_ros.localization.range_view import RangeView
from infomap_ros.localization.target import TargetDetector
from infomap_ros.replay.localize_run import looking_along_x

_LEAST_SIGMA = 1e-4
"""Of a pose that defines the map [m and rad]: in messages a covariance of zero means unknown."""


@dataclass(frozen=True)
class CameraFollowerConfig:
    """What the localizer is made with.

    Attributes:
        localizer: its parameters.
        motion: how far odometry and kinematics are to be trusted.
        detector: of the target, None where there is none.
        start_tilt: how far the camera looks down at the beginning, where neither odometry nor
            target say what is up [rad].
    """

    localizer: LocalizerConfig
    motion: KinematicMotion
    detector: TargetDetector | None
    start_tilt: float


class CameraFollower:
    """Makes a localizer when the camera is known, and tells it how the robot has moved."""

    def __init__(self, config: CameraFollowerConfig) -> None:
        self._config = config
        self._localizer: Localizer | None = None
        self._camera: PinholeCamera | None = None
        self._posture: RobotPosture | None = None

    def follow(self, view: RangeView, posture: RobotPosture | None) -> Localisation:
        """Locate the camera.

        Args:
            view: later than those before.
            posture: of the robot at that time, None where it is not known.

        Raises:
            InvalidInputError: the view is not later than those before.
        """
        if self._localizer is None or view.camera != self._camera:
            self._localizer = self._begin(view.camera, posture)
        before, self._posture = self._posture, posture
        prior = None
        if before is not None and posture is not None:
            prior = self._config.motion.between(before, posture)
        return self._localizer.locate(view, prior)

    def reset(self) -> None:
        """Forget everything; the next view begins anew."""
        self._localizer = self._posture = None

    def keyframes(self) -> KeptPoses | None:
        """The kept poses as they are known now, None before the first view."""
        return None if self._localizer is None else self._localizer.keyframes()

    def fiducials(self) -> Fiducials | None:
        """The scene's fiducials as they are known now, None before the first view."""
        return None if self._localizer is None else self._localizer.fiducials()

    def _begin(self, camera: PinholeCamera, posture: RobotPosture | None) -> Localizer:
        """A localizer whose map is the target's frame, or odometry's, or level by assumption."""
        start, sigmas = looking_along_x(self._config.start_tilt), [_LEAST_SIGMA] * 6
        if posture is not None:
            start, kinematics = posture.T_odom_camera, self._config.motion.config
            sigmas = [kinematics.kinematics_position_sigma] * 3
            sigmas += [kinematics.kinematics_rotation_sigma] * 3
        covariance = np.diag(np.square(sigmas))
        self._camera, self._posture = camera, None
        return Localizer(camera, self._config.localizer, self._config.detector, start, covariance)
