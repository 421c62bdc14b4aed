"""A posture of the arm to drive in: over the base, low, touching nothing, the camera ahead."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import RobotModelError
from infomap_ros.geometry import PinholeCamera
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.distance_field import field_of_blocked
from infomap_ros.motion.arm.own_view import OwnView
from infomap_ros.motion.collision.body import CollisionBody
from infomap_ros.motion.collision.checker import CollisionChecker
from infomap_ros.motion.collision.pair_study import TrueShapes, near_pairs

_POSTURES = 4000
_ROUNDS = 12
_ROUND = 200
_OVERHANG_COST = 3.0
_LOW_COST = 10.0
_TILT_COST = 1.0  # [m]
_LEVEL = 0.3  # of the optical axis' vertical part, up to which the camera looks ahead
_COVERED_COST = 1.0  # [m]
_CAMERA = PinholeCamera(640, 480, 500.0, 500.0, 319.5, 239.5)  # as many have
_CLEARANCE = 0.1  # [m]
_SPARE = 0.02  # share of a joint's range that is kept from its limits
_STAYS = 0.01  # [m]; what the arm moves to the side by less than this, over all its postures, stays
_UNLIKE = 0.5  # [rad or m] by which some joint of two postures differs
_COMPARED = 50  # postures in which that is seen
_APART = 0.002  # [m] between the true shapes of links, at least
_WELL_APART = 0.02  # [m] between them where that is possible: a servo follows no better
_TRIED = 20  # postures of a round whose true shapes are looked at


def driving_posture(body: CollisionBody) -> FloatArray:
    """Find a compact posture, always the same for the same robot.

    Least are the height of the arm's highest point and of its middle, above the base's origin,
    three times its overhang beyond the base's outline seen from above, and ten times what it lacks
    of a clearance over the base's lowest point, together, and what keeps the camera from seeing
    where it is: looking up or down, and the body before it. First of random postures without
    contact, then of ever nearer neighbors of the best one. What the arm's joints only lift, as a
    second arm on the same torso, overhangs in every posture alike, and its overhang does not count.

    Returns:
        Positions of the arm, shape (n,) [rad or m].

    Raises:
        RobotModelError: no posture without contact was found.
    """
    return least_posture(body, _cost_of(body))


def compact_postures(body: CollisionBody, count: int) -> FloatArray:
    """Other postures to drive in, by the cost of `driving_posture`, shape (K, n), K <= count.

    Where the map blocks the best one, one that is unlike it may be free.
    """
    qs, cost = sample_postures(body, _POSTURES), _cost_of(body)
    gaps, kept = _Gaps(body, qs), list[FloatArray]()
    for row in np.argsort([cost(q) for q in qs]):
        if len(kept) == count:
            break
        is_new = not kept or np.abs(np.array(kept) - qs[row]).max(axis=1).min() > _UNLIKE
        if is_new and np.isfinite(gaps.lacking(row)):
            kept.append(qs[row])
    return np.array(kept).reshape(-1, len(body.chain))


def _cost_of(body: CollisionBody) -> Callable[[FloatArray], float]:
    """What is least in the driving posture, as a function of the arm's positions."""
    still, moving = _standing(body)
    low, high = _outline(body, still)
    swings = _swinging(body)[moving]
    own_view = OwnView.of(body, _CAMERA)

    def cost(q: FloatArray) -> float:
        up = abs(float(body.chain.camera_pose(q[None])[0, 2, 2]))
        blind = _COVERED_COST * float(own_view.covered(q[None])[0])
        blind += _TILT_COST * max(up - _LEVEL, 0.0)
        return blind + _cost(body.spheres(q, np.eye(4))[moving], swings, low, high)

    return cost


