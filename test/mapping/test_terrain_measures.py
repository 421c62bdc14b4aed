"""Steps, roughness and holes against plain numpy."""

from __future__ import annotations

import numpy as np

from infomap_ros.mapping.terrain.cubes import OPEN, SOLID, drop_specks
from infomap_ros.mapping.terrain.measures import fill_holes, largest_steps, plane_misfits


def grid_with_holes(rng: np.random.Generator) -> np.ndarray:
    heights = rng.normal(0.0, 0.1, (17, 13))
    heights[rng.random(heights.shape) < 0.2] = np.nan
    heights[3:6, 4:9] = np.nan
    return heights


def test_largest_step_is_that_of_the_neighbors_as_far_as_it_is_sure(rng):
    heights = grid_with_holes(rng)
    steps = np.empty_like(heights)
    sigmas = rng.uniform(0.0, 0.05, heights.shape)
    largest_steps(heights, sigmas, steps)
    padded = np.pad(heights, 1, constant_values=np.nan)
    doubts = np.pad(sigmas, 1, constant_values=np.nan)
    shifted = []
    for a, b in np.ndindex(3, 3):
        part = np.s_[a : a + heights.shape[0], b : b + heights.shape[1]]
        doubt = 2.0 * np.sqrt(doubts[part] ** 2 + sigmas**2)
        shifted.append(np.abs(padded[part] - heights) - doubt)
    expected = np.nanmax(shifted, axis=0, initial=0.0)
    expected[np.isnan(heights)] = np.nan
    np.testing.assert_allclose(steps, expected, atol=1e-12)


def test_roughness_is_the_residual_of_least_squares(rng):
    heights = grid_with_holes(rng)
    roughness = np.empty_like(heights)
    plane_misfits(heights, 2, 0.15, roughness)
    np.testing.assert_array_equal(np.isnan(roughness), np.isnan(heights))
    for i, j in np.argwhere(np.isfinite(heights)):
        part = np.s_[max(i - 2, 0) : i + 3, max(j - 2, 0) : j + 3]
        z = heights[part]
        x, y = np.indices(z.shape)
        ok = np.abs(z - heights[i, j]) <= 0.15
        design = np.column_stack([np.ones(ok.sum()), x[ok], y[ok]])
        if ok.sum() < 4 or np.linalg.matrix_rank(design) < 3:
            assert roughness[i, j] == 0.0
            continue
        plane = np.linalg.lstsq(design, z[ok], rcond=None)[0]
        expected = np.sqrt(((design @ plane - z[ok]) ** 2).mean())
        np.testing.assert_allclose(roughness[i, j], expected, atol=1e-9)


def filled(heights: np.ndarray, largest: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    result, sigmas = heights.copy(), np.full(heights.shape, 0.01)
    marks = np.empty(heights.shape, bool)
    fill_holes(result, sigmas, np.zeros(heights.shape, bool), largest, 0.02, marks)
    return result, sigmas, marks


def test_hole_in_a_slope_gets_the_slope():
    x, y = np.indices((9, 9))
    slope = 0.03 * x - 0.05 * y
    holed = slope.copy()
    holed[4, 4] = holed[4, 5] = holed[2, 7] = np.nan
    heights, sigmas, marks = filled(holed, 2)
    np.testing.assert_allclose(heights, slope, atol=1e-9)
    np.testing.assert_allclose(sigmas, 0.01)
    assert marks.sum() == 3


def test_hole_at_the_border_or_too_large_stays():
    flat = np.zeros((9, 9))
    flat[0, 3] = flat[4:6, 4:6] = np.nan
    heights, _, marks = filled(flat, 3)
    np.testing.assert_array_equal(np.isnan(heights), np.isnan(flat))
    assert not marks.any()


def test_only_groups_up_to_the_largest_size_are_dropped(rng):
    from scipy.ndimage import label

    for _ in range(20):
        cubes = np.where(rng.random((12, 11, 10)) < 0.05, SOLID, OPEN).astype(np.uint8)
        groups, count = label(cubes == SOLID, np.ones((3, 3, 3)))
        sizes = np.bincount(groups.ravel(), minlength=count + 1)
        expected = (cubes == SOLID) & (sizes[groups] > 3)
        drop_specks(cubes, 3)
        np.testing.assert_array_equal(cubes == SOLID, expected)
