"""How a camera is expected to move of which nothing is known but that it is carried."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import make_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.filter.motion_prior import MotionPrior

_CHANGE = 0.2
"""Standard deviation by which a velocity changes from one image to the next, as a share of it,
beyond what a camera at rest is granted: at 10 images/s a car that brakes as hard as it can
(10 m/s^2) loses a tenth of 10 m/s."""

_WIDER, _FASTEST = 3.0, 40.0
"""Factor of the speed that is tried where the images contradict the expected one, and its end
[m/s]: the speed of a car on a motorway."""

_SPEED, _TURN_RATE = 0.7, 1.0  # sigmas per axis while nothing is known of them [m/s, rad/s]
_LONGEST = 3.0  # longer gaps count as this long: a camera that is carried stays in its room [s]


def free_motion(duration: float) -> MotionPrior:
    """Prior where neither odometry nor joint states exist: anything that is not too fast.

    Args:
        duration: between the two images [s].

    Raises:
        InvalidInputError: the duration is negative or not finite.
    """
    return FreeMotion().expected(duration)


class FreeMotion:
    """Follows how fast the camera is, so that no speed has to be set.

    The next motion is expected to be like the last one (constant velocity), with standard
    deviations that grow with it. Where the images contradict that, as at the beginning and after a
    jerk, wider ones are tried (`wider`).
    """

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Forget how fast it was."""
        self._velocity = np.zeros(6)  # [m/s, rad/s], in the frame of the camera

    def note(self, motion: FloatArray, duration: float) -> None:
        """Learn from a motion that images have shown.

        Args:
            motion: T_before_after, shape (4, 4).
            duration: that it took [s].
        """
        turn = Rotation.from_matrix(motion[:3, :3]).as_rotvec()
        self._velocity = np.concatenate([motion[:3, 3], turn]) / max(duration, 1e-3)

    def expected(self, duration: float) -> MotionPrior:
        """The motion that is expected.

        Args:
            duration: within which it is made [s].

        Raises:
            InvalidInputError: the duration is negative or not finite.
        """
        if not (np.isfinite(duration) and duration >= 0.0):
            raise InvalidInputError("duration", f"is {duration} s, expected at least 0")
        time = min(duration, _LONGEST)
        step = self._velocity * time
        motion = make_transform(Rotation.from_rotvec(step[3:]).as_matrix(), step[:3])
        speed, turn_rate = self._sigmas()
        return MotionPrior(motion, _covariance(speed * time, turn_rate * time))

    def wider(self, duration: float) -> Iterator[MotionPrior]:
        """What may be added to `expected` where the images contradict it, more and more.

        Args:
            duration: [s].
        """
        time = min(duration, _LONGEST)
        speed, turn_rate = self._sigmas()
        while speed < _FASTEST:
            speed *= _WIDER
            yield MotionPrior(np.eye(4), _covariance(speed * time, turn_rate * time))

    def _sigmas(self) -> tuple[float, float]:
        speed, turn_rate = (float(np.linalg.norm(part)) for part in np.split(self._velocity, 2))
        return _SPEED + _CHANGE * speed, _TURN_RATE + _CHANGE * turn_rate


def _covariance(distance: float, turn: float) -> FloatArray:
    return np.diag(np.square(np.repeat([distance, turn], 3)))
