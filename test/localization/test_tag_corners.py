"""Lines along the edges of tags, where the pixels do not tell all of them."""

from __future__ import annotations

import numpy as np

from infomap_ros.localization.target import tag_detection


def test_a_step_beyond_all_pixels_is_no_line() -> None:
    s, d = (grid.ravel() for grid in np.meshgrid(np.linspace(-0.8, 0.8, 9), np.arange(-3.0, 4.0)))
    dark = np.full(len(s), 10.0)
    edge = tag_detection._Beside(np.zeros(2), np.array([1.0, 0.0]), 10.0, s, d, dark)
    beyond = np.array([50.0, 0.0, 0.0, 10.0, 0.0, 200.0, 0.0])
    residual, jacobian = tag_detection._step_residuals(edge, beyond)
    assert tag_detection._line(edge, beyond, residual, jacobian, 20.0) is None


def line_along(direction: list[float]) -> tag_detection._Line:
    """A line through the origin, known to a hundredth of a pixel."""
    along = np.array(direction) / np.linalg.norm(direction)
    nothing = np.zeros(0)
    edge = tag_detection._Beside(np.zeros(2), along, 10.0, nothing, nothing, nothing)
    return tag_detection._Line(edge, 0.0, 0.0, 1e-4 * np.eye(2))


def test_edges_that_are_parallel_have_no_corner() -> None:
    assert tag_detection._intersect(line_along([1.0, 0.0]), line_along([1.0, 0.0])) is None
    assert tag_detection._intersect(line_along([1.0, 0.0]), line_along([1.0, 0.02])) is None
    met = tag_detection._intersect(line_along([1.0, 0.0]), line_along([0.0, 1.0]))
    assert met is not None and np.allclose(met[0], 0.0)


def test_an_information_that_is_all_but_singular_has_no_inverse() -> None:
    rows = np.random.default_rng(0).normal(size=(20, 7))
    rows[:, 6] = rows[:, 5] * (1.0 + 1e-9)
    assert tag_detection._inverse(rows.T @ rows) is None
    rows[3, 6] = np.nan
    assert tag_detection._inverse(rows.T @ rows) is None
