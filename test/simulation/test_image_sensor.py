from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.simulation.cameras import stereo_camera
from infomap_ros.simulation.cameras.stereo_camera import ImageSensor


def test_noise_is_shot_noise_plus_read_noise(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stereo_camera, "_VIGNETTING", 0.0)
    sensor = ImageSensor(rng)
    for light in (0.1, 0.4, 0.7):
        image = sensor.expose(np.full((200, 200), light)).astype(np.float64)
        gray_per_electron = 255.0 / 9000.0
        shot, read = 9000.0 * light, 14.0**2
        rounding = 1.0 / 12.0
        expected = (shot + read) * gray_per_electron**2 + rounding
        assert image.mean() == pytest.approx(255.0 * light, abs=0.1)
        assert image.var() == pytest.approx(expected, rel=0.05)


def test_corners_are_darker_by_the_vignetting(rng: np.random.Generator) -> None:
    sensor, light = ImageSensor(rng), np.full((101, 101), 0.5)
    image = np.mean([sensor.expose(light) for _ in range(40)], axis=0)
    assert image[50, 50] == pytest.approx(127.5, abs=2.0)
    assert image[0, 0] == pytest.approx(0.75 * 127.5, abs=2.0)


def test_exposure_finds_the_target_at_once_and_then_moves_by_single_steps(
    rng: np.random.Generator,
) -> None:
    sensor = ImageSensor(rng)
    sensor.adjust(np.full((4, 4), 0.05))
    assert 255.0 * 0.05 * sensor.exposure == pytest.approx(115.0, rel=0.05)
    before = sensor.exposure
    sensor.adjust(np.full((4, 4), 0.5))
    assert sensor.exposure == pytest.approx(before * 2.0**-0.125)


def test_too_much_light_saturates(rng: np.random.Generator) -> None:
    image = ImageSensor(rng).expose(np.full((8, 8), 3.0))
    assert (image == 255).all()
