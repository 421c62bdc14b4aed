"""The new information of a view as Sujan and Dubowsky (2005) print it, eqs. (5) to (9).

Kept for reproduction, doi:10.1177/0278364905051774. All three are entropies of the picture that the
map gives of the view, of the frequencies q_i = f_i / N of gray levels (eq. 6): f_i voxels in view
have level i, N is the largest number of voxels that field of view and depth of field can hold, and
known obstacles hide what is behind them. The unknown take the average of their neighbors'
probabilities (`mapping.prediction`).

They do not have the properties that the paper states of them: the entropy of a histogram is 0 when
all visible voxels have the same level, so that a wholly unknown view scores 0, and is largest where
1/e of N has one level. `expected_entropy_reduction` has these properties.

f_i is counted as the volume in view, as in `views.ray_kernels`, so that it does not depend on the
number of rays. Where the result does, it is by the levels: 1 bit of these metrics means something
else with another number of `GRAY_LEVELS`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.views.information.field import code_at, with_predictions, workers_of
from infomap_ros.views.information.gains import entropy_of, gain_table, shell_volumes
from infomap_ros.views.information.ray_kernels import region_steps, turned
from infomap_ros.views.information.view_query import FINEST, ViewQuery

GRAY_LEVELS = 32
"""Levels of probability that eqs. (7) to (9) tell apart."""


class SeenVolumes(NamedTuple):
    """What a view holds.

    Attributes:
        shares: share of N in view by distance and code, shape (steps, codes).
        distances: of the steps, in units of the range, shape (steps,).
        probabilities: of the codes, shape (codes,).
        known: which codes are of known voxels, shape (codes,).
    """

    shares: FloatArray
    distances: FloatArray
    probabilities: FloatArray
    known: NDArray[np.bool_]


def scene_entropy(query: ViewQuery) -> FloatArray:
    """Eq. (7): entropy of the gray levels of known plus that of unknown voxels, shape (M,) [bits].

    A gray level is one of `GRAY_LEVELS` equal parts of the range of p.
    """
    count = GRAY_LEVELS

    def rate(seen: SeenVolumes) -> float:
        levels = np.broadcast_to(seen.probabilities, seen.shares.shape)
        return _histogram_entropy(seen, levels, count, np.ones(count))

    return _rated(query, rate)


def stretched_scene_entropy(query: ViewQuery) -> FloatArray:
    """Eq. (7) with the gray levels of eq. (8), shape (M,) [bits].

    As printed, p' = 1 / (1 - p) 1/d for p < 1/2 and 1/p 1/d otherwise leaves [1, 2] unless d = 1,
    and p'' leaves [0, 1]. Here d is the distance in units of the range, so that p' is at least 1
    and nearer voxels are stretched more, and p'' is clipped to the half of [0, 1] that it is meant
    for: [0, 1/2] for p < 1/2, [1/2, 1] otherwise.
    """
    count = GRAY_LEVELS

    def rate(seen: SeenVolumes) -> float:
        levels = stretched(seen.probabilities, seen.distances[:, None])
        return _histogram_entropy(seen, levels, count, np.ones(count))

    return _rated(query, rate)


def weighted_scene_entropy(query: ViewQuery) -> FloatArray:
    """Eq. (9): as eq. (7), each level weighted by the entropy of its voxels, shape (M,) [bits].

    The weight is that of the middle of the level.
    """
    count = GRAY_LEVELS
    middles = (np.arange(count) + 0.5) / count

    def rate(seen: SeenVolumes) -> float:
        levels = np.broadcast_to(seen.probabilities, seen.shares.shape)
        return _histogram_entropy(seen, levels, count, entropy_of(middles))

    return _rated(query, rate)


def stretched(probability: ArrayLike, distance: ArrayLike) -> FloatArray:
    """Eq. (8), corrected as `stretched_scene_entropy` says; distance in units of the range."""
    p, d = np.asarray(probability, dtype=np.float64), np.asarray(distance, dtype=np.float64)
    certain = np.where(p < 0.5, 1.0 - p, p)
    excess = np.minimum((1.0 / (certain * d) - 1.0) / 2.0, 0.5)
    return np.asarray(np.where(p < 0.5, excess, 1.0 - excess))


def _histogram_entropy(
    seen: SeenVolumes, levels: FloatArray, count: int, weights: FloatArray
) -> float:
    """Weighted entropy of the histogram of gray levels, known and unknown apart [bits]."""
    bins = np.clip((levels * count).astype(np.int64), 0, count - 1)
    total = 0.0
    for codes in (seen.known, ~seen.known):
        q = np.bincount(bins[:, codes].ravel(), seen.shares[:, codes].ravel(), count)
        total -= float(weights @ (q * np.log2(np.where(q > 0.0, q, 1.0))))
    return max(total, 0.0)


def _rated(query: ViewQuery, rate: Callable[[SeenVolumes], float]) -> FloatArray:
    """Rate what each view holds."""
    values = np.zeros(len(query.poses))
    if len(query.poses) == 0:
        return values
    m = query.voxel_map
    field = with_predictions(query.finest_field(), m, FINEST)
    table = gain_table(m.config, query.max_range, query.config)
    edges = np.arange(len(table.gains) + 1) * table.step
    volumes = shell_volumes(edges.astype(np.float64), query.config.planar)
    middles = 0.5 * (edges[1:] + edges[:-1])
    volumes[middles * m.config.voxel_size < query.config.min_range] = 0.0
    placed = query.placed_in(field)
    p, known = FINEST.probabilities(), FINEST.known()

    def see(_: int, first: int, last: int) -> None:
        for view in range(first, last):
            seen = np.zeros((len(volumes), len(p)))
            _see(
                placed.poses[view], placed.rays, placed.angles, placed.box, field.directory,
                field.codes, known & (p > 0.5), volumes, table.step, seen,
            )  # fmt: skip
            whole = placed.angles.sum() * volumes.sum()
            values[view] = rate(SeenVolumes(seen / whole, middles / edges[-1], p, known))

    workers_of(query.threads).run(see, len(values))
    return values


@njit(cache=True, nogil=True)
def _see(
    pose: Any,
    rays: Any,
    angles: Any,
    box: Any,
    directory: Any,
    codes: Any,
    hides: Any,
    volumes: Any,
    step: float,
    seen: Any,
) -> None:
    """Add up the volume in view by step and code [voxels]; the first voxel that hides ends a ray.

    Args:
        pose: T_map_camera, position relative to the directory [voxels].
        rays: unit directions in the camera frame, shape (N, 3).
        angles: solid angle of each ray, shape (N,) [sr].
        box: the region that counts, (low, high) corners relative to the directory [voxels].
        directory: of a `VisibleField`.
        codes: of it.
        hides: by code, shape (codes,).
        volumes: volume of each step per steradian, shape (steps,) [voxels/sr].
        step: length of a step [voxels].
        seen: receives the volumes, shape (steps, codes).
    """
    ox, oy, oz = pose[0, 3], pose[1, 3], pose[2, 3]
    low, high = (box[0, 0], box[0, 1], box[0, 2]), (box[1, 0], box[1, 1], box[1, 2])
    for ray in range(len(rays)):
        dx, dy, dz = turned(pose, rays[ray])
        start, end = region_steps((ox, oy, oz), (dx, dy, dz), low, high, step, len(volumes))
        for n in range(end):
            r = (n + 0.5) * step
            x, y, z = np.floor(ox + dx * r), np.floor(oy + dy * r), np.floor(oz + dz * r)
            code = code_at(directory, codes, int(x), int(y), int(z))
            if n >= start:
                seen[n, code] += angles[ray] * volumes[n]
            if hides[code]:
                break
