"""Holes in the mapped surface: where it should go on, and is not in the map.

A surface voxel says where its surface lies and how it is turned. Continued in its tangent plane by
a voxel or two, the surface is expected there too, unless free space was seen in its place. A hole
that a far glance left in the floor behind a table has few unknown voxels, or none, as its voxels
may be occupied by what the noise of neighboring points put there: its volume calls for no view,
its surface does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from infomap_ros.geometry.symmetric import smallest_axes
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import FREE, OCCUPIED, OccupancyThresholds, VoxelMap, VoxelWindow

_REACH = 2  # [voxels] that a surface is continued
_VOICES = 2  # surface voxels that must agree on a hole
_BEFORE = (1.5, 2.5)  # [voxels] before a surface, where it must be free
_OUTWARD = (1.5, 2.5, 3.5)  # [voxels] where more was seen to be free than on its other side
_LAYERS = (0, -1, -2, 1)  # [voxels] along the normal in which no surface may be
_NEAR = 1.0 + 1e-6  # [voxels] to a surface voxel: not missing


@dataclass(frozen=True, eq=False)
class MissingSurface:
    """Voxels in which a surface is expected and none is mapped.

    Attributes:
        voxels: their indices in the map, shape (N, 3).
        places: where in them, shape (N, 3) [m, map].
        normals: of the expected surface, towards the free space, shape (N, 3).
    """

    voxels: NDArray[np.int64]
    places: FloatArray
    normals: FloatArray

    def __len__(self) -> int:
        return len(self.places)


def missing_surface(voxel_map: VoxelMap, region: ArrayLike, inside: ArrayLike) -> MissingSurface:
    """Find the holes of the surface that borders on the free space about the robot.

    Args:
        voxel_map: the map.
        region: box (low, high), shape (2, 3) [m, map]; surfaces beyond do not count.
        inside: a point of the free space about the robot, shape (3,) [m, map].
    """
    box = np.asarray(region, dtype=np.float64)
    size = voxel_map.config.voxel_size
    margin = (_REACH + 3) * size
    window = voxel_map.window(box[0] - margin, box[1] + margin)
    seen_free = window.states(OccupancyThresholds(surface_margin=0)) == FREE
    about = _free_about(window, np.asarray(inside, dtype=np.float64))
    _, means, covariances = voxel_map.gaussians(relative=True)
    inside_box = _within(means, box)
    faces = _faces(means[inside_box], covariances[inside_box], window, about, seen_free)
    places, normals = _continued(*faces, window.voxel_size)
    kept = _within(places, box) & ~_at(window, seen_free, places)
    kept[kept] = _is_free_before(window, about, places[kept], normals[kept])
    places, normals = _agreed(window, places[kept], normals[kept])
    lacks = _lacks_surface(means, places, normals, size)
    places, normals = places[lacks], normals[lacks]
    return MissingSurface(window.positions_of(places) + window.first, places, normals)


def _free_about(window: VoxelWindow, inside: FloatArray) -> NDArray[np.bool_]:
    """Free voxels that hang together with a place, or with the open voxel nearest to it."""
    states = window.states()
    labels, _ = ndimage.label(states != OCCUPIED)
    start = np.clip(window.positions_of(inside[None])[0], 0, np.array(states.shape) - 1)
    label = labels[tuple(start)]
    if label == 0 and labels.any():
        open_places = np.argwhere(labels > 0)
        nearest = open_places[np.argmin(((open_places - start) ** 2).sum(axis=1))]
        label = labels[tuple(nearest)]
    return np.asarray((states == FREE) & (labels == label))


def _faces(
    means: FloatArray,
    covariances: FloatArray,
    window: VoxelWindow,
    about: NDArray[np.bool_],
    seen_free: NDArray[np.bool_],
) -> tuple[FloatArray, FloatArray]:
    """Surfaces that free space lies before, with normals into it: places and normals, (N, 3) each.

    What nobody has seen counts as free near a surface, on its back as well if it is thin; so
    the side counts of which more was seen.
    """
    _, normals = smallest_axes(covariances)
    seen = [_count(window, seen_free, means, side * normals) for side in (1.0, -1.0)]
    found = []
    for side, more, less in ((1.0, seen[0], seen[1]), (-1.0, seen[1], seen[0])):
        outward = side * normals
        kept = (more >= less) & _is_free_before(window, about, means, outward)
        found.append((means[kept], outward[kept]))
    return np.concatenate([f[0] for f in found]), np.concatenate([f[1] for f in found])


def _count(
    window: VoxelWindow, mask: NDArray[np.bool_], places: FloatArray, normals: FloatArray
) -> NDArray[np.int64]:
    steps = [_at(window, mask, places + n * window.voxel_size * normals) for n in _OUTWARD]
    return np.asarray(np.sum(steps, axis=0), dtype=np.int64)


def _continued(
    means: FloatArray, normals: FloatArray, size: float
) -> tuple[FloatArray, FloatArray]:
    """Surfaces continued in their tangent planes: places and normals, (N, 3) each."""
    least = np.eye(3)[np.abs(normals).argmin(axis=1)]
    along = np.cross(normals, least)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(normals, along)
    steps = np.arange(-_REACH, _REACH + 1) * size
    places = [means + u * along + v * across for u in steps for v in steps if u or v]
    return np.concatenate(places), np.tile(normals, (len(places), 1))


def _is_free_before(
    window: VoxelWindow, about: NDArray[np.bool_], places: FloatArray, normals: FloatArray
) -> NDArray[np.bool_]:
    ahead = [_at(window, about, places + n * window.voxel_size * normals) for n in _BEFORE]
    return np.asarray(np.logical_or.reduce(ahead))


def _agreed(
    window: VoxelWindow, places: FloatArray, normals: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """One place per voxel in which several surface voxels expect a surface."""
    _, first, counts = np.unique(
        window.positions_of(places), axis=0, return_index=True, return_counts=True
    )
    chosen = first[counts >= _VOICES]
    return places[chosen], normals[chosen]


def _lacks_surface(
    means: FloatArray, places: FloatArray, normals: FloatArray, size: float
) -> NDArray[np.bool_]:
    """Where no surface voxel is near, nor in the layers just before and behind."""
    lacks = np.ones(len(places), np.bool_)
    if not len(means) or not len(places):
        return lacks
    tree = cKDTree(means)
    for layer in _LAYERS:
        rest = np.flatnonzero(lacks)
        beside = places[rest] + layer * size * normals[rest]
        lacks[rest] = np.isinf(tree.query(beside, distance_upper_bound=_NEAR * size)[0])
    return lacks


def _within(points: FloatArray, box: FloatArray) -> NDArray[np.bool_]:
    return np.asarray(((points >= box[0]) & (points <= box[1])).all(axis=1))


def _at(window: VoxelWindow, mask: NDArray[np.bool_], points: FloatArray) -> NDArray[np.bool_]:
    """What `mask`, of the window's shape, holds at points; False beyond it."""
    places = window.positions_of(points)
    found = window.contains(places)
    found[found] = mask[tuple(places[found].T)]
    return np.asarray(found)
