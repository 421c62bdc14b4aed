"""What inverse kinematics knows of an arm beforehand, and says of a target it cannot reach."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.arm.ik_search import Arm
from infomap_ros.motion.robot.chain import KinematicChain

_AT_LIMIT = 1e-9  # [rad or m]
_SLIDE_WITHOUT_LIMIT = 1.0  # where random starts of a joint without limits end [m]


@lru_cache(maxsize=64)
def arm_of(chain: KinematicChain) -> Arm:
    """Describe a chain for a search."""
    half = np.where(chain.is_prismatic, _SLIDE_WITHOUT_LIMIT, math.pi)
    wide = ~(chain.upper - chain.lower <= 2.0 * half)
    wide &= ~chain.is_prismatic | ~np.isfinite(chain.upper - chain.lower)
    middle = np.clip(0.0, chain.lower + half, np.maximum(chain.upper - half, chain.lower + half))
    return Arm(
        lower=chain.lower,
        upper=chain.upper,
        prismatic=chain.is_prismatic,
        speeds=np.where(np.isfinite(chain.velocity), chain.velocity, 1.0),
        low=np.where(wide, middle - half, chain.lower),
        high=np.where(wide, middle + half, chain.upper),
        root=_root(chain),
        reach=_reach(chain),
    )


def why_not(
    chain: KinematicChain,
    T_base_camera: FloatArray,
    q: FloatArray,
    errors: tuple[float, float],
    tolerances: tuple[float, float],
    direction_only: bool,
) -> str:
    """Say why `q`, the best that was found, is not good enough.

    Args:
        chain: of n joints.
        T_base_camera: wanted pose, shape (4, 4).
        q: shape (n,).
        errors: distance [m] and angle [rad] from the wanted pose.
        tolerances: allowed distance [m] and angle [rad].
        direction_only: the angle is one between viewing directions.
    """
    arm = arm_of(chain)
    away = float(np.linalg.norm(T_base_camera[:3, 3] - arm.root))
    if away > arm.reach + tolerances[0]:
        joint = f"joint '{chain.joint_names[0]}'" if len(chain) else "the base"
        return f"out of reach: {away:.2f} m from {joint}, the arm extends {arm.reach:.2f} m"
    parts = []
    if errors[0] > tolerances[0]:
        parts.append(f"position off by {_length(errors[0])}")
    if errors[1] > tolerances[1]:
        what = "direction" if direction_only else "rotation"
        parts.append(f"{what} off by {_angle(errors[1])}")
    at_limit = (q - chain.lower < _AT_LIMIT) | (chain.upper - q < _AT_LIMIT)
    names = [f"'{chain.joint_names[index]}'" for index in np.flatnonzero(at_limit)]
    if names:
        parts.append("at the limits of joint " + ", ".join(names))
    return ", ".join(parts)


def _length(meters: float) -> str:
    if meters < 0.01:
        return f"{1000.0 * meters:.2g} mm"
    return f"{100.0 * meters:.1f} cm" if meters < 1.0 else f"{meters:.2f} m"


def _angle(radians: float) -> str:
    degrees = math.degrees(radians)
    return f"{degrees:.2g} deg" if degrees < 10.0 else f"{degrees:.0f} deg"


def _root(chain: KinematicChain) -> FloatArray:
    arrays = chain.arrays
    first = arrays.placements[0] if len(arrays.columns) else arrays.tail
    return np.ascontiguousarray(first[:, 3])


def _reach(chain: KinematicChain) -> float:
    """Length of the chain, stretched, from the origin of its first joint at zero."""
    arrays = chain.arrays
    if not len(arrays.columns):
        return 0.0
    lengths = np.linalg.norm(arrays.placements[1:, :, 3], axis=1).sum()
    slides = 0.0
    for column, scale, offset, prismatic in zip(*arrays[:4], strict=True):
        if prismatic:
            ends = scale * np.array([chain.lower[column], chain.upper[column]]) + offset
            slides += float(np.abs(ends).max())
    return float(lengths + slides + np.linalg.norm(arrays.tail[:, 3]))
