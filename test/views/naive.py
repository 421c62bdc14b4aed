"""Slow and obvious oracles for what views tell."""

from __future__ import annotations

import itertools
import math
from statistics import NormalDist

import numpy as np

from infomap_ros.geometry import PinholeCamera
from infomap_ros.mapping import VoxelMap
from infomap_ros.views.information.view_query import InformationConfig


def entropy(p: float) -> float:
    """Of a binary variable [bits]."""
    return -sum(q * math.log2(q) for q in (p, 1.0 - p) if q > 0.0)


def mutual_information(p: float, hit: float, miss: float) -> float:
    """Of a voxel and an observation that adds `hit` or `miss` [nats], from their joint table."""
    # Occupied and hit, occupied and missed, empty and hit, empty and missed: a p, (1 - a) p, ...
    matrix = np.array([[1.0, -math.exp(hit)], [1.0, -math.exp(miss)]])
    a, b = np.linalg.solve(matrix, [0.0, 1.0 - math.exp(miss)])
    joint = np.array([[a * p, (1.0 - a) * p], [b * (1.0 - p), (1.0 - b) * (1.0 - p)]])
    total = 0.0
    for voxel, observed in itertools.product(range(2), range(2)):
        share = joint[voxel, observed]
        if share > 0.0:
            total += share * math.log2(share / joint[voxel].sum() / joint[:, observed].sum())
    return total


def observed_share(m: VoxelMap, distance: float, config: InformationConfig) -> float:
    """Chance that a voxel at a distance is told what is in it."""
    size, correlation = m.config.voxel_size, m.config.error_correlation
    pixels = (size / (config.pixel_angle * distance)) ** 2
    variance = (config.range_noise * distance**config.range_exponent) ** 2
    variance *= correlation + (1.0 - correlation) / max(pixels, 1.0)
    normal = NormalDist(0.0, math.sqrt(variance))
    return min(pixels, 1.0) * (normal.cdf(0.5 * size) - normal.cdf(-0.5 * size))


def solid_angle(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
    """Of the triangle between three directions [sr] (doi:10.1109/TBME.1983.325207)."""
    a, b, c = (v / np.linalg.norm(v) for v in (a, b, c))
    return 2.0 * math.atan2(abs(a @ np.cross(b, c)), 1.0 + a @ b + b @ c + c @ a)


def image_cells(camera: PinholeCamera, spacing: float) -> list[tuple[np.ndarray, float]]:
    """Direction and solid angle of each cell of the image."""
    sides = [
        np.array([-0.5 - c, n - 0.5 - c]) / f
        for c, n, f in ((camera.cx, camera.width, camera.fx), (camera.cy, camera.height, camera.fy))
    ]
    x, y = (np.linspace(*side, math.ceil((side[1] - side[0]) / spacing) + 1) for side in sides)
    cells = []
    for j, i in itertools.product(range(len(y) - 1), range(len(x) - 1)):
        corners = [np.array([x[i + a], y[j + b], 1.0]) for a, b in ((0, 0), (1, 0), (1, 1), (0, 1))]
        angle = solid_angle(*corners[:3]) + solid_angle(corners[0], *corners[2:])
        middle = np.array([x[i] + x[i + 1], y[j] + y[j + 1], 2.0])
        cells.append((middle / np.linalg.norm(middle), angle))
    return cells


def voxel_gain(m: VoxelMap, known: bool, log_odds: float, config: InformationConfig) -> float:
    """Bits of a voxel that is surely observed."""
    p = 1.0 / (1.0 + math.exp(-log_odds)) if known else 0.5
    if known and not config.certain_probability <= p <= 1.0 - config.certain_probability:
        return 0.0
    weight = config.known_weight if known else 1.0
    return weight * mutual_information(p, 0.25 * m.config.hit_quanta, 0.25 * m.config.miss_quanta)


def clear_share(known: bool, log_odds: float, length: float, config: InformationConfig) -> float:
    """Chance that a ray through a voxel, in voxels, does not end there."""
    p = 1.0 / (1.0 + math.exp(-log_odds))
    if not known or p <= config.hiding_probability:
        return 1.0
    return 0.0 if p > 1.0 - config.certain_probability else (1.0 - p) ** length


def view_bits(
    m: VoxelMap,
    pose: np.ndarray,
    camera: PinholeCamera,
    max_range: float,
    config: InformationConfig,
    region: np.ndarray | None = None,
) -> float:
    """Expected entropy reduction of a view, step by step along every ray."""
    size = m.config.voxel_size
    steps = max(math.ceil(max_range / size), 64)
    length = max_range / steps
    total = 0.0
    for direction, angle in image_cells(camera, config.ray_spacing):
        distances = (np.arange(steps) + 0.5) * length
        points = pose[:3, 3] + distances[:, None] * (pose[:3, :3] @ direction)
        known, log_odds, visible = m.is_known(points), m.log_odds(points), 1.0
        for n, r in enumerate(distances):
            volume = angle * (((n + 1) * length) ** 3 - (n * length) ** 3) / 3.0 / size**3
            counts = r >= config.min_range
            if region is not None:
                counts &= bool((points[n] >= region[0]).all() and (points[n] <= region[1]).all())
            if counts:
                gain = voxel_gain(m, known[n], log_odds[n], config)
                total += visible * volume * gain * observed_share(m, r, config)
            visible *= clear_share(known[n], log_odds[n], length / size, config)
            if not known[n]:
                visible *= (1.0 - config.unknown_occlusion) ** (1.0 / steps)
            if visible < config.min_visibility:
                break
    return total
