"""Poses of a model that a scene allows: votes, clusters, registration, check.

Where a model may be in a scene, by the votes of point pairs, without any first guess.

Two points with normals have four numbers that do not depend on the pose: their distance and three
angles. Pairs of the scene look up pairs of the model with the same numbers and vote for the pose
that takes one to the other (Drost, Ulrich, Navab, Ilic, CVPR 2010,
doi:10.1109/CVPR.2010.5540108).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import make_transform, transform_points
from infomap_ros.geometry.transforms import FloatArray, perturb_transform
from infomap_ros.localization.target.model_check import (
    Agreement,
    check_pose,
    flat_share,
    visible_points,
)
from infomap_ros.localization.target.model_scene import ModelScene, ModelShape, on_large_planes

_ANGLES = 15  # bins over 180 degrees
_TURNS = 30  # bins over 360 degrees
_DISTANCES = 20  # bins over the diameter
_MOST_ALIKE = 200  # entries of one bin that vote for one pair


class PairTable(NamedTuple):
    """Pairs of the model by their four numbers.

    Attributes:
        points: shape (N, 3) [m].
        normals: shape (N, 3).
        diameter: largest distance of a pair [m].
        starts: of each bin's entries, shape (bins + 1,).
        references: first point of each entry, shape (E,).
        turns: turn of the second point about the normal of the first, shape (E,) [rad].
    """

    points: FloatArray
    normals: FloatArray
    diameter: float
    starts: NDArray[np.int64]
    references: NDArray[np.int32]
    turns: NDArray[np.float32]


def build_table(points: FloatArray, normals: FloatArray, diameter: float) -> PairTable:
    """Sort all pairs of a model; points and normals of shape (N, 3), diameter [m]."""
    keys, turns = _model_pairs(points, normals, diameter)
    valid = np.flatnonzero(keys >= 0)
    order = valid[np.argsort(keys[valid], kind="stable")]
    bins = (_DISTANCES + 1) * (_ANGLES + 1) ** 3
    starts = np.searchsorted(keys[order], np.arange(bins + 1))
    references = (order // len(points)).astype(np.int32)
    return PairTable(points, normals, diameter, starts, references, turns[order])


class Votes(NamedTuple):
    """One pose per reference point of the scene.

    Attributes:
        transforms: ``T_scene_model``, shape (R, 4, 4).
        votes: shape (R,).
    """

    transforms: FloatArray
    votes: NDArray[np.int64]


def vote(
    table: PairTable, points: FloatArray, normals: FloatArray, references: NDArray[np.int64]
) -> Votes:
    """Let the pairs of a scene vote.

    Args:
        table: of the model.
        points: of the scene, shape (S, 3) [m].
        normals: of the scene, shape (S, 3).
        references: indices of the points from which pairs are formed, shape (R,).

    Returns:
        The best pose for each reference point.
    """
    best, turn, votes = _vote(
        points,
        normals,
        references,
        table.diameter,
        len(table.points),
        table.starts,
        table.references,
        table.turns,
    )
    transforms = np.empty((len(references), 4, 4))
    for i, reference in enumerate(references):
        to_scene = _to_axis(points[reference], normals[reference])
        to_model = _to_axis(table.points[best[i]], table.normals[best[i]])
        transforms[i] = np.linalg.inv(to_scene) @ _about_x(turn[i]) @ to_model
    return Votes(transforms, votes)


def _about_x(angle: float) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1.0]])


def _to_axis(point: FloatArray, normal: FloatArray) -> FloatArray:
    """Takes the point to the origin and the normal to the x axis, shape (4, 4)."""
    rows = np.zeros((3, 3))
    _axes(normal[0], normal[1], normal[2], rows)
    matrix = np.eye(4)
    matrix[:3, :3] = rows
    matrix[:3, 3] = -rows @ point
    return matrix


@njit(cache=True, nogil=True)
def _axes(nx, ny, nz, rows):  # type: ignore[no-untyped-def]
    """A rotation whose first row is the normal; always the same for the same normal."""
    if abs(nx) < 0.6:
        ax, ay, az = 0.0, nz, -ny  # x axis cross normal, reversed
    else:
        ax, ay, az = -nz, 0.0, nx  # y axis cross normal, reversed
    length = np.sqrt(ax * ax + ay * ay + az * az)
    ax, ay, az = ax / length, ay / length, az / length
    rows[0, 0], rows[0, 1], rows[0, 2] = nx, ny, nz
    rows[1, 0], rows[1, 1], rows[1, 2] = ax, ay, az
    rows[2, 0] = ny * az - nz * ay
    rows[2, 1] = nz * ax - nx * az
    rows[2, 2] = nx * ay - ny * ax


@njit(cache=True, nogil=True)
def _pair(points, normals, r, i, diameter, rows):  # type: ignore[no-untyped-def]
    """Bin of a pair and the turn of its second point about the first's normal; -1 if too far."""
    dx = points[i, 0] - points[r, 0]
    dy = points[i, 1] - points[r, 1]
    dz = points[i, 2] - points[r, 2]
    distance = np.sqrt(dx * dx + dy * dy + dz * dz)
    if distance > diameter or distance < 0.05 * diameter:
        return -1, 0.0
    first = (dx * normals[r, 0] + dy * normals[r, 1] + dz * normals[r, 2]) / distance
    second = (dx * normals[i, 0] + dy * normals[i, 1] + dz * normals[i, 2]) / distance
    between = (
        normals[r, 0] * normals[i, 0]
        + normals[r, 1] * normals[i, 1]
        + normals[r, 2] * normals[i, 2]
    )
    key = int(distance / diameter * _DISTANCES)
    for cosine in (first, second, between):
        angle = np.arccos(min(max(cosine, -1.0), 1.0))
        key = key * (_ANGLES + 1) + int(angle / np.pi * _ANGLES)
    y = rows[1, 0] * dx + rows[1, 1] * dy + rows[1, 2] * dz
    z = rows[2, 0] * dx + rows[2, 1] * dy + rows[2, 2] * dz
    return key, np.arctan2(z, y)


