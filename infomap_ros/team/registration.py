"""How two maps lie to each other that have no frame in common, from their surfaces and free space.

Candidates come from correspondences of local shape (KISS-Matcher), are drawn to the nearest
minimum by generalized ICP (small_gicp), and judged by what the maps say of each other: surface
that lies on surface, and surface that lies where the other has seen free space. The best one is
refused where surfaces in common do not hold it in all six directions, and where another one, as
in the second of two equal rooms, explains nearly as much.

Its covariance counts what one scan sees as one error: that of point-to-plane distances by clusters
(Liang and Zeger 1986, doi:10.1093/biomet/73.1.13), and the sigma of the maps themselves, by which
whole clusters are displaced, which no distance between surfaces shows.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from infomap_ros.errors import InvalidInputError, MissingExtraError
from infomap_ros.geometry import invert_transform, make_transform, transform_points
from infomap_ros.geometry.transforms import FloatArray, perturb_transform
from infomap_ros.mapping import VoxelMap

_RESOLUTIONS = (2.0, 4.0, 6.0)  # of the shapes that are compared [voxels]
_ATTEMPTS = 24  # to find the place, the first with all of the surface, then with parts of it
_RIVAL_ATTEMPTS = 6  # to find another one
_PART = 0.4  # of the surface, at random
_REACHES = (6.0, 4.0, 2.0)  # within which surfaces are drawn to each other [voxels]
_STEPS, _STILL = 10, 1e-4  # at each of them at the most, and a step that is the last [m, rad]
_JUDGED = 8000  # surface voxels of each map, at the most
_NORMAL = 3.0  # by which each unit between normals sets surfaces apart [voxels]
_FREE = -3.0  # log odds of free space
_LEAST = 500  # surface voxels
_LEAST_MATCHED, _ENOUGH_MATCHED = 0.3, 0.5  # of the surface of both: to be possible, not to go on
_MOST_CONTRADICTED = 0.03  # of the voxels that are matched or contradicted
_LEAST_HELD = 0.01  # of matched voxels, in the weakest of six directions
_CONTRADICTION = 10.0  # matched voxels for which one counts that is contradicted
_RIVAL = 0.7  # of what speaks for the best place
_APART = 5.0, 0.1  # at the middle [voxels] or in turn [rad]: another place
_CLUSTER = 0.5  # edge of the cubes whose errors count as one [ranges of the sensor]
_NEIGHBORS = 20  # voxels that give a normal
_Index = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Registration:
    """Where a map lies in another one.

    Attributes:
        T_first_second: shape (4, 4).
        covariance: of it, in the first frame, shape (6, 6), convention of `geometry.transforms`.
        matched: surface voxels of both that lie on surface of the other one.
        contradicted: that lie where the other one has seen free space.
        rival: matched voxels of the best other place, 0 where there is none.
    """

    T_first_second: FloatArray
    covariance: FloatArray
    matched: int
    contradicted: int
    rival: int


def register_maps(first: VoxelMap, second: VoxelMap) -> Registration:
    """Find out how a map lies in another one; the same maps have the same answer.

    Raises:
        InvalidInputError: they have too little in common, or it can lie in several places.
        MissingExtraError: KISS-Matcher or small_gicp is not installed.
    """
    try:
        search = _Search(_Surface(first), _Surface(second))
    except ImportError as error:
        raise MissingExtraError("merge", "kiss-matcher or small-gicp") from error
    best = search.best(_ATTEMPTS)
    if best is None:
        raise InvalidInputError(
            "maps", "have too little surface in common to find one in the other"
        )
    rival = search.rival(best)
    if rival is not None and rival.score > _RIVAL * best.score:
        away, turn = search.between(best.T, rival.T)
        raise InvalidInputError(
            "maps",
            f"fit each other in two ways, by {best.matched} and {rival.matched} surface voxels, "
            f"{away:.1f} m and {np.degrees(turn):.0f} degrees apart",
        )
    other = 0 if rival is None else rival.matched
    return Registration(*search.refined(best.T), best.matched, best.contradicted, other)


class _Surface:
    """Surface voxels of a map with normals to the side that is free.

    By their side the front of a wall is distinguished from its back, onto which it could be drawn.
    """

    def __init__(self, voxel_map: VoxelMap) -> None:
        gicp = import_module("small_gicp")
        self.map, self.size = voxel_map, voxel_map.config.voxel_size
        _, self.points, self.covariances = voxel_map.gaussians()
        if len(self.points) < _LEAST:
            raise InvalidInputError("map", f"has {len(self.points)} surface voxels")
        cloud = gicp.PointCloud(self.points)
        gicp.estimate_normals(cloud, gicp.KdTree(cloud), _NEIGHBORS)
        self.normals = self._to_free_space(np.asarray(cloud.normals())[:, :3])
        thin = gicp.voxelgrid_sampling(self.points, _RESOLUTIONS[0] * self.size).points()
        self.thin = np.asarray(thin)[:, :3]
        self.cloud = gicp.PointCloud(self.thin)
        self.cloud_tree = gicp.KdTree(self.cloud)
        gicp.estimate_covariances(self.cloud, self.cloud_tree, _NEIGHBORS)
        self.tree = cKDTree(self.oriented(self.points, self.normals))
        rng = np.random.default_rng(0)
        self.sample = np.sort(rng.permutation(len(self.points))[:_JUDGED])

    def _to_free_space(self, normals: FloatArray) -> FloatArray:
        step = 2.0 * self.size * normals
        ahead, behind = (self.map.log_odds(self.points + offset) for offset in (step, -step))
        return np.where((ahead > behind)[:, None], -normals, normals)

    def oriented(self, points: FloatArray, normals: FloatArray) -> FloatArray:
        """Points among which those of other sides are far, shape (N, 6)."""
        return np.hstack([points, _NORMAL * self.size * normals])

    def moved(self, T: FloatArray, chosen: Any = slice(None)) -> FloatArray:
        """Some of them where the map is moved, `oriented`."""
        points = transform_points(T, self.points[chosen])
        return self.oriented(points, self.normals[chosen] @ T[:3, :3].T)

    def nearest(self, oriented: FloatArray, reach: float) -> tuple[_Index, _Index]:
        """Which of N points lie within a reach [voxels] of the surface, and on which of its."""
        distances, found = self.tree.query(oriented, distance_upper_bound=reach * self.size)
        near = np.flatnonzero(np.isfinite(distances))
        return near, found[near]


@dataclass(frozen=True, eq=False)
class _Place:
    """A place of the second map in the first one, judged."""

    T: FloatArray
    matched: int
    contradicted: int
    share: float
    held: float

    @property
    def score(self) -> float:
        return self.matched - _CONTRADICTION * self.contradicted

    @property
    def is_possible(self) -> bool:
        judged = self.matched + self.contradicted
        is_held = self.held >= _LEAST_HELD and self.share >= _LEAST_MATCHED
        return is_held and self.contradicted <= _MOST_CONTRADICTED * judged


class _Search:
    """Finds places of the second map in the first one."""

    def __init__(self, first: _Surface, second: _Surface) -> None:
        self._kiss, self._gicp = import_module("kiss_matcher"), import_module("small_gicp")
        self._first, self._second = first, second
        self._size = first.size
        self._middle = second.points.mean(axis=0)
        self._rng = np.random.default_rng(0)

    def between(self, T: FloatArray, other: FloatArray) -> tuple[float, float]:
        """By how much two places of the second map differ at its middle [m], and in turn [rad]."""
        away = np.linalg.norm((T - other)[:3] @ np.append(self._middle, 1.0))
        return float(away), Rotation.from_matrix(T[:3, :3].T @ other[:3, :3]).magnitude()

    def best(self, attempts: int) -> _Place | None:
        """The possible place with the most matches, or the first that has enough."""
        best = None
        for guess in self._guesses(self._first.thin, self._second.thin, attempts):
            place = self._place(guess)
            if place.is_possible and (best is None or place.score > best.score):
                best = place
                if place.share > _ENOUGH_MATCHED:
                    break
        return best

    def rival(self, best: _Place) -> _Place | None:
        """The best other place: of what `best` leaves over in either map, or turned."""
        first, second = self._first, self._second
        rest = first.thin[self._unmatched(second, first, best.T)]
        others = second.thin[self._unmatched(first, second, invert_transform(best.T))]
        guesses = [
            *self._guesses(rest, second.thin, _RIVAL_ATTEMPTS),
            *self._guesses(first.thin, others, _RIVAL_ATTEMPTS),
            *self._turned(best.T),
        ]
        places = [self._place(guess) for guess in guesses]
        apart = [self.between(place.T, best.T) for place in places]
        possible = [
            place
            for place, (away, turn) in zip(places, apart, strict=True)
            if place.is_possible and (away > _APART[0] * self._size or turn > _APART[1])
        ]
        return max(possible, key=lambda place: place.score, default=None)

    def _guesses(
        self, first: FloatArray, second: FloatArray, attempts: int
    ) -> Iterator[FloatArray]:
        """Transforms by corresponding shapes, half of them turned about the upright axis alone."""
        kinds = [(res, quatro) for res in _RESOLUTIONS for quatro in (True, False)]
        for attempt in range(attempts if min(len(first), len(second)) > _LEAST else 0):
            resolution, is_upright = kinds[attempt % len(kinds)]
            part = second if attempt < len(kinds) else self._part(second)
            config = self._kiss.KISSMatcherConfig(resolution * self._size, use_quatro=is_upright)
            matcher = self._kiss.KISSMatcher(config)
            found = matcher.estimate(list(part.astype(np.float32)), list(first.astype(np.float32)))
            yield make_transform(found.rotation, found.translation)

    def _part(self, points: FloatArray) -> FloatArray:
        """The part about one of the points, drawn by chance."""
        away = np.linalg.norm(points - points[self._rng.integers(len(points))], axis=1)
        return points[away <= np.quantile(away, _PART)]

    def _turned(self, T: FloatArray) -> Iterator[FloatArray]:
        """By quarters about the main directions of the normals, in which rooms often look alike."""
        normals = self._first.normals
        axes = np.linalg.eigh(normals.T @ normals)[1].T
        middle = transform_points(T, self._middle)
        for vector in (quarter * axis for axis in axes for quarter in (1, 2, 3)):
            turn = Rotation.from_rotvec(0.5 * np.pi * vector).as_matrix()
            yield make_transform(turn, middle - turn @ middle) @ T

    def _place(self, T: FloatArray) -> _Place:
        """The nearest place at which surfaces lie on each other."""
        clouds, tree = (self._first.cloud, self._second.cloud), self._first.cloud_tree
        reach = _REACHES[0] * self._size
        found = self._gicp.align(*clouds, tree, T, max_correspondence_distance=reach)
        return self._judged(self.refined(np.asarray(found.T_target_source), self._second.sample)[0])

    def _judged(self, T: FloatArray) -> _Place:
        """What the maps say of a place."""
        first, second = self._first, self._second
        forth = self._matches(first, second, T)
        back = self._matches(second, first, invert_transform(T))
        matched, contradicted = np.add(forth[:2], back[:2])
        points, normals = np.split(forth[2], 2, axis=1)
        held = 0.0
        if len(points) >= _LEAST:
            levers = points - points.mean(axis=0)
            levers /= np.sqrt(np.mean(levers**2) * 3.0)
            rows = np.hstack([normals, np.cross(levers, normals)])
            held = float(np.linalg.eigvalsh(rows.T @ rows)[0]) / len(points)
        share = matched / (len(first.points) + len(second.points))
        return _Place(T, round(matched), round(contradicted), share, held)

    @staticmethod
    def _matches(
        first: _Surface, second: _Surface, T: FloatArray
    ) -> tuple[float, float, FloatArray]:
        """How much of the second surface lies on the first, and in its free space; where."""
        moved = second.moved(T, second.sample)
        near, on = first.nearest(moved, _REACHES[-1])
        apart = np.delete(moved[:, :3], near, axis=0)
        in_free = np.count_nonzero(first.map.log_odds(apart) < _FREE)
        scale = len(second.points) / len(second.sample)
        where = np.hstack([moved[near, :3], first.normals[on]])
        return scale * len(near), scale * in_free, where

    @staticmethod
    def _unmatched(first: _Surface, second: _Surface, T: FloatArray) -> NDArray[np.bool_]:
        """Which surface of the second map has none of the first near; T_second_first."""
        tree = cKDTree(transform_points(T, first.thin))
        reach = _REACHES[0] * first.size
        return np.isinf(tree.query(second.thin, distance_upper_bound=reach)[0])

    def refined(self, T: FloatArray, chosen: Any = slice(None)) -> tuple[FloatArray, FloatArray]:
        """The place of least squares between points and planes, and its covariance."""
        first, second = self._first, self._second
        covariances, step = second.covariances[chosen], np.zeros(6)
        for number, reach in enumerate(np.repeat(_REACHES[1:], _STEPS)):
            if number % _STEPS and np.abs(step).max() < _STILL:
                continue
            moved = second.moved(T, chosen)
            near, on = first.nearest(moved, reach)
            if len(near) < _LEAST:
                return T, np.full((6, 6), np.inf)
            of, normals = moved[near, :3], first.normals[on]
            total = first.covariances[on] + T[:3, :3] @ covariances[near] @ T[:3, :3].T
            variances = np.einsum("ni,nij,nj->n", normals, total, normals)
            apart = np.einsum("ni,ni->n", normals, first.points[on] - of)
            weights = 1.0 / (variances + np.median(np.abs(apart)) ** 2)
            weights /= 1.0 + apart**2 * weights  # Cauchy's: what is no surface of both
            rows = np.hstack([normals, np.cross(of - T[:3, 3], normals)])
            inverse = np.linalg.inv(rows.T @ (weights[:, None] * rows))
            step = inverse @ (rows.T @ (weights * apart))
            T = perturb_transform(T, step)
        cells = np.floor(of / (_CLUSTER * first.map.config.max_range)).astype(np.int64)
        _, cluster = np.unique(cells, axis=0, return_inverse=True)
        count = int(cluster.max()) + 1
        sums, sides = np.zeros((count, 6)), np.zeros((count, 6, 3))
        np.add.at(sums, cluster, rows * (weights * apart)[:, None])
        np.add.at(sides, cluster, (weights[:, None] * rows)[:, :, None] * normals[:, None])
        errors = np.bincount(cluster, weights * variances) / np.bincount(cluster, weights)
        spread = sums.T @ sums * count / max(count - 6, 1)
        spread += np.einsum("k,kij,klj->il", errors, sides, sides)
        robust = inverse @ spread @ inverse
        return T, 0.5 * (robust + robust.T)
