"""A scripted survey: the rover drives a curve while its arm sweeps the cameras over the scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

from infomap_ros.geometry.transforms import FloatArray

ARM_JOINTS = ("arm_pan_joint", "arm_shoulder_joint", "arm_elbow_joint", "arm_wrist_joint")

# Share of the survey: base x, y [m]; arm pan, shoulder, elbow and camera pitch (down positive)
# [rad]. Far sweep, near sweep with the deck in view, a look from low down, far sweep from the end.
_KEYS = np.array(
    [
        (0.00, -0.30, 0.00, 0.95, -0.35, 0.65, 0.38),
        (0.12, -0.10, 0.00, 0.30, -0.35, 0.65, 0.34),
        (0.28, 0.10, 0.01, -0.95, -0.30, 0.65, 0.42),
        (0.38, 0.22, 0.03, -0.80, -0.45, 0.90, 0.85),
        (0.54, 0.40, 0.06, 0.75, -0.55, 0.95, 0.95),
        (0.64, 0.55, 0.09, 1.15, 0.10, 0.75, 0.48),
        (0.74, 0.72, 0.12, 0.55, 0.45, 0.85, 0.26),
        (0.87, 0.88, 0.12, -0.35, 0.05, 0.80, 0.28),
        (1.00, 0.98, 0.10, -1.25, -0.15, 0.75, 0.40),
    ]
)


@dataclass(frozen=True)
class SurveyState:
    """Where everything should be at one time.

    Attributes:
        x: of the base in the world [m].
        y: of the base in the world [m].
        heading: yaw of the base, along the way [rad].
        joints: arm joint angles by name [rad].
    """

    x: float
    y: float
    heading: float
    joints: dict[str, float]


class Survey:
    """The script, stretched over a duration.

    Args:
        duration: of the whole survey [s].
        keys: rows as in `_KEYS`: share of the duration, base x, y [m], pan, shoulder, elbow,
            camera pitch [rad].
    """

    def __init__(self, duration: float, keys: FloatArray = _KEYS) -> None:
        self.duration = duration
        times = keys[:, 0] * duration
        pan, shoulder, elbow, pitch = keys[:, 3:].T
        arm = np.column_stack([pan, shoulder, elbow, pitch - shoulder - elbow])
        self._way = _smooth(times, keys[:, 1:3])
        self._arm = PchipInterpolator(times, arm)
        self._way_rate = self._way.derivative()

    def at(self, time: float) -> SurveyState:
        """State at a time [s] from the start; held still before the start and after the end."""
        inside = float(np.clip(time, 0.0, self.duration))
        x, y = self._way(inside)
        direction = self._way_rate(inside)
        return SurveyState(
            float(x),
            float(y),
            float(np.arctan2(direction[1], direction[0])),
            dict(zip(ARM_JOINTS, self._arm(inside).tolist(), strict=True)),
        )


def _smooth(times: FloatArray, points: FloatArray) -> CubicHermiteSpline:
    """A way through points with the mean slope at each, so that the heading never jumps."""
    return CubicHermiteSpline(times, points, np.gradient(points, times, axis=0))
