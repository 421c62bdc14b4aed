"""How much of the task's region is known, and how well."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import float_array
from infomap_ros.mapping import FREE, OCCUPIED, UNKNOWN, OccupancyThresholds, VoxelMap
from infomap_ros.mapping.export import surface_sigmas

_MARGIN = OccupancyThresholds().surface_margin
_AROUND = ndimage.generate_binary_structure(3, 3)
_Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class MapProgress:
    """The state of the map within the region of the task.

    Attributes:
        known_fraction: share of the reachable surface that is known, 0 to 1, as
            `measure_progress` defines it.
        entropy_bits: what is not known, summed over all voxels of the region [bits].
        mean_sigma: mean standard deviation of the surface along its normal [m]; NaN without one.
        surface_voxels: surface voxels in the region.
        known_voxels: voxels of the whole map that were ever observed.
    """

    known_fraction: float
    entropy_bits: float
    mean_sigma: float
    surface_voxels: int
    known_voxels: int


def measure_progress(voxel_map: VoxelMap, region: ArrayLike, inside: ArrayLike) -> MapProgress:
    """Measure expanse and resolution of a map.

    The known fraction is ``K / (K + M)``. K counts the surface voxels that border on the free
    space about the robot. M counts what is missing of the surface, each as one voxel:

    - expanse: columns of the region without any surface, which space that is not known to be
      occupied joins to the robot. What lies behind closed walls is not missing.
    - detail: unknown voxels on the border of the free space that are as near to a known surface,
      which therefore goes on there.

    A large hole in a known surface counts with its rim alone, so the fraction errs towards 1 where
    hidden faces stand upright, and towards 0 where space is walled off by what cannot be seen.

    Args:
        voxel_map: the map.
        region: box (low, high), shape (2, 3), map frame [m].
        inside: a point of the free space about the robot, such as the camera's position, shape (3,)
            [m].

    Raises:
        InvalidInputError: the region is not a finite box.
    """
    box = float_array(region, "region")
    if box.shape != (2, 3) or not np.isfinite(box).all() or (box[1] <= box[0]).any():
        raise InvalidInputError("region", f"is {box.tolist()}, expected finite (low, high) corners")
    window = voxel_map.window(box[0], box[1])
    states = window.states()
    start = np.clip(window.positions_of(np.reshape(inside, (1, 3)))[0], 0, _last(states))
    known, missing = count_surface(states, start)
    indices, _, covariances = voxel_map.gaussians()
    centres = (indices + 0.5) * voxel_map.config.voxel_size
    chosen = ((centres >= box[0]) & (centres <= box[1])).all(axis=1)
    sigmas = surface_sigmas(covariances[chosen])
    return MapProgress(
        known / (known + missing) if known else 0.0,
        voxel_map.entropy_bits(box),
        float(sigmas.mean()) if len(sigmas) else float("nan"),
        int(chosen.sum()),
        voxel_map.known_voxels,
    )


def count_surface(states: NDArray[np.uint8], start: NDArray[np.int64]) -> tuple[int, int]:
    """Known and missing surface voxels as `measure_progress` defines them.

    Args:
        states: as of `VoxelWindow.states`, shape (nx, ny, nz).
        start: array position of the robot, shape (3,); where it is not in open space, the nearest
            voxel that is.
    """
    occupied, unknown = states == OCCUPIED, states == UNKNOWN
    open_space = _component(~occupied, start)
    free = (states == FREE) & open_space
    beside_free = _beside(free)
    known = int((occupied & beside_free).sum())
    has_surface = occupied.any(axis=2)
    expanse = int((~has_surface & (open_space & (unknown | free)).any(axis=2)).sum())
    near_surface = ndimage.binary_dilation(occupied, _AROUND, iterations=_MARGIN + 1)
    detail = unknown & beside_free & near_surface & has_surface[:, :, None]
    return known, expanse + int(detail.sum())


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


def _beside(mask: _Mask) -> _Mask:
    """Voxels that share a face with one of `mask`."""
    beside = np.zeros_like(mask)
    for axis in range(3):
        ahead, behind = [slice(None)] * 3, [slice(None)] * 3
        ahead[axis], behind[axis] = slice(1, None), slice(None, -1)
        beside[tuple(ahead)] |= mask[tuple(behind)]
        beside[tuple(behind)] |= mask[tuple(ahead)]
    return beside


def _last(states: NDArray[np.uint8]) -> NDArray[np.int64]:
    return np.array(states.shape) - 1
