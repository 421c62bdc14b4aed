"""What has changed between two maps of one place.

A surface point of one map lies in a voxel of which both maps have evidence. Whether its state is
another one is asked of a chain of two states, as in J. Saarinen et al., "Independent Markov chain
occupancy grid maps for representation of dynamic environments", IROS 2012,
https://doi.org/10.1109/IROS.2012.6385629, and D. Meyer-Delius et al., "Occupancy grid models for
robot mapping in changing environments", AAAI 2012: occupied and free are equally likely before
anything is seen, and from one map to the other the state becomes the other one with probability c.
With the odds a and b of occupancy by what the one and the other map has seen,

    P(free, then occupied) = c b / ((1 - c) (1 + a b) + c (a + b)),

and with a in place of b in the numerator for occupied, then free. Where one map knows nothing
(odds 1) this is c at most: no change is found.

A map says of the place of another one's point what it says of where that point may lie. Two things
are known: the covariance of the point along its surface's normal, and that of the maps to each
other. The probability q that the map has the surface there is the largest of

    p(x) exp(-t^2 / 2)    of its voxels, at t = 0, 1, 2, 3 sigmas along the axes of that covariance,
    p(u) exp(-d^2 / 2)    of its surface points u near, d being the Mahalanobis distance,

the factor being the likelihood of the displacement against that of none, and a = q / (1 - q). So a
surface that moved by little in terms of the sigmas of both points and of the registration is the
same one. A point stands for a patch, which at an edge is counted in one voxel or in that beside it:
across its normal its sigma is a voxel's edge, and d is that of patches whose normals differ, too.
What is new within one and a half voxels of an edge or of a surface of another direction, as the
foot of a box on a floor, is not found.

Where the later map went on from the earlier one, its own evidence is the difference of the two: the
sums are exact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from scipy.special import expit

from infomap_ros.geometry import invert_transform, point_covariances, transform_points
from infomap_ros.geometry.transforms import FloatArray, carry_covariance
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.voxels.keys import pack_all
from infomap_ros.team.merging import NamedMap, check_pair, sessions_of, share_offset
from infomap_ros.team.registration import Registration
from infomap_ros.team.replica import moved_offset

APPEARED, VANISHED = "appeared", "vanished"
CHANGED = 0.95
"""A voxel has changed that has with this probability, as one is occupied that is (evidence.md)."""

_PRIOR = 0.05  # c: takes 5.9 nats from each map, a hit from three scans, misses from two places
_SIGMAS = (1.0, 2.0, 3.0)
_NEAR = 1.5  # patches whose means are no farther apart along any axis touch [voxels]
_NEIGHBORS = 32  # of a point, at the most
_TOGETHER = 2.0  # changed voxels so near along each axis are of one object [voxels]
_LEAST_VOXELS = 4  # of an object; what is less is scattered
_MOST_LOG_ODDS = 50.0
_Flags = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class ChangedObject:
    """Changed voxels that hang together.

    Attributes:
        what: `APPEARED` or `VANISHED`.
        box: lower and upper corner about its voxels, shape (2, 3), frame of the old map [m].
        voxels: number of them.
        surface: area of the surface in them [m^2].
        probability: mean over them, which is the expected share that has changed.
    """

    what: str
    box: FloatArray
    voxels: int
    surface: float
    probability: float


@dataclass(frozen=True, eq=False)
class ChangedSurface:
    """The surface points of a map of which the other one says that they have appeared, or vanished.

    Attributes:
        surface_voxels: of the map.
        compared: of them, whose place the other map knows: as surface, or so surely as free space
            that a change would have been found.
        points: where it has changed, frame of the old map, shape (K, 3) [m].
        sigmas: of them along the normal, that of the registration included, shape (K,) [m].
        areas: of the surface in each voxel, shape (K,) [m^2].
        probabilities: that the state has changed, shape (K,).
    """

    surface_voxels: int
    compared: int
    points: FloatArray
    sigmas: FloatArray
    areas: FloatArray
    probabilities: FloatArray


@dataclass(frozen=True, eq=False)
class MapChanges:
    """What is another one in the new map than in the old one.

    Attributes:
        appeared: surface of the new map where the old one has free space.
        vanished: surface of the old map where the new one has free space.
        objects: those that appeared and those that vanished, the largest first.
        scattered: changed voxels that are of none, as fewer than four hang together.
    """

    appeared: ChangedSurface
    vanished: ChangedSurface
    objects: tuple[ChangedObject, ...]
    scattered: int


def changes_between(
    old: NamedMap, new: NamedMap, registration: Registration | None = None
) -> MapChanges:
    """Compare two maps of one place; they stay as they are.

    Args:
        old: the earlier map.
        new: the later one, also one that went on from `old`.
        registration: where `new` lies in `old`, if they have no frame in common.

    Raises:
        InvalidInputError: voxels differ in size, or without a registration origins do; or both
            maps hold a session, and `new` not all of those of `old`. Names the maps.
    """
    goes_on = sessions_of(old.map) < sessions_of(new.map)
    if goes_on and registration is None:
        check_pair(old, new, may_share_sessions=True)
    else:
        check_pair(old, new, has_common_frame=registration is not None)
    if registration is None:
        T, offset = np.eye(4), np.zeros((6, 6))
        if not (goes_on or share_offset([old.map, new.map])):
            offset = old.map.offset + new.map.offset
    else:
        T = registration.T_first_second
        offset = old.map.offset + moved_offset(new.map.offset, T)
        offset += carry_covariance(registration.covariance, -T[:3, 3])
    before = _Witness(old.map, np.eye(4))
    after = _Witness(new.map, T, old.map if goes_on else None)
    appeared = _changed(after, before, offset)
    vanished = _changed(before, after, offset)
    size = old.map.config.voxel_size
    objects, scattered = [], 0
    for what, surface in ((APPEARED, appeared), (VANISHED, vanished)):
        found, rest = _objects(what, surface, size)
        objects += found
        scattered += rest
    objects.sort(key=lambda each: -each.voxels)
    return MapChanges(appeared, vanished, tuple(objects), scattered)


class _Witness:
    """What one of the maps says, in the frame of the old one."""

    def __init__(
        self, voxel_map: VoxelMap, T_old_map: FloatArray, before: VoxelMap | None = None
    ) -> None:
        """`before` is the map that `voxel_map` went on from, whose evidence is not its own."""
        self._map, self._before = voxel_map, before
        self._T_map_old = invert_transform(T_old_map)
        self.size = voxel_map.config.voxel_size
        indices, means, covariances = voxel_map.gaussians(relative=True)
        hits = self._own((indices + 0.5) * self.size) > 0.0
        indices, means, covariances = indices[hits], means[hits], covariances[hits]
        alone = self._without_point(indices)
        means = np.concatenate([means, alone])
        anywhere = np.broadcast_to(self.size**2 / 12.0 * np.eye(3), (len(alone), 3, 3))
        covariances = np.concatenate([covariances, anywhere])
        centers = np.concatenate([(indices + 0.5) * self.size, alone])
        turn = T_old_map[:3, :3]
        self.log_odds = self._own(centers)
        self.points = transform_points(T_old_map, means)
        self.covariances = turn @ covariances @ turn.T
        values, axes = np.linalg.eigh(self.covariances)
        self.normals, self.variances = axes[:, :, 0], np.maximum(values[:, 0], 0.0)
        across = np.eye(3) - self.normals[:, :, None] * self.normals[:, None, :]
        self.patches = self.covariances + self.size**2 * across

    def _own(self, points: ArrayLike) -> FloatArray:
        """Evidence at points of the map's own frame, shape (N, 3) [m] -> (N,) [nats]."""
        evidence = self._map.log_odds(points)
        return evidence if self._before is None else evidence - self._before.log_odds(points)

    def _without_point(self, indices: NDArray[np.int32]) -> FloatArray:
        """Centers of occupied voxels that have no surface point, nor have those around [m].

        In a map that went on, free space of old outweighs what is new for some time.
        """
        known = self._map.voxels()[0]
        occupied = known[self._own((known + 0.5) * self.size) > 0.0].astype(np.int64)
        steps = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3), axis=-1).reshape(-1, 3)
        near = np.unique(pack_all((indices[:, None].astype(np.int64) + steps).reshape(-1, 3)))
        return np.asarray((occupied[~np.isin(pack_all(occupied), near)] + 0.5) * self.size)

    def probability(self, points: FloatArray) -> FloatArray:
        """Of occupancy, at points of the old frame, shape (N, 3) [m] -> (N,)."""
        return np.asarray(expit(self._own(transform_points(self._T_map_old, points))))

    def of_points(self, points: FloatArray, covariances: FloatArray) -> FloatArray:
        """The first q: of voxels in which points may lie, given their covariances (N, 3, 3)."""
        values, axes = np.linalg.eigh(covariances)
        steps = np.sqrt(np.maximum(values, 0.0))[:, None, :] * axes
        q = self.probability(points)
        for sigmas in _SIGMAS:
            for axis in range(3):
                for step in (sigmas * steps[:, :, axis], -sigmas * steps[:, :, axis]):
                    likelihood = np.exp(-0.5 * sigmas**2)
                    q = np.maximum(q, likelihood * self.probability(points + step))
        return q

    def of_patches(
        self, points: FloatArray, patches: FloatArray, registration: FloatArray
    ) -> FloatArray:
        """The second q: of surface points near; covariances of shape (N, 3, 3)."""
        q = np.zeros(len(points))
        if not len(points) or not len(self.points):
            return q
        reach = _NEAR * self.size
        reach = reach + _SIGMAS[-1] * np.sqrt(np.linalg.eigvalsh(registration)[:, -1].clip(0.0))
        tree = cKDTree(self.points)
        most = min(_NEIGHBORS, len(self.points))
        apart, found = tree.query(points, np.arange(1, most + 1), p=np.inf)
        own = expit(np.maximum(self.log_odds, 0.0))
        for column in range(most):
            near = np.flatnonzero(apart[:, column] <= reach)
            other = found[near, column]
            offset = self.points[other] - points[near]
            total = patches[near] + self.patches[other] + registration[near]
            square = np.einsum(
                "ni,ni->n", offset, np.linalg.solve(total, offset[..., None])[..., 0]
            )
            q[near] = np.maximum(q[near], own[other] * np.exp(-0.5 * square))
        return q


