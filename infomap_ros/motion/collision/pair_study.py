"""Which links of a robot can touch, which do by design, and how near others come without harm.

Spheres that cover convex hulls stick out of the true shapes. For a robot whose links nearly touch,
or lie in the hollow of another one, that would mean a contact in every configuration. Random
configurations tell, with the true shapes of the collision meshes beside them.
"""

from __future__ import annotations

import fnmatch
from dataclasses import replace
from itertools import combinations
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio
from numba import njit
from numpy.typing import NDArray

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.collision.kernels import BodyArrays, pair_gap, place_bodies
from infomap_ros.motion.robot.robot_model import LinkTree, RobotModel


def movable_pairs(robot: RobotModel, tree: LinkTree) -> NDArray[np.int64]:
    """Pairs of links with shapes that move against each other and are not joined by a joint.

    Two links count as joined where only links without shapes are between them, and where all
    joints between them slide in one direction, as the tubes of a telescope do: these are in one
    another by design.

    Returns:
        Numbers in ``robot.links_with_solids``, shape (P, 2).
    """
    links = robot.links_with_solids
    joint_of = {shape.link: shape.joint for shape in robot.shapes}
    above = {link: _next_above(robot, link) for link in links}
    pairs = [
        (i, j)
        for (i, a), (j, b) in combinations(enumerate(links), 2)
        if above[a] != b
        and above[b] != a
        and not _is_telescope(tree, int(tree.bodies[joint_of[a]]), int(tree.bodies[joint_of[b]]))
    ]
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def allowed_pairs(
    links: tuple[str, ...], pairs: NDArray[np.int64], contacts: tuple[str, ...]
) -> NDArray[np.bool_]:
    """Tell which pairs of links, shape (P, 2), are allowed to touch, shape (P,).

    Args:
        links: names.
        pairs: numbers of links.
        contacts: pairs of patterns, as ``first:second``, in either order.
    """
    patterns = [contact.split(":") for contact in contacts]
    patterns += [[second, first] for first, second in patterns]
    allowed = [
        any(
            fnmatch.fnmatchcase(links[i], a) and fnmatch.fnmatchcase(links[j], b)
            for a, b in patterns
        )
        for i, j in pairs
    ]
    return np.array(allowed, dtype=bool)


def is_any_of(link: str, patterns: tuple[str, ...]) -> bool:
    """Whether a link's name matches a pattern."""
    return any(fnmatch.fnmatchcase(link, pattern) for pattern in patterns)


def _is_telescope(tree: LinkTree, first: int, second: int) -> bool:
    """Whether all joints between two bodies slide in one direction; also where there is none."""
    up, down = set(tree.bodies_up_from(first)), set(tree.bodies_up_from(second))
    joints = [body - 1 for body in up ^ down]
    axes = np.array([tree.axis(joint) for joint in joints]).reshape(-1, 3)
    parallel = np.abs(axes @ axes[:1].T) > 1.0 - 1e-6
    return bool(tree.arrays.prismatic[joints].all() and parallel.all())


def _next_above(robot: RobotModel, link: str) -> str:
    """The nearest link with shapes on the way to the root, or empty."""
    parent = _link_above(robot, link)
    while parent and parent not in robot.links_with_solids:
        parent = _link_above(robot, parent)
    return parent


def _link_above(robot: RobotModel, link: str) -> str:
    """The parent link, empty for the root."""
    frames = robot.model.frames
    own = frames[robot.model.getFrameId(link, pinocchio.FrameType.BODY)]
    above = frames[frames[own.parentFrame].parentFrame]
    return str(above.name) if above.type == pinocchio.FrameType.BODY else ""


_TESTED = 200  # configurations in which the true shapes of a pair are compared
_ENOUGH = 30  # configurations without a contact that show that two links do not meet
_SLACK = 0.003  # above the overlap of the least true contact that was found [m]


class PairStudy(NamedTuple):
    """How links are to be compared.

    Attributes:
        compared: pairs that must not touch, shape (P,).
        gaps: distance of the spheres below which they count as touching, shape (P,) [m]; negative
            where they overlap without harm.
        false_alarms: share of configurations in which they then still count as touching and do
            not, shape (P,).
    """

    compared: NDArray[np.bool_]
    gaps: FloatArray
    false_alarms: FloatArray


