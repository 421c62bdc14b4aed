"""The smallest axes of covariances, against numpy's eigenvectors."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.geometry.symmetric import smallest_axes


def covariances(rng: np.random.Generator, *sigmas: float) -> np.ndarray:
    """Matrices with these standard deviations along random axes."""
    axes = np.linalg.qr(rng.normal(size=(500, 3, 3)))[0]
    return np.einsum("nik,k,njk->nij", axes, np.square(sigmas), axes)


@pytest.mark.parametrize(
    "sigmas",
    [
        (0.01, 0.3, 0.3),
        (1e-4, 0.3, 0.3001),
        (1e-6, 0.2, 1.0),
        (0.1, 0.11, 5.0),
        (0.01, 0.01, 1.0),
        (1e-3, 2e-3, 10.0),
        (2.0, 2.0, 2.0),
        (1.0, 1.0 + 1e-7, 1.0 + 2e-7),
    ],
)
def test_eigenvalue_and_direction_are_those_of_the_matrix(
    rng: np.random.Generator, sigmas: tuple[float, ...]
) -> None:
    matrices = covariances(rng, *sigmas)
    values, axes = smallest_axes(matrices)
    np.testing.assert_allclose(np.linalg.norm(axes, axis=1), 1.0, atol=1e-12)
    scale = max(sigmas) ** 2
    np.testing.assert_allclose(values, np.linalg.eigh(matrices)[0][:, 0], atol=1e-13 * scale)
    along = np.einsum("nij,nj->ni", matrices, axes)
    np.testing.assert_allclose(along, values[:, None] * axes, atol=1e-12 * scale)


def test_there_may_be_none() -> None:
    values, axes = smallest_axes(np.zeros((0, 3, 3)))
    assert values.shape == (0,) and axes.shape == (0, 3)


def test_zero_has_the_eigenvalue_zero() -> None:
    values, axes = smallest_axes(np.zeros((2, 3, 3)))
    assert (values == 0.0).all()
    np.testing.assert_allclose(np.linalg.norm(axes, axis=1), 1.0)
