"""Times for a way through joint space, within limits of velocity and acceleration.

The joints move together along each straight piece with the trapezoidal profile that is the fastest
between the speeds at its ends: for a piece of unit direction u the path speed is at most
min v_j / |u_j| and its change at most min a_j / |u_j|. At a corner they stop, or pass it on a
parabola where a collision check finds that free (`corner_blends`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import float_array
from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.arm.corner_blends import FreeWay, StraightPieces, corner_speeds
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
    default_velocity: ClassVar[float] = 0.5
    """Largest speed of a joint whose description gives none [rad/s or m/s]."""
    acceleration: float = parameter(
        1.0,
        "Largest acceleration of every joint; robot descriptions do not hold it.",
        unit="rad/s^2 or m/s^2",
        low=0.001,
        high=1000.0,
    )
    corner_deviation: float = setting(
        0.05,
        "How far a joint may pass beside a corner of a way so as not to stop there; the collision "
        "check decides whether it does. 0 stops at every corner.",
        unit="rad or m",
        low=0.0,
        high=1.0,
    )
    period: float = setting(
        0.05, "Longest time between two knots of a moving arm.", unit="s", low=0.001, high=10.0
    )

    def __post_init__(self) -> None:
        check_config(self)

    def velocities(self, chain: KinematicChain) -> FloatArray:
        """Speeds that the joints may have, shape (n,) [rad/s or m/s]."""
        known = np.where(np.isfinite(chain.velocity), chain.velocity, self.default_velocity)
        return np.asarray(self.velocity_share * known)


def time_path(
    chain: KinematicChain,
    waypoints: FloatArray,
    config: TrajectoryConfig | None = None,
    is_free: FreeWay | None = None,
) -> ArmPath:
    """Give a way times.

    Args:
        chain: whose joints move.
        waypoints: corners of the way, shape (K, n) [rad or m], at least one.
        config: limits.
        is_free: whether a straight way is free: corners that can be passed are; all are stopped at
            without it.

    Returns:
        The same way, but for its corners, with knots so close that straight lines between them keep
        the limits.

    Raises:
        InvalidInputError: `waypoints` has another shape or is not finite.
    """
    settings = config or TrajectoryConfig()
    corners = float_array(waypoints, "waypoints")
    if corners.ndim != 2 or corners.shape[1] != len(chain) or not len(corners):
        raise InvalidInputError("waypoints", f"shape {corners.shape}, expected (K, {len(chain)})")
    if not np.isfinite(corners).all():
        raise InvalidInputError("waypoints", "is not finite")
    corners = _distinct(corners)
    if len(corners) == 1:
        return ArmPath(chain.joint_names, corners, np.zeros(1))
    way = StraightPieces.of(corners, settings.velocities(chain), settings.acceleration)
    speeds = np.zeros(len(corners))
    if is_free is not None:
        speeds = corner_speeds(way, settings.corner_deviation, is_free, settings.period)
    positions, times = _timed(way, speeds, settings.period)
    return ArmPath(chain.joint_names, positions, times)


def _distinct(corners: FloatArray) -> FloatArray:
    kept = [corners[0]]
    for corner in corners[1:]:
        if np.abs(corner - kept[-1]).max(initial=0.0) > _STILL:
            kept.append(corner)
    return np.array(kept)


def _timed(way: StraightPieces, speeds: FloatArray, period: float) -> tuple[FloatArray, FloatArray]:
    """Knots and times of a way that passes its corners at some speeds."""
    margins = way.margins(speeds)
    positions, times = [way.corners[:1]], [np.zeros(1)]
    for piece, (direction, length) in enumerate(zip(way.directions, way.lengths, strict=True)):
        begin, end = margins[piece], length - margins[piece + 1]
        ends = float(speeds[piece]), float(speeds[piece + 1])
        limits = float(way.speeds[piece]), float(way.growths[piece])
        seconds, lengths = _profile(end - begin, ends, limits, period)
        positions.append(way.corners[piece] + (begin + lengths)[:, None] * direction)
        if margins[piece + 1] == 0.0:
            positions[-1][-1] = way.corners[piece + 1]
        times.append(times[-1][-1] + seconds)
        if margins[piece + 1] > 0.0:
            seconds, knots = way.parabola(piece + 1, ends[1], period)
            positions.append(knots[1:])
            times.append(times[-1][-1] + seconds[1:])
    return np.concatenate(positions), np.concatenate(times)


def _profile(
    length: float, ends: tuple[float, float], limits: tuple[float, float], period: float
) -> tuple[FloatArray, FloatArray]:
    """Times [s] and lengths of a piece, both without the start.

    Args:
        length: of the piece.
        ends: path speeds at its ends, which its length allows to reach from each other [1/s].
        limits: largest path speed [1/s] and its largest change [1/s^2].
        period: longest time between two knots [s].
    """
    (first, last), (speed, growth) = ends, limits
    top = min(speed, math.sqrt(growth * length + 0.5 * (first**2 + last**2)))
    top = max(top, first, last)
    rising, falling = (top - first) / growth, (top - last) / growth
    climb, fall = 0.5 * (top + first) * rising, 0.5 * (top + last) * falling
    even = max(length - climb - fall, 0.0) / top
    parts = ((rising, first, growth), (even, top, 0.0), (falling, top, -growth))
    seconds, lengths, begin, at = [], [], 0.0, 0.0
    for duration, start, change in parts:
        if duration < 1e-9:
            continue
        steps = np.linspace(0.0, duration, max(1, math.ceil(duration / period - 1e-9)) + 1)[1:]
        seconds.append(begin + steps)
        lengths.append(at + start * steps + 0.5 * change * steps**2)
        begin, at = float(seconds[-1][-1]), float(lengths[-1][-1])
    return np.concatenate(seconds), np.minimum(np.concatenate(lengths), length)
