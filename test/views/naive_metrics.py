"""Slow and obvious oracles for the metrics of the paper as printed and of others."""

from __future__ import annotations

import math

import numpy as np

from infomap_ros.geometry import PinholeCamera
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.prediction import predict_unknown
from infomap_ros.studies.published_metrics import PROXIMITY_STEPS
from infomap_ros.views.information.printed_metrics import GRAY_LEVELS
from infomap_ros.views.information.view_query import InformationConfig

from .naive import entropy, image_cells

Cell = tuple[int, int, int]


def crossed(origin: np.ndarray, direction: np.ndarray, reach: float, size: float) -> list[Cell]:
    """Voxels that a ray crosses, in order, from where it meets the planes between voxels."""
    meets = [0.0, reach]
    for axis in range(3):
        a, b = sorted((origin[axis], origin[axis] + reach * direction[axis]))
        planes = np.arange(math.ceil(a / size), math.floor(b / size) + 1) * size
        meets.extend((planes - origin[axis]) / direction[axis])
    meets = np.sort(meets)
    middles = origin + direction * (0.5 * (meets[:-1] + meets[1:]))[:, None]
    longer = np.diff(meets) > 1e-12
    return [tuple(cell) for cell in np.floor(middles[longer] / size).astype(int).tolist()]


def rays_of(
    m: VoxelMap, pose: np.ndarray, camera: PinholeCamera, max_range: float, spacing: float
) -> list[tuple[float, list[tuple[Cell, bool, float]]]]:
    """Solid angle of each ray and its voxels (index, known, p) up to the first surface."""
    rays, size = [], m.config.voxel_size
    for direction, angle in image_cells(camera, spacing):
        cells = crossed(pose[:3, 3], pose[:3, :3] @ direction, max_range, size)
        centers = (np.array(cells) + 0.5) * size
        known, p = m.is_known(centers), m.probability(centers)
        voxels = list(zip(cells, known.tolist(), p.tolist(), strict=True))
        hits = np.flatnonzero(known & (p > 0.5))
        rays.append((angle, voxels[: hits[0] + 1] if len(hits) else voxels))
    return rays


def summed(
    m: VoxelMap,
    pose: np.ndarray,
    camera: PinholeCamera,
    max_range: float,
    config: InformationConfig,
    surfaces: np.ndarray,
) -> dict[str, float]:
    """The metrics of others; `surfaces` are the indices of all surface voxels, shape (n, 3)."""
    pixel = config.pixel_angle**2
    total = dict.fromkeys(
        ("occlusion_aware", "unobserved_voxels", "rear_side_voxel", "rear_side_entropy"), 0.0
    )
    near, entropies, voxel_count, first = 0.0, 0.0, 0.0, {"surface": 0.0, "unknown": 0.0}
    rays = rays_of(m, pose, camera, max_range, config.ray_spacing)
    for angle, voxels in rays:
        weight = angle / pixel
        seen = np.cumprod([1.0] + [1.0 - p for _, _, p in voxels])
        told = [v * entropy(p) for v, (_, _, p) in zip(seen, voxels, strict=False)]
        known = [is_known for _, is_known, _ in voxels]
        ends = known[-1] and voxels[-1][2] > 0.5
        total["occlusion_aware"] += weight * sum(told)
        total["unobserved_voxels"] += weight * sum(
            t for t, k in zip(told, known, strict=True) if not k
        )
        if ends and len(voxels) > 1 and not known[-2]:
            last_known = max((n for n in range(len(known) - 1) if known[n]), default=-1)
            total["rear_side_voxel"] += weight
            total["rear_side_entropy"] += weight * sum(told[last_known + 1 :])
        for cell, is_known, _ in voxels:
            if not is_known:
                steps = np.abs(surfaces - cell).sum(axis=1).min()
                near += weight * max(0, PROXIMITY_STEPS - int(steps))
        if ends:
            entropies += weight * sum(entropy(p) for _, _, p in voxels)
            voxel_count += weight * len(voxels)
        after = voxels[known.index(True) :] if any(known) else []
        kind = next(
            ("surface" if k else "unknown" for _, k, p in after if not k or p > 0.5), "nothing"
        )
        if kind in first:
            first[kind] += angle
    angles = sum(angle for angle, _ in rays)
    total["proximity_count"] = near
    total["average_entropy"] = entropies / voxel_count if voxel_count else 0.0
    total["area_factor"] = factor(first["surface"] / angles, 0.2) + factor(
        first["unknown"] / angles, 0.8
    )
    return total


def factor(x: float, wanted: float) -> float:
    """Cubics through (0, 0), (wanted, 1), (1, 0), flat at each; coefficients by a linear solve."""
    a, b, f_a, f_b = (0.0, wanted, 0.0, 1.0) if x <= wanted else (wanted, 1.0, 1.0, 0.0)
    matrix = [[1, t, t**2, t**3] for t in (a, b)] + [[0, 1, 2 * t, 3 * t**2] for t in (a, b)]
    coefficients = np.linalg.solve(matrix, [f_a, f_b, 0.0, 0.0])
    return float(np.polyval(coefficients[::-1], x))


def printed(
    m: VoxelMap,
    pose: np.ndarray,
    camera: PinholeCamera,
    max_range: float,
    config: InformationConfig,
) -> dict[str, float]:
    """Eqs. (7), (8) and (9), counting volume step by step along rays."""
    size, levels = m.config.voxel_size, GRAY_LEVELS
    steps = max(math.ceil(max_range / size), 64)
    length = max_range / steps
    window = m.window(
        *((bound + end) * size for bound, end in zip(m.bounds(), (0, 1), strict=True))
    )
    predicted = predict_unknown(window)
    shares = {(eq, known): np.zeros(levels) for eq in (7, 8) for known in (True, False)}
    whole = 0.0
    for direction, angle in image_cells(camera, config.ray_spacing):
        visible = True
        for n in range(steps):
            r = (n + 0.5) * length
            counts = r >= config.min_range
            volume = counts * angle * (((n + 1) * length) ** 3 - (n * length) ** 3) / 3.0
            whole += volume
            if not visible:
                continue
            point = (pose[:3, 3] + r * (pose[:3, :3] @ direction))[None]
            known, place = bool(m.is_known(point)[0]), window.positions_of(point)
            p = float(predicted[tuple(place[0])]) if window.contains(place)[0] else 0.5
            if not known:  # as exact as evidence is counted
                p = 1.0 / (1.0 + math.exp(-0.25 * round(math.log(p / (1.0 - p)) / 0.25)))
            shares[7, known][min(int(p * levels), levels - 1)] += volume
            stretch = 1.0 / (max(p, 1.0 - p) * r / max_range)
            gray = min((stretch - 1.0) / 2.0, 0.5)
            gray = gray if p < 0.5 else 1.0 - gray
            shares[8, known][min(int(gray * levels), levels - 1)] += volume
            visible = not (known and p > 0.5)
    weights = np.array([entropy((n + 0.5) / levels) for n in range(levels)])
    return {
        "scene_entropy": sum(_bits(shares[7, k] / whole) for k in (True, False)),
        "stretched_scene_entropy": sum(_bits(shares[8, k] / whole) for k in (True, False)),
        "weighted_scene_entropy": sum(_bits(shares[7, k] / whole, weights) for k in (True, False)),
    }


def _bits(q: np.ndarray, weights: np.ndarray | None = None) -> float:
    w = np.ones(len(q)) if weights is None else weights
    return -sum(a * b * math.log2(b) for a, b in zip(w, q, strict=True) if b > 0.0)
