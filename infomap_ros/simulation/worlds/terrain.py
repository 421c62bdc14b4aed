"""Rough ground as a height field: rolling relief, small bumps, and a rim that closes the view.

What worlds with natural ground have in common: parameters, and a floor that is not even.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.simulation.worlds.textures import spectral_noise


@dataclass(frozen=True, eq=False)
class Terrain:
    """Heights on a regular square grid about the origin of the world.

    Between the nodes the surface is two flat triangles per cell, cut along the diagonal from
    (x, y) to (x + 1, y + 1).

    Attributes:
        heights: z of node (i, j) at y = -half + i * spacing, x = -half + j * spacing,
            shape (n, n) [m].
        half: half the edge length of the square [m].
    """

    heights: FloatArray
    half: float

    @property
    def spacing(self) -> float:
        """Distance between neighboring nodes [m]."""
        return 2.0 * self.half / (len(self.heights) - 1)

    def height(self, points: ArrayLike) -> FloatArray:
        """Height of the surface at (x, y), shape (..., 2) [m] -> (...) [m]; edges extend."""
        last = len(self.heights) - 1
        position = (np.asarray(points, dtype=np.float64) + self.half) / self.spacing
        position = np.clip(position, 0.0, last - 1e-9)
        cell = position.astype(int)
        s, t = np.moveaxis(position - cell, -1, 0)
        column, row = np.moveaxis(cell, -1, 0)
        z = self.heights
        z00, z10 = z[row, column], z[row, column + 1]
        z01, z11 = z[row + 1, column], z[row + 1, column + 1]
        upper = z00 + s * (z11 - z01) + t * (z01 - z00)
        lower = z00 + s * (z10 - z00) + t * (z11 - z10)
        return np.asarray(np.where(t > s, upper, lower))

    def triangles(self) -> tuple[FloatArray, NDArray[np.int64]]:
        """The surface as vertices, shape (V, 3) [m], and faces, shape (F, 3)."""
        n = len(self.heights)
        axis = np.linspace(-self.half, self.half, n)
        x, y = np.meshgrid(axis, axis)
        vertices = np.stack([x, y, self.heights], axis=-1).reshape(-1, 3)
        node = np.arange(n * n).reshape(n, n)
        a, b = node[:-1, :-1].ravel(), node[:-1, 1:].ravel()
        c, d = node[1:, :-1].ravel(), node[1:, 1:].ravel()
        faces = np.concatenate([np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)])
        return vertices, faces


def rough_terrain(
    half: float, spacing: float, relief: float, roughness: float, rng: np.random.Generator
) -> Terrain:
    """Make a shallow crater floor with a rim.

    Args:
        half: half the edge length [m].
        spacing: wanted distance of the nodes [m]; met up to rounding.
        relief: standard deviation of the rolling relief [m].
        roughness: standard deviation of the bumps below about 0.4 m [m].
        rng: source of randomness.

    Returns:
        The terrain; its height at the origin is zero.
    """
    n = round(2.0 * half / spacing) + 1
    axis = np.linspace(-half, half, n)
    x, y = np.meshgrid(axis, axis)
    rolling = spectral_noise(n, 2.6, rng)
    bumps = _high_pass(spectral_noise(n, 2.3, rng), spacing, 0.4)
    distance = np.hypot(x, y) / half
    rim = 0.28 * half * np.clip(distance - 0.62, 0.0, None) ** 1.5
    heights = relief * rolling + roughness * bumps + rim
    middle = n // 2
    return Terrain(heights - heights[middle, middle], half)


def _high_pass(field: FloatArray, spacing: float, wavelength: float) -> FloatArray:
    """Keep what is shorter than a wavelength [m]; standard deviation 1."""
    spectrum = np.fft.rfft2(field)
    n = len(field)
    frequency = np.hypot(np.fft.fftfreq(n, spacing)[:, None], np.fft.rfftfreq(n, spacing)[None, :])
    kept = spectrum * (1.0 - np.exp(-((frequency * wavelength) ** 2)))
    filtered = np.fft.irfft2(kept, s=field.shape)
    return np.asarray(filtered / filtered.std())


@dataclass(frozen=True)
class NaturalGroundConfig:
    """Parameters of a world with natural ground.

    Raises:
        ConfigError: a value is out of its range.
    """

    seed: int = parameter(7, "Seed of everything random in the world", low=0)
    spacing: float = parameter(
        0.035, "Distance of height field nodes", unit="m", low=0.01, high=0.5
    )
    relief: float = parameter(
        0.025, "Standard deviation of the floor's relief", unit="m", low=0.0, high=1.0
    )
    roughness: float = parameter(
        0.005, "Standard deviation of bumps below 0.4 m", unit="m", low=0.0, high=0.1
    )
    target_distance: float = parameter(
        1.6,
        "Distance of the board with tags from the start; 0 for none.",
        unit="m",
        low=0.0,
        high=10.0,
    )
    texture_size: int = parameter(
        2048, "Edge length of the ground texture", unit="px", low=64, high=8192
    )

    def __post_init__(self) -> None:
        """Validate all fields."""
        check_config(self)


def node_count(config: NaturalGroundConfig, half: float) -> int:
    """Nodes along an edge of the height field that reaches `half` [m] from its middle."""
    return round(2.0 * half / config.spacing) + 1


def uneven_floor(config: NaturalGroundConfig, n: int, rng: np.random.Generator) -> FloatArray:
    """Heights of a floor with relief and bumps, shape (n, n) [m]."""
    relief = config.relief * spectral_noise(n, 3.0, rng)
    return np.asarray(relief + config.roughness * spectral_noise(n, 1.6, rng))
