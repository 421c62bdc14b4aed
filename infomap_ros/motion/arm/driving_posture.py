"""A posture of the arm to drive in: over the base, low, and touching nothing."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import RobotModelError
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.distance_field import field_of_blocked
from infomap_ros.motion.collision.body import CollisionBody
from infomap_ros.motion.collision.checker import CollisionChecker

_POSTURES = 4000
_ROUNDS = 12
_ROUND = 200
_OVERHANG_COST = 3.0
_LOW_COST = 10.0
_CLEARANCE = 0.1  # [m]
_SPARE = 0.02  # share of a joint's range that is kept from its limits


def driving_posture(body: CollisionBody) -> FloatArray:
    """Find a compact posture, always the same for the same robot.

    Least are the height of the arm's highest point and of its middle, above the base's origin,
    three times its overhang beyond the base's outline seen from above, and ten times what it lacks
    of a clearance over the base's lowest point, together: first of random postures without contact,
    then of ever nearer neighbors of the best one.

    Returns:
        Positions of the arm, shape (n,) [rad or m].

    Raises:
        RobotModelError: no posture without contact was found.
    """
    still, moving = _standing(body)
    low, high = _outline(body, still)
    return least_posture(body, lambda q: _cost(body.spheres(q, np.eye(4))[moving], low, high))


def least_posture(body: CollisionBody, cost: Callable[[FloatArray], float]) -> FloatArray:
    """Find the posture of least cost that touches nothing of the robot, always the same.

    First of random ones, then of ever nearer neighbors of the best one.

    Args:
        body: of the robot.
        cost: of positions of the arm, shape (n,) [rad or m].

    Returns:
        Positions of the arm, shape (n,) [rad or m].

    Raises:
        RobotModelError: no posture without contact was found.
    """
    qs = sample_postures(body, _POSTURES)
    if not len(qs):
        raise RobotModelError(f"robot '{body.robot.name}' touches itself in every posture")
    low_q, high_q = posture_box(body)
    spare = _SPARE * (high_q - low_q)
    low_q, high_q = low_q + spare, high_q - spare
    rng = np.random.default_rng(2)
    best, least = qs[0], np.inf
    for round_number in range(_ROUNDS + 1):
        costs = [cost(q) for q in qs]
        if len(costs) and min(costs) < least:
            best, least = qs[int(np.argmin(costs))], min(costs)
        spread = 0.2 * 0.7**round_number * (high_q - low_q)
        near = np.clip(best + spread * rng.normal(size=(_ROUND, len(best))), low_q, high_q)
        qs = near[_free_of_itself(body, near)]
    return np.asarray(best)


def posture_box(body: CollisionBody) -> tuple[FloatArray, FloatArray]:
    """Limits of the joints, a turn for one that has none, shapes (n,) [rad or m]."""
    chain = body.chain
    low = np.where(np.isfinite(chain.lower), chain.lower, -np.pi)
    return low, np.where(np.isfinite(chain.upper), chain.upper, np.pi)


def sample_postures(body: CollisionBody, count: int) -> FloatArray:
    """Random postures within the limits that touch nothing of the robot itself, shape (K, n)."""
    low, high = posture_box(body)
    qs = np.random.default_rng(1).uniform(low, high, (count, len(body.chain)))
    return np.asarray(qs[_free_of_itself(body, qs)])


def _free_of_itself(body: CollisionBody, qs: FloatArray) -> NDArray[np.bool_]:
    """Which postures, shape (N, n), touch nothing of the robot, shape (N,)."""
    nothing = field_of_blocked(np.zeros((1, 1, 1), bool), (0, 0, 0), 1.0, outside_is_free=True)
    return CollisionChecker(body, nothing).are_free(qs, np.eye(4))


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
    middle = float(spheres[:, 2].mean()) if len(spheres) else 0.0
    lowest = float((spheres[:, 2] - spheres[:, 3]).min(initial=np.inf))
    lacking = max(low[2] + _CLEARANCE - lowest, 0.0)
    return top + middle + _OVERHANG_COST * overhang + _LOW_COST * lacking