@njit(cache=True, nogil=True)
def _model_pairs(points, normals, diameter):  # type: ignore[no-untyped-def]
    count = len(points)
    keys = np.full(count * count, -1, np.int64)
    turns = np.zeros(count * count, np.float32)
    rows = np.empty((3, 3))
    for r in range(count):
        _axes(normals[r, 0], normals[r, 1], normals[r, 2], rows)
        for i in range(count):
            if i != r:
                key, turn = _pair(points, normals, r, i, diameter, rows)
                keys[r * count + i] = key
                turns[r * count + i] = turn
    return keys, turns


@njit(cache=True, nogil=True)
def _vote(  # type: ignore[no-untyped-def]
    points, normals, references, diameter, model_count, starts, model_references, model_turns
):
    count = len(references)
    best = np.zeros(count, np.int64)
    turn = np.zeros(count)
    votes = np.zeros(count, np.int64)
    table = np.zeros((model_count, _TURNS), np.int32)
    rows = np.empty((3, 3))
    for k in range(count):
        r = references[k]
        table[:] = 0
        _axes(normals[r, 0], normals[r, 1], normals[r, 2], rows)
        for i in range(len(points)):
            if i == r:
                continue
            key, scene_turn = _pair(points, normals, r, i, diameter, rows)
            if key < 0:
                continue
            # Of a bin with very many alike pairs, as of planes, some are enough.
            step = 1 + (starts[key + 1] - starts[key]) // _MOST_ALIKE
            for entry in range(starts[key] + (i + k) % step, starts[key + 1], step):
                angle = (scene_turn - model_turns[entry]) / (2.0 * np.pi)
                angle -= np.floor(angle)
                table[model_references[entry], int(angle * _TURNS) % _TURNS] += 1
        best[k], turn[k], votes[k] = _peak(table)
    return best, turn, votes


