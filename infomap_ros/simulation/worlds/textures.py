"""Procedural textures with contrast at every scale, so that stereo finds a match at any range.

All images tile without a seam and come from a random generator: same seed, same image.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.transforms import FloatArray

Image = NDArray[np.uint8]
Color = tuple[float, float, float]


def spectral_noise(size: int, exponent: float, rng: np.random.Generator) -> FloatArray:
    """Periodic noise whose amplitude spectrum falls as 1 / frequency^exponent.

    Args:
        size: edge length [px].
        exponent: 0 = white, 1 = equal contrast in every octave, above = smooth.
        rng: source of randomness.

    Returns:
        shape (size, size), mean 0, standard deviation 1.
    """
    spectrum = np.fft.rfft2(rng.standard_normal((size, size), dtype=np.float32))
    frequency = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None, :])
    frequency[0, 0] = np.inf
    noise = np.fft.irfft2(spectrum * frequency**-exponent, s=(size, size))
    return np.asarray(noise / noise.std())


def colorize(values: FloatArray, dark: Color, light: Color) -> Image:
    """Blend two colors by values of unit standard deviation; shape (H, W, 3), uint8 RGB."""
    blend = (0.5 + np.tanh(0.6 * values) * 0.5)[..., None]
    mixed = np.asarray(dark) * (1.0 - blend) + np.asarray(light) * blend
    return np.asarray(np.clip(255.0 * mixed, 0, 255), dtype=np.uint8)


def ground(size: int, rng: np.random.Generator) -> Image:
    """Sand with gravel of all sizes, each stone with a lit and a shaded side."""
    sand = 0.8 * spectral_noise(size, 1.1, rng) + 0.55 * spectral_noise(size, 0.35, rng)
    sand += _gravel(size, rng)
    return colorize(sand - 0.1, (0.26, 0.17, 0.12), (0.86, 0.66, 0.50))


def rock(size: int, rng: np.random.Generator, tint: Color = (1.0, 1.0, 1.0)) -> Image:
    """Weathered stone with grain, stains and veins."""
    veins = -1.2 * np.exp(-((spectral_noise(size, 1.6, rng) / 0.03) ** 2))
    grain = 0.9 * spectral_noise(size, 1.0, rng) + 0.5 * spectral_noise(size, 0.3, rng)
    dark, light = np.array((0.22, 0.19, 0.17)), np.array((0.80, 0.74, 0.68))
    return colorize(grain + veins, tuple(dark * tint), tuple(light * tint))


def bricks(size: int, rng: np.random.Generator, rows: int = 12, columns: int = 8) -> Image:
    """A wall of uneven blocks with light joints."""
    v, u = np.mgrid[0:size, 0:size] / size
    row = np.floor(v * rows).astype(int)
    along = u * columns + 0.5 * (row % 2) + 0.03 * spectral_noise(size, 1.6, rng)
    column = np.floor(along).astype(int) % columns
    shade = rng.normal(0.0, 0.9, (rows, columns))[row, column]
    joint = (np.abs(along % 1.0 - 0.5) > 0.47) | (np.abs((v * rows) % 1.0 - 0.5) > 0.44)
    grain = 0.6 * spectral_noise(size, 1.0, rng) + 0.5 * spectral_noise(size, 0.3, rng)
    return colorize(
        np.where(joint, 1.6, shade - 0.2) + grain, (0.24, 0.16, 0.14), (0.78, 0.68, 0.6)
    )


def crate(size: int, rng: np.random.Generator) -> Image:
    """A scratched equipment case with ribs and stripes."""
    v, u = np.mgrid[0:size, 0:size] / size
    ribs = 0.7 * np.sign(np.sin(2.0 * np.pi * 5.0 * u))
    edge = np.maximum(np.abs(u - 0.5), np.abs(v - 0.5)) > 0.44
    stripes = np.where(((u + v) * 14.0) % 1.0 < 0.5, 2.0, -2.0)
    grain = 0.7 * spectral_noise(size, 1.0, rng) + 0.5 * spectral_noise(size, 0.3, rng)
    return colorize(np.where(edge, stripes, ribs) + grain, (0.16, 0.20, 0.22), (0.82, 0.80, 0.70))


def solar_cells(size: int, rng: np.random.Generator, columns: int = 8, rows: int = 8) -> Image:
    """Dusty solar cells between bright leads."""
    v, u = np.mgrid[0:size, 0:size] / size
    cell_u, cell_v = (u * columns) % 1.0, (v * rows) % 1.0
    lead = (np.abs(cell_u - 0.5) > 0.46) | (np.abs(cell_v - 0.5) > 0.46)
    finger = np.abs((cell_v * 6.0) % 1.0 - 0.5) > 0.45
    shade = rng.normal(0.0, 0.25, (rows, columns))[
        (v * rows).astype(int), (u * columns).astype(int)
    ]
    dust = 0.8 * spectral_noise(size, 1.2, rng) + 0.5 * spectral_noise(size, 0.3, rng)
    value = np.where(lead, 1.8, np.where(finger, 0.2, -0.5 + shade)) + 0.6 * dust
    return colorize(value, (0.10, 0.13, 0.24), (0.80, 0.82, 0.86))


def worn_paint(size: int, rng: np.random.Generator) -> Image:
    """Bright paint with stains and chips, to be multiplied with a part's own color."""
    stains = 0.8 * spectral_noise(size, 1.1, rng) + 0.7 * spectral_noise(size, 0.3, rng)
    return colorize(stains + 0.8, (0.35, 0.34, 0.33), (1.0, 1.0, 1.0))


