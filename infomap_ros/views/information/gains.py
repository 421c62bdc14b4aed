"""What the steps of a ray tell, prepared for a map and a sensor."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.geometry import points_inside
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.files.export import surface_sigmas
from infomap_ros.mapping.voxels.keys import BLOCK_BITS, BLOCK_SIDE, local_index
from infomap_ros.views.information.field import (
    SOLID,
    UNCERTAIN,
    CodeBook,
    VisibleField,
    visible_field,
    with_predictions,
    with_rows,
)
from infomap_ros.views.information.information_config import InformationConfig
from infomap_ros.views.information.observation_value import surface_bits, voxel_bits
from infomap_ros.views.information.ray_kernels import RayArrays

_LEAST_STEPS = 64
_STEPS_IN_PLANE = 4  # per voxel; a longer step may miss the corner of the one voxel that hides


def code_book(config: InformationConfig) -> CodeBook:
    """Codes by what counts as certain and as precise."""
    return CodeBook(config.certain_probability, config.wanted_sigma)


def shell_volumes(edges: FloatArray, planar: bool) -> FloatArray:
    """Voxels per steradian between distances, shape (n + 1,) [voxels] -> (n,); in a plane per rad.

    In a plane a ray stands for a sector of one layer of voxels: r dr instead of r^2 dr.
    """
    power = 2 if planar else 3
    return np.asarray(np.diff(edges**power) / power)


@dataclass(frozen=True, eq=False)
class GainTable:
    """What the steps of a ray tell, by the code of the voxel in which they are.

    Attributes:
        gains: bits per steradian (in a plane per radian), shape (steps, codes), float32.
        before: sum over the steps before, shape (steps + 1, codes), float32.
        clear: probability that a step's way does not hide what is behind it, shape (codes,).
        step: length of a step [voxels].
    """

    gains: NDArray[np.float32]
    before: NDArray[np.float32]
    clear: FloatArray
    step: float


@lru_cache(maxsize=16)
def gain_table(grid: VoxelMapConfig, max_range: float, config: InformationConfig) -> GainTable:
    """Gains for a map's voxel size and evidence, up to a range [m]."""
    reach = max_range / grid.voxel_size
    steps = max(math.ceil(reach * (_STEPS_IN_PLANE if config.planar else 1)), _LEAST_STEPS)
    edges = np.linspace(0.0, reach, steps + 1)
    middle = 0.5 * (edges[:-1] + edges[1:]) * grid.voxel_size
    book = code_book(config)
    p = book.probabilities()
    bits = voxel_bits(p, middle[:, None], grid, config)
    bits[:, (p == 0.0) | (p == 1.0)] = 0.0
    bits[:, book.known()] *= config.known_weight
    bits += surface_bits(book.sigmas(), middle[:, None], grid, config)
    bits[middle < config.min_range] = 0.0
    gains = bits * shell_volumes(edges, config.planar)[:, None]
    before = np.concatenate([np.zeros((1, len(p))), np.cumsum(gains, axis=0)])
    step = reach / steps
    clear = np.where(p > config.hiding_probability, (1.0 - p) ** step, 1.0)
    clear[~book.known()] *= (1.0 - config.unknown_occlusion) ** (1.0 / steps)
    return GainTable(gains.astype(np.float32), before.astype(np.float32), clear, step)


def field_around(
    m: VoxelMap,
    positions: FloatArray,
    max_range: float,
    config: InformationConfig,
    threads: int = 1,
) -> VisibleField:
    """The part of a map that can be seen from positions, shape (M, 3) [m], within `max_range`."""
    low, high = positions.min(axis=0) - max_range, positions.max(axis=0) + max_range
    book = code_book(config)
    field = visible_field(m, low, high, book, threads)
    if config.predict_unknown:
        field = with_predictions(field, m, book)
    return with_surfaces(field, m, book, config) if config.wanted_sigma > 0.0 else field


def ray_arrays(
    field: VisibleField, m: VoxelMap, max_range: float, config: InformationConfig
) -> RayArrays:
    """What rays through a field look up, for the kernels.

    Args:
        field: part of the map, as `field_around` prepares it.
        m: the map.
        max_range: [m].
        config: of the sensor.
    """
    table = gain_table(m.config, max_range, config)
    steps = table.gains, table.before, table.clear, table.step
    return RayArrays(field.directory, field.codes, *steps, config.min_visibility)


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
    field, level = with_rows(field, blocks[inside]), np.minimum(level[inside], count)
    kinds = book.limit, book.surface, count
    _enter(field.directory, places[inside], level, *kinds, field.codes)
    return field


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
