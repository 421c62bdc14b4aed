"""Information metrics of others, for comparison.

Isler et al. (2016, doi:10.1109/ICRA.2016.7487527) and Delmerico et al. (2018,
doi:10.1007/s10514-017-9634-0) sum the information of the voxels that rays cross up to the first
surface, ray by ray: a voxel that many rays cross counts as often. Average entropy is Kriegel et al.
(2015, doi:10.1007/s11554-013-0386-6), the area factor Vasquez-Gomez et al. (2014,
doi:10.5772/58759), both as Delmerico et al. compare them.

Sums are over the sensor's own pixels, one ``pixel_angle`` squared each, whatever number of rays is
cast for them. An unknown voxel has p = 1/2 and hides accordingly. Voxels outside the region hide
what is behind them but do not count. The noise of the sensor does not matter to any of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import distance_transform_cdt

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import OCCUPIED, VoxelMap
from infomap_ros.mapping.voxels.keys import BLOCK_SIDE, begin_walk, exit_distance, next_voxel
from infomap_ros.views.information.field import VisibleField, code_at, workers_of
from infomap_ros.views.information.gains import entropy_of
from infomap_ros.views.information.ray_kernels import turned
from infomap_ros.views.information.view_information import METRICS, Metric
from infomap_ros.views.information.view_query import FINEST, ViewQuery

IntArray = NDArray[np.int64]

_WANTED_OCCUPIED, _WANTED_OCCPLANE = 0.2, 0.8
PROXIMITY_STEPS = 10
"""Steps from a surface within which unknown voxels count for `proximity_count` [voxels]."""


def occlusion_aware(query: ViewQuery) -> FloatArray:
    """Sum of the entropies of all voxels times the probability to see them, shape (M,) [bits]."""
    return _sums(query)[:, OCCLUSION_AWARE]


def unobserved_voxels(query: ViewQuery) -> FloatArray:
    """As `occlusion_aware`, of unknown voxels only, shape (M,) [bits]."""
    return _sums(query)[:, UNOBSERVED]


def rear_side_voxel(query: ViewQuery) -> FloatArray:
    """Pixels whose ray meets a surface from its unknown rear side, shape (M,) [1]."""
    return _sums(query)[:, REAR_SIDE]


def rear_side_entropy(query: ViewQuery) -> FloatArray:
    """As `occlusion_aware`, of surfaces met from behind and of the unknown voxels before them.

    Shape (M,) [bits]; of the unknown voxels those in a row right before the surface.
    """
    return _sums(query)[:, REAR_SIDE_ENTROPY]


def proximity_count(query: ViewQuery) -> FloatArray:
    """Sum over unknown voxels of how much nearer than `PROXIMITY_STEPS` a surface is, shape (M,).

    In steps from voxel to voxel [voxels]. Isler et al. count voxels behind surfaces, by the
    distance behind; here any unknown voxel near a surface, which does not need a record of the
    scans.
    """
    return _sums(query, near_surfaces=True)[:, PROXIMITY]


def average_entropy(query: ViewQuery) -> FloatArray:
    """Mean entropy of the voxels on rays that end at a surface, shape (M,) [bits per voxel]."""
    sums = _sums(query)
    count = sums[:, SURFACE_RAY_VOXELS]
    return np.asarray(sums[:, SURFACE_RAY_ENTROPY] / np.where(count > 0.0, count, 1.0))


def area_factor(query: ViewQuery) -> FloatArray:
    """How near the image comes to one fifth known surface and four fifths occlusion, shape (M,).

    In [0, 2], without unit: f(share of rays that meet a surface first) + f(share that leave free
    space into unknown first), f being 1 at the wanted share and 0 at 0 and 1.
    """
    sums = _sums(query)
    rays = sums[:, RAYS]
    occupied = sums[:, FIRST_SURFACE] / np.where(rays > 0.0, rays, 1.0)
    occplane = sums[:, FIRST_UNKNOWN] / np.where(rays > 0.0, rays, 1.0)
    return near_share(occupied, _WANTED_OCCUPIED) + near_share(occplane, _WANTED_OCCPLANE)


EVERY_METRIC: Mapping[str, Metric] = METRICS | {
    metric.__name__: metric
    for metric in (
        occlusion_aware,
        unobserved_voxels,
        rear_side_voxel,
        rear_side_entropy,
        proximity_count,
        average_entropy,
        area_factor,
    )
}
"""Those that views can be chosen by, and those of others, by name."""


def near_share(share: ArrayLike, wanted: float) -> FloatArray:
    """Cubics with f(0) = f(1) = 0 and a flat top f(wanted) = 1 (Vasquez-Gomez et al. 2014)."""
    x = np.asarray(share, dtype=np.float64)
    t = np.where(x <= wanted, x / wanted, (1.0 - x) / (1.0 - wanted))
    return np.asarray(t * t * (3.0 - 2.0 * t))


def _sums(query: ViewQuery, near_surfaces: bool = False) -> FloatArray:
    """Sums over the pixels of each view, shape (M, COLUMNS)."""
    sums = np.zeros((len(query.poses), COLUMNS))
    if len(query.poses) == 0:
        return sums
    m, config, field = query.voxel_map, query.config, query.finest_field()
    placed = query.placed_in(field)
    p, known = FINEST.probabilities(), FINEST.known()
    nearness, first_near = np.zeros((0, 0, 0), np.float32), np.zeros(3, np.int64)
    if near_surfaces:
        nearness, first_near = _nearness(m, field, PROXIMITY_STEPS)

    def cast(_: int, first: int, last: int) -> None:
        add_crossings(
            placed.poses[first:last], placed.rays, placed.angles / config.pixel_angle**2,
            placed.box, query.max_range / m.config.voxel_size, field.directory, field.codes, p,
            entropy_of(p), known, nearness, first_near, sums[first:last],
        )  # fmt: skip

    workers_of(query.threads).run(cast, len(sums))
    return sums


def _nearness(m: VoxelMap, field: VisibleField, reach: int) -> tuple[NDArray[np.float32], IntArray]:
    """`reach` less the steps to the nearest surface, at least 0, by voxel.

    Returns:
        An array that holds the field and all voxels within reach of it, float32; and the index of
        its first voxel relative to the field, shape (3,).
    """
    size = field.voxel_size
    low = (field.first * BLOCK_SIDE - 2 * reach + 0.5) * size
    shape = np.array(field.directory.shape) * BLOCK_SIDE + 4 * reach
    surface = m.window(low, low + (shape - 1) * size).states() == OCCUPIED
    first = np.full(3, -2 * reach)
    if not surface.any():
        return np.zeros((0, 0, 0), np.float32), first
    steps = distance_transform_cdt(~surface, "taxicab")
    return np.maximum(reach - steps, 0).astype(np.float32), first


OCCLUSION_AWARE, UNOBSERVED, REAR_SIDE, REAR_SIDE_ENTROPY, PROXIMITY = range(5)
SURFACE_RAY_ENTROPY, SURFACE_RAY_VOXELS, FIRST_SURFACE, FIRST_UNKNOWN, RAYS = range(5, 10)
COLUMNS = 10
"""Columns of what `add_crossings` adds up, and their number."""


@njit(cache=True, nogil=True)
def walk(
    origin: Any,
    direction: Any,
    reach: float,
    directory: Any,
    codes: Any,
    ends: Any,
    path: Any,
    voxels: Any,
) -> int:
    """Follow a ray through the grid to the first voxel that ends it.

    Args:
        origin: relative to the directory, tuple [voxels].
        direction: unit vector, tuple.
        reach: of the ray [voxels].
        directory: of a `VisibleField`.
        codes: of it.
        ends: whether a ray ends in a voxel, by code.
        path: receives the codes of the voxels.
        voxels: receives their indices relative to the directory, shape (n, 3).

    Returns:
        Number of voxels, the one that ends the ray included.
    """
    x, y, z = origin
    voxel, crossings, steps, deltas = begin_walk(x, y, z, direction[0], direction[1], direction[2])
    count, entered = 0, 0.0
    while entered < reach and count < len(path):
        i, j, k = voxel
        path[count] = code_at(directory, codes, i, j, k)
        voxels[count, 0], voxels[count, 1], voxels[count, 2] = i, j, k
        count += 1
        if ends[path[count - 1]]:
            break
        entered = exit_distance(crossings)
        voxel, crossings = next_voxel(voxel, crossings, steps, deltas)
    return count


@njit(cache=True, nogil=True)
def add_crossings(
    poses: Any,
    rays: Any,
    weights: Any,
    box: Any,
    reach: float,
    directory: Any,
    codes: Any,
    probabilities: Any,
    entropies: Any,
    known: Any,
    nearness: Any,
    first_near: Any,
    sums: Any,
) -> None:
    """Add up, for each pose, what its rays cross.

    Args:
        poses: T_map_camera, positions relative to the directory [voxels], shape (M, 4, 4).
        rays: unit directions in the camera frame, shape (N, 3).
        weights: of the rays, shape (N,).
        box: the region that counts, (low, high) corners relative to the directory [voxels].
        reach: of the rays [voxels].
        directory: of a `VisibleField`.
        codes: of it.
        probabilities: of occupancy by code.
        entropies: by code [bits].
        known: whether codes are of known voxels.
        nearness: of voxels to a surface.
        first_near: index of ``nearness[0, 0, 0]`` relative to the directory, shape (3,).
        sums: receives the sums, shape (M, COLUMNS).
    """
    longest = int(2.0 * reach) + 8  # a ray crosses at most sqrt(3) voxels per voxel of length
    path, voxels = np.empty(longest, np.uint8), np.empty((longest, 3), np.int64)
    inside = np.empty(longest, np.bool_)
    ends = known & (probabilities > 0.5)
    for view in range(len(poses)):
        origin = (poses[view, 0, 3], poses[view, 1, 3], poses[view, 2, 3])
        for ray in range(len(rays)):
            count = walk(
                origin, turned(poses[view], rays[ray]), reach, directory, codes, ends, path, voxels
            )
            for n in range(count):
                inside[n] = True
                for axis in range(3):
                    c = voxels[n, axis] + 0.5
                    inside[n] &= box[0, axis] <= c <= box[1, axis]
            out, weight = sums[view], weights[ray]
            _add_entropies(path[:count], inside, probabilities, entropies, known, ends, weight, out)
            _add_rear_side(path[:count], inside, probabilities, entropies, known, ends, weight, out)
            _add_first(path[:count], inside, known, ends, weight, out)
            out[PROXIMITY] += weight * _near(
                voxels[:count], path, inside, known, nearness, first_near
            )


@njit(cache=True, nogil=True)
def _add_entropies(
    path: Any, inside: Any, p: Any, entropies: Any, known: Any, ends: Any, weight: float, out: Any
) -> None:
    """Entropies of all voxels: as far as they are seen, and on average."""
    visible, total, count = 1.0, 0.0, 0
    for n in range(len(path)):
        code = path[n]
        if inside[n]:
            out[OCCLUSION_AWARE] += weight * visible * entropies[code]
            out[UNOBSERVED] += 0.0 if known[code] else weight * visible * entropies[code]
            total += entropies[code]
            count += 1
        visible *= 1.0 - p[code]
    if ends[path[-1]]:
        out[SURFACE_RAY_ENTROPY] += weight * total
        out[SURFACE_RAY_VOXELS] += weight * count


@njit(cache=True, nogil=True)
def _add_rear_side(
    path: Any, inside: Any, p: Any, entropies: Any, known: Any, ends: Any, weight: float, out: Any
) -> None:
    """Surfaces met from unknown space."""
    last = len(path) - 1
    if last < 1 or not ends[path[last]] or known[path[last - 1]] or not inside[last]:
        return
    visible, run = 1.0, 0.0
    for n in range(last):
        code = path[n]
        run = 0.0 if known[code] else run + (visible * entropies[code] if inside[n] else 0.0)
        visible *= 1.0 - p[code]
    out[REAR_SIDE] += weight
    out[REAR_SIDE_ENTROPY] += weight * (run + visible * entropies[path[last]])


@njit(cache=True, nogil=True)
def _add_first(path: Any, inside: Any, known: Any, ends: Any, weight: float, out: Any) -> None:
    """What a ray meets first: a surface, or the unknown behind free space."""
    out[RAYS] += weight
    n = 0
    while n < len(path) and not known[path[n]]:  # around the camera nothing may be known yet
        n += 1
    while n < len(path):
        code = path[n]
        if not known[code] or ends[code]:
            if inside[n]:
                out[FIRST_SURFACE if known[code] else FIRST_UNKNOWN] += weight
            return
        n += 1


@njit(cache=True, nogil=True)
def _near(voxels: Any, path: Any, inside: Any, known: Any, nearness: Any, first: Any) -> float:
    """Sum of the nearness of the unknown voxels of a ray."""
    nx, ny, nz = nearness.shape
    total = 0.0
    for n in range(len(voxels)):
        i, j, k = voxels[n, 0] - first[0], voxels[n, 1] - first[1], voxels[n, 2] - first[2]
        if 0 <= i < nx and 0 <= j < ny and 0 <= k < nz and inside[n] and not known[path[n]]:
            total += nearness[i, j, k]
    return total
