"""Postures of an arm: to drive in, and those that bring its camera to a view.

To drive it is over the base, low, touching nothing, the camera ahead and seeing past the robot's
own body. For views many random postures are kept with the camera pose that each gives. Those whose
camera looks up or down as steeply as a wanted view, and stands as high above the ground, each name
one place and heading of the base that brings the camera there: the inversion of the arm's
reachability (Vahrenkamp, Asfour and Dillmann 2013, doi:10.1109/ICRA.2013.6630839).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.errors import RobotModelError
from infomap_ros.geometry import PinholeCamera
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.distance_field import field_of_blocked
from infomap_ros.motion.collision.body import CollisionBody
from infomap_ros.motion.collision.checker import CollisionChecker
from infomap_ros.motion.collision.kernels import place_spheres
from infomap_ros.motion.collision.pair_study import TrueShapes, near_pairs

MOST_COVERED = 0.2
"""Share of the image beyond which no posture is taken for a view: from what is left neither the
pose of the camera nor the depth at the outlines of the body can be trusted."""

_RAYS = (12, 9)  # across and down the image
_BEYOND_LEAST = 0.1  # of a share; beyond the least, where every posture covers more


@dataclass(frozen=True, eq=False)
class OwnView:
    """Casts a few rays through the image at the spheres of the links.

    Those of the link that carries the camera do not count: what they cover is always the same, and
    spheres are too coarse for a housing about a lens.

    Attributes:
        body: of the robot.
        rays: unit vectors in the camera frame, shape (R, 3).
        counted: which spheres of the body count, shape (S,).
    """

    body: CollisionBody
    rays: FloatArray
    counted: NDArray[np.bool_]

    @classmethod
    def of(cls, body: CollisionBody, camera: PinholeCamera) -> OwnView:
        """For the camera at the end of the arm."""
        columns, rows = (np.arange(count) + 0.5 for count in _RAYS)
        u, v = np.meshgrid(
            columns / _RAYS[0] * camera.width - 0.5, rows / _RAYS[1] * camera.height - 0.5
        )
        x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
        rays = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3)
        model = body.robot.model
        frame = model.frames[model.getFrameId(body.robot.camera_frame)]
        counted = body.arrays.bodies != body.tree.bodies[frame.parentJoint]
        return cls(
            body,
            rays / np.linalg.norm(rays, axis=1, keepdims=True),
            np.repeat(counted, np.diff(body.arrays.starts)),
        )

    def covered(self, qs: FloatArray) -> FloatArray:
        """Share of the image that the body covers, shape (M,), in postures, shape (M, n)."""
        shares = np.empty(len(qs))
        if len(qs):
            T_camera_base = np.linalg.inv(self.body.chain.camera_pose(qs))[:, :3]
            tree, arrays = self.body.tree.arrays, self.body.arrays
            _cast(tree, arrays, qs, T_camera_base, self.rays, self.counted, shares)
        return shares


def most_covered(shares: FloatArray) -> float:
    """Share of the image that may be covered, by those in many postures of the arm, shape (M,)."""
    return max(MOST_COVERED, float(shares.min(initial=1.0)) + _BEYOND_LEAST) if len(shares) else 1.0


@njit(cache=True, nogil=True)
def _cast(
    tree: Any, body: Any, qs: Any, T_camera_base: Any, rays: Any, counted: Any, shares: Any
) -> None:
    """Shares of rays, shape (R, 3), that meet a counted sphere, for each posture."""
    spheres, meets = np.empty_like(body.spheres), np.empty(len(rays), np.bool_)
    for k in range(len(qs)):
        place_spheres(tree, body, qs[k], T_camera_base[k], spheres)
        meets[:] = False
        for s in range(len(spheres)):
            if not counted[s]:
                continue
            x, y, z, radius = spheres[s, 0], spheres[s, 1], spheres[s, 2], spheres[s, 3]
            square = x * x + y * y + z * z
            if z < -radius or square <= radius * radius:
                continue
            least = math.sqrt(square - radius * radius)
            for r in range(len(rays)):
                if rays[r, 0] * x + rays[r, 1] * y + rays[r, 2] * z >= least:
                    meets[r] = True
        shares[k] = meets.mean()


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
    """Random postures within the limits that touch nothing of the robot itself, shape (K, n).

    Without joints there is one posture, and where nothing moves nothing touches.
    """
    if not len(body.chain):
        return np.empty((1, 0))
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


_HEIGHT_BIN = 0.05  # [m]
_STEEPNESS_BIN = 0.1  # [rad]
_ON_AXIS = 1e-3  # [m] from the axis counts a camera on it: 0 stands for none


@dataclass(frozen=True, eq=False)
class ArmPostures:
    """Random postures that touch nothing of the robot itself and see past it.

    Attributes:
        q: positions of the arm, shape (K, n) [rad or m].
        positions: of the camera, base frame, shape (K, 3) [m].
        azimuths: of its viewing direction about the base's z axis, shape (K,) [rad].
        steepness: angle of its viewing direction above the base's x-y plane, shape (K,) [rad].
        radii: farthest that a camera is from the base's z axis, by its height and steepness in
            bins, 0 where there is none, shape (A, B) [m].
        lowest: height of the first bin [m].
        most_covered: share beyond which a posture is not taken for a view.
    """

    q: FloatArray
    positions: FloatArray
    azimuths: FloatArray
    steepness: FloatArray
    radii: FloatArray
    lowest: float
    most_covered: float

    @classmethod
    def of(cls, body: CollisionBody, count: int, own_view: OwnView | None = None) -> ArmPostures:
        """Draw `count` postures and keep those without contact; always the same.

        Args:
            body: of the robot.
            count: of postures.
            own_view: to leave out those in which the camera sees too much of the robot.
        """
        q = sample_postures(body, count)
        covered = np.zeros(len(q)) if own_view is None else own_view.covered(q)
        most = most_covered(covered)
        q = q[covered <= most]
        poses = body.chain.camera_pose(q)
        positions, directions = poses[:, :3, 3], poses[:, :3, 2]
        steepness = np.arcsin(np.clip(directions[:, 2], -1.0, 1.0))
        lowest = float(positions[:, 2].min(initial=0.0))
        radii = _radii(positions, steepness, lowest)
        azimuths = np.arctan2(directions[:, 1], directions[:, 0])
        return cls(q, positions, azimuths, steepness, radii, lowest, most)

    def radius_for(self, heights: FloatArray, steepness: FloatArray) -> FloatArray:
        """Farthest that a camera of some height and steepness is from the base's z axis.

        Args:
            heights: above the base's origin, shape (...) [m].
            steepness: shape (...) [rad].

        Returns:
            Shape (...) [m]; 0 where no posture comes near, or the height is NaN.
        """
        rows, columns = _bins(np.nan_to_num(heights, nan=-np.inf), steepness, self.lowest)
        inside = (rows >= 0) & (rows < self.radii.shape[0])
        found = self.radii[np.clip(rows, 0, self.radii.shape[0] - 1), columns]
        return np.where(inside, found, 0.0)

    def places_for(
        self, T_map_camera: FloatArray, tolerance: float
    ) -> tuple[FloatArray, FloatArray, NDArray[np.int64]]:
        """Places of a level base that bring the camera over a point, looking in a direction.

        Args:
            T_map_camera: the wanted view, shape (4, 4).
            tolerance: of the steepness [rad].

        Returns:
            x, y [m] and yaw [rad] of the base, shape (P, 3); the height that its origin must have,
            shape (P,) [m, map]; and the posture of each, shape (P,).
        """
        direction, target = T_map_camera[:3, 2], T_map_camera[:3, 3]
        steepness = np.arcsin(np.clip(direction[2], -1.0, 1.0))
        chosen = np.flatnonzero(np.abs(self.steepness - steepness) <= tolerance)
        yaws = np.arctan2(direction[1], direction[0]) - self.azimuths[chosen]
        x, y = self.positions[chosen, 0], self.positions[chosen, 1]
        cosine, sine = np.cos(yaws), np.sin(yaws)
        places = np.column_stack(
            [target[0] - cosine * x + sine * y, target[1] - sine * x - cosine * y, yaws]
        )
        return places, target[2] - self.positions[chosen, 2], chosen


def _bins(
    heights: FloatArray, steepness: FloatArray, lowest: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    rows = np.floor(np.clip((heights - lowest) / _HEIGHT_BIN, -1.0, 1e6)).astype(np.int64)
    return rows, np.floor((steepness + 0.5 * np.pi) / _STEEPNESS_BIN).astype(np.int64)


def _radii(positions: FloatArray, steepness: FloatArray, lowest: float) -> FloatArray:
    """Largest radius in each bin and its neighbors, as few postures fall into one."""
    rows, columns = _bins(positions[:, 2], steepness, lowest)
    radii = np.zeros((int(rows.max(initial=0)) + 1, int(np.pi / _STEEPNESS_BIN) + 1))
    away = np.maximum(np.linalg.norm(positions[:, :2], axis=1), _ON_AXIS)
    np.maximum.at(radii, (rows, columns), away)
    padded = np.pad(radii, 1)
    shifted = [
        padded[1 + i : 1 + i + radii.shape[0], 1 + j : 1 + j + radii.shape[1]]
        for i in (-1, 0, 1)
        for j in (-1, 0, 1)
    ]
    return np.asarray(np.max(shifted, axis=0))
