"""How far a body must keep from things because it is not known exactly where it is."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import check_covariance, check_transform, skew
from infomap_ros.motion.base.vehicle_config import VehicleConfig
from infomap_ros.motion.collision.collision_config import CollisionConfig

_RIM = 8  # directions in which the rim of the body is asked
_STEP = 0.01  # [m]; vehicles of a few margins are made and remembered


def base_sigma(
    T_map_camera: ArrayLike, covariance: ArrayLike, T_map_base: ArrayLike, radius: float
) -> float:
    """How well it is known where a robot's body is, as its camera's pose tells.

    A pose error (dt, dtheta) shifts a point p of the robot by ``dt + dtheta x (p - c)``, c being
    the camera's position.

    Args:
        T_map_camera: shape (4, 4).
        covariance: of that pose, shape (6, 6), convention of `geometry.transforms`.
        T_map_base: shape (4, 4).
        radius: of the body about the base's origin [m].

    Returns:
        Largest standard deviation, in any level direction, of a point of the body's rim [m].

    Raises:
        InvalidInputError: not rigid transforms, not a covariance, or a negative radius.
    """
    camera = check_transform(T_map_camera, "T_map_camera")[:3, 3]
    base = check_transform(T_map_base, "T_map_base")
    spread = check_covariance(covariance, 6, "covariance")
    if not radius >= 0.0:
        raise InvalidInputError("radius", f"is {radius}, expected at least 0 m")
    largest = 0.0
    for angle in np.linspace(0.0, 2.0 * math.pi, _RIM, endpoint=False):
        rim = base @ (radius * math.cos(angle), radius * math.sin(angle), 0.0, 1.0)
        level = np.hstack([np.eye(3), -skew(rim[:3] - camera)])[:2]
        variances = np.linalg.eigvalsh(level @ spread @ level.T)
        largest = max(largest, float(variances[-1]))
    return math.sqrt(largest)


def widenings_for(config: VehicleConfig | CollisionConfig, sigma: float) -> list[float]:
    """By how much a body is to be taken for wider, the wanted first, down to 0 for a sure pose.

    The errors that the margin is for and those of the pose are independent, so that their squares
    are added. Whole steps of 1 cm are taken, the nearest.

    Args:
        config: of the vehicle or of the arm.
        sigma: of its position, from `base_sigma` [m].

    Returns:
        One or more, falling [m].
    """
    least = config.margin
    wanted = min(math.hypot(least, config.margin_sigmas * sigma), max(config.max_margin, least))
    steps = round((wanted - least) / _STEP)
    return [_STEP * step for step in range(steps, -1, -1)]