def _changed(of: _Witness, by: _Witness, offset: FloatArray) -> ChangedSurface:
    """The surface of one map that the other one contradicts."""
    registration = point_covariances(offset, of.points)
    along = of.normals[:, :, None] * of.normals[:, None, :]
    covariances = registration + of.variances[:, None, None] * along
    q = by.of_points(of.points, covariances)
    matched = by.probability(of.points) > 0.5
    rest = np.flatnonzero(~matched)
    beside = by.of_patches(of.points[rest], of.patches[rest], registration[rest])
    matched[rest] = beside > _MOST_FREE
    q[rest] = np.maximum(q[rest], beside)
    probabilities = _probability(q, of.log_odds)
    changed = probabilities >= CHANGED
    compared = int(np.count_nonzero(matched | (q <= _MOST_FREE)))
    normals = of.normals[changed]
    sigmas = np.sqrt(np.einsum("ni,nij,nj->n", normals, covariances[changed], normals))
    # A plane of area A meets about A (|n_x| + |n_y| + |n_z|) / size^2 voxels.
    areas = of.size**2 / np.abs(normals).sum(axis=1)
    found = of.points[changed], sigmas, areas, probabilities[changed]
    return ChangedSurface(len(of.points), compared, *found)


def _probability(q: FloatArray, log_odds: FloatArray) -> FloatArray:
    """That a voxel is occupied in the map with these odds, (N,) [nats], and not in that with q."""
    b = np.exp(np.clip(log_odds, -_MOST_LOG_ODDS, _MOST_LOG_ODDS))
    a = q / np.maximum(1.0 - q, np.exp(-_MOST_LOG_ODDS))
    return np.asarray(_PRIOR * b / ((1.0 - _PRIOR) * (1.0 + a * b) + _PRIOR * (a + b)))


