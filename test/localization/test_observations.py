from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import PinholeCamera
from infomap_ros.localization.fiducials.observations import FiducialObservations, no_observations

CAMERA = PinholeCamera(640, 480, 500.0, 480.0, 320.0, 240.0)


def observed(**changes: object) -> FiducialObservations:
    arguments: dict[str, object] = {
        "ids": [3, 7, 9],
        "pixels": [[320.0, 240.0], [400.0, 100.0], [10.0, 20.0]],
        "pixel_sigmas": [0.2, 0.4, 0.3],
        "inverse_depths": [0.5, 0.25, np.nan],
        "inverse_depth_sigmas": [0.01, 0.01, np.nan],
    }
    return FiducialObservations(**(arguments | changes))  # type: ignore[arg-type]


def test_points_and_covariances_are_those_of_sampled_measurements(
    rng: np.random.Generator,
) -> None:
    noisy = observed()
    points, covariances = noisy.points(CAMERA), noisy.covariances(CAMERA)
    for row in (0, 1):
        pixels = rng.normal(noisy.pixels[row], noisy.pixel_sigmas[row], (400_000, 2))
        rho = rng.normal(noisy.inverse_depths[row], noisy.inverse_depth_sigmas[row], 400_000)
        rays = np.column_stack(
            [(pixels - [CAMERA.cx, CAMERA.cy]) / [CAMERA.fx, CAMERA.fy], np.ones(len(rho))]
        )
        samples = rays / rho[:, None]
        # The estimate is of the point whose measurement this is: its bias is taken out.
        bias = samples.mean(axis=0) - rays.mean(axis=0) / noisy.inverse_depths[row]
        expected = rays.mean(axis=0) / noisy.inverse_depths[row] - bias
        assert np.allclose(points[row], expected, atol=2e-3)
        sampled = np.cov(samples.T)
        assert np.allclose(covariances[row], sampled, atol=0.05 * np.abs(sampled).max())


def test_without_range_or_with_a_poor_one_there_is_no_point() -> None:
    poor = observed(inverse_depth_sigmas=[0.01, 0.2, np.nan])
    assert poor.has_range.tolist() == [True, True, False]
    assert np.isfinite(poor.points(CAMERA)).all(axis=1).tolist() == [True, False, False]
    assert np.isnan(poor.covariances(CAMERA)[1:]).all()


def test_selects_by_mask_and_by_index() -> None:
    assert observed().select(np.array([True, False, True])).ids.tolist() == [3, 9]
    assert observed().select(np.array([1])).pixels.tolist() == [[400.0, 100.0]]
    assert len(no_observations().points(CAMERA)) == 0


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"ids": [3, 3, 9]}, "ids"),
        ({"pixels": [[1.0, 2.0]]}, "pixels"),
        ({"pixels": [[np.nan, 2.0]] * 3}, "pixels"),
        ({"pixel_sigmas": [0.1, 0.0, 0.1]}, "pixel_sigmas"),
        ({"inverse_depth_sigmas": [0.1, np.nan, 0.1]}, "inverse_depth_sigmas"),
    ],
)
def test_refuses_what_cannot_be_measured(changes: dict[str, object], named: str) -> None:
    with pytest.raises(InvalidInputError, match=named):
        observed(**changes)
