"""Markov prediction of unknown voxels against a direct solution of its linear equations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import distance_transform_cdt
from scipy.sparse import lil_matrix
from scipy.sparse.linalg import spsolve
from scipy.special import expit

from infomap_ros.errors import ConfigError
from infomap_ros.mapping import LOG_ODDS_QUANTUM, VoxelWindow
from infomap_ros.mapping.prediction import PredictionConfig, predict_unknown
from infomap_ros.mapping.voxels.window import UNKNOWN_QUANTA

EXACT = PredictionConfig(distance=250, tolerance=1e-7, iterations=5000)


def window_of(quanta: np.ndarray) -> VoxelWindow:
    return VoxelWindow(quanta.astype(np.int16), np.zeros(3, np.int64), 0.1)


def solved(quanta: np.ndarray, distance: int) -> np.ndarray:
    """Average of neighbors by a sparse linear solve, over voxels within `distance` steps."""
    unknown = quanta == UNKNOWN_QUANTA
    values = np.where(unknown, 0.5, expit(quanta * LOG_ODDS_QUANTUM))
    steps = distance_transform_cdt(unknown, "taxicab")
    inside = unknown & (steps <= distance)
    number = {tuple(place): n for n, place in enumerate(np.argwhere(inside))}
    matrix, right = lil_matrix((len(number), len(number))), np.zeros(len(number))
    for place, n in number.items():
        for axis, side in ((0, -1), (0, 1), (1, -1), (1, 1), (2, -1), (2, 1)):
            other = list(place)
            other[axis] += side
            if not all(0 <= c < s for c, s in zip(other, quanta.shape, strict=True)):
                continue
            if tuple(other) in number:
                matrix[n, number[tuple(other)]] -= 1.0
            elif unknown[tuple(other)]:
                continue
            else:
                right[n] += values[tuple(other)]
            matrix[n, n] += 1.0
    values[inside] = spsolve(matrix.tocsr(), right)
    return values


def scattered(rng: np.random.Generator, share: float) -> np.ndarray:
    """Known voxels here and there, and a free block."""
    shape = (14, 11, 17)
    quanta = np.where(rng.random(shape) < share, rng.integers(-20, 20, shape), UNKNOWN_QUANTA)
    quanta[3:8, 2:6, 5:12] = -12
    return quanta


@pytest.mark.parametrize("share", [0.0, 0.01, 0.3])
@pytest.mark.parametrize("distance", [2, 5, 100])
def test_is_the_solution_of_the_linear_equations(
    rng: np.random.Generator, share: float, distance: int
) -> None:
    quanta = scattered(rng, share)
    config = PredictionConfig(distance=distance, tolerance=1e-7, iterations=5000)
    predicted = predict_unknown(window_of(quanta), config)
    np.testing.assert_allclose(predicted, solved(quanta, distance), atol=2e-5)


def test_default_is_near_the_solution(rng: np.random.Generator) -> None:
    quanta = scattered(rng, 0.02)
    predicted = predict_unknown(window_of(quanta))
    np.testing.assert_allclose(predicted, solved(quanta, 8), atol=0.01)


def test_between_two_walls_it_is_a_ramp() -> None:
    quanta = np.full((33, 5, 4), UNKNOWN_QUANTA)
    quanta[0], quanta[-1] = -30, 30
    predicted = predict_unknown(window_of(quanta), EXACT)
    ramp = np.linspace(predicted[0, 0, 0], predicted[-1, 0, 0], 33)
    np.testing.assert_allclose(
        predicted, np.broadcast_to(ramp[:, None, None], (33, 5, 4)), atol=1e-4
    )


def test_unknown_takes_after_the_closest_known() -> None:
    quanta = np.full((30, 6, 6), UNKNOWN_QUANTA)
    quanta[:3], quanta[-3:] = -12, 8
    predicted = predict_unknown(window_of(quanta), PredictionConfig(distance=4))
    np.testing.assert_allclose(predicted[3:7], predicted[0, 0, 0], atol=1e-3)
    np.testing.assert_allclose(predicted[23:27], predicted[-1, 0, 0], atol=1e-3)
    np.testing.assert_array_equal(predicted[7:23], 0.5)


def test_known_voxels_keep_their_probability(rng: np.random.Generator) -> None:
    quanta = scattered(rng, 0.3)
    quanta[0, 0, 0], quanta[0, 0, 1] = 32767, -32767
    predicted, known = predict_unknown(window_of(quanta)), quanta != UNKNOWN_QUANTA
    expected = expit(quanta[known] * LOG_ODDS_QUANTUM)
    np.testing.assert_allclose(predicted[known], expected, rtol=1e-5, atol=1e-12)


def test_nothing_known_stays_at_one_half() -> None:
    predicted = predict_unknown(window_of(np.full((4, 5, 6), UNKNOWN_QUANTA)))
    np.testing.assert_array_equal(predicted, np.full((4, 5, 6), 0.5, np.float32))


def test_impossible_configuration_is_named() -> None:
    with pytest.raises(ConfigError, match="distance"):
        PredictionConfig(distance=0)
