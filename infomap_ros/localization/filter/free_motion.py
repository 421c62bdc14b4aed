"""How a camera is expected to move of which nothing is known but that it is carried."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import make_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.filter.lie import exponential, logarithm
from infomap_ros.localization.filter.motion_prior import MotionPrior

_CHANGE = 0.2
"""Standard deviation by which a velocity changes from one image to the next, as a share of it,
beyond what a camera at rest is granted: at 10 images/s a car that brakes as hard as it can
(10 m/s^2) loses a tenth of 10 m/s."""

_WIDER, _FASTEST = 3.0, 40.0
"""Factor of the speed that is tried where the images contradict the expected one, and its end
[m/s]: the speed of a car on a motorway."""

_GYRO_BIAS, _GYRO_DRIFT = 0.03, 1e-3
"""Sigma of what a gyroscope tells at rest before images have shown it [rad/s], and of its change
within a second: those of a phone or a camera."""

_GYRO_NOISE = 1e-3  # of a gyroscope, vibration included [rad per root of s]
_GYRO_DELAY = 5e-3  # sigma of the delay between gyroscope and camera [s]
_IMPROBABLE = 25.0  # squared distance of three axes that one in 10^5 exceeds
_IMAGE_TURN = 2e-3  # sigma of a turn that images have shown, along each axis [rad]

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

    Attributes:
        turn: how a gyroscope says that the camera turns in the motion that is expected next,
            ``R_before_after``, shape (3, 3); None where there is none. What it tells at rest is
            learnt from the images.
    """

    def __init__(self) -> None:
        self.turn: FloatArray | None = None
        self._bias, self._bias_variance = np.zeros(3), _GYRO_BIAS**2
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
        duration = max(duration, 1e-3)
        turn = logarithm(motion[:3, :3])
        self._velocity = np.concatenate([motion[:3, 3], turn]) / duration
        if self.turn is not None:
            self._learn_bias(motion[:3, :3], self.turn, duration)

    def _learn_bias(self, shown: FloatArray, measured: FloatArray, duration: float) -> None:
        """What the gyroscope tells at rest, by a Kalman filter of three equal axes."""
        variance = self._bias_variance + _GYRO_DRIFT**2 * duration
        noise = (_IMAGE_TURN**2 + _gyro_variance(measured, duration)) / duration**2
        innovation = logarithm(shown.T @ measured) / duration - self._bias
        if innovation @ innovation > _IMPROBABLE * (variance + noise):
            return
        gain = variance / (variance + noise)
        self._bias = self._bias + gain * innovation
        self._bias_variance = (1.0 - gain) * variance

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
        speed, turn_rate = self._sigmas()
        if self.turn is None:
            motion = make_transform(exponential(step[3:]), step[:3])
            return MotionPrior(motion, _covariance(speed * time, turn_rate * time))
        turned = self.turn @ exponential(-self._bias * duration)
        variance = self._bias_variance * duration**2 + _gyro_variance(turned, duration)
        covariance = _covariance(speed * time, float(np.sqrt(variance)))
        return MotionPrior(make_transform(turned, step[:3]), covariance)

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


def _gyro_variance(turn: FloatArray, duration: float) -> float:
    """Of a turn, shape (3, 3), by a gyroscope without bias, along each axis [rad^2]."""
    rate = float(np.linalg.norm(logarithm(turn))) / max(duration, 1e-3)
    return _GYRO_NOISE**2 * duration + (_GYRO_DELAY * rate) ** 2


def _covariance(distance: float, turn: float) -> FloatArray:
    return np.diag(np.square(np.repeat([distance, turn], 3)))
