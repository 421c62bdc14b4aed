"""Surfaces of a field by how precisely they are known."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.geometry import points_inside
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.files.export import surface_sigmas
from infomap_ros.mapping.voxels.keys import BLOCK_BITS, BLOCK_SIDE, BLOCK_VOXELS, local_index
from infomap_ros.views.information.codes import SOLID, UNCERTAIN, CodeBook
from infomap_ros.views.information.field import VisibleField
from infomap_ros.views.information.information_config import InformationConfig


def with_surfaces(
    field: VisibleField, m: VoxelMap, book: CodeBook, config: InformationConfig
) -> VisibleField:
    """The field with codes for surfaces that are less precise than `wanted_sigma`.

    Args:
        field: of the map.
        m: the map.
        book: that the field was made with.
        config: says where a coarser surface suffices.
    """
    indices, _, covariances = m.gaussians(relative=True)
    levels, count = book.sigma_levels, len(book.sigma_levels)
    ratio = np.log(levels[-1] / book.wanted_sigma) / count
    sigmas = np.maximum(surface_sigmas(covariances), 1e-12)
    exact = np.log(sigmas / book.wanted_sigma) / ratio
    level = np.floor(exact + _fraction_of(indices)).astype(np.int64)
    level[_are_precise(indices, sigmas, m.config.voxel_size, config)] = 0
    places = indices - field.first * BLOCK_SIDE
    blocks = places >> BLOCK_BITS
    inside = ((blocks >= 0) & (blocks < field.directory.shape)).all(axis=1) & (level > 0)
    places, at = places[inside], tuple(blocks[inside].T)
    directory = field.directory.copy()
    alike = np.unique(np.ravel_multi_index(at, directory.shape)[directory[at] < 0])
    own = (-1 - directory.flat[alike]).astype(np.uint8)
    codes = np.concatenate([field.codes, np.repeat(own[:, None], BLOCK_VOXELS, axis=1)])
    directory.flat[alike] = len(field.codes) + np.arange(len(alike))
    level = np.minimum(level[inside], count)
    _enter(directory, places, level, book.limit, book.surface, count, codes)
    return replace(field, directory=directory, codes=codes)


def _are_precise(
    indices: NDArray[np.int32], sigmas: FloatArray, voxel_size: float, config: InformationConfig
) -> NDArray[np.bool_]:
    """Which surfaces lie outside of the fine places and suffice there, (K, 3), (K,) -> (K,)."""
    suffices = sigmas <= config.coarse_sigma
    if not config.fine_places or not suffices.any():
        return np.zeros(len(indices), np.bool_)
    outside = ~points_inside((indices[suffices] + 0.5) * voxel_size, config.fine_places)
    suffices[suffices] = outside
    return suffices


def _fraction_of(indices: NDArray[np.int32]) -> FloatArray:
    """A number in [0, 1) that belongs to each voxel, (K, 3) -> (K,).

    Rounding by it instead of to the nearest level makes sums over many voxels right.
    """
    i, j, k = indices.astype(np.int64).T
    mixed = (i * 73856093) ^ (j * 19349663) ^ (k * 83492791)
    return np.asarray((mixed * 0x9E3779B1 >> 16 & 0xFFFF) / 65536.0)


@njit(cache=True, nogil=True)
def _enter(
    directory: Any, places: Any, levels: Any, limit: int, surface: int, count: int, codes: Any
) -> None:
    """Write the codes of surfaces; `limit` and `surface` are those of the `CodeBook`."""
    for n in range(len(places)):
        i, j, k = places[n, 0], places[n, 1], places[n, 2]
        row = directory[i >> BLOCK_BITS, j >> BLOCK_BITS, k >> BLOCK_BITS]
        local = local_index(i, j, k)
        code = np.int64(codes[row, local])
        kind = limit if code == SOLID else code - UNCERTAIN - limit - 1
        codes[row, local] = surface + kind * count + levels[n] - 1