def _most_free() -> float:
    """The q at which a surely occupied voxel has just changed."""
    odds = _PRIOR / (1.0 - _PRIOR) * (1.0 - CHANGED) / CHANGED
    return odds / (1.0 + odds)


_MOST_FREE = _most_free()


def _objects(what: str, surface: ChangedSurface, size: float) -> tuple[list[ChangedObject], int]:
    """Objects, and how many voxels are of none."""
    voxels = np.floor(surface.points / size)
    if not len(voxels):
        return [], 0
    pairs = cKDTree(voxels).query_pairs(_TOGETHER + 0.5, p=np.inf, output_type="ndarray")
    links = coo_array((np.ones(len(pairs)), pairs.T), (len(voxels), len(voxels)))
    _, cluster = connected_components(links, directed=False)
    objects, scattered = [], 0
    for number in np.unique(cluster):
        of = cluster == number
        distinct = np.unique(voxels[of], axis=0)
        if len(distinct) < _LEAST_VOXELS:
            scattered += len(distinct)
            continue
        box = size * np.stack([distinct.min(axis=0), distinct.max(axis=0) + 1.0])
        area, probability = surface.areas[of].sum(), surface.probabilities[of].mean()
        objects.append(ChangedObject(what, box, len(distinct), float(area), float(probability)))
    return objects, scattered
