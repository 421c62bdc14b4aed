"""Where a model may be in a scene, by the votes of point pairs, without any first guess.

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

from infomap_ros.geometry.transforms import FloatArray

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