def carpet(size: int, rng: np.random.Generator) -> Image:
    """A worn carpet of colored fibres with stains."""
    fibres = 0.9 * spectral_noise(size, 0.25, rng) + 0.9 * spectral_noise(size, 0.9, rng)
    return colorize(fibres, (0.22, 0.26, 0.30), (0.74, 0.74, 0.72))


def plaster(size: int, rng: np.random.Generator) -> Image:
    """A wall with stains, scratches and scattered marks."""
    marks = -1.4 * np.exp(-((spectral_noise(size, 1.4, rng) / 0.05) ** 2))
    grain = 0.8 * spectral_noise(size, 1.0, rng) + 0.6 * spectral_noise(size, 0.35, rng)
    return colorize(grain + marks + 0.5, (0.34, 0.31, 0.28), (0.95, 0.93, 0.88))


def wood(size: int, rng: np.random.Generator) -> Image:
    """Boards with grain, knots and scratches."""
    v, _ = np.mgrid[0:size, 0:size] / size
    rings = np.sin(2.0 * np.pi * (14.0 * v + 0.9 * spectral_noise(size, 1.7, rng)))
    grain = 0.7 * spectral_noise(size, 1.0, rng) + 0.6 * spectral_noise(size, 0.35, rng)
    return colorize(0.6 * rings + grain, (0.26, 0.16, 0.09), (0.82, 0.62, 0.42))


def _gravel(size: int, rng: np.random.Generator) -> FloatArray:
    """Shaded stones of many sizes; the drawing wraps around the edges."""
    layer = np.zeros((size, size), np.float32)
    for radius, per_area in ((0.012, 90), (0.006, 700), (0.003, 3500)):
        for _ in range(per_area):
            _stone(layer, rng.uniform(0.5, 1.4) * radius * size, rng)
    return layer.astype(np.float64)


def _stone(layer: NDArray[np.float32], radius: float, rng: np.random.Generator) -> None:
    size = len(layer)
    u, v = rng.uniform(0, size, 2)
    axes = (max(1, round(radius)), max(1, round(radius * rng.uniform(0.5, 1.0))))
    angle, tone = rng.uniform(0, 180), rng.normal(0.0, 1.0)
    shift = 0.25 * radius
    for du in (-size, 0, size) if not radius < u < size - radius else (0,):
        for dv in (-size, 0, size) if not radius < v < size - radius else (0,):
            center = (round(u + du), round(v + dv))
            lit = (round(u + du - shift), round(v + dv - shift))
            inner = (max(1, round(0.7 * axes[0])), max(1, round(0.7 * axes[1])))
            cv2.ellipse(layer, center, axes, angle, 0, 360, tone - 1.2, cv2.FILLED)
            cv2.ellipse(layer, lit, inner, angle, 0, 360, tone + 0.6, cv2.FILLED)
