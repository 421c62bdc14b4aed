"""Steps, roughness and holes against plain numpy."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.mapping.terrain.measures import (
    OPEN,
    SOLID,
    drop_specks,
    fill_holes,
    largest_steps,
    plane_misfits,
)


def grid_with_holes(rng: np.random.Generator) -> np.ndarray:
    heights = rng.normal(0.0, 0.1, (17, 13))
    heights[rng.random(heights.shape) < 0.2] = np.nan
    heights[3:6, 4:9] = np.nan
    return heights


@pytest.mark.parametrize("edge", [0.02, 0.05])
def test_largest_step_is_that_about_a_cell_as_far_as_it_is_sure(rng, edge):
    heights = grid_with_holes(rng)
    steps = np.empty_like(heights)
    sigmas = rng.uniform(0.0, 0.05, heights.shape)
    largest_steps(heights, sigmas, edge, steps)
    offsets = np.array(list(np.ndindex(5, 5))) - 2
    lengths = np.hypot(*offsets.T)
    near = (lengths > 0.0) & (lengths * edge <= max(0.05, 1.5 * edge))
    expected = np.full(heights.shape, np.nan)
    z, s = (np.pad(grid, 2, constant_values=np.nan) for grid in (heights, sigmas))

    def sure(one: tuple, other: tuple) -> float:
        return abs(z[one] - z[other]) - min(np.hypot(s[one], s[other]), edge / np.sqrt(6.0))

    for i, j in np.argwhere(np.isfinite(heights)):
        known = [0.0]
        for (a, b), length in zip(offsets[near], lengths[near], strict=True):
            here, one, other = (i + 2, j + 2), (i + 2 + a, j + 2 + b), (i + 2 - a, j + 2 - b)
            known += [sure(one, here), sure(one, other) * min(1.0, 0.05 / (length * edge))]
        expected[i, j] = np.nanmax(known)
    np.testing.assert_allclose(steps, expected, atol=1e-9)


@pytest.mark.parametrize("edge", [0.02, 0.05])
def test_an_edge_that_is_blurred_is_a_step_in_cells_of_any_size(edge):
    """0.1 m up over 0.1 m, whatever the cells; a slope of 20 degrees is none of 5.7 cm."""
    x = (np.arange(round(0.8 / edge)) + 0.5) * edge
    steps = np.empty((len(x), len(x)))
    for rise, low, high in ((np.clip(x - 0.35, 0.0, 0.1), 0.07, 0.1), (0.36 * x, 0.02, 0.04)):
        heights = np.repeat(rise[:, None], len(x), axis=1)
        largest_steps(heights, np.zeros_like(heights), edge, steps)
        assert low <= steps.max() + 1e-9 and steps.max() <= high + 1e-9


def test_a_stone_of_which_little_is_known_is_no_ramp():
    """12 cm on four cells, as seen from afar, with deviations that would hide it."""
    heights, steps = np.zeros((8, 8)), np.empty((8, 8))
    heights[3:5, 3:5], sigmas = 0.12, np.full((8, 8), 0.04)
    largest_steps(heights, sigmas, 0.05, steps)
    assert (steps[2:6, 2:6] > 0.09).all()
    heights[heights > 0.0] = 0.05  # one cube: all that it may be is the edge of the ground's own
    largest_steps(heights, sigmas, 0.05, steps)
    assert steps.max() < 0.03


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
