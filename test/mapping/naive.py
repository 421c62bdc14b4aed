"""Slow and obvious oracles for the kernels of the voxel map."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from infomap_ros.geometry import PinholeCamera, invert_transform, skew

Voxel = tuple[int, int, int]

SIDE = 8
"""Voxels along the edge of a block."""

NEAREST_DEPTH = 1e-3
"""Voxels with their center nearer to the image plane than this are not looked at [m]."""

CLOSE = 4.0
"""Blocks nearer than this many voxels choose the pyramid level voxel by voxel."""

LONGEST_MARGIN = 20.0
"""Margin before a grazed surface, in times of that before one that is met squarely."""


class Verdict(NamedTuple):
    """What a scan says of some voxels.

    Attributes:
        indices: shape (n, 3).
        free: whether the scan sees through each voxel, shape (n,).
        clear: whether rounding cannot change that, shape (n,).
    """

    indices: np.ndarray
    free: np.ndarray
    clear: np.ndarray


def measured_depths(
    points: np.ndarray,
    camera: PinholeCamera,
    T_map_camera: np.ndarray,
    max_range: float,
    sigmas: float,
    covariance: np.ndarray,
    pose_covariance: np.ndarray,
) -> np.ndarray:
    """Depth up to which each pixel sees, shape (H, W) [m]; NaN where nothing is measured.

    The deviation of range and position along the line of sight is that of the usable pixel nearest
    to the middle of its tile of 8 x 8 pixels.
    """
    points = points.astype(np.float64)
    z = points[..., 2]
    norm = np.linalg.norm(points, axis=-1)
    usable = np.isfinite(points).all(axis=-1) & (z > 0.0)
    depths = np.full(z.shape, np.nan)
    for v0, u0 in itertools.product(range(0, camera.height, 8), range(0, camera.width, 8)):
        tile = [
            (v, u)
            for v in range(v0, min(v0 + 8, camera.height))
            for u in range(u0, min(u0 + 8, camera.width))
            if usable[v, u]
        ]
        if not tile:
            continue
        middle = min(tile, key=lambda p: (p[0] - v0 - 3.6) ** 2 + (p[1] - u0 - 3.7) ** 2)
        sight = points[middle] / norm[middle]
        in_map = T_map_camera[:3, :3] @ sight
        variance = sight @ covariance @ sight + in_map @ pose_covariance[:3, :3] @ in_map
        margin = sigmas * np.sqrt(variance) * sight[2]
        for pixel in tile:
            beyond = norm[pixel] > max_range
            depths[pixel] = z[pixel] * max_range / norm[pixel] if beyond else z[pixel] - margin
    return depths


def pyramid(depths: np.ndarray) -> list[np.ndarray]:
    """Levels of cells of 2, 4, 8, ... pixels: the depth up to which a cell sees, -inf = unmeasured.

    A cell of 2 x 2 pixels is measured where one of its pixels is, a larger cell where two
    thirds of its area are; it sees as far as its shortest-sighted measured pixel.
    """
    levels: list[np.ndarray] = []
    nearest, share = np.where(np.isnan(depths), np.inf, depths), ~np.isnan(depths)
    while not levels or max(nearest.shape) > 1:
        cells = [(slice(2 * v, 2 * v + 2), slice(2 * u, 2 * u + 2))
                 for v in range((nearest.shape[0] + 1) // 2)
                 for u in range((nearest.shape[1] + 1) // 2)]  # fmt: skip
        shape = (nearest.shape[0] + 1) // 2, (nearest.shape[1] + 1) // 2
        together = np.mean if levels else np.max
        nearest, share = (
            np.array([nearest[cell].min() for cell in cells]).reshape(shape),
            np.array([float(together(share[cell])) for cell in cells]).reshape(shape),
        )
        levels.append(np.where(share >= 2.0 / 3.0, nearest, -np.inf))
    return levels


def neighborhoods(level: np.ndarray) -> np.ndarray:
    """Smallest value of each cell and its eight neighbors within the image."""
    padded = np.pad(level, 1, constant_values=np.inf)
    shifts = itertools.product(range(3), range(3))
    height, width = level.shape
    return np.min([padded[v : v + height, u : u + width] for v, u in shifts], axis=0)


def level_of(extent: float, levels: int) -> int:
    """Lowest level whose cells are at least `extent` pixels wide, or the highest there is."""
    wide_enough = (level for level in range(levels) if 2.0 ** (level + 1) >= extent)
    return next(wide_enough, levels - 1)


def seen_through(
    depths: np.ndarray,
    camera: PinholeCamera,
    T_map_camera: np.ndarray,
    size: float,
    max_range: float,
) -> Verdict:
    """Free voxels of an organized scan, by the rule of `infomap_ros.mapping.scans.free_space`."""
    levels = [neighborhoods(level) for level in pyramid(depths)]
    corners = np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * size
    T_camera_map = invert_transform(T_map_camera)
    far_side = float((corners @ T_camera_map[2, :3]).max())
    local = np.array(list(itertools.product(range(SIDE), repeat=3)))
    verdicts = []
    for block in _frustum_blocks(camera, T_map_camera, size * SIDE, max_range):
        indices = block * SIDE + local
        centers = (indices + 0.5) * size @ T_camera_map[:3, :3].T + T_camera_map[:3, 3]
        nearest = centers[:, 2].min()
        depth_of_level = centers[:, 2] if nearest < CLOSE * size else np.full(SIDE**3, nearest)
        free, clear = np.zeros(SIDE**3, bool), np.ones(SIDE**3, bool)
        for n, (x, y, z) in enumerate(centers):
            if z <= NEAREST_DEPTH:
                continue
            u = camera.fx * x / z + camera.cx + 0.5
            v = camera.fy * y / z + camera.cy + 0.5
            clear[n] = min(abs(u - round(u)), abs(v - round(v))) > 1e-7
            if not (0.0 <= u < camera.width and 0.0 <= v < camera.height):
                continue
            extent = np.sqrt(0.75) * size * max(camera.fx, camera.fy) / depth_of_level[n]
            level = level_of(extent, len(levels))
            sees = levels[level][int(v) >> (level + 1), int(u) >> (level + 1)]
            free[n] = sees > z + far_side
            clear[n] &= abs(sees - z - far_side) > 1e-5
        verdicts.append((indices, free, clear))
    return Verdict(*(np.concatenate(part) for part in zip(*verdicts, strict=True)))


def _frustum_blocks(
    camera: PinholeCamera, T_map_camera: np.ndarray, edge: float, max_range: float
) -> list[np.ndarray]:
    u, v = np.array([-0.5, camera.width - 0.5]), np.array([-0.5, camera.height - 0.5])
    x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    corners = [np.zeros(3), *(np.array([a, b, 1.0]) * max_range for a in x for b in y)]
    corners = np.array(corners) @ T_map_camera[:3, :3].T + T_map_camera[:3, 3]
    low, high = np.floor(corners.min(axis=0) / edge), np.floor(corners.max(axis=0) / edge)
    ranges = [range(int(a) - 1, int(b) + 2) for a, b in zip(low, high, strict=True)]
    return [np.array(block) for block in itertools.product(*ranges)]


def crossings(
    start: np.ndarray, end: np.ndarray, indices: np.ndarray, size: float
) -> tuple[np.ndarray, np.ndarray]:
    """Shares of the way from start to end at which the line enters and leaves each voxel.

    Args:
        start: shape (3,) [m].
        end: shape (3,) [m].
        indices: shape (n, 3).
        size: [m].

    Returns:
        enter (n,) and leave (n,); enter >= leave where the line misses the voxel.
    """
    direction = end - start
    with np.errstate(divide="ignore", invalid="ignore"):
        a = (indices * size - start) / direction
        b = ((indices + 1) * size - start) / direction
    return np.minimum(a, b).max(axis=1), np.maximum(a, b).min(axis=1)


def voxels_around(start: np.ndarray, end: np.ndarray, size: float) -> np.ndarray:
    """All voxels of the box around a line, shape (n, 3)."""
    low = np.floor(np.minimum(start, end) / size).astype(int) - 1
    high = np.floor(np.maximum(start, end) / size).astype(int) + 2
    grids = np.meshgrid(*(np.arange(a, b) for a, b in zip(low, high, strict=True)), indexing="ij")
    return np.stack(grids, axis=-1).reshape(-1, 3)


def crossed_before(start: np.ndarray, end: np.ndarray, size: float, margin: float) -> set[Voxel]:
    """Voxels that a ray has left when it still has `margin` to go [m], that of `end` excepted."""
    indices = voxels_around(start, end, size)
    enter, leave = crossings(start, end, indices, size)
    length = float(np.linalg.norm(end - start))
    crossed = (np.maximum(enter, 0.0) < leave) & (leave <= 1.0 - margin / length)
    crossed &= (indices != np.floor(end / size)).any(axis=1)
    return {tuple(index) for index in indices[crossed].tolist()}


def ray_distance(
    origin: np.ndarray, direction: np.ndarray, occupied: np.ndarray, size: float
) -> float:
    """Distance at which a ray enters the first of the occupied voxels, (n, 3), or inf [m]."""
    enter, leave = crossings(origin, origin + direction, occupied, size)
    met = np.maximum(enter, 0.0) < leave
    return float(np.maximum(enter[met], 0.0).min(initial=np.inf) * np.linalg.norm(direction))


def merged(means: list[np.ndarray], covariances: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Eq. (4) of Sujan and Dubowsky (2005), pairwise: K = C1 (C1 + C2)^-1, C = C1 - K C1."""
    mean, covariance = means[0], covariances[0]
    for other_mean, other in zip(means[1:], covariances[1:], strict=True):
        gain = covariance @ np.linalg.inv(covariance + other)
        mean = mean + gain @ (other_mean - mean)
        covariance = covariance - gain @ covariance
    return mean, covariance


def point_covariance(
    rotation: np.ndarray,
    arm: np.ndarray,
    covariance: np.ndarray,
    pose_covariance: np.ndarray,
    normal: np.ndarray,
    size: float,
) -> np.ndarray:
    """Covariance of one observation of a voxel, shape (3, 3) [m^2].

    Args:
        rotation: of T_map_sensor, shape (3, 3).
        arm: mean of the points relative to the sensor, map frame [m].
        covariance: of the mean in the sensor frame, shape (3, 3) [m^2].
        pose_covariance: shape (6, 6).
        normal: of the surface, map frame.
        size: of a voxel [m].
    """
    jacobian = np.hstack([np.eye(3), -skew(arm)])
    total = rotation @ covariance @ rotation.T + jacobian @ pose_covariance @ jacobian.T
    along = normal @ total @ normal
    across = max(along, size**2 / 12.0)
    plane = np.outer(normal, normal)
    return np.asarray(along * plane + across * (np.eye(3) - plane))
