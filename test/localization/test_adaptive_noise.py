"""Sigmas grow to what fiducials show, and shrink again."""

from __future__ import annotations

import numpy as np

from infomap_ros.localization.filter.fiducial_filter import FiducialFilter
from infomap_ros.localization.filter.hypothesis_choice import AdaptiveNoise
from infomap_ros.localization.filter.motion_prior import MotionPrior

from .fiducial_scene import CAMERA, PIXEL_SIGMA, RHO_SIGMA, observe, wall

LOOSE = MotionPrior(np.eye(4), np.diag([0.05**2] * 3 + [0.05**2] * 3))


def noisier(observations, factor, rng):
    """The same with so many times the noise that they state."""
    extra = np.sqrt(factor**2 - 1.0)
    count = len(observations)
    return type(observations)(
        observations.ids,
        observations.pixels + extra * PIXEL_SIGMA * rng.normal(size=(count, 2)),
        observations.pixel_sigmas,
        observations.inverse_depths + extra * RHO_SIGMA * rng.normal(size=count),
        observations.inverse_depth_sigmas,
    )


def followed(factor: float, views: int, noise: AdaptiveNoise, seed: int) -> None:
    """Update a filter from one place by measurements of that much noise."""
    rng = np.random.default_rng(seed)
    points = wall(60, rng)
    pose_filter = FiducialFilter(CAMERA)
    pose_filter.add(observe(points, np.eye(4), rng))
    for _ in range(views):
        seen = noisier(observe(points, np.eye(4), rng), factor, rng)
        pose_filter.predict(LOOSE)
        update = pose_filter.update(noise.applied(seen))
        while not update.is_consistent and noise.grow():
            update = pose_filter.update(noise.applied(seen))
        assert update.is_consistent
        noise.note(update)


def test_true_sigmas_stay_as_they_are():
    noise = AdaptiveNoise(8.0)
    followed(1.0, 20, noise, 1)
    assert noise.factor < 1.3


def test_the_factor_follows_the_noise_up_and_down_again():
    noise = AdaptiveNoise(8.0)
    followed(3.0, 40, noise, 2)
    assert 2.0 < noise.factor < 4.5
    followed(1.0, 60, noise, 3)
    assert noise.factor < 2.0


def test_the_factor_is_limited_and_scales_every_sigma():
    noise = AdaptiveNoise(2.0)
    assert noise.grow() and not noise.grow()
    seen = observe(wall(10, np.random.default_rng(4)), np.eye(4), None)
    scaled = noise.applied(seen)
    np.testing.assert_allclose(scaled.pixel_sigmas, 2.0 * seen.pixel_sigmas)
    np.testing.assert_allclose(scaled.inverse_depth_sigmas, 2.0 * seen.inverse_depth_sigmas)
    np.testing.assert_array_equal(scaled.pixels, seen.pixels)