@njit(cache=True, nogil=True)
def _peak(table):  # type: ignore[no-untyped-def]
    """Row, turn [rad] and height of the highest pair of neighboring bins."""
    row, column, height, weight = 0, 0, -1, 0.5
    for m in range(table.shape[0]):
        for a in range(_TURNS):
            following = table[m, (a + 1) % _TURNS]
            both = table[m, a] + following
            if both > height:
                row, column, height = m, a, both
                weight = following / both if both > 0 else 0.5
    return row, (column + 0.5 + weight) * 2.0 * np.pi / _TURNS, height


_PAIR_SPACING = 0.05  # of the points that vote, as a share of the diameter
_CHECK_SPACING = 0.02
_REFERENCES = 2000  # points of the scene that vote
_LARGE = 1.3  # planes that reach farther, in diameters, are not of the model
_CLUSTERS = 30  # that are registered
_NEAR = 0.1  # clusters: poses nearer than this share of the diameter
_TURNED = np.cos(np.radians(20.0))
_OTHER_TURNS = 100  # poses about the found place that are tried beside it


class Hypothesis(NamedTuple):
    """A pose that was registered.

    Attributes:
        transform: ``T_camera_model``, shape (4, 4).
        agreement: with the range image.
    """

    transform: FloatArray
    agreement: Agreement


