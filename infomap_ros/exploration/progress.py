"""How much of the task's region is known, and how well."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from infomap_ros.errors import InvalidInputError
from infomap_ros.exploration.robot import MapProgress
from infomap_ros.geometry import float_array
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import FREE, OCCUPIED, UNKNOWN, OccupancyThresholds, VoxelMap, VoxelWindow
from infomap_ros.mapping.files.export import surface_sigmas

GOES_ON = OccupancyThresholds().surface_margin + 1
"""A surface is continued so far [voxels]."""
_WALL = 1.0  # [m] of surface in a column, at which it is a wall,
_WALL_SHARE = 0.6  # or such a share of the region's height where that is less
_GAP = 0.2  # [m] width of gaps in walls that count as closed
_VOICES = 4  # surface voxels that must agree on where a surface goes on
_Mask = NDArray[np.bool_]


def measure_progress(
    voxel_map: VoxelMap,
    region: ArrayLike,
    inside: ArrayLike,
    surface_sigma: float,
    interests: Sequence[FloatArray] = (),
    interest_sigma: float = 0.0,
) -> MapProgress:
    """Measure expanse and resolution of a map.

    The known fraction is ``K / (K + M)``. K counts the surface voxels that border on the free
    space about the robot. M counts what is missing of the surface, each as one voxel:

    - expanse: columns of the region without any surface, between which and the robot stands no
      wall. What lies behind closed walls is not missing.
    - detail: unknown voxels on the border of the free space that go on where a known surface with
      the same free side ends, in its plane or one voxel beside it. Several voxels of that surface
      must be near: a false match that floats in the air goes on nowhere. The border of free space
      elsewhere is air that was not seen.

    Of what is known the share of surface voxels counts as precise whose standard deviation along
    the normal is at most `surface_sigma`.

    A large hole in a known surface counts with its rim alone, so the fraction errs towards 1 where
    hidden faces stand upright. docs/results/exploration_worlds.md compares it with the truth.

    Args:
        voxel_map: the map.
        region: box (low, high), shape (2, 3), map frame [m].
        inside: a point of the free space about the robot, such as the camera's position, shape (3,)
            [m].
        surface_sigma: that is precise enough [m].
        interests: boxes about places of interest, shape (2, 3) each, map frame [m].
        interest_sigma: that is precise enough in them [m].

    Raises:
        InvalidInputError: the region is not a finite box.
    """
    box = float_array(region, "region")
    if box.shape != (2, 3) or not np.isfinite(box).all() or (box[1] <= box[0]).any():
        raise InvalidInputError("region", f"is {box.tolist()}, expected finite (low, high) corners")
    indices, _, covariances = voxel_map.gaussians()
    centers = (indices + 0.5) * voxel_map.config.voxel_size
    sigmas = surface_sigmas(covariances)

    def inner_sigmas(box: FloatArray) -> FloatArray:
        return np.asarray(sigmas[((centers >= box[0]) & (centers <= box[1])).all(axis=1)])

    def precise_fraction(known: float, inner: FloatArray, limit: float) -> float:
        return known * float((inner <= limit).mean()) if len(inner) else 0.0

    known, inner = _known_fraction(voxel_map, box, inside), inner_sigmas(box)
    shares = (
        precise_fraction(
            _known_fraction(voxel_map, place, inside), inner_sigmas(place), interest_sigma
        )
        for place in interests
    )
    return MapProgress(
        known,
        voxel_map.entropy_bits(box),
        float(inner.mean()) if len(inner) else float("nan"),
        len(inner),
        voxel_map.known_voxels,
        precise_fraction(known, inner, surface_sigma),
        min(shares, default=1.0),
    )


def _known_fraction(voxel_map: VoxelMap, box: FloatArray, inside: ArrayLike) -> float:
    """K / (K + M) of `measure_progress`."""
    window = voxel_map.window(box[0], box[1])
    states = window.states()
    start = start_in(window, states, inside)
    known, missing = count_surface(states, start, voxel_map.config.voxel_size)
    return known / (known + missing) if known else 0.0


def count_surface(
    states: NDArray[np.uint8], start: NDArray[np.int64], voxel_size: float
) -> tuple[int, int]:
    """Known and missing surface voxels as `measure_progress` defines them.

    Args:
        states: as of `VoxelWindow.states`, shape (nx, ny, nz).
        start: array position of the robot, shape (3,); where it is not in open space, the nearest
            voxel that is.
        voxel_size: edge of a voxel [m].
    """
    occupied = states == OCCUPIED
    known, detail = np.zeros_like(occupied), np.zeros_like(occupied)
    for _, surface, missing in faces(states, start):
        known |= surface
        detail |= missing
    has_surface = occupied.any(axis=2)
    expanse = ~has_surface & (states != OCCUPIED).any(axis=2)
    expanse &= _component(~_walls(occupied, voxel_size), start[:2])
    return int(known.sum()), int(expanse.sum()) + int((detail & has_surface[:, :, None]).sum())


def faces(
    states: NDArray[np.uint8], start: NDArray[np.int64]
) -> Iterator[tuple[FloatArray, _Mask, _Mask]]:
    """By the side of the free space: the direction to it, surface, and where surface goes on."""
    occupied, unknown = states == OCCUPIED, states == UNKNOWN
    free = (states == FREE) & _component(~occupied, start)
    for axis in range(3):
        for step in (-1, 1):
            faces_free = _neighbors(free, axis, step)
            surface = occupied & faces_free
            beside = [2 * GOES_ON + 1] * 3
            beside[axis] = 3
            missing = unknown & faces_free & (_count_near(surface, beside) >= _VOICES)
            yield step * np.eye(3)[axis], surface, missing


def _walls(occupied: _Mask, voxel_size: float) -> NDArray[np.bool_]:
    """Columns that the camera cannot look across, shape (nx, ny), narrow gaps closed."""
    height = min(_WALL, _WALL_SHARE * occupied.shape[2] * voxel_size)
    walls = occupied.sum(axis=2) * voxel_size >= height - 1e-9
    reach = int(0.5 * _GAP / voxel_size + 1e-9)
    if reach == 0:
        return walls
    around = np.pad(walls, reach)
    closed = ndimage.binary_closing(around, np.ones((2 * reach + 1, 2 * reach + 1)))
    return np.asarray(closed[reach:-reach, reach:-reach])


def _component(mask: _Mask, start: NDArray[np.int64]) -> _Mask:
    """The part of `mask` that is connected to the place of it nearest to `start`."""
    if not mask.any():
        return mask
    labels, _ = ndimage.label(mask)
    label = labels[tuple(start)]
    if label == 0:
        places = np.argwhere(mask)
        label = labels[tuple(places[np.argmin(((places - start) ** 2).sum(axis=1))])]
    return np.asarray(labels == label)


def _count_near(mask: _Mask, sizes: Sequence[int]) -> NDArray[np.int64]:
    """How many voxels of `mask` are in a box of odd sizes [voxels] about each voxel."""
    counts = mask.astype(np.int64)
    for axis, size in enumerate(sizes):
        counts = ndimage.correlate1d(counts, np.ones(size, np.int64), axis, mode="constant")
    return np.asarray(counts)


def _neighbors(mask: _Mask, axis: int, step: int) -> _Mask:
    """What `mask` holds one step, -1 or 1, along an axis; False beyond the edge."""
    shifted = np.zeros_like(mask)
    here, there = [slice(None)] * 3, [slice(None)] * 3
    here[axis] = slice(1, None) if step < 0 else slice(None, -1)
    there[axis] = slice(None, -1) if step < 0 else slice(1, None)
    shifted[tuple(here)] = mask[tuple(there)]
    return shifted


def start_in(
    window: VoxelWindow, states: NDArray[np.uint8], inside: ArrayLike
) -> NDArray[np.int64]:
    """Position of the voxel of a window that is nearest to a place, shape (3,) [m]."""
    here = window.positions_of(np.reshape(inside, (1, 3)))[0]
    return np.clip(here, 0, np.array(states.shape) - 1)
