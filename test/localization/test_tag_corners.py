"""Lines along the edges of tags, where the pixels do not tell all of them."""

from __future__ import annotations

import numpy as np

from infomap_ros.localization.target import tag_corners


def test_a_step_beyond_all_pixels_is_no_line() -> None:
    s, d = (grid.ravel() for grid in np.meshgrid(np.linspace(-0.8, 0.8, 9), np.arange(-3.0, 4.0)))
    dark = np.full(len(s), 10.0)
    edge = tag_corners._Beside(np.zeros(2), np.array([1.0, 0.0]), 10.0, s, d, dark)
    beyond = np.array([50.0, 0.0, 0.0, 10.0, 0.0, 200.0, 0.0])
    residual, jacobian = tag_corners._step_residuals(edge, beyond)
    assert tag_corners._line(edge, beyond, residual, jacobian, 20.0) is None
