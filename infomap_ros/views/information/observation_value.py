"""What one observation of a voxel is expected to tell, in bits.

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

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import erf

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import LOG_ODDS_QUANTUM, VoxelMapConfig
from infomap_ros.views.information.information_config import InformationConfig


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
