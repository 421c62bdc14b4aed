"""From light to gray values: exposure, vignetting, shot noise, read noise, quantization."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.config import check_config, setting
from infomap_ros.geometry.transforms import FloatArray


@dataclass(frozen=True)
class ImageSensorConfig:
    """Parameters of the image sensor."""

    full_well: float = setting(
        9000.0, "Electrons at gray value 255; fewer means more shot noise", low=50.0, high=1e6
    )
    read_noise: float = setting(
        14.0, "Standard deviation of the read noise, in electrons", low=0.0, high=1000.0
    )
    vignetting: float = setting(
        0.25, "Share of light that is lost in the corners", low=0.0, high=0.95
    )
    target_level: float = setting(
        115.0, "Median gray value that the exposure control aims at", low=1.0, high=254.0
    )
    exposure_step: float = setting(
        0.125, "Step of the exposure control, as power of two", low=0.001, high=2.0
    )

    def __post_init__(self) -> None:
        """Validate all fields."""
        check_config(self)


class ImageSensor:
    """One sensor with exposure control; both cameras of a pair use the same exposure.

    Args:
        config: the parameters.
        rng: source of the noise.
    """

    def __init__(self, config: ImageSensorConfig, rng: np.random.Generator) -> None:
        self.config = config
        self._rng = rng
        self._steps: int | None = None

    @property
    def exposure(self) -> float:
        """Present exposure; at 1 a white surface just saturates."""
        return float(2.0 ** ((self._steps or 0) * self.config.exposure_step))

    def adjust(self, light: FloatArray, images: int = 1) -> None:
        """Move the exposure towards the target level, by one step per image.

        The first image sets it at once.

        Args:
            light: light on the pixels, 1 = white in full light, any shape.
            images: so many are taken of it.
        """
        median = max(float(np.median(light)), 1e-6)
        wanted = np.log2(self.config.target_level / (255.0 * median)) / self.config.exposure_step
        if self._steps is None:
            self._steps = round(wanted)
        self._steps += int(np.clip(round(wanted - self._steps), -images, images))

    def expose(self, light: FloatArray, gain: float = 1.0) -> NDArray[np.uint8]:
        """Take one image.

        Args:
            light: light on the pixels, shape (H, W), 1 = white in full light.
            gain: sensitivity of this sensor relative to nominal.

        Returns:
            Gray values, shape (H, W), uint8.
        """
        config = self.config
        electrons = config.full_well * self.exposure * gain * light * self._falloff(light.shape)
        noisy = self._rng.normal(electrons, np.sqrt(electrons + config.read_noise**2))
        return np.clip(np.rint(255.0 * noisy / config.full_well), 0, 255).astype(np.uint8)

    def _falloff(self, shape: tuple[int, ...]) -> FloatArray:
        """Light that each pixel keeps, falling with the square of the distance to the middle."""
        v, u = (np.linspace(-1.0, 1.0, n) ** 2 for n in shape)
        return np.asarray(1.0 - 0.5 * self.config.vignetting * (v[:, None] + u[None, :]))
