"""Which links of a robot touch by design, and how near others come without harm.

Spheres that cover convex hulls stick out of the true shapes. For a robot whose links nearly touch,
or lie in the hollow of another one, that would mean a contact in every configuration. Random
configurations tell, with the true shapes of the collision meshes beside them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import coal
import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.collision.kernels import BodyArrays, pair_gap, place_bodies
from infomap_ros.motion.robot.link_tree import LinkTree
from infomap_ros.motion.robot.robot_model import RobotModel

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