class TrueShapes:
    """A robot's collision meshes in some configurations of its arm.

    Args:
        robot: with a camera frame.
        tree: its kinematics.
        qs: positions of its arm, shape (N, n).
        convex: take the convex hulls of the meshes instead, as simulators of forces do.
    """

    def __init__(
        self, robot: RobotModel, tree: LinkTree, qs: FloatArray, *, convex: bool = False
    ) -> None:
        self._shapes = [
            [
                replace(shape, geometry=_hull(shape.geometry)) if convex else shape
                for shape in robot.shapes
                if shape.link == link
            ]
            for link in robot.links_with_solids
        ]
        self._tree, self._qs = tree, qs
        self._placed: dict[int, FloatArray] = {}

    def touch(self, first: int, second: int, configuration: int) -> bool:
        """Whether two links, by number, touch in a configuration, by number."""
        one, two = (self._at(link, configuration) for link in (first, second))
        request = coal.CollisionRequest()
        return any(
            coal.collide(*a, *b, request, coal.CollisionResult()) > 0 for a in one for b in two
        )

    def distance(self, first: int, second: int, configuration: int) -> float:
        """Between two links, by number, in a configuration, by number [m]; 0 where they touch."""
        one, two = (self._at(link, configuration) for link in (first, second))
        request = coal.DistanceRequest()
        return min(
            max(coal.distance(*a, *b, request, coal.DistanceResult()), 0.0)
            for a in one
            for b in two
        )

    def _at(
        self, link: int, configuration: int
    ) -> list[tuple[coal.CollisionGeometry, coal.Transform3s]]:
        if configuration not in self._placed:
            self._placed[configuration] = self._joints(self._qs[configuration])
        joints, placed = self._placed[configuration], []
        for shape in self._shapes[link]:
            pose = joints[shape.joint] @ shape.placement
            placed.append((shape.geometry, coal.Transform3s(pose[:3, :3], pose[:3, 3])))
        return placed

    def _joints(self, q: FloatArray) -> FloatArray:
        """Frames of all joints of the model in the base frame, shape (njoints, 3, 4)."""
        places = np.empty((len(self._tree.arrays.parents) + 1, 3, 4))
        place_bodies(self._tree.arrays, q, np.eye(4)[:3], places)
        bodies = np.concatenate(
            [places, np.broadcast_to([[[0.0, 0.0, 0.0, 1.0]]], (len(places), 1, 4))], axis=1
        )
        return (bodies[self._tree.bodies] @ self._tree.placements)[:, :3]


def _hull(geometry: coal.CollisionGeometry) -> coal.CollisionGeometry:
    """The convex hull of a mesh; another shape as it is."""
    if not isinstance(geometry, coal.BVHModelBase):
        return geometry
    geometry.buildConvexHull(True, "Qt")
    return geometry.convex


def study_pairs(
    shapes: TrueShapes,
    tree: LinkTree,
    arrays: BodyArrays,
    qs: FloatArray,
    gaps: FloatArray,
    always: float,
    alarms: float,
) -> PairStudy:
    """Find which pairs are compared, and with which gaps.

    - Links that truly touch in the first configuration, or nearly always, do so by design.
    - Where spheres come too near and there never is a contact, the gap becomes less than all that
      was seen.
    - Where they do so too often without a contact, or in the first configuration, it becomes what
      lies just above the overlap of all true contacts.

    Args:
        shapes: the true ones in the same configurations.
        tree: kinematics.
        arrays: spheres and pairs.
        qs: configurations, shape (N, n), the first one known to be possible.
        gaps: distances to keep, shape (P,) [m].
        always: share of configurations in which links touch by design.
        alarms: share of configurations in which a false contact is borne.
    """
    found = np.empty((len(qs), len(gaps)))
    _sampled_gaps(tree.arrays, arrays, qs, gaps, found)
    study = PairStudy(np.ones(len(gaps), dtype=bool), gaps.copy(), np.zeros(len(gaps)))
    for pair in np.flatnonzero((found < gaps).any(axis=0)):
        near = np.flatnonzero(found[:, pair] < gaps[pair])
        share, at_rest = len(near) / len(qs), near[0] == 0
        if len(near) < _ENOUGH and share <= alarms and not at_rest:
            continue
        tested = near[:: max(1, len(near) // _TESTED)]
        first, second = arrays.pairs[pair]
        touches = np.array([shapes.touch(first, second, k) for k in tested])
        by_design = share * touches.mean() >= always or (at_rest and touches[0])
        study.compared[pair] = not by_design
        never = len(near) >= _ENOUGH and not touches.any()
        if at_rest or never or share * (1.0 - touches.mean()) > alarms:
            study.gaps[pair] = min(gaps[pair], _harmless_gap(found[tested, pair], touches))
        alarmed = (found[tested, pair] < study.gaps[pair]) & ~touches
        study.false_alarms[pair] = share * alarmed.mean()
    return study


def _harmless_gap(distances: FloatArray, touches: NDArray[np.bool_]) -> float:
    if touches.any():
        return float(distances[touches].max()) + _SLACK
    return float(distances.min()) - _SLACK


def near_pairs(
    tree: LinkTree, arrays: BodyArrays, qs: FloatArray, distance: float
) -> NDArray[np.bool_]:
    """Which pairs of links may be nearer than a distance [m], by their spheres.

    Args:
        tree: kinematics.
        arrays: spheres and pairs.
        qs: configurations, shape (N, n).
        distance: between the links [m].

    Returns:
        Shape (N, P); where it is False the true shapes are farther apart.
    """
    found = np.empty((len(qs), len(arrays.pairs)))
    _sampled_gaps(tree.arrays, arrays, qs, np.full(len(arrays.pairs), distance), found)
    return found < distance


@njit(cache=True, nogil=True)
def _sampled_gaps(tree: Any, body: Any, qs: Any, limits: Any, found: Any) -> None:
    """`pair_gap` of all pairs, each with its limit, in configurations (N, n): shape (N, P) [m]."""
    places = np.empty((len(tree.parents) + 1, 3, 4))
    base = np.eye(4)[:3]
    for i in range(len(qs)):
        place_bodies(tree, qs[i], base, places)
        for pair in range(len(limits)):
            found[i, pair] = pair_gap(body, pair, limits[pair], places)
