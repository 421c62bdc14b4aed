"""What the steps of a ray tell, prepared for a map and a sensor.

What one observation of a voxel is expected to tell, in bits.

A voxel is occupied with probability p. A scan that looks at it adds either the evidence of a hit or
that of a miss, h and m nats, to its log-odds. For the map to be right about its probabilities the
two must be likelihood ratios of one and the same observation:

    e^h = P(hit | occupied) / P(hit | empty),    e^m = P(miss | occupied) / P(miss | empty)

which fixes both likelihoods. What the observation is expected to take off the voxel's entropy is
then the mutual information of voxel and observation,

    I = H(p) - P(hit) H(p | hit) - P(miss) H(p | miss)

never negative, largest near p = 1/2.

From afar the chance is smaller that a voxel is told anything. Where pixels are farther apart than
voxels are wide only that share of the voxels is looked at. And the surface is told in the voxel in
which it lies only as far as its range is known: the mean of the n pixels that see the voxel's face
has, by eq. (1) of Sujan and Dubowsky (2005, doi:10.1177/0278364905051774) and with the correlation
c of the errors of neighboring pixels, the variance along the ray

    sigma^2 = (S L^n)^2 (c + (1 - c) / n_pixels)

so that a voxel of size s looked at squarely gets the share erf(s / (sqrt(8) sigma)) of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray
from scipy.special import erf

from infomap_ros.geometry import points_inside
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import LOG_ODDS_QUANTUM, VoxelMap, VoxelMapConfig
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
from infomap_ros.views.information.ray_kernels import RayArrays
from infomap_ros.views.information.view_query import InformationConfig


def entropy_of(probability: ArrayLike) -> FloatArray:
    """Entropy of binary variables [bits], any shape; 0 for certain ones."""
    p = np.clip(np.asarray(probability, dtype=np.float64), 1e-300, 1.0)
    q = np.clip(1.0 - np.asarray(probability, dtype=np.float64), 1e-300, 1.0)
    return np.asarray(-(p * np.log2(p) + q * np.log2(q)))


def expected_reduction(probability: ArrayLike, hit: float, miss: float) -> FloatArray:
    """Mutual information of a voxel and one observation of it [bits].

    Args:
        probability: that the voxel is occupied, any shape.
        hit: log-odds that a hit adds, above 0 [nats].
        miss: log-odds that a miss adds, below 0 [nats].
    """
    p = np.asarray(probability, dtype=np.float64)
    ratio_hit, ratio_miss = math.exp(hit), math.exp(miss)
    hit_if_empty = (1.0 - ratio_miss) / (ratio_hit - ratio_miss)
    hit_if_occupied = ratio_hit * hit_if_empty
    p_hit = hit_if_occupied * p + hit_if_empty * (1.0 - p)
    p_miss = 1.0 - p_hit
    after_hit = hit_if_occupied * p / p_hit
    after_miss = (1.0 - hit_if_occupied) * p / np.maximum(p_miss, 1e-300)
    left = p_hit * entropy_of(after_hit) + p_miss * entropy_of(np.minimum(after_miss, 1.0))
    return np.maximum(entropy_of(p) - left, 0.0)


def observed_share(
    distances: ArrayLike, grid: VoxelMapConfig, config: InformationConfig
) -> FloatArray:
    """Chance that a scan tells a voxel at some distance what is in it, in [0, 1].

    Args:
        distances: from the camera, any shape [m].
        grid: of the map: voxel size, correlation of the range errors of neighboring pixels.
        config: noise law and angle between pixels.
    """
    sigma, seen = voxel_observation(distances, grid, config)
    located = erf(grid.voxel_size / np.maximum(np.sqrt(8.0) * sigma, 1e-12 * grid.voxel_size))
    return np.asarray(located * seen)


def voxel_observation(
    distances: ArrayLike, grid: VoxelMapConfig, config: InformationConfig
) -> tuple[FloatArray, FloatArray]:
    """Standard deviation of what a scan says of a voxel, along the ray [m], and how likely it does.

    Arguments as of `observed_share`; shapes as `distances`.
    """
    length = np.maximum(np.asarray(distances, dtype=np.float64), 1e-9)
    pixels = (grid.voxel_size / (config.pixel_angle * length)) ** 2
    averaged = grid.error_correlation + (1.0 - grid.error_correlation) / np.maximum(pixels, 1.0)
    sigma = config.range_noise * length**config.range_exponent * np.sqrt(averaged)
    return sigma, np.minimum(pixels, 1.0)


def voxel_bits(
    probability: ArrayLike, distances: ArrayLike, grid: VoxelMapConfig, config: InformationConfig
) -> FloatArray:
    """Bits that one scan is expected to take off voxels that nothing hides.

    Args:
        probability: of the voxels, broadcasts against `distances`.
        distances: from the camera [m].
        grid: of the map: voxel size, evidence of a hit and a miss, correlation of errors.
        config: of the sensor.
    """
    hit, miss = grid.hit_quanta * LOG_ODDS_QUANTUM, grid.miss_quanta * LOG_ODDS_QUANTUM
    share = observed_share(distances, grid, config)
    return np.asarray(share * expected_reduction(probability, hit, miss))


def surface_bits(
    sigma: ArrayLike, distances: ArrayLike, grid: VoxelMapConfig, config: InformationConfig
) -> FloatArray:
    """Bits that one scan is expected to tell about where surfaces lie.

    A Gaussian whose standard deviation falls from a to b loses log2(a / b) bits of entropy, with
    1 / b^2 = 1 / a^2 + 1 / sigma^2 (eq. 4 of Sujan and Dubowsky 2005, in one dimension). What is
    more precise than ``wanted_sigma`` does not count.

    Args:
        sigma: of the surfaces along their normals, 0 for none; broadcasts against `distances` [m].
        distances: from the camera [m].
        grid: of the map.
        config: of the sensor.
    """
    observed, seen = voxel_observation(distances, grid, config)
    prior = np.asarray(sigma, dtype=np.float64)
    wanted = max(config.wanted_sigma, 1e-12)
    after = prior * observed / np.maximum(np.hypot(prior, observed), 1e-300)
    return np.asarray(seen * np.log2(np.maximum(prior, wanted) / np.maximum(after, wanted)))


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
        clear: probability that a step does not hide what is behind it, shape (codes,).
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
