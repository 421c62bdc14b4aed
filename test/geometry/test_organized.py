"""The camera behind an organized cloud is found from the cloud alone."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import PinholeCamera
from infomap_ros.geometry.organized import fit_pinhole_camera

CAMERA = PinholeCamera(320, 240, 211.7, 219.3, cx=163.25, cy=117.5)


def test_camera_is_found_to_a_thousandth_of_a_pixel(rng: np.random.Generator) -> None:
    depth = rng.uniform(0.3, 8.0, (240, 320))
    depth[rng.random(depth.shape) < 0.6] = np.nan

    found = fit_pinhole_camera(CAMERA.back_project(depth))

    assert found is not None
    assert (found.width, found.height) == (320, 240)
    truth = (CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy)
    np.testing.assert_allclose((found.fx, found.fy, found.cx, found.cy), truth, atol=1e-3)


def test_a_scanning_laser_is_no_pinhole_camera() -> None:
    azimuth = np.linspace(-1.2, 1.2, 320)
    elevation = np.linspace(-0.3, 0.3, 16)[:, None]
    x, y = np.sin(azimuth) * np.cos(elevation), np.sin(elevation) * np.ones_like(azimuth)
    z = np.cos(azimuth) * np.cos(elevation)

    assert fit_pinhole_camera(3.0 * np.stack([x, y, z], axis=-1)) is None


@pytest.mark.parametrize("measured", [0, 5])
def test_too_few_points_tell_nothing(measured: int) -> None:
    depth = np.full((240, 320), np.nan)
    depth[0, :measured] = 1.0

    assert fit_pinhole_camera(CAMERA.back_project(depth)) is None


def test_a_cloud_without_rows_is_refused() -> None:
    with pytest.raises(InvalidInputError):
        fit_pinhole_camera(np.zeros((10, 3)))
