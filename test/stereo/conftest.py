"""Textured stereo pairs with exactly known disparity, rendered without the code under test."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
import pytest

from infomap_ros.geometry import PinholeCamera, StereoRig


@dataclass(frozen=True)
class Scene:
    left: np.ndarray
    right: np.ndarray
    disparity: np.ndarray  # of the left pixels
    rig: StereoRig


def _texture(rng: np.random.Generator, height: int, width: int, blur: float) -> np.ndarray:
    noise = cv2.GaussianBlur(rng.standard_normal((2 * height, 2 * width)), (0, 0), 2.0 * blur)
    return (128.0 + 35.0 * noise / noise.std()).astype(np.float32)


def make_rig(width: int, height: int, focal: float = 300.0, baseline: float = 0.1) -> StereoRig:
    camera = PinholeCamera(width, height, focal, focal, (width - 1) / 2.0, (height - 1) / 2.0)
    return StereoRig(camera, camera, baseline)


@pytest.fixture
def render() -> Callable[..., Scene]:
    """Function (seed, blur, noise, width, height) -> Scene: a wavy surface, 18 to 42 px."""

    def scene(
        seed: int = 0, blur: float = 1.0, noise: float = 2.0, width: int = 320, height: int = 240
    ) -> Scene:
        rng = np.random.default_rng(seed)
        texture = _texture(rng, height, width, blur)
        u, v = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))

        def disparity(columns: np.ndarray) -> np.ndarray:
            return 30.0 + 12.0 * np.sin(columns / 90.0) * np.cos(v / 70.0)

        source = u.copy()
        for _ in range(60):  # the left column that the right pixel u sees
            source = u + disparity(source)

        def shade(columns: np.ndarray) -> np.ndarray:
            maps = (2.0 * columns).astype(np.float32), (2.0 * v).astype(np.float32)
            image = cv2.remap(texture, *maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
            noisy = image + rng.normal(0.0, noise, image.shape)
            return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)

        return Scene(shade(u), shade(source), disparity(u), make_rig(width, height))

    return scene
