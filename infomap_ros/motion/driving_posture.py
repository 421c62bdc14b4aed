"""A posture of the arm to drive in: over the base, low, and touching nothing."""

from __future__ import annotations

import numpy as np

from infomap_ros.errors import RobotModelError
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.distance_field import field_of_blocked
from infomap_ros.motion.collision import CollisionChecker
from infomap_ros.motion.collision_body import CollisionBody

_POSTURES = 4000
_OVERHANG_COST = 3.0


def driving_posture(body: CollisionBody) -> FloatArray:
    """Find a compact posture, always the same for the same robot.

    Of random postures without contact, the one for which height above the base plus three times
    the overhang beyond the base's outline, seen from above, is least.

    Returns:
        Positions of the arm, shape (n,) [rad or m].

    Raises:
        RobotModelError: no posture without contact was found.
    """
    qs = sample_postures(body, _POSTURES)
    if not len(qs):
        raise RobotModelError(f"robot '{body.robot.name}' touches itself in every posture")
    still, moving = _standing(body)
    low, high = _outline(body, still)
    costs = [_cost(body.spheres(q, np.eye(4))[moving], low, high) for q in qs]
    return np.asarray(qs[int(np.argmin(costs))])


def sample_postures(body: CollisionBody, count: int) -> FloatArray:
    """Random postures within the limits that touch nothing of the robot itself, shape (K, n)."""
    chain = body.chain
    low = np.where(np.isfinite(chain.lower), chain.lower, -np.pi)
    high = np.where(np.isfinite(chain.upper), chain.upper, np.pi)
    qs = np.random.default_rng(1).uniform(low, high, (count, len(chain)))
    nothing = field_of_blocked(np.zeros((1, 1, 1), bool), (0, 0, 0), 1.0, outside_is_free=True)
    return np.asarray(qs[CollisionChecker(body, nothing).are_free(qs, np.eye(4))])


def _standing(body: CollisionBody) -> tuple[np.ndarray, np.ndarray]:
    """Which spheres stand still on the base and which move."""
    moves = np.repeat(body.arrays.bodies > 0, np.diff(body.arrays.starts))
    return ~moves, moves


def _outline(body: CollisionBody, still: np.ndarray) -> tuple[FloatArray, FloatArray]:
    spheres = body.spheres(np.zeros(len(body.chain)), np.eye(4))[still]
    if not len(spheres):
        return np.zeros(3), np.zeros(3)
    low = (spheres[:, :3] - spheres[:, 3:]).min(axis=0)
    return low, (spheres[:, :3] + spheres[:, 3:]).max(axis=0)


def _cost(spheres: FloatArray, low: FloatArray, high: FloatArray) -> float:
    reach = np.maximum(
        spheres[:, :3] + spheres[:, 3:] - high, low - spheres[:, :3] + spheres[:, 3:]
    )
    overhang = float(np.maximum(reach[:, :2], 0.0).max(initial=0.0))
    top = float((spheres[:, 2] + spheres[:, 3]).max(initial=0.0))
    return top + _OVERHANG_COST * overhang