def least_posture(body: CollisionBody, cost: Callable[[FloatArray], float]) -> FloatArray:
    """Find the posture of least cost that touches nothing of the robot, always the same.

    First of random ones, then of ever nearer neighbors of the best one. What is least is often what
    nearly touches, and the spheres tell that badly where they were adapted (`pair_study`): so the
    true shapes are looked at too, and each millimeter that two of them lack of being well apart
    counts as much as one that the arm is too low.

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
        costs = np.array([cost(q) for q in qs])
        gaps = _Gaps(body, qs)
        for row in np.argsort(costs)[:_TRIED]:
            if costs[row] >= least:
                break
            total = costs[row] + _LOW_COST * gaps.lacking(row)
            if total < least:
                best, least = qs[row], total
        spread = 0.2 * 0.7**round_number * (high_q - low_q)
        near = np.clip(best + spread * rng.normal(size=(_ROUND, len(best))), low_q, high_q)
        qs = near[_free_of_itself(body, near)]
    return np.asarray(best)


class _Gaps:
    """Between the true shapes of the links that are compared, in postures of shape (N, n)."""

    def __init__(self, body: CollisionBody, qs: FloatArray) -> None:
        self._shapes, self._pairs = TrueShapes(body.robot, body.tree, qs), body.arrays.pairs
        self._near = near_pairs(body.tree, body.arrays, qs, _WELL_APART)

    def lacking(self, row: int) -> float:
        """What they lack of being well apart, together [m]; infinite where any two touch.

        Links that are near each other by design lack it in every posture alike.
        """
        pairs = self._pairs[self._near[row]]
        gaps = np.array([self._shapes.distance(a, b, row) for a, b in pairs])
        touching = (gaps <= _APART).any()
        return np.inf if touching else float(np.maximum(_WELL_APART - gaps, 0.0).sum())


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


def _standing(body: CollisionBody) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which spheres belong to the base, with its wheels, and which move with the arm.

    Neither are those of a second arm beside it: what joints with limits move is no base.
    """
    robot, counts = body.robot, np.diff(body.arrays.starts)
    limited = {
        int(robot.model.getJointId(joint.name)) for joint in robot.joints if not joint.is_continuous
    }
    joint_of = {shape.link: shape.joint for shape in robot.shapes}
    above = (set(map(int, robot.model.supports[joint_of[link]])) for link in body.links)
    moves = body.arrays.bodies > 0
    still = ~moves & np.array([not (joints & limited) for joints in above], dtype=bool)
    return np.repeat(still, counts), np.repeat(moves, counts)


def _swinging(body: CollisionBody) -> NDArray[np.bool_]:
    """Which spheres the arm moves to the side, not only up and down."""
    qs = sample_postures(body, _COMPARED)
    places = np.array([body.spheres(q, np.eye(4))[:, :2] for q in qs])
    moved = np.ptp(places, axis=0) if len(qs) else np.full((len(body.arrays.spheres), 2), np.inf)
    return np.asarray((moved > _STAYS).any(axis=1))


def _outline(body: CollisionBody, still: NDArray[np.bool_]) -> tuple[FloatArray, FloatArray]:
    spheres = body.spheres(np.zeros(len(body.chain)), np.eye(4))[still]
    if not len(spheres):
        return np.zeros(3), np.zeros(3)
    low = (spheres[:, :3] - spheres[:, 3:]).min(axis=0)
    return low, (spheres[:, :3] + spheres[:, 3:]).max(axis=0)


def _cost(
    spheres: FloatArray, swings: NDArray[np.bool_], low: FloatArray, high: FloatArray
) -> float:
    arm = spheres[swings]
    reach = np.maximum(arm[:, :3] + arm[:, 3:] - high, low - arm[:, :3] + arm[:, 3:])
    overhang = float(np.maximum(reach[:, :2], 0.0).max(initial=0.0))
    top = float((spheres[:, 2] + spheres[:, 3]).max(initial=0.0))
    middle = float(spheres[:, 2].mean()) if len(spheres) else 0.0
    lowest = float((spheres[:, 2] - spheres[:, 3]).min(initial=np.inf))
    lacking = max(low[2] + _CLEARANCE - lowest, 0.0)
    return top + middle + _OVERHANG_COST * overhang + _LOW_COST * lacking
