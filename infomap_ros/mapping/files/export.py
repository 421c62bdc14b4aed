"""The surface of a voxel map as a point cloud file for any viewer."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.mapping.voxel_map import VoxelMap

PLY_VERTEX = np.dtype(
    [
        *((name, "<f4") for name in ("x", "y", "z", "probability", "sigma")),
        *((name, "u1") for name in ("red", "green", "blue")),
    ]
)
"""One vertex of `write_ply`: position [m, map], occupancy probability, standard deviation along the
surface normal [m], color by height."""

_COLORS = np.array(  # dark blue, blue, green, yellow-green, yellow: of rising lightness
    [(68, 1, 84), (59, 82, 139), (33, 145, 140), (94, 201, 98), (253, 231, 37)], dtype=np.float64
)
_PLY_TYPES = {"<f4": "float", "|u1": "uchar"}


def write_ply(voxel_map: VoxelMap, path: str | Path) -> int:
    """Write the surface voxels as a binary PLY point cloud.

    Args:
        voxel_map: the map.
        path: file to write; one that is there is replaced.

    Returns:
        Number of vertices.

    Raises:
        OSError: the file cannot be written.
    """
    vertices = surface_vertices(voxel_map)
    properties = [
        f"property {_PLY_TYPES[PLY_VERTEX[name].str]} {name}" for name in PLY_VERTEX.names or ()
    ]
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment position in m, frame map; sigma in m along the surface normal; color by height",
        f"element vertex {len(vertices)}",
        *properties,
        "end_header",
    ]
    with Path(path).open("wb") as file:
        file.write("\n".join([*header, ""]).encode("ascii"))
        file.write(vertices.tobytes())
    return len(vertices)


def surface_vertices(voxel_map: VoxelMap) -> NDArray[np.void]:
    """Surface voxels as records of `PLY_VERTEX`, shape (K,)."""
    indices, means, covariances = voxel_map.gaussians()
    centers = (indices + 0.5) * voxel_map.config.voxel_size
    vertices = np.zeros(len(means), dtype=PLY_VERTEX)
    vertices["x"], vertices["y"], vertices["z"] = means.T
    vertices["probability"] = voxel_map.probability(centers)
    vertices["sigma"] = surface_sigmas(covariances)
    colors = height_colors(means[:, 2])
    vertices["red"], vertices["green"], vertices["blue"] = colors.T
    return vertices


def surface_sigmas(covariances: NDArray[np.float64]) -> NDArray[np.float64]:
    """Standard deviations along the surface normal, (K, 3, 3) [m^2] -> (K,) [m].

    The normal is where a surface voxel's Gaussian is thinnest.
    """
    sigmas = np.empty(len(covariances))
    _thinnest(np.ascontiguousarray(covariances, dtype=np.float64), sigmas)
    return sigmas


@njit(cache=True, nogil=True)
def _thinnest(covariances: Any, sigmas: Any) -> None:
    """Roots of the smallest eigenvalues, by the closed form for symmetric 3x3 matrices.

    O. K. Smith, "Eigenvalues of a symmetric 3 x 3 matrix", Communications of the ACM 4(4), 1961,
    https://doi.org/10.1145/355578.366316.
    """
    for row in range(len(covariances)):
        c = covariances[row]
        middle = (c[0, 0] + c[1, 1] + c[2, 2]) / 3.0
        x, y, z = c[0, 0] - middle, c[1, 1] - middle, c[2, 2] - middle
        a, b, d = c[1, 0], c[2, 0], c[2, 1]
        spread = math.sqrt((x * x + y * y + z * z + 2.0 * (a * a + b * b + d * d)) / 6.0)
        smallest = middle
        if spread > 0.0:
            determinant = x * (y * z - d * d) - a * (a * z - d * b) + b * (a * d - y * b)
            half = 0.5 * determinant / (spread * spread * spread)
            angle = math.acos(min(max(half, -1.0), 1.0)) / 3.0
            smallest += 2.0 * spread * math.cos(angle + 2.0 * math.pi / 3.0)
        sigmas[row] = math.sqrt(max(smallest, 0.0))


def height_colors(heights: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Colors from dark blue (low) to yellow (high), shape (K,) [m] -> (K, 3) RGB.

    The scale runs from the 1st to the 99th percentile, so that an outlier does not fade the rest.
    """
    if not len(heights):
        return np.zeros((0, 3), dtype=np.uint8)
    low, high = np.percentile(heights, [1.0, 99.0])
    share = np.clip((heights - low) / max(high - low, 1e-9), 0.0, 1.0)
    stops = np.linspace(0.0, 1.0, len(_COLORS))
    channels = [np.interp(share, stops, _COLORS[:, i]) for i in range(3)]
    return np.rint(np.stack(channels, axis=1)).astype(np.uint8)
