"""Times for a way through joint space, within limits of velocity and acceleration.

The joints move together along each straight piece and stop at its ends, with the trapezoidal
profile that is the fastest of those that start and end at rest: for a piece of direction d (the
change of the positions), the path velocity is at most min v_j / |d_j| and its change at most
min a_j / |d_j|.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import float_array
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.robot.chain import KinematicChain
from infomap_ros.motion.route import ArmPath

_STILL = 1e-9  # change of a position that is none [rad or m]


@dataclass(frozen=True)
class TrajectoryConfig:
    """How fast joints move.

    Raises:
        ConfigError: a value is out of its range.
    """

    velocity_share: float = parameter(
        0.5, "Share of the joints' largest speeds that is used.", low=0.01, high=1.0
    )
    default_velocity: float = parameter(
        0.5,
        "Largest speed of a joint whose description gives none.",
        unit="rad/s or m/s",
        low=0.001,
        high=100.0,
    )
    acceleration: float = parameter(
        1.0,
        "Largest acceleration of every joint; robot descriptions do not hold it.",
        unit="rad/s^2 or m/s^2",
        low=0.001,
        high=1000.0,
    )
    period: float = parameter(
        0.05, "Longest time between two knots of a moving arm.", unit="s", low=0.001, high=10.0
    )

    def __post_init__(self) -> None:
        check_config(self)

    def velocities(self, chain: KinematicChain) -> FloatArray:
        """Speeds that the joints may have, shape (n,) [rad/s or m/s]."""
        known = np.where(np.isfinite(chain.velocity), chain.velocity, self.default_velocity)
        return np.asarray(self.velocity_share * known)


def time_path(
    chain: KinematicChain, waypoints: FloatArray, config: TrajectoryConfig | None = None
) -> ArmPath:
    """Give a way times.

    Args:
        chain: whose joints move.
        waypoints: corners of the way, shape (K, n) [rad or m], at least one.
        config: limits.

    Returns:
        The same way with knots so close that straight lines between them keep the limits.

    Raises:
        InvalidInputError: `waypoints` has another shape or is not finite.
    """
    settings = config or TrajectoryConfig()
    corners = float_array(waypoints, "waypoints")
    if corners.ndim != 2 or corners.shape[1] != len(chain) or not len(corners):
        raise InvalidInputError("waypoints", f"shape {corners.shape}, expected (K, {len(chain)})")
    if not np.isfinite(corners).all():
        raise InvalidInputError("waypoints", "is not finite")
    positions, times = [corners[:1]], [np.zeros(1)]
    for first, second in pairwise(corners):
        change = second - first
        if np.abs(change).max(initial=0.0) <= _STILL:
            continue
        with np.errstate(divide="ignore"):
            speed = float((settings.velocities(chain) / np.abs(change)).min())
            growth = float((settings.acceleration / np.abs(change)).min())
        seconds, shares = _profile(speed, growth, settings.period)
        positions.append(first + shares[:, None] * change)
        positions[-1][-1] = second
        times.append(times[-1][-1] + seconds)
    return ArmPath(chain.joint_names, np.concatenate(positions), np.concatenate(times))


def _profile(speed: float, growth: float, period: float) -> tuple[FloatArray, FloatArray]:
    """Times [s] and shares of a piece, both without the start, from rest to rest.

    Args:
        speed: largest path velocity [1/s].
        growth: its largest change [1/s^2].
        period: longest time between two knots [s].
    """
    speed = min(speed, math.sqrt(growth))  # a piece too short for the full speed is a triangle
    rising, total = speed / growth, 1.0 / speed + speed / growth
    bounds = [0.0, rising, total - rising, total]
    steps = [max(1, math.ceil((b - a) / period - 1e-9)) for a, b in pairwise(bounds)]
    if bounds[2] - bounds[1] < 1e-9:
        steps[1] = 0
    pieces = [
        np.linspace(a, b, n + 1)[1:] for a, b, n in zip(bounds, bounds[1:], steps, strict=False)
    ]
    seconds = np.concatenate(pieces)
    before, after = np.minimum(seconds, rising), np.maximum(seconds - (total - rising), 0.0)
    shares = (
        speed * seconds
        - 0.5 * growth * (rising**2 - (rising - before) ** 2)
        - 0.5 * growth * after**2
    )
    shares[-1] = 1.0
    return seconds, shares