class ModelSearch:
    """Searches one model.

    Args:
        shape: of the model.
        tolerance: difference of depth that counts as agreement, beside 3 sigma [m].
    """

    def __init__(self, shape: ModelShape, tolerance: float) -> None:
        self.shape, self.tolerance = shape, tolerance
        diameter = shape.diameter
        self._spacing = _CHECK_SPACING * diameter
        self._checked = shape.thinned(self._spacing)
        self._coarse = shape.thinned(2.0 * self._spacing)
        pairs = shape.thinned(_PAIR_SPACING * diameter)
        self._table: PairTable = build_table(pairs.points, pairs.normals, diameter)
        self._turns = _other_turns(shape.points)

    def find(self, scene: ModelScene) -> list[Hypothesis]:
        """Poses that the scene's points vote for, the best first."""
        points, normals = scene.thinned(_PAIR_SPACING * self.shape.diameter)
        diameter = self.shape.diameter
        large = on_large_planes(points, normals, _LARGE * diameter, _CHECK_SPACING * diameter)
        rest = np.flatnonzero(~large)
        step = max(1, len(rest) // _REFERENCES)
        votes = vote(self._table, points, normals, rest[::step])
        starts = self._clusters(votes)
        found = [self.refine(start, scene) for start in starts]
        return sorted(found, key=lambda one: -one.agreement.score)

    def others(self, scene: ModelScene, found: FloatArray) -> list[Hypothesis]:
        """Poses with the model turned about its middle, registered: what else may be there."""
        middle = make_transform(np.eye(3), self.shape.center)
        back = make_transform(np.eye(3), -self.shape.center)
        turned = [found @ middle @ make_transform(turn, np.zeros(3)) @ back for turn in self._turns]
        return [self.refine(start, scene) for start in turned]

    def refine(self, start: FloatArray, scene: ModelScene) -> Hypothesis:
        """Register the visible part of the model to the scene, and check the result."""
        pose, diameter = start, self.shape.diameter
        for reach in (0.1, 0.04):
            seen = visible_points(self._coarse, pose, 2.0 * self._spacing)
            if len(seen) < 20:
                break
            pose = register(self._coarse.points[seen], scene, pose, reach * diameter)
        return Hypothesis(pose, self.check(pose, scene))

    def check(self, pose: FloatArray, scene: ModelScene) -> Agreement:
        """How a pose agrees with the range image."""
        return check_pose(self._checked, pose, scene.cloud, self._spacing, self.tolerance)

    def flat_share(self, pose: FloatArray) -> float:
        """Share of what the camera sees of the model that lies on one plane."""
        return flat_share(self._checked, pose, self._spacing, self.tolerance)

    def _clusters(self, votes: Votes) -> list[FloatArray]:
        """The poses with most votes, those of poses nearby included."""
        middles = transform_points_of(votes.transforms, self.shape.center)
        order = np.argsort(-votes.votes)
        free = np.ones(len(order), bool)
        clusters: list[tuple[float, FloatArray]] = []
        for index in order:
            if not free[index]:
                continue
            apart = np.linalg.norm(middles - middles[index], axis=1)
            rotation = votes.transforms[index, :3, :3]
            trace = np.einsum("nij,ij->n", votes.transforms[:, :3, :3], rotation)
            same = free & (apart < _NEAR * self.shape.diameter) & (0.5 * (trace - 1.0) > _TURNED)
            free &= ~same
            clusters.append((float(votes.votes[same].sum()), votes.transforms[index]))
        clusters.sort(key=lambda one: -one[0])
        return [pose for _, pose in clusters[:_CLUSTERS]]

    def difference(self, first: FloatArray, second: FloatArray) -> tuple[float, float]:
        """How far apart two poses put the model's middle [m], and the turn between them [rad]."""
        apart = transform_points(first, self.shape.center) - transform_points(
            second, self.shape.center
        )
        turn = Rotation.from_matrix(first[:3, :3].T @ second[:3, :3]).magnitude()
        return float(np.linalg.norm(apart)), float(turn)


def register(
    points: FloatArray, scene: ModelScene, start: FloatArray, reach: float, iterations: int = 8
) -> FloatArray:
    """Move points onto the planes of their nearest neighbors (iterative closest points).

    Chen and Medioni 1992, doi:10.1016/0262-8856(92)90066-C.

    Args:
        points: in the model's frame, shape (N, 3) [m].
        scene: where to.
        start: first ``T_camera_model``, shape (4, 4).
        reach: pairs farther apart do not count [m].
        iterations: at most.

    Returns:
        ``T_camera_model``, shape (4, 4); as it was where fewer than six pairs are left.
    """
    pose = start
    for _ in range(iterations):
        placed = transform_points(pose, points)
        distance, index = scene.tree.query(placed, distance_upper_bound=reach)
        near = distance < reach
        if near.sum() < 6:
            break
        normals = scene.normals[index[near]]
        residual = np.einsum("ni,ni->n", normals, placed[near] - scene.points[index[near]])
        arms = placed[near] - pose[:3, 3]
        rows = np.hstack([normals, np.cross(arms, normals)])
        information = rows.T @ rows
        information += 1e-9 * np.trace(information) * np.eye(6)
        step = -np.linalg.solve(information, rows.T @ residual)
        pose = perturb_transform(pose, step)
        if np.linalg.norm(step[:3]) < 1e-3 * reach and np.linalg.norm(step[3:]) < 1e-3:
            break
    return pose


def transform_points_of(transforms: FloatArray, point: FloatArray) -> FloatArray:
    """One point through many transforms, shape (N, 3)."""
    return np.asarray(transforms[:, :3, :3] @ point + transforms[:, :3, 3])


def _other_turns(points: FloatArray) -> FloatArray:
    """Turns under which a model may look alike, shape (R, 3, 3).

    Quarter and half turns about the axes of its frame and its principal axes, and others evenly.
    """
    quarters = Rotation.create_group("O").as_matrix()
    _, _, axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    axes[2] *= np.linalg.det(axes)
    own = axes.T @ quarters @ axes
    turns = np.concatenate([quarters, own, _even_rotations(_OTHER_TURNS)])
    return np.asarray(turns[np.linalg.norm(turns - np.eye(3), axis=(1, 2)) > 0.2])


def _even_rotations(count: int) -> FloatArray:
    """Rotations spread evenly: super-Fibonacci spirals (Alexa 2022), shape (count, 3, 3).

    doi:10.1109/CVPR52688.2022.00811.
    """
    s = np.arange(count) + 0.5
    inner, outer = np.sqrt(s / count), np.sqrt(1.0 - s / count)
    alpha = 2.0 * np.pi * s / np.sqrt(2.0)
    beta = 2.0 * np.pi * s / 1.533751168755204288118041
    quaternions = [inner * np.sin(alpha), inner * np.cos(alpha)]
    quaternions += [outer * np.sin(beta), outer * np.cos(beta)]
    return np.asarray(Rotation.from_quat(np.stack(quaternions, axis=1)).as_matrix())
